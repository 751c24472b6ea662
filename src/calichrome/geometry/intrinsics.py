"""One camera: lens and board poses from its own views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.homography import fit_homography
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
)
from calichrome.geometry.board_pose import start_board_pose
from calichrome.geometry.lenses import BrownConrady

__all__ = ["CameraSolution", "solve_camera", "start_lenses"]

MIN_VIEWS = 3
_START_ITERATIONS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSolution:
    """A calibrated camera.

    Parameters
    ----------
    lens
        At the minimum.
    lens_cov : (9, 9) float or None
        Covariance in the order of the lens's names; rows of fixed parameters are zero. None where
        the views leave a direction open.
    cams_from_board
        One pose a view, in the order given.
    residuals_px
        One (N, 2) array a view, projected minus observed.
    rms_px
        Root mean square 2-D distance over all corners.
    """

    lens: BrownConrady
    lens_cov: FloatArray | None
    cams_from_board: tuple[Pose, ...]
    residuals_px: tuple[FloatArray, ...]
    rms_px: float


def solve_camera(
    views: Sequence[PlanarView],
    size_wh: tuple[int, int],
    *,
    fixed: Mapping[str, float] | None = None,
    start: BrownConrady | None = None,
) -> CameraSolution:
    """Estimate the lens and one board pose a view by Levenberg-Marquardt.

    Parameters
    ----------
    views
        At least three, tilted differently.
    size_wh
        Picture size, pixels.
    fixed
        Lens parameters that keep the given value, by name; ``{"p1": 0, "p2": 0, "k3": 0}`` is
        Zhang's model.
    start
        A lens near the solution; None: closed form from the homographies.

    Raises
    ------
    SolveError
        If there are too few views or no start leads anywhere.

    References
    ----------
    .. [1] Z. Zhang, "A Flexible New Technique for Camera Calibration", IEEE PAMI 22 (11), 2000.
    """
    if len(views) < MIN_VIEWS:
        raise SolveError(
            f"{len(views)} views of the board are not enough; record at least {MIN_VIEWS}, better "
            f"15, each tilted another way"
        )
    fixed = dict(fixed or {})
    unknown = set(fixed) - set(BrownConrady.NAMES)
    if unknown:
        raise SolveError(
            f"{', '.join(sorted(unknown))} is no parameter of {BrownConrady.MODEL}; its names are "
            f"{', '.join(BrownConrady.NAMES)}"
        )
    if min(fixed.get("fx", 1.0), fixed.get("fy", 1.0)) <= 0:
        raise SolveError("a fixed focal length must be positive; correct fx, fy in recording.toml")
    free = np.array([name not in fixed for name in BrownConrady.NAMES])
    sightings = Sightings.collect([(0, index, view) for index, view in enumerate(views)])
    lenses = [start] if start is not None else start_lenses(views, size_wh)
    lenses = [BrownConrady(**{**lens.as_dict(), **fixed}) for lens in lenses]
    best = _best_start(sightings, views, lenses, free)
    solved = adjust(sightings, best.scene, Free(free[None], np.zeros(1, dtype=bool)))
    return _as_solution(solved, views, free)


def _best_start(
    sightings: Sightings,
    views: Sequence[PlanarView],
    lenses: Sequence[BrownConrady],
    free: BoolArray,
) -> Adjustment:
    """Run a few steps from every start and keep the one that leads lowest."""
    tried: list[Adjustment] = []
    for lens in lenses:
        try:
            poses = tuple(start_board_pose(view, lens) for view in views)
            scene = Scene((lens,), (Pose.identity(),), poses)
            everything = Free(free[None], np.zeros(1, dtype=bool))
            tried.append(adjust(sightings, scene, everything, max_iterations=_START_ITERATIONS))
        except (ValueError, np.linalg.LinAlgError):
            continue  # a board behind the camera, or no homography: not a start
    if not tried:
        raise SolveError(
            "no lens explains the views even roughly; check that the pictures are of one camera "
            "and that the target is described rightly"
        )
    return min(tried, key=lambda item: item.variance)


def start_lenses(views: Sequence[PlanarView], size_wh: tuple[int, int]) -> list[BrownConrady]:
    """Closed-form pinholes with the principal point in the middle, best first.

    Each homography (h1 h2 h3) of a view gives h1' w h2 = 0 and h1' w h1 = h2' w h2 with
    w = diag(1/fx^2, 1/fy^2, 1). Where the views are too much alike to give positive squares,
    focal lengths from wide to long are returned instead.

    References
    ----------
    .. [1] Z. Zhang, 2000, eq. 3 and 4, with zero skew and known principal point.
    """
    centre = (np.array(size_wh) - 1) / 2
    unit = float(max(size_wh))  # keeps the equations near 1
    rows, sides = [], []
    for view in views:
        homography = fit_homography(view.points_board[:, :2], (view.pixels - centre) / unit)
        h1, h2 = homography[:, 0], homography[:, 1]
        h1, h2 = h1 / np.linalg.norm(h1), h2 / np.linalg.norm(h2)
        rows += [h1[:2] * h2[:2], h1[:2] ** 2 - h2[:2] ** 2]
        sides += [-h1[2] * h2[2], h2[2] ** 2 - h1[2] ** 2]
    matrix, side = np.array(rows), np.array(sides)
    both, *_ = np.linalg.lstsq(matrix, side, rcond=None)
    total = matrix.sum(axis=1)
    equal = float(total @ side) / max(float(total @ total), 1e-300)
    inverse_squares = [pair for pair in (both, np.array([equal, equal])) if (pair > 1e-4).all()]
    focals = [unit / np.sqrt(pair) for pair in inverse_squares]
    focals += [np.full(2, unit * factor) for factor in ((1.2,) if focals else (0.6, 1.2, 2.5, 5))]
    return [
        BrownConrady(fx=float(fx), fy=float(fy), cx=float(centre[0]), cy=float(centre[1]))
        for fx, fy in focals
    ]


def _as_solution(
    solved: Adjustment, views: Sequence[PlanarView], free: BoolArray
) -> CameraSolution:
    lens_cov = None
    if solved.covariance is not None:
        lens_cov = np.zeros((len(free), len(free)))
        n_free = int(free.sum())
        lens_cov[np.ix_(free, free)] = solved.covariance[:n_free, :n_free]
    ends = np.cumsum([len(view.pixels) for view in views])[:-1]
    return CameraSolution(
        lens=solved.scene.lenses[0],
        lens_cov=lens_cov,
        cams_from_board=solved.scene.ref_from_boards,
        residuals_px=tuple(np.split(solved.residuals_px, ends)),
        rms_px=rms_px(solved.residuals_px),
    )
