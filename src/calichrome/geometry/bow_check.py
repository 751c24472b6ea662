"""What it costs to take a bowed board for flat."""

from dataclasses import dataclass, replace

import numpy as np

from calichrome.errors import SolveError
from calichrome.geometry.comparison import projection_difference
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.geometry.uncertainty import projection_sigma_px
from calichrome.target import Target

__all__ = ["BowCheck", "bow_left_out"]

_SURE = 5.0  # sigmas of the sagitta from which a bow is a fact
_MATTERS = 1.5  # sigmas of projection by which it must shift the result, 1.8 times the stated error
# in all; choices


@dataclass(frozen=True, slots=True, kw_only=True)
class BowCheck:
    """A bow that was left out.

    Parameters
    ----------
    sagitta_m
        Highest minus lowest point of the board.
    shift_sigmas
        By how much projections shift, root mean square over the pictures, in their own sigma.
    matters
        True if the bow is certain and shifts the result beyond its uncertainty.
    """

    sagitta_m: float
    shift_sigmas: float
    matters: bool


def bow_left_out(flat: RigSolution, target: Target, settings: RigSettings) -> BowCheck | None:
    """Solve again with a bow, and compare; None where that cannot be told."""
    try:
        bowed = solve_rig(flat.dataset, target, replace(settings, warp=True, start=flat))
    except SolveError:
        return None
    bow = bowed.bow_m(target.corners_board)
    if bow is None:
        return None
    sagitta_m, sigma_m = bow
    shifts = []
    for camera, lens in bowed.lenses.items():
        cov, size_wh = bowed.lens_cov[camera], flat.dataset.sizes_wh[camera]
        if cov is None or not cov.any():
            continue
        difference, _ = projection_difference(flat.lenses[camera], lens, size_wh)
        sigma = projection_sigma_px(lens, cov, size_wh)
        shifts.append(np.nanmean((difference**2).sum(axis=1)) / np.nanmean(sigma**2))
    shift = float(np.sqrt(max(shifts))) if shifts else 0.0
    return BowCheck(
        sagitta_m=sagitta_m,
        shift_sigmas=shift,
        matters=sagitta_m > _SURE * sigma_m and shift > _MATTERS,
    )
