"""A lens from corners: OpenCV's minimum, Zhang's published camera, and an honest sigma."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import PlanarView, Scene, planar_view
from calichrome.geometry.intrinsics import CameraSolution, solve_camera
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import Dataset
from calichrome.target import Target

MakeRig = Callable[[Target, int, int], Scene]
Observe = Callable[[Scene, Target, float, np.random.Generator], Dataset]

_SIZE_WH = (640, 480)
_ZHANG = {"p1": 0.0, "p2": 0.0, "k3": 0.0}


def _views(dataset: Dataset, target: Target, camera: str = "a") -> list[PlanarView]:
    return [planar_view(view, target) for view in dataset.views[camera].values()]


def _cost(residuals_px: FloatArray) -> float:
    return float((residuals_px**2).sum())


def _opencv(views: list[PlanarView], flags: int) -> tuple[float, BrownConrady]:
    """Sum of squares at the minimum that OpenCV finds, and the lens there."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-15)
    rms, matrix, coeffs, _, _ = cv2.calibrateCamera(
        [view.points_board.astype(np.float32) for view in views],
        [view.pixels.astype(np.float32) for view in views],
        _SIZE_WH,
        np.eye(3),
        np.zeros(5),
        flags=flags,
        criteria=criteria,
    )
    focal_centre = matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
    lens = BrownConrady.from_parameters(np.concatenate([focal_centre, coeffs.ravel()]))
    return rms**2 * sum(len(view.pixels) for view in views), lens


@pytest.mark.parametrize(
    ("fixed", "flags"),
    [({}, 0), (_ZHANG, cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3)],
    ids=["all-nine", "k1-k2"],
)
def test_reaches_the_minimum_of_opencv(
    fixed: dict[str, float],
    flags: int,
    board: Target,
    make_rig: MakeRig,
    observe: Observe,
    rng: np.random.Generator,
) -> None:
    dataset = observe(make_rig(board, 1, 10), board, 0.3, rng)
    # OpenCV keeps points as float32: give both the same numbers
    views = [
        PlanarView(
            points_board=view.points_board.astype(np.float32).astype(np.float64),
            pixels=view.pixels.astype(np.float32).astype(np.float64),
        )
        for view in _views(dataset, board)
    ]
    solved = solve_camera(views, _SIZE_WH, fixed=fixed)
    cost = _cost(np.concatenate(solved.residuals_px))
    expected, lens = _opencv(views, flags)
    # a cost 1e-6 above the minimum leaves parameters within 0.04 sigma: the same answer
    assert cost == pytest.approx(expected, rel=1e-6)
    assert solved.lens_cov is not None
    sigma = np.sqrt(np.diag(solved.lens_cov))
    np.testing.assert_array_less(
        np.abs(solved.lens.parameters - lens.parameters), 0.04 * sigma + 1e-12
    )


def test_exact_corners_give_the_exact_lens(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 1, 8)
    solved = solve_camera(_views(observe(truth, board, 0, rng), board), _SIZE_WH)
    # rounding of pixels near 500 is 1e-13, the condition number of the scaled problem below 1e5
    np.testing.assert_allclose(
        solved.lens.parameters, truth.lenses[0].parameters, rtol=1e-7, atol=1e-7
    )
    assert solved.rms_px < 1e-9


def test_fixed_parameters_stay(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    views = _views(observe(make_rig(board, 1, 8), board, 0.2, rng), board)
    fixed = {"cx": 320.5, "k3": 0.0, "p1": 0.0}
    solved = solve_camera(views, _SIZE_WH, fixed=fixed)
    assert {name: solved.lens.as_dict()[name] for name in fixed} == fixed
    assert solved.lens_cov is not None
    held = np.array([name in fixed for name in BrownConrady.NAMES])
    assert not solved.lens_cov[held].any()
    assert not solved.lens_cov[:, held].any()
    assert (np.diag(solved.lens_cov)[~held] > 0).all()


def test_too_few_views_are_refused(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    views = _views(observe(make_rig(board, 1, 2), board, 0.2, rng), board)
    with pytest.raises(SolveError, match="2 views of the board are not enough"):
        solve_camera(views, _SIZE_WH)


def test_an_unknown_parameter_is_named(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    views = _views(observe(make_rig(board, 1, 3), board, 0.2, rng), board)
    with pytest.raises(SolveError, match="k4 is no parameter"):
        solve_camera(views, _SIZE_WH, fixed={"k4": 0.0})


def test_zhang_1998(data: Path) -> None:
    """Z. Zhang, MSR-TR-98-71: five views of 64 squares, with the parameters he published."""
    model = np.loadtxt(data / "zhang1998" / "Model.txt").reshape(-1, 2)
    points_board = np.concatenate([model, np.zeros((len(model), 1))], axis=1)
    views = [
        PlanarView(
            points_board=points_board,
            pixels=np.loadtxt(data / "zhang1998" / f"data{number}.txt").reshape(-1, 2),
        )
        for number in range(1, 6)
    ]
    solved = solve_camera(views, _SIZE_WH, fixed=_ZHANG)
    # He has one parameter more, a skew of 0.2; his sigma of fx and fy is 1.4 px.
    assert solved.lens.fx == pytest.approx(832.50, abs=0.4)
    assert solved.lens.fy == pytest.approx(832.53, abs=0.4)
    assert solved.lens.cx == pytest.approx(303.96, abs=0.4)
    assert solved.lens.cy == pytest.approx(206.59, abs=0.4)
    assert solved.lens.k1 == pytest.approx(-0.2286, abs=2e-3)
    assert solved.lens.k2 == pytest.approx(0.1904, abs=1e-2)
    assert solved.rms_px == pytest.approx(0.335, abs=2e-3)  # his report: 0.335 px


def _draws(
    truth: Scene, board: Target, observe: Observe, rng: np.random.Generator, n_draws: int
) -> list[CameraSolution]:
    return [
        solve_camera(
            _views(observe(truth, board, 0.2, rng), board), _SIZE_WH, start=truth.lenses[0]
        )
        for _ in range(n_draws)
    ]


def test_lens_scatters_as_its_covariance_says(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 1, 8)
    n_draws = 50
    squared = 0.0
    for solved in _draws(truth, board, observe, rng, n_draws):
        assert solved.lens_cov is not None
        error = solved.lens.parameters - truth.lenses[0].parameters
        scale = np.sqrt(np.diag(solved.lens_cov))
        correlation = solved.lens_cov / np.outer(scale, scale)
        squared += float((error / scale) @ np.linalg.solve(correlation, error / scale))
    # Chi-square over 9 x 50: its mean is 1 with sigma sqrt(2 / 450) = 0.067; three of these.
    # A sigma wrong by 15 % would show as 0.74 or 1.38.
    assert squared / (9 * n_draws) == pytest.approx(1, abs=0.2)


@pytest.mark.slow
def test_every_sigma_of_the_lens(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 1, 10)
    draws = _draws(truth, board, observe, rng, 250)
    found = np.stack([solved.lens.parameters for solved in draws])
    variances = [np.diag(solved.lens_cov) for solved in draws if solved.lens_cov is not None]
    ratio = found.std(axis=0, ddof=1) / np.sqrt(np.mean(variances, axis=0))
    assert len(variances) == len(draws)
    # The scatter of 250 draws is itself known to 1 / sqrt(2 x 249) = 4.5 %; three of these.
    np.testing.assert_allclose(ratio, 1, atol=0.14)
