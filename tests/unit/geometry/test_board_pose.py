"""One board in one view, or in several."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import PlanarView
from calichrome.geometry.board_pose import solve_board_pose, start_board_pose
from calichrome.geometry.intrinsics import CameraSolution
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.pairs import solve_pair

LENS = BrownConrady(fx=600, fy=605, cx=320, cy=240, k1=-0.2, k2=0.05)
POINTS = np.stack(
    [*map(np.ravel, np.meshgrid(np.arange(6) * 0.03, np.arange(4) * 0.03)), np.zeros(24)], axis=1
)


def _view(cam_from_board: Pose, noise: FloatArray | float = 0.0) -> PlanarView:
    pixels = LENS.project(cam_from_board.apply(POINTS)) + noise
    return PlanarView(points_board=POINTS, pixels=pixels)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("roll_rad", [0.0, 1.5, 3.0])
def test_exact_corners_give_the_exact_start(tilt_rad: float, roll_rad: float) -> None:
    roll = Pose.from_rotvec([0, 0, roll_rad], [0, 0, 0])
    truth = Pose.from_rotvec([tilt_rad, 0.1, 0], [-0.05, 0.02, 0.6]) @ roll
    found = start_board_pose(_view(truth), LENS)
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-9)
    np.testing.assert_allclose(found.trans_m, truth.trans_m, atol=1e-9)


def test_two_cameras_place_a_board_together(rng: np.random.Generator) -> None:
    cams_from_ref = {"a": Pose.identity(), "b": Pose.from_rotvec([0, 0.3, 0], [-0.2, 0, 0.05])}
    truth = Pose.from_rotvec([0.2, -0.3, 0.1], [-0.05, -0.04, 0.6])
    lenses = dict.fromkeys("ab", LENS)
    errors = {"one": np.zeros(3), "both": np.zeros(3)}
    for _ in range(30):
        views = {
            camera: _view(motion @ truth, rng.normal(0, 0.3, (24, 2)))
            for camera, motion in cams_from_ref.items()
        }
        for kind, used in (("one", {"a": views["a"]}), ("both", views)):
            found = solve_board_pose(used, lenses, cams_from_ref).scene.ref_from_boards[0]
            errors[kind] += (found.trans_m - truth.trans_m) ** 2
    # A second camera at the side measures depth: far better than the size of the board alone
    assert errors["both"][2] < 0.3 * errors["one"][2]
    # sideways 0.3 px / 600 px x 0.6 m / sqrt(24) = 6e-5 m; depth three times that at this baseline,
    # and about twice that again at the origin, which is a corner of the board
    assert np.sqrt(errors["both"] / 30).max() < 6e-4


def test_contradicting_cameras_are_refused() -> None:
    """Camera b looks away from the board that it is said to see."""
    cams_from_ref = {"a": Pose.identity(), "b": Pose.from_rotvec([0, np.pi, 0], [0, 0, 0])}
    view = _view(Pose.from_rotvec([0.2, -0.3, 0.1], [-0.05, -0.04, 0.6]))
    with pytest.raises(ValueError, match="every start lies behind a camera"):
        solve_board_pose({"a": view, "b": view}, dict.fromkeys("ab", LENS), cams_from_ref)


def test_pairs_need_a_shared_frame() -> None:
    pose = Pose.from_rotvec([0.2, 0, 0], [0, 0, 0.6])
    camera = CameraSolution(
        lens=LENS, lens_cov=None, cams_from_board=(pose,), residuals_px=(), rms_px=0.0
    )
    with pytest.raises(SolveError, match="share no frame"):
        solve_pair({"1": _view(pose)}, {"2": _view(pose)}, camera, camera, {"1": pose}, {"2": pose})


def test_a_pair_of_uncertain_lenses_is_uncertain() -> None:
    motion = Pose.from_rotvec([0, 0.1, 0], [-0.1, 0, 0])
    poses = {str(i): Pose.from_rotvec([0.1 * i, 0.2, 0], [0, 0, 0.6]) for i in range(3)}
    camera = CameraSolution(
        lens=LENS, lens_cov=None, cams_from_board=(), residuals_px=(), rms_px=0.0
    )
    pair = solve_pair(
        {name: _view(pose) for name, pose in poses.items()},
        {name: _view(motion @ pose) for name, pose in poses.items()},
        camera,
        camera,
        poses,
        {name: motion @ pose for name, pose in poses.items()},
    )
    assert pair.cov is None
    np.testing.assert_allclose(pair.b_from_a.trans_m, motion.trans_m, atol=1e-12)
