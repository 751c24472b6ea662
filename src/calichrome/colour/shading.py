"""What a lens lets through at each place of its picture.

Two cameras that look at one board in one instant see the same light on it. Whatever lamps there
are, the ratio of their white readings at a disc depends on their two lenses alone, on their
exposures, and, weakly, on how the colour of the light changes over the board. The lenses' fall-off
is fixed to the pictures and follows from such ratios without any model of the light. One camera
alone cannot tell its lens from its lamp.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["N_RADIAL", "Vignetting", "shading_terms"]

N_RADIAL = 3
"""Even powers of the radius: on the light fall-off cos^p of p <= 5 of rendered pictures three leave
less than 0.1 % (two: 0.1 %, one: 1 %)."""
_N_TERMS = N_RADIAL + 2


def shading_terms(places: FloatArray) -> FloatArray:
    """Return r^2, r^4, r^6, u, v of places (..., 2) in half diagonals, (..., 5)."""
    squared = (places**2).sum(axis=-1, keepdims=True)
    return np.concatenate([squared, squared**2, squared**3, places], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Vignetting:
    """Share of light that reaches each place of a picture, relative to its centre.

    ``log gain = c1 r^2 + c2 r^4 + c3 r^6 + c4 u + c5 v`` per channel, with (u, v) the place in half
    diagonals of the picture from `centre_px` and r its length.

    Parameters
    ----------
    centre_px : (2,) float
        Where the gain is 1: the foot of the optical axis.
    half_diagonal_px
        The unit of u, v and r.
    coefficients : (3, 5) float
        Of R, G, B.
    covariance : (3, 5, 5) float
        Of each channel's coefficients.
    covered_radius
        In half diagonals. Beyond, where nothing was measured, the log of the gain goes on along its
        tangent over r^2, but never rises.
    """

    centre_px: FloatArray
    half_diagonal_px: float
    coefficients: FloatArray
    covariance: FloatArray
    covered_radius: float

    def __post_init__(self) -> None:
        for name, shape in (
            ("centre_px", (2,)),
            ("coefficients", (3, _N_TERMS)),
            ("covariance", (3, _N_TERMS, _N_TERMS)),
        ):
            object.__setattr__(self, name, frozen(checked(getattr(self, name), shape, name)))
        if not (self.half_diagonal_px > 0 and self.covered_radius > 0):
            raise ValueError(
                f"half_diagonal_px={self.half_diagonal_px}, covered_radius={self.covered_radius}: "
                f"both must be positive"
            )

    def gain(self, pixels: FloatArray) -> FloatArray:
        """Return the gain at pixels (..., 2), (..., 3): positive everywhere, 1 at the centre."""
        places = (np.asarray(pixels) - self.centre_px) / self.half_diagonal_px
        radius = np.linalg.norm(places, axis=-1, keepdims=True)
        within = np.minimum(1, self.covered_radius / np.maximum(radius, 1e-12))
        logs = shading_terms(places * within) @ self.coefficients.T
        edge = self.covered_radius ** (2 * np.arange(N_RADIAL))
        slope = self.coefficients[:, :N_RADIAL] @ (np.arange(1, N_RADIAL + 1) * edge)
        beyond = np.maximum(radius**2 - self.covered_radius**2, 0)
        return np.asarray(np.exp(logs + np.minimum(slope, 0) * beyond))

    def gain_map(self, size_wh: tuple[int, int]) -> FloatArray:
        """Return the gain at every pixel of a picture, (H, W, 3)."""
        x, y = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
        return self.gain(np.stack([x, y], axis=-1).astype(np.float64))

    def sigma(self, pixels: FloatArray) -> FloatArray:
        """Return the relative standard deviation of `gain`, (..., 3).

        It is 0 at the centre, where the gain is 1 by definition, and grows without bound outside
        the covered radius.
        """
        places = (np.asarray(pixels) - self.centre_px) / self.half_diagonal_px
        terms = shading_terms(places)
        variance = np.einsum("...i,kij,...j->...k", terms, self.covariance, terms)
        return np.asarray(np.sqrt(np.maximum(variance, 0)))

    def to_json(self) -> dict[str, object]:
        """Numbers for rig.json."""
        return {
            "model": "radial-log",
            "centre_px": self.centre_px.tolist(),
            "half_diagonal_px": self.half_diagonal_px,
            "coefficients": self.coefficients.tolist(),
            "covariance": self.covariance.tolist(),
            "covered_radius": self.covered_radius,
        }

    @classmethod
    def from_json(cls, entry: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""

        def numbers(name: str) -> FloatArray:
            return np.asarray(entry[name], dtype=np.float64)

        return cls(
            centre_px=numbers("centre_px"),
            half_diagonal_px=float(numbers("half_diagonal_px")),
            coefficients=numbers("coefficients"),
            covariance=numbers("covariance"),
            covered_radius=float(numbers("covered_radius")),
        )
