"""A matrix for each hue: colours of one hue stay in one plane, whatever their chroma and level."""

from typing import ClassVar

import numpy as np

from calichrome.colour.model import TermModel
from calichrome.core.arrays import FloatArray

__all__ = ["HuePlane", "HuePlane2"]

_OPPONENT = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3), -np.sqrt(3)]])
_CHROMA = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])


def _hue(balanced: FloatArray, n_waves: int) -> tuple[FloatArray, FloatArray]:
    """Cos and sin of 1..n times the hue, (..., 2n), and d / d balanced, (..., 2n, 3); 0 on grey."""
    opponent = balanced @ _OPPONENT.T
    radius = np.linalg.norm(opponent, axis=-1, keepdims=True)
    is_grey = radius == 0
    unit = np.where(is_grey, 0.0, opponent / np.where(is_grey, 1.0, radius))
    turning = np.stack([-unit[..., 1], unit[..., 0]], axis=-1) / np.where(is_grey, np.inf, radius)
    by_balanced = turning @ _OPPONENT  # d hue / d balanced
    angle = unit[..., 0] + 1j * unit[..., 1]
    waves, slopes = [], []
    for order in range(1, n_waves + 1):
        power = angle**order
        waves += [power.real, power.imag]
        slopes += [-order * power.imag[..., None] * by_balanced]
        slopes += [order * power.real[..., None] * by_balanced]
    return np.stack(waves, axis=-1), np.stack(slopes, axis=-2)


class HuePlane(TermModel):
    """The matrix varies with hue as a Fourier series of one wave; white is kept.

    Within a half plane of one hue (bounded by the grey axis) the matrix is one and the same, so
    exposure, shading and mixing with white leave the corrected hue plane as it is.

    References
    ----------
    .. [1] M. Mackiewicz, C. F. Andersen, G. D. Finlayson, "Method for hue plane preserving color
       correction", JOSA A 33 (11), 2016 (the idea; they join sectors, here the matrix is smooth).
    """

    __slots__ = ()
    MODEL: ClassVar[str] = "hue-plane"
    N_WAVES: ClassVar[int] = 1
    MIN_COLOURS: ClassVar[int] = 6
    N_SHRUNK: ClassVar[int] = 4

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R - G, B - G, then both times cos and sin of the hue."""
        chroma = balanced @ _CHROMA.T
        waves, _ = _hue(balanced, cls.N_WAVES)
        varied = waves[..., :, None] * chroma[..., None, :]
        return np.concatenate([chroma, varied.reshape(*chroma.shape[:-1], -1)], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        chroma = balanced @ _CHROMA.T
        waves, by_balanced = _hue(balanced, cls.N_WAVES)
        varied = (
            waves[..., :, None, None] * _CHROMA
            + by_balanced[..., :, None, :] * chroma[..., None, :, None]
        )
        lead = chroma.shape[:-1]
        first = np.broadcast_to(_CHROMA, (*lead, 2, 3))
        return np.concatenate([first, varied.reshape(*lead, -1, 3)], axis=-2)


class HuePlane2(HuePlane):
    """The same with two waves."""

    __slots__ = ()
    MODEL: ClassVar[str] = "hue-plane-2"
    N_WAVES: ClassVar[int] = 2
    MIN_COLOURS: ClassVar[int] = 10
    N_SHRUNK: ClassVar[int] = 8
