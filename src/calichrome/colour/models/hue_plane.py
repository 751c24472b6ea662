"""A matrix for each hue: colours of one hue stay in one plane, whatever their chroma and level."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calichrome.colour.model import TermModel
from calichrome.core.arrays import FloatArray

__all__ = ["HuePlane", "HuePlane2"]

_OPPONENT = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3), -np.sqrt(3)]])
_CHROMA = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])

_Phasors = NDArray[np.complex128]


class HuePlane(TermModel):
    """The matrix varies with hue as a Fourier series of one wave; white is kept.

    Within a half plane of one hue (bounded by the grey axis) the matrix is one and the same, so
    exposure, shading and mixing with white leave the corrected hue plane as it is.

    Notes
    -----
    With the opponent signals (r cos h, r sin h) of a colour, a matrix is a + b cos h + c sin h
    times r, and one whose entries vary as cos h and sin h adds r, r cos 2h and r sin 2h: products
    of two waves are waves of the sum and of the difference. Each further wave k adds r cos (k+1) h
    and r sin (k+1) h alone.

    References
    ----------
    .. [1] M. Mackiewicz, C. F. Andersen, G. D. Finlayson, "Method for hue plane preserving color
       correction", JOSA A 33 (11), 2016 (the idea; they join sectors, here the matrix is smooth).
    """

    __slots__ = ()
    MODEL: ClassVar[str] = "hue-plane"
    MIN_COLOURS: ClassVar[int] = 5
    N_SHRUNK: ClassVar[int] = 3
    ORDERS: ClassVar[tuple[int, ...]] = (2,)

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R - G, B - G, r, then r cos kh and r sin kh of each order k."""
        phasor = _phasor(balanced)
        radius = np.abs(phasor)
        waves = [radius * _unit(phasor) ** order for order in cls.ORDERS]
        varied = [part for wave in waves for part in (wave.real, wave.imag)]
        return np.concatenate([balanced @ _CHROMA.T, np.stack([radius, *varied], -1)], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        unit = _unit(_phasor(balanced))[..., None]
        by_phasor = _OPPONENT[0] + 1j * _OPPONENT[1]
        along = unit.conj() * by_phasor  # dr + i r dh
        rows = [along.real]
        for order in cls.ORDERS:
            wave = unit**order * (along.real + 1j * order * along.imag)
            rows += [wave.real, wave.imag]
        first = np.broadcast_to(_CHROMA, (*balanced.shape[:-1], 2, 3))
        return np.concatenate([first, np.stack(rows, axis=-2)], axis=-2)


class HuePlane2(HuePlane):
    """The same with two waves."""

    __slots__ = ()
    MODEL: ClassVar[str] = "hue-plane-2"
    MIN_COLOURS: ClassVar[int] = 7
    N_SHRUNK: ClassVar[int] = 5
    ORDERS: ClassVar[tuple[int, ...]] = (2, 3)


def _phasor(balanced: FloatArray) -> _Phasors:
    """Opponent signals as complex numbers r exp(ih), (...)."""
    opponent = balanced @ _OPPONENT.T
    return np.asarray(opponent[..., 0] + 1j * opponent[..., 1])


def _unit(
    phasor: _Phasors,
) -> _Phasors:
    """Return exp(ih); 0 on grey, where there is no hue."""
    radius = np.abs(phasor)
    return np.asarray(np.where(radius == 0, 0.0, phasor / np.where(radius == 0, 1.0, radius)))
