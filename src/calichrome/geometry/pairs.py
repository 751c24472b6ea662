"""Two cameras: where one is from the other."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import (
    Adjustment,
    Free,
    PlanarView,
    Scene,
    Sightings,
    adjust,
    rms_px,
    whitened_residuals,
)
from calichrome.geometry.intrinsics import CameraSolution

__all__ = ["PairSolution", "solve_pair"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairSolution:
    """The motion between two cameras.

    Parameters
    ----------
    b_from_a
        Moves points of camera a's frame into camera b's.
    cov : (6, 6) float or None
        Of (omega, tau) as `Pose` defines them: rad, m. Holds the noise of the pair's own corners
        and the uncertainty of both lenses; None where either leaves a direction open.
    rms_px
        Root mean square 2-D distance over both cameras, lenses fixed.
    n_shared
        Frames that both cameras see.
    """

    b_from_a: Pose
    cov: FloatArray | None
    rms_px: float
    n_shared: int


def solve_pair(
    views_a: Mapping[str, PlanarView],
    views_b: Mapping[str, PlanarView],
    camera_a: CameraSolution,
    camera_b: CameraSolution,
    poses_a: Mapping[str, Pose],
    poses_b: Mapping[str, Pose],
) -> PairSolution:
    """Estimate b_from_a from the frames that both see, lenses fixed (Levenberg-Marquardt).

    Parameters
    ----------
    views_a, views_b
        Views by frame; only shared frames count.
    camera_a, camera_b
        The cameras' own solutions.
    poses_a, poses_b
        cam_from_board of each frame from the camera's own solution: the start.

    Raises
    ------
    SolveError
        If no frame is shared, or none of them gives a start with the board before both cameras.
    """
    shared = [frame for frame in views_a if frame in views_b]
    if not shared:
        raise SolveError("the two cameras share no frame")
    sightings = Sightings.collect(
        [(0, index, views_a[frame]) for index, frame in enumerate(shared)]
        + [(1, index, views_b[frame]) for index, frame in enumerate(shared)]
    )
    lenses = camera_a.lens, camera_b.lens
    boards = tuple(poses_a[frame] for frame in shared)
    free = Free(np.zeros((2, 9), dtype=bool), np.array([False, True]))
    solved: list[Adjustment] = []
    for start in _starts([poses_b[frame] @ poses_a[frame].inverse() for frame in shared]):
        try:
            scene = Scene(lenses, (Pose.identity(), start), boards)
            solved.append(adjust(sightings, scene, free))
        except ValueError:
            continue  # this start puts a board behind camera b
    if not solved:
        raise SolveError(
            "no motion between the two cameras puts the boards before both; check that equal frame "
            "names mean equal instants"
        )
    best = min(solved, key=lambda item: item.variance)
    return PairSolution(
        b_from_a=best.scene.cams_from_ref[1],
        cov=_covariance(sightings, best, camera_a, camera_b),
        rms_px=rms_px(best.residuals_px),
        n_shared=len(shared),
    )


def _starts(motions: list[Pose]) -> list[Pose]:
    """Return the motion that most frames agree on, then the mean of all."""
    turns = np.stack([motion.rotation for motion in motions])
    agreement = np.einsum("aij,bij->ab", turns, turns)  # trace of the relative rotation
    central = motions[int(np.argmax(np.median(agreement, axis=1)))]
    return [central] if len(motions) == 1 else [central, Pose.mean(motions)]


def _covariance(
    sightings: Sightings, solved: Adjustment, camera_a: CameraSolution, camera_b: CameraSolution
) -> FloatArray | None:
    """Covariance of b_from_a: its own noise, and what the lenses pass on.

    At the minimum J'r = 0, so a change dl of the fixed lenses moves the pair's unknowns by
    dp = -(Jp'Jp)^-1 Jp' Jl dl. Lens noise and corner noise are taken as independent.
    """
    if solved.covariance is None or camera_a.lens_cov is None or camera_b.lens_cov is None:
        return None
    everything = Free(np.ones((2, 9), dtype=bool), np.array([False, True]))
    _, jacobian = whitened_residuals(sightings, solved.scene, everything)
    by_lens, own = jacobian[:, :18], jacobian[:, 18:]
    response = -(solved.covariance / solved.variance) @ (own.T @ by_lens)
    lens_cov = np.zeros((18, 18))
    lens_cov[:9, :9], lens_cov[9:, 9:] = camera_a.lens_cov, camera_b.lens_cov
    total = solved.covariance + response @ lens_cov @ response.T
    return np.asarray(total[:6, :6])
