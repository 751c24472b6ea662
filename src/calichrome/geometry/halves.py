"""Two halves of the frames, solved apart, and whether they differ as they say."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import SolveError
from calichrome.geometry.comparison import LensDifference, compare_lenses
from calichrome.geometry.rig_solution import RigSolution
from calichrome.observations import Dataset

__all__ = ["Halves", "compare_halves"]

_FEWEST_FRAMES = 8  # four in each half; a choice: with fewer, a lens hangs on single views


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """Even and odd frames.

    Parameters
    ----------
    solutions
        Of the frames at even, and at odd positions.
    lenses
        camera -> difference of projection after the best rotation; cameras that one half leaves
        open are absent.
    """

    solutions: tuple[RigSolution, RigSolution]
    lenses: Mapping[str, LensDifference]

    def ratio(self, camera: str) -> float | None:
        """Difference over what both covariances predict; None if a half leaves the lens open.

        Its square times the effective number of lens parameters is nearly a chi-square of that many
        degrees, so it is about 1 if the covariances are true, and above 1 if they are too small.
        """
        found = self.lenses.get(camera)
        return None if found is None else found.ratio

    def position_sigmas(self, camera: str) -> FloatArray | None:
        """Difference of the position cam_from_ref in combined sigmas, (3,).

        None if a half leaves it open, and for the reference camera.
        """
        first, second = self.solutions
        covs = first.pose_cov[camera], second.pose_cov[camera]
        if covs[0] is None or covs[1] is None or not covs[0].any():
            return None
        apart = second.cams_from_ref[camera].trans_m - first.cams_from_ref[camera].trans_m
        return np.asarray(apart / np.sqrt(np.diag(covs[0] + covs[1])[3:]))


def compare_halves(dataset: Dataset, solve: Callable[[Dataset], RigSolution]) -> Halves | None:
    """Solve both halves of the frames and compare their lenses.

    Parameters
    ----------
    dataset
        All frames.
    solve
        Solves some of the frames, from the solution of all.

    Returns
    -------
    Halves or None
        None where there are too few frames, or a half does not determine a solution.

    References
    ----------
    .. [1] D. Kogan, mrcal, "How to run a calibration": cross-validation of two halves.
    """
    frames = dataset.frames
    if len(frames) < _FEWEST_FRAMES:
        return None
    try:
        solutions = (
            solve(dataset.without_frames(frozenset(frames[1::2]))),
            solve(dataset.without_frames(frozenset(frames[::2]))),
        )
    except SolveError:
        return None
    differences = {}
    for camera in dataset.cameras:
        covs = solutions[0].lens_cov[camera], solutions[1].lens_cov[camera]
        if covs[0] is not None and covs[1] is not None and covs[0].any():  # or all is fixed
            differences[camera] = compare_lenses(
                solutions[0].lenses[camera],
                solutions[1].lenses[camera],
                dataset.sizes_wh[camera],
                covs=(covs[0], covs[1]),
            )
    return Halves(solutions, differences)
