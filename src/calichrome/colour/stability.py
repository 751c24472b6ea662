"""What a colour model does where no disc was: numbers that decide whether it may be used."""

from dataclasses import dataclass

import numpy as np

from calichrome.colorimetry.description import difference
from calichrome.colour.model import ColourModel
from calichrome.colour.models.linear import LinearWhite
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.core.arrays import FloatArray

__all__ = ["EXPOSURES", "Stability", "judge_stability"]

EXPOSURES = (0.25, 0.5, 2.0, 4.0)
"""Of what was calibrated: two stops either way."""

_EXPOSURE = 0.05  # mean dE over the sweep: a twentieth of what the best models miss anyway; chosen
_WHITE = 0.3  # dE: whites are compared side by side, where a third of a dE is seen; chosen
_GAIN = 8.0
"""Times what a matrix stretches differences. On 47 cameras and 3 lights root-polynomials of degree
3 that keep white have up to 6, free ones 20 to 5000, which turns noise into colour; chosen between.
"""
_LATTICE = 9  # nodes along an edge of the camera cube: more find no larger gains
_INSIDE = 2000  # colours within the hull of the discs
_GREYS = 256  # steps of the grey ramp
_CUBE = 1.25  # balanced: the brightest channel of a camera whose white is at 80 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Stability:
    """How a model behaves away from the discs.

    Parameters
    ----------
    exposure_delta_e
        Mean difference between correcting a disc and correcting it at another exposure, scaled
        back.
    gain
        Largest stretch of a small camera difference over the camera cube, relative to white and to
        the same of a matrix that keeps white (1.2 to 2.6 for most cameras, 17 where the channels
        hardly differ).
    white_delta_e
        By how much white is missed, in the description space.
    grey_monotone
        Whether brighter greys stay brighter, in X, Y and Z.
    hue_reversals
        Share of colours within the hull of discs, white and black about which the map turns hues
        the other way round (its Jacobian's determinant is not positive).
    farthest
        Distance of the cube's farthest colour from the nearest disc, relative to white: how much of
        what the camera can show is guessed.
    """

    exposure_delta_e: float
    gain: float
    white_delta_e: float
    grey_monotone: bool
    hue_reversals: float
    farthest: float

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the model must not be chosen; empty if it may."""
        found = []
        if not np.isfinite(self.gain) or self.gain > _GAIN:
            found.append(f"stretches differences {self.gain:.0f} times as far as a matrix")
        if self.exposure_delta_e > _EXPOSURE:
            found.append(f"changes by {self.exposure_delta_e:.2f} dE with exposure")
        if self.white_delta_e > _WHITE:
            found.append(f"misses white by {self.white_delta_e:.1f} dE")
        if not self.grey_monotone:
            found.append("greys do not rise")
        if self.hue_reversals > 0:
            found.append("reverses hues")
        return tuple(found)


def judge_stability(model: ColourModel, pairs: ColourPairs) -> Stability:
    """Probe a model around the colours it was fitted to."""
    matrix, _ = fit_terms(LinearWhite, pairs)
    return Stability(
        exposure_delta_e=_exposure(model, pairs),
        gain=_largest_gain(model, pairs) / _largest_gain(matrix, pairs),
        white_delta_e=_white(model, pairs),
        grey_monotone=_greys_rise(model, pairs),
        hue_reversals=_reversals(model, pairs),
        farthest=_farthest(pairs),
    )


def _exposure(model: ColourModel, pairs: ColourPairs) -> float:
    here = model.apply(pairs.rgb)
    changes = [
        difference(model.apply(factor * pairs.rgb) / factor, here, pairs.space, pairs.adopted_white)
        for factor in EXPOSURES
    ]
    return float(np.mean(changes))


def _largest_gain(model: ColourModel, pairs: ColourPairs) -> float:
    edge = np.linspace(0.0, _CUBE, _LATTICE)
    lattice = np.stack(np.meshgrid(edge, edge, edge), axis=-1).reshape(-1, 3)
    jacobian = model.jacobian(lattice * pairs.white_rgb)
    relative = jacobian / pairs.white_xyz[:, None] * pairs.white_rgb
    if not np.isfinite(relative).all():
        return float("inf")
    return float(np.linalg.norm(relative, ord=2, axis=(-2, -1)).max())


def _white(model: ColourModel, pairs: ColourPairs) -> float:
    corrected = model.apply(pairs.white_rgb)
    return float(difference(corrected, pairs.white_xyz, pairs.space, pairs.adopted_white))


def _greys_rise(model: ColourModel, pairs: ColourPairs) -> bool:
    ramp = np.linspace(0.0, _CUBE, _GREYS)[:, None] * pairs.white_rgb
    return bool((np.diff(model.apply(ramp), axis=0) > 0).all())


def _reversals(model: ColourModel, pairs: ColourPairs) -> float:
    corners = np.concatenate([pairs.balanced, np.ones((1, 3)), np.zeros((1, 3))])
    # few corners with large shares: most colours then lie near the hull's faces, not in its middle
    shares = np.random.default_rng(0).dirichlet(np.full(len(corners), 0.1), _INSIDE)
    jacobian = model.jacobian((shares @ corners) * pairs.white_rgb)
    return float(np.mean(~(np.linalg.det(jacobian) > 0)))


def _farthest(pairs: ColourPairs) -> float:
    edge = np.linspace(0.0, _CUBE, _LATTICE)
    lattice = np.stack(np.meshgrid(edge, edge, edge), axis=-1).reshape(-1, 1, 3)
    away: FloatArray = np.linalg.norm(lattice - pairs.balanced, axis=-1)
    return float(away.min(axis=1).max())
