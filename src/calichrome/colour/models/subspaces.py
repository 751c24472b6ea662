"""Local matrices: one for each region of chromaticity, blended smoothly."""

from typing import ClassVar

import numpy as np

from calichrome.colour.model import TermModel
from calichrome.colour.models.root_polynomial import RootPolynomial2White
from calichrome.core.arrays import FloatArray

__all__ = ["Subspaces", "SubspacesRoot"]

_CENTRES = np.array([[2.0, 0.5, 0.5], [0.5, 2.0, 0.5], [0.5, 0.5, 2.0]])
"""Reddish, greenish and bluish regions about grey (1, 1, 1), channels over their mean: the corners
of what the discs of a ColorChecker reach."""
_WIDTH = 1.0
"""Of a region, in the same unit, about half the distance of the centres. On the Munsell chips 0.5
is worse by 0.08 dE (by 0.17 with noise), 1.2 better by 0.004 (0.06) but hardly local."""
_CHROMA = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])


def _shares(balanced: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share of each region (..., 3), the grey one left out, and d / d balanced (..., 3, 3)."""
    # of sizes, since noise below black may bring the mean to 0; black gets the share of grey
    mean = np.abs(balanced).mean(axis=-1, keepdims=True)
    safe = np.where(mean > 0, mean, 1.0)
    relative = np.where(mean > 0, balanced / safe, 1.0)
    centres = np.concatenate([_CENTRES, np.ones((1, 3))])
    away = relative[..., None, :] - centres
    bells = np.exp(-0.5 * (away**2).sum(axis=-1) / _WIDTH**2)
    total = np.maximum(bells.sum(axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    shares = bells / total
    pull = -away / _WIDTH**2
    average = (shares[..., None] * pull).sum(axis=-2, keepdims=True)
    by_relative = shares[..., None] * (pull - average)
    by_balanced = np.where(
        (mean > 0)[..., None],
        (
            by_relative
            - (by_relative * relative[..., None, :]).sum(-1, keepdims=True)
            * np.sign(balanced)[..., None, :]
            / 3
        )
        / safe[..., None],
        0.0,
    )
    return shares[..., :3], by_balanced[..., :3, :]


class Subspaces(TermModel):
    """A matrix for greys and what each of three regions adds to it; white is kept."""

    __slots__ = ()
    MODEL: ClassVar[str] = "subspaces"
    MIN_COLOURS: ClassVar[int] = 8
    N_SHRUNK: ClassVar[int] = 6

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R - G, B - G, then both times the share of each region."""
        chroma = balanced @ _CHROMA.T
        shares, _ = _shares(balanced)
        local = shares[..., :, None] * chroma[..., None, :]
        return np.concatenate([chroma, local.reshape(*chroma.shape[:-1], 6)], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        chroma = balanced @ _CHROMA.T
        shares, by_balanced = _shares(balanced)
        local = (
            shares[..., :, None, None] * _CHROMA
            + by_balanced[..., :, None, :] * chroma[..., None, :, None]
        )
        lead = chroma.shape[:-1]
        first = np.broadcast_to(_CHROMA, (*lead, 2, 3))
        return np.concatenate([first, local.reshape(*lead, 6, 3)], axis=-2)


class SubspacesRoot(TermModel):
    """The regions' matrices and the roots of degree 2 together; white is kept.

    On the Munsell chips 0.01 dE better than either alone, as both are drawn towards a matrix: the
    discs decide which of them bends.
    """

    __slots__ = ()
    MODEL: ClassVar[str] = "subspaces-root"
    MIN_COLOURS: ClassVar[int] = 11
    N_SHRUNK: ClassVar[int] = 9

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """Those of `RootPolynomial2White`, then the regions'."""
        roots, local = RootPolynomial2White.terms(balanced), Subspaces.terms(balanced)
        return np.concatenate([roots, local[..., 2:]], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        roots, local = RootPolynomial2White.slopes(balanced), Subspaces.slopes(balanced)
        return np.concatenate([roots, local[..., 2:, :]], axis=-2)
