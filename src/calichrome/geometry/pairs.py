"""Two cameras: where one is from the other."""

from collections.abc import Iterable, Mapping, Sequence
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
from calichrome.geometry.lenses import BrownConrady

__all__ = ["PairSolution", "covariance_of_errors", "solve_pair"]

Seen = tuple[Mapping[str, PlanarView], Mapping[str, Pose]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairSolution:
    """The motion between two cameras.

    Parameters
    ----------
    b_from_a
        Moves points of camera a's frame into camera b's.
    errors : side, frame -> (6, k) float, or None
        How (omega, tau), rad and m as `Pose` defines them, answer to independent unit errors: of
        the corners of camera a (side 0) or b (side 1) in a frame, and of its lens (frame None).
        Pairs that share a camera share these errors. None where the data leave a direction open.
    rms_px
        Root mean square 2-D distance over both cameras, lenses fixed.
    n_shared
        Frames that both cameras see.
    """

    b_from_a: Pose
    errors: Mapping[tuple[int, str | None], FloatArray] | None
    rms_px: float
    n_shared: int

    @property
    def cov(self) -> FloatArray | None:
        """Covariance of (omega, tau), (6, 6): noise of the corners and of both lenses."""
        return None if self.errors is None else covariance_of_errors(self.errors.values())


def covariance_of_errors(responses: Iterable[FloatArray]) -> FloatArray:
    """Add up what independent unit errors do, (6, k) each, to a covariance (6, 6)."""
    return sum((response @ response.T for response in responses), np.zeros((6, 6)))


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
        errors=_errors(
            shared, sightings, best, (camera_a, camera_b), ((views_a, poses_a), (views_b, poses_b))
        ),
        rms_px=rms_px(best.residuals_px),
        n_shared=len(shared),
    )


def _starts(motions: list[Pose]) -> list[Pose]:
    """Return the motion that most frames agree on, then the mean of all."""
    turns = np.stack([motion.rotation for motion in motions])
    agreement = np.einsum("aij,bij->ab", turns, turns)  # trace of the relative rotation
    central = motions[int(np.argmax(np.median(agreement, axis=1)))]
    return [central] if len(motions) == 1 else [central, Pose.mean(motions)]


def _errors(
    frames: Sequence[str],
    sightings: Sightings,
    solved: Adjustment,
    cameras: tuple[CameraSolution, CameraSolution],
    seen: tuple[Seen, Seen],
) -> dict[tuple[int, str | None], FloatArray] | None:
    """Respond to the noise of every view, and to what the lenses pass on.

    At the minimum Jp'r = 0, so noise dr of the corners and a change dl of the fixed lenses move
    the pair's unknowns by dp = -(Jp'Jp)^-1 Jp' (dr + Jl dl).

    Both come from the same corners and still do not correlate: dl answers only to noise that no
    board pose can follow, and the columns of Jp in one view are motions of that view's board. For
    the same reason the noise of a view acts through six numbers, its part along these motions.
    """
    if solved.covariance is None:
        return None
    everything = Free(np.ones((2, 9), dtype=bool), np.array([False, True]))
    _, jacobian = whitened_residuals(sightings, solved.scene, everything)
    by_lens, own = jacobian[:, :18], jacobian[:, 18:]
    response = -(solved.covariance[:6] / solved.variance) @ own.T
    errors: dict[tuple[int, str | None], FloatArray] = {}
    start = 0
    for side, (camera, (views, poses)) in enumerate(zip(cameras, seen, strict=True)):
        if camera.lens_cov is None:
            return None
        columns = slice(9 * side, 9 * side + 9)
        errors[side, None] = response @ by_lens[:, columns] @ _root(camera.lens_cov)
        for frame in frames:
            stop = start + 2 * len(views[frame].pixels)
            motions = _board_motions(views[frame], camera.lens, poses[frame])
            errors[side, frame] = np.sqrt(solved.variance) * response[:, start:stop] @ motions
            start = stop
    return errors


def _board_motions(view: PlanarView, lens: BrownConrady, cam_from_board: Pose) -> FloatArray:
    """Orthonormal basis (2N, 6) of how the whitened corners of a view follow its board."""
    scene = Scene((lens,), (Pose.identity(),), (cam_from_board,))
    _, jacobian = whitened_residuals(Sightings.collect([(0, 0, view)]), scene, Free.only_boards(1))
    return np.asarray(np.linalg.qr(jacobian)[0])


def _root(cov: FloatArray) -> FloatArray:
    """Return R with R R' = cov; fixed parameters have zero rows, so Cholesky would fail."""
    scale = np.sqrt(np.where(np.diag(cov) > 0, np.diag(cov), 1.0))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0)))
