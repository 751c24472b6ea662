"""What lies between a chart and its picture besides colour: stray light, and a lamp at one side.

A chart of a ColorChecker's kind has no white beside every patch, so both are told by the patches
themselves: the camera's values are taken as

    rgb = (1 + g . place) N xyz + veil,

with a matrix N for the camera. That is coarse (no camera is a matrix) but enough to tell the two,
and they are taken out only if colours that were left out are then predicted better.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["DISAGREES", "ChartLight", "agreeing", "find_light"]

DISAGREES = 15.0
"""dE2000 by which a patch may miss what the others predict by a matrix. Of 51 cameras under 3
lights with 0.5 % noise no patch of the ColorChecker is left out by more than 14.6, one in a hundred
by more than 5.3."""
_DRAWS = 600  # of four patches each: with 40 % of them wrong, 78 draws are free of these on average
_DRAWN = 4  # patches: a matrix needs three, one more steadies it
_SEARCHES = 10  # of who agrees with whom: it settles after 2 or 3
_ROUNDS = 30  # of matrix, then light: settles to 1e-6 in 5 to 10
_SETTLED = 1e-6
_MISFIT = 0.05  # relative error of camera values beside a matrix, and
_FLOOR = 0.02  # of white, added: dark patches count, but not for their last bit
_SIMPLER = 0.25  # standard errors of the paired difference; DESIGN's rule for models
_NEEDED = 12
"""Patches for telling light from colour: 14 numbers are fitted to three values of each."""
_DARKEST = 0.2
"""Of the middle's light: below, the light is no plane. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChartLight:
    """What has to be taken from a picture of a chart.

    Parameters
    ----------
    veil_rgb : (3,) float
        Linear camera value that lies on everything: stray light or a black level; zeros if the
        chart does not tell any.
    slope : (2,) float
        Relative change of light per unit of place; zeros if the light is even.
    """

    veil_rgb: FloatArray
    slope: FloatArray

    @classmethod
    def none(cls) -> "ChartLight":
        """Even light and no veil."""
        return cls(veil_rgb=np.zeros(3), slope=np.zeros(2))

    def at(self, places: FloatArray) -> FloatArray:
        """Light at places (N, 2) relative to that at the origin, (N,)."""
        return np.asarray(np.maximum(1 + places @ self.slope, _DARKEST))

    def removed(self, rgb: FloatArray, places: FloatArray) -> FloatArray:
        """Camera values (N, 3) as they would be in even light and without a veil."""
        return np.asarray((rgb - self.veil_rgb) / self.at(places)[:, None])


def find_light(pairs: ColourPairs, places: FloatArray) -> ChartLight:
    """Choose between nothing, a veil, a slope of light, and both.

    Parameters
    ----------
    pairs
        Patches as read; all are believed.
    places : (N, 2) float
        Of the patches on the chart, about its middle; all alike: the light is taken as even.

    Notes
    -----
    Chosen like a colour model: the smallest leave-one-out error of a matrix, and the simplest of
    those that are not surely worse. On the Munsell chips (9 pairs of camera and light, 0.5 %
    noise) that turns 1.46 dE2000 into 1.20 if the light falls off by 40 % over the chart, 5.0 into
    1.4 if a veil of 5 % lies on it, and costs 0 to 0.16 if there is neither.
    """
    if len(pairs) < _NEEDED:
        return ChartLight.none()
    kinds = [(False, False), (True, False)]
    if _spread(places):
        kinds += [(False, True), (True, True)]
    errors = [_left_out(pairs, places, veiled=veiled, sloped=sloped) for veiled, sloped in kinds]
    best = min(errors, key=lambda error: float(error.mean()))
    for (veiled, sloped), error in zip(kinds, errors, strict=True):
        paired = error - best
        if paired.mean() <= _SIMPLER * paired.std(ddof=1) / np.sqrt(len(pairs)):
            return _solve(pairs, places, veiled=veiled, sloped=sloped)[1]
    raise AssertionError


def agreeing(pairs: ColourPairs, places: FloatArray) -> BoolArray:
    """Tell which patches one camera can have seen, (N,).

    The largest group is searched that agrees on a matrix, from many draws of a few patches, then
    widened by all that agree with its matrix, veil and light.
    """
    n = len(pairs)
    rng = np.random.default_rng(0)
    drawn = rng.permuted(np.tile(np.arange(n), (_DRAWS, 1)), axis=1)[:, :_DRAWN]
    matrices = np.linalg.pinv(pairs.balanced[drawn]) @ pairs.xyz[drawn]
    errors = np.minimum(pairs.difference(pairs.balanced @ matrices), DISAGREES)
    agree: BoolArray = errors[errors.sum(axis=1).argmin()] < DISAGREES
    for _ in range(_SEARCHES):
        if agree.sum() < _NEEDED:
            break
        inverse, light = _solve(pairs[agree], places[agree], veiled=True, sloped=_spread(places))
        predicted = light.removed(pairs.rgb, places) @ inverse
        now = pairs.difference(predicted) < DISAGREES
        if (now == agree).all():
            break
        agree = now
    return agree


def _spread(places: FloatArray) -> bool:
    return bool(np.ptp(places, axis=0).min() > 0)


def _left_out(pairs: ColourPairs, places: FloatArray, *, veiled: bool, sloped: bool) -> FloatArray:
    everything = np.arange(len(pairs))
    predicted = np.empty_like(pairs.xyz)
    for row in everything:
        kept = everything != row
        inverse, light = _solve(pairs[kept], places[kept], veiled=veiled, sloped=sloped)
        predicted[row] = light.removed(pairs.rgb[[row]], places[[row]])[0] @ inverse
    return pairs.difference(predicted)


def _solve(
    pairs: ColourPairs, places: FloatArray, *, veiled: bool, sloped: bool
) -> tuple[FloatArray, ChartLight]:
    """Return the matrix from light-free camera values to XYZ, and the light."""
    rgb, xyz = pairs.rgb, pairs.xyz
    sigma = _MISFIT * (np.abs(rgb) + _FLOOR * pairs.white_rgb)
    variances = np.diagonal(pairs.rgb_cov, axis1=1, axis2=2)
    weight = 1 / np.sqrt(sigma**2 + variances)
    slope, veil = np.zeros(2), np.zeros(3)
    for _ in range(_ROUNDS if sloped else 1):
        lit = xyz * (1 + places @ slope)[:, None]
        design = np.concatenate([lit, np.ones((len(rgb), 1))], axis=1) if veiled else lit
        solution = np.stack(
            [
                np.linalg.lstsq(design * w[:, None], values * w, rcond=None)[0]
                for values, w in zip(rgb.T, weight.T, strict=True)
            ],
            axis=1,
        )
        seen = xyz @ solution[:3]
        if veiled:
            veil = solution[3]
        if not sloped:
            break
        steps = (seen * weight)[:, :, None] * places[:, None, :]
        left = (rgb - veil - seen) * weight
        before = slope
        slope = np.linalg.lstsq(steps.reshape(-1, 2), left.ravel(), rcond=None)[0]
        if np.abs(slope - before).max() < _SETTLED:
            break
    light = ChartLight(veil_rgb=veil, slope=slope)
    even = light.removed(rgb, places)
    # back from camera to XYZ, weighed as a fit would
    factors = np.sqrt(np.trace(pairs.whitening, axis1=1, axis2=2))[:, None]
    matrix = np.linalg.lstsq(even * factors, xyz * factors, rcond=None)[0]
    return matrix, light
