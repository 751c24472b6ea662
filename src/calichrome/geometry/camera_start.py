"""Where to begin with one camera: its lens, and the board in each of its views.

Nothing is assumed of the focal length or of the corners' being right: homographies are fitted by
reweighting, several lenses compete, and of the two places that a small tilted plane may have, each
view keeps both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.board_pose import pose_from_homography
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.lenses import Lens

__all__ = ["CameraStart", "PlacedView", "mirrored_place", "place_views", "start_camera"]

_REWEIGHTINGS = 12
_FOCALS = (0.35, 0.6, 1.0, 1.7, 3.0, 5.0)
"""Focal lengths to try, over the picture's larger side: 110 to 11 degrees of view. Neighbours
differ by 1.7, inside the factor of 2 to 2.5 from which a solve was seen to return."""
_HUBER_PX = 1.0
_FIRST_ITERATIONS = 8
_SECOND_ITERATIONS = 25
_ROBUST = 3.0  # of the median residual: where a reweighted homography stops trusting a corner


@dataclass(frozen=True, slots=True, eq=False)
class PlacedView:
    """The places of the board that one view allows, best first.

    Parameters
    ----------
    cams_from_board
        One or two poses.
    errors_px
        Median 2-D residual of each.
    """

    cams_from_board: tuple[Pose, ...]
    errors_px: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CameraStart:
    """A lens near the solution and a place for every view."""

    lens: Lens
    views: tuple[PlacedView, ...]


def robust_homography(source: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit H although some points lie: least squares, reweighted by the median residual.

    Parameters
    ----------
    source, target : (N, 2) float
        Matching points, N >= 4.

    Returns
    -------
    homography : (3, 3) float
    weights : (N,) float
        Near 0 for points that lie.

    References
    ----------
    .. [1] P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted
       least-squares", Comm. Stat. A 6 (9), 1977 (Cauchy weights).
    """
    weights = np.ones(len(source))
    homography = fit_homography(source, target)
    if len(source) < 6:
        return homography, weights  # too few to tell who lies
    for _ in range(_REWEIGHTINGS):
        errors = np.linalg.norm(apply_homography(homography, source) - target, axis=1)
        scale = max(float(np.median(errors)), 1e-9 * float(np.ptp(target)))
        weights = 1 / (1 + (errors / (_ROBUST * scale)) ** 2)
        homography = fit_homography(source, target, weights)
    return homography, weights


def start_camera(
    views: Sequence[ObservedView],
    points_board: FloatArray,
    size_wh: tuple[int, int],
    model: type[Lens],
    *,
    fixed: dict[str, float] | None = None,
    lens: Lens | None = None,
) -> CameraStart:
    """Find a lens and the board's places from the views of one camera.

    Parameters
    ----------
    views
        Of this camera; at least one.
    points_board : (n, 3) float, metres
        All corners of the board.
    size_wh
        Picture size, pixels.
    model
        Lens model.
    fixed
        Lens parameters that keep their value, by name.
    lens
        A lens near the solution; None: closed form and a ladder of focal lengths.

    Raises
    ------
    SolveError
        If no lens explains the views even roughly.
    """
    fixed = fixed or {}
    fits = [robust_homography(points_board[view.corner_ids, :2], view.pixels) for view in views]
    weights = [weight for _, weight in fits]
    own = [replace(view, camera=0, frame=index) for index, view in enumerate(views)]
    observations = Observations.pack(own, points_board, [model], len(views))
    candidates = (
        [lens]
        if lens is not None
        else [
            _with(model, model.start(size_wh, focal), fixed)
            for focal in _focals([homography for homography, _ in fits], size_wh)
        ]
    )
    tried: list[tuple[float, BundleState]] = []
    for candidate in candidates:
        poses = _poses(views, weights, points_board, candidate)
        state = None if poses is None else _solved(observations, candidate, poses, fixed)
        if state is not None:
            tried.append((_error_px(observations, state), state))
    if not tried:
        raise SolveError(
            "no lens explains the views even roughly; check that the pictures are of one camera "
            "and that the target is described rightly"
        )
    tried.sort(key=lambda item: item[0])
    finished = [_finished(observations, state, points_board, fixed) for _, state in tried[:2]]
    best = min(finished, key=lambda item: _error_px(observations, item))
    return CameraStart(best.lenses[0], place_views(views, points_board, best.lenses[0]))


def _finished(
    observations: Observations,
    state: BundleState,
    points_board: FloatArray,
    fixed: dict[str, float],
) -> BundleState:
    """Free the whole lens, and mend views that sit in their mirrored place."""
    free = _free(state, fixed, distortion=True)
    for _ in range(2):
        state = solve_bundle(
            observations, state, free, huber=_HUBER_PX,
            max_iterations=_SECOND_ITERATIONS, relative_decrease=1e-6,
        ).state  # fmt: skip
        other = _settled(observations, _mirrored(state, points_board))
        own_errors, other_errors = (
            _view_errors(observations, state),
            _view_errors(observations, other),
        )
        better = other_errors < 0.9 * own_errors  # a tenth: both are at the same minimum otherwise
        if not better.any():
            break
        state = replace(
            state,
            board_rotations=np.where(
                better[:, None, None], other.board_rotations, state.board_rotations
            ),
            board_trans_m=np.where(better[:, None], other.board_trans_m, state.board_trans_m),
        )
    return state


def place_views(
    views: Sequence[ObservedView], points_board: FloatArray, lens: Lens
) -> tuple[PlacedView, ...]:
    """Find both places of the board in each view, the lens being known."""
    own = [replace(view, camera=0, frame=index) for index, view in enumerate(views)]
    observations = Observations.pack(own, points_board, [type(lens)], len(views))
    weights = [
        robust_homography(points_board[view.corner_ids, :2], view.pixels)[1] for view in views
    ]
    poses = _poses(views, weights, points_board, lens)
    if poses is None:
        raise SolveError("a view lies outside what its lens can see")
    start = BundleState.build([lens], [Pose.identity()], poses, BoardShape.flat(points_board))
    first = _settled(observations, start)
    second = _settled(observations, _mirrored(first, points_board))
    errors = np.stack([_view_errors(observations, first), _view_errors(observations, second)])
    placed = []
    for index, pair in enumerate(zip(first.ref_from_boards, second.ref_from_boards, strict=True)):
        order = np.argsort(errors[:, index])
        placed.append(
            PlacedView(
                tuple(pair[place] for place in order),
                tuple(float(errors[place, index]) for place in order),
            )
        )
    return tuple(placed)


def mirrored_place(cam_from_board: Pose, middle: FloatArray) -> Pose:
    """Return the other place of a plane that looks nearly the same.

    The board is turned about its middle until its normal lies as far on the other side of the line
    of sight: to first order in size over distance both project alike.

    References
    ----------
    .. [1] D. Oberkampf, D. DeMenthon, L. Davis, "Iterative Pose Estimation Using Coplanar Feature
       Points", CVIU 63 (3), 1996.
    """
    centre = cam_from_board.apply(middle)
    sight = centre / np.linalg.norm(centre)
    normal = cam_from_board.rotation[:, 2]
    axis = np.cross(normal, sight)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return cam_from_board
    angle = 2 * np.arctan2(sine, float(normal @ sight))
    if angle > np.pi:  # seen from behind: the nearer way round
        angle -= 2 * np.pi
    turn = Rotation.from_rotvec(axis / sine * angle).as_matrix()
    rotation = turn @ cam_from_board.rotation
    return Pose(rotation, centre - rotation @ middle)


def _focals(homographies: Sequence[FloatArray], size_wh: tuple[int, int]) -> list[float]:
    """Focal lengths in pixels: each view's own closed form at its quartiles, and a ladder.

    With the principal point in the middle, h1' w h2 = 0 and h1' w h1 = h2' w h2 of a homography
    (h1 h2 h3) each give w = diag(1/f^2, 1/f^2, 1).

    References
    ----------
    .. [1] Z. Zhang, "A Flexible New Technique for Camera Calibration", IEEE PAMI 22 (11), 2000,
       eq. 3 and 4, with zero skew and known principal point.
    """
    unit = float(max(size_wh))
    centre = (np.array(size_wh) - 1) / 2
    to_unit = np.array(
        [[1 / unit, 0, -centre[0] / unit], [0, 1 / unit, -centre[1] / unit], [0, 0, 1]]
    )
    above, below = [], []
    for homography in homographies:
        h = to_unit @ homography
        h = h / np.linalg.norm(h[:, :2])
        for a, b in (
            (h[0, 0] * h[0, 1] + h[1, 0] * h[1, 1], -h[2, 0] * h[2, 1]),
            (
                h[0, 0] ** 2 + h[1, 0] ** 2 - h[0, 1] ** 2 - h[1, 1] ** 2,
                h[2, 1] ** 2 - h[2, 0] ** 2,
            ),
        ):
            above.append(abs(b) * np.sign(a * b))
            below.append(abs(a))
    ratio = np.array(above) / np.maximum(below, 1e-12)  # 1 / f^2, where positive
    weight = np.array(below)
    good = ratio > 1e-3
    closed = []
    if good.any():
        order = np.argsort(ratio[good])
        share = np.cumsum(weight[good][order]) / weight[good].sum()
        closed = [float(1 / np.sqrt(ratio[good][order][np.searchsorted(share, 0.5)]))]
    total = float(
        np.dot(np.array(above), np.array(below)) / max(float(np.dot(below, below)), 1e-300)
    )
    if total > 1e-3:
        closed.append(1 / np.sqrt(total))
    return [unit * focal for focal in (*closed, *_FOCALS)]


def _with(model: type[Lens], lens: Lens, fixed: dict[str, float]) -> Lens:
    values = {**lens.as_dict(), **fixed}
    return model.from_parameters(np.array([values[name] for name in model.NAMES]))


def _free(state: BundleState, fixed: dict[str, float], *, distortion: bool) -> Free:
    """Focal lengths and first radial term; with `distortion`, all but the optional terms."""
    model = state.models[0]
    optional = {name for group in model.OPTIONAL for name in group}
    first = {"fx", "fy", "k1"}
    names = [
        name not in fixed and (name in first or (distortion and name not in optional))
        for name in model.NAMES
    ]
    return Free(
        lenses=np.array([names]), cameras=np.zeros(1, dtype=bool), shape=np.zeros(0, dtype=bool)
    )


def _solved(
    observations: Observations, lens: Lens, poses: Sequence[Pose], fixed: dict[str, float]
) -> BundleState | None:
    """Run a few robust steps from one lens; None where it puts a board behind the camera."""
    state = BundleState.build(
        [lens], [Pose.identity()], poses, BoardShape.flat(observations.points_board)
    )
    try:
        return solve_bundle(
            observations, state, _free(state, fixed, distortion=False), huber=_HUBER_PX,
            max_iterations=_FIRST_ITERATIONS, relative_decrease=1e-3,
        ).state  # fmt: skip
    except ValueError:
        return None


def _poses(
    views: Sequence[ObservedView],
    weights: Sequence[FloatArray],
    points_board: FloatArray,
    lens: Lens,
) -> list[Pose] | None:
    """cam_from_board of every view in closed form; None if a view lies outside the lens.

    The homography is fitted about the middle of the corners, where it is best known.
    """
    poses = []
    for view, weight in zip(views, weights, strict=True):
        rays = lens.unproject(view.pixels)
        seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0)
        if seen.sum() < 4:
            return None
        points = points_board[view.corner_ids[seen], :2]
        middle = points.mean(axis=0)
        plane = rays[seen, :2] / rays[seen, 2:]
        pose = pose_from_homography(fit_homography(points - middle, plane, weight[seen]))
        poses.append(Pose(pose.rotation, pose.trans_m - pose.rotation[:, :2] @ middle))
    return poses


def _mirrored(state: BundleState, points_board: FloatArray) -> BundleState:
    middle = points_board.mean(axis=0)
    poses = [mirrored_place(pose, middle) for pose in state.ref_from_boards]
    return replace(
        state,
        board_rotations=np.stack([pose.rotation for pose in poses]),
        board_trans_m=np.stack([pose.trans_m for pose in poses]),
    )


def _settled(observations: Observations, state: BundleState) -> BundleState:
    """Move the boards alone, robustly; as it was where that is impossible."""
    try:
        return solve_bundle(
            observations, state, Free.only_boards(state), huber=_HUBER_PX,
            max_iterations=_SECOND_ITERATIONS, relative_decrease=1e-7,
        ).state  # fmt: skip
    except ValueError:
        return state


def _view_errors(observations: Observations, state: BundleState) -> FloatArray:
    """Median 2-D residual of every view, pixels; inf where a corner is behind the camera."""
    errors = [
        float(np.median(np.linalg.norm(part, axis=1))) for part in residuals_px(observations, state)
    ]
    return np.asarray(np.nan_to_num(np.array(errors), nan=np.inf))


def _error_px(observations: Observations, state: BundleState) -> float:
    """Mean of the views' median residuals, each bounded: one false view must not decide."""
    errors = _view_errors(observations, state)
    bound = 5 * float(np.median(errors)) + 1e-9
    return float(np.minimum(errors, bound).mean())
