"""Radial curves: where they cease to rise, and their inverse up to there."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

from calichrome.core.arrays import FloatArray

__all__ = ["first_fold", "first_positive_root", "invert_rising", "unit_cubic"]

Curve = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
_ROUNDING = 4 * np.finfo(np.float64).eps
_MAX_STEPS = 200  # bisection alone needs 53 + the doublings of the bracket


def unit_cubic(
    a: FloatArray, b: FloatArray, c: FloatArray, s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return 1 + a s + b s^2 + c s^3 and its slope by s."""
    # in place, for this is the inner loop: value = 1 + s h, h = a + s (b + s c),
    # slope = h + s (b + 2 s c)
    slope = c * s
    value = slope + b
    slope += value
    slope *= s
    value *= s
    value += a
    slope += value
    value *= s
    value += 1
    return value, slope


def first_positive_root(coefficients: FloatArray) -> float:
    """Return the smallest x > 0 where sum coefficients[i] x^i, positive at 0, is 0; inf if none."""
    # np.roots wants the highest power first: in this order its roots are 1/x, and it is the
    # coefficient of 1/x^n that must not vanish, which is the value at 0
    inverses = np.roots(coefficients)
    inverses = inverses.real[(inverses.imag == 0) & (inverses.real > 0)]
    return float(1 / inverses.max()) if len(inverses) else np.inf


@lru_cache(maxsize=256)  # of lenses in use; the roots take as long as some thousand points
def first_fold(numerator: tuple[float, ...], denominator: tuple[float, ...], taken: float) -> float:
    """Return the radius at which a radial bend no longer holds against another one; inf if never.

    Parameters
    ----------
    numerator, denominator
        Coefficients by rising powers of s = r^2 of the factor g(s) = numerator / denominator, both
        1 at the axis.
    taken
        What the other bend may take away from d(r g)/dr and from g, per unit of r.

    Returns
    -------
    float
        The first r > 0 where d(r g)/dr or g sinks to taken * r, or where g has a pole.
    """
    r = Polynomial([0.0, 1.0])
    upper, lower = Polynomial(numerator)(r * r), Polynomial(denominator)(r * r)
    rise = (r * upper).deriv() * lower - r * upper * lower.deriv()
    ends = lower, rise - taken * r * lower**2, upper - taken * r * lower
    return min(first_positive_root(np.asarray(end.coef)) for end in ends)


def invert_rising(curve: Curve, values: FloatArray, end: float) -> FloatArray:
    """Solve curve(x) = values for x in [0, end) by Newton's method inside a shrinking bracket.

    Parameters
    ----------
    curve
        Returns value and slope; rises from curve(0) = 0 up to `end`, without bound if that is inf.
    values : (N,) float
        Not negative; nan gives nan.
    end
        Where the curve ceases to rise.

    Returns
    -------
    (N,) float
        nan where the curve does not reach the value before `end`.
    """
    found: FloatArray = np.full(values.shape, np.nan)
    todo = np.flatnonzero(np.isfinite(values))
    if np.isfinite(end):
        todo = todo[~(values[todo] >= curve(np.array([end]))[0])]  # nan: a pole, beyond any value
        high = np.full(len(todo), end)
    else:
        high = np.ones(len(todo))
        while (short := curve(high)[0] < values[todo]).any():
            high[short] *= 2
    values = values[todo]
    low, x = np.zeros(len(todo)), np.minimum(values, high / 2)
    change = high
    for _ in range(_MAX_STEPS):
        if not len(todo):
            break
        value, slope = curve(x)
        error = value - values
        low, high = np.where(error <= 0, x, low), np.where(error >= 0, x, high)
        ahead = x - error / slope
        done = (np.minimum(np.abs(ahead - x), high - low) <= _ROUNDING * x) | (
            np.abs(error) <= _ROUNDING * values
        )
        inside = (ahead > low) & (ahead < high)
        found[todo[done]] = np.where(inside, ahead, x)[done]
        # Newton's steps must shrink: they may circle without ever leaving the bracket
        newton = inside & (np.abs(ahead - x) < change / 2)
        ahead = np.where(newton, ahead, (low + high) / 2)
        change = np.abs(ahead - x)[~done]
        todo, values = todo[~done], values[~done]
        low, high, x = low[~done], high[~done], ahead[~done]
    return found
