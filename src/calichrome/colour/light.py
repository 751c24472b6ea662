"""How bright each place of a view was, read from the white squares beside the discs."""

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["light_at"]

_ROUNDS = 3  # of reweighting: it only has to sort out single squares, not to converge
_HUBER = 2.0  # robust sigmas beyond which a white reading loses weight (a shadow, a misread square)


def light_at(positions: FloatArray, white_rgb: FloatArray) -> FloatArray:
    """Smooth the levels of the white squares of one view and return them at the same places.

    Parameters
    ----------
    positions : (M, 2) float
        Where the levels were read; any unit.
    white_rgb : (M, 3) float
        Linear levels; nan where unknown.

    Returns
    -------
    (M, 3) float
        A quadratic surface through the known levels, per channel (a plane for fewer than 12, their
        median for fewer than 6); nan everywhere if there are none.

    Notes
    -----
    Light of a lamp and the fall-off of a lens are smooth over a board; a quadratic takes both up:
    docs/decisions/0003-light-before-colour.md has the measurement.
    """
    known = np.isfinite(white_rgb).all(axis=1)
    if not known.any():
        return np.full_like(white_rgb, np.nan)
    scale = max(float(np.ptp(positions[known], axis=0).max()), 1e-12)
    x, y = ((positions - positions[known].mean(axis=0)) / scale).T
    terms = [np.ones_like(x), x, y, x * x, x * y, y * y]
    n_known = int(known.sum())
    design = np.stack(terms[: 6 if n_known >= 12 else 3 if n_known >= 6 else 1], axis=1)
    if design.shape[1] == 1:
        return np.broadcast_to(np.median(white_rgb[known], axis=0), white_rgb.shape).copy()
    weights = np.ones(n_known)
    surface = np.empty_like(white_rgb)
    for _ in range(_ROUNDS):
        weighted = design[known] * weights[:, None]
        solution, *_ = np.linalg.lstsq(weighted, white_rgb[known] * weights[:, None], rcond=None)
        surface = design @ solution
        # one weight for all channels: a shadow darkens all three
        error = np.abs(white_rgb[known] / np.maximum(surface[known], 1e-9) - 1).max(axis=1)
        sigma = max(1.4826 * float(np.median(error)), 1e-9)
        weights = np.sqrt(np.minimum(1, _HUBER * sigma / np.maximum(error, 1e-12)))
    return surface
