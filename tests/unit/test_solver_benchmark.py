"""The solver benchmark: its problems are what it says they are, its meters measure."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.solver.exchange import Geometry, Problem, Solution
from benchmarks.solver.problems import SPECS, make_problem
from benchmarks.solver.run import error_ratio, main

_PROJECT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def rig() -> Problem:
    return make_problem(SPECS["rig"])


def _views_cam(problem: Problem, geometry: Geometry) -> tuple[FloatArray, FloatArray]:
    """Return rotations (V, 3, 3) and translations (V, 3) of cam_from_board."""
    turn = geometry.cam_from_ref_rotation[problem.camera_index]
    trans_m = geometry.ref_from_board_m[problem.frame_index]
    moved_m = np.einsum("vij,vj->vi", turn, trans_m)
    return (
        turn @ geometry.ref_from_board_rotation[problem.frame_index],
        moved_m + geometry.cam_from_ref_m[problem.camera_index],
    )


def _angles_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    turn = Rotation.from_matrix(a @ b.transpose(0, 2, 1))
    return np.asarray(np.degrees(turn.magnitude()))


@pytest.mark.parametrize("name", ["small", "stereo", "rig"])
def test_sizes_are_those_of_the_specification(name: str) -> None:
    spec, problem = SPECS[name], make_problem(SPECS[name])
    assert problem.pixels.shape == (spec.n_views, np.prod(spec.corners_xy), 2)
    assert set(problem.camera_index) == set(range(spec.n_cameras))
    assert set(problem.frame_index) == set(range(spec.n_frames))
    order = np.lexsort((problem.camera_index, problem.frame_index))
    np.testing.assert_array_equal(order, np.arange(spec.n_views))


def test_more_frames_keep_the_views_per_frame() -> None:
    spec = SPECS["rig"].with_frames(300)
    assert (spec.n_cameras, spec.n_frames, spec.n_views) == (8, 300, 1806)


def test_seed_decides(rig: Problem) -> None:
    np.testing.assert_array_equal(make_problem(SPECS["rig"]).pixels, rig.pixels)
    assert not np.array_equal(make_problem(SPECS["rig"], seed=2).pixels, rig.pixels)


def test_pixels_are_the_projected_truth_with_the_stated_noise(rig: Problem) -> None:
    rotation, trans_m = _views_cam(rig, rig.truth)
    residuals = np.empty_like(rig.pixels)
    for view, camera in enumerate(rig.camera_index):
        fx, fy, cx, cy, *distortion = rig.truth.lens[camera]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        rotvec = cv2.Rodrigues(rotation[view])[0]
        projected = cv2.projectPoints(
            rig.board_m, rotvec, trans_m[view], matrix, np.array(distortion)
        )[0]
        residuals[view] = rig.pixels[view] - projected.reshape(-1, 2)
    n = residuals.size
    # four standard errors of a mean and of a standard deviation
    assert abs(residuals.mean()) < 4 * rig.sigma_px / np.sqrt(n)
    assert residuals.std() == pytest.approx(float(rig.sigma_px), rel=4 / np.sqrt(2 * n))


def test_boards_are_whole_and_can_be_read(rig: Problem) -> None:
    noise_px = 6 * float(rig.sigma_px)
    assert (rig.pixels > -noise_px).all()
    assert (rig.pixels < rig.size_wh - 1 + noise_px).all()
    rotation, trans_m = _views_cam(rig, rig.truth)
    assert (rotation[:, 2, 2] > np.cos(np.radians(60))).all()
    assert (trans_m[:, 2] > 0).all()


def test_poses_are_proper_and_camera_0_is_the_reference(rig: Problem) -> None:
    for geometry in (rig.truth, rig.start):
        np.testing.assert_array_equal(geometry.cam_from_ref_rotation[0], np.eye(3))
        np.testing.assert_array_equal(geometry.cam_from_ref_m[0], 0)
        for rotation in (geometry.cam_from_ref_rotation, geometry.ref_from_board_rotation):
            product = rotation @ rotation.transpose(0, 2, 1)
            np.testing.assert_allclose(product - np.eye(3), 0, atol=1e-14)
            np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-14)


def test_start_is_off_by_what_is_said(rig: Problem) -> None:
    truth, start = rig.truth, rig.start
    np.testing.assert_allclose(np.abs(start.lens[:, :2] / truth.lens[:, :2] - 1), 0.03)
    np.testing.assert_array_equal(start.lens[:, 2:4], np.tile([959.5, 599.5], (8, 1)))
    np.testing.assert_array_equal(start.lens[:, 4:], 0)
    cameras = truth.cam_from_ref_rotation, start.cam_from_ref_rotation
    np.testing.assert_allclose(_angles_deg(*cameras)[1:], 1)
    boards = truth.ref_from_board_rotation, start.ref_from_board_rotation
    np.testing.assert_allclose(_angles_deg(*boards), 2)

    # the board, 10 fields of 30 mm wide, fills 45 % of 1920 px at f = 1300 px
    distance_m = 1300 * 10 * 0.03 / (0.45 * 1920)
    centres = [
        -np.einsum("cji,cj->ci", g.cam_from_ref_rotation, g.cam_from_ref_m) for g in (truth, start)
    ]
    moved_m = np.linalg.norm(centres[1] - centres[0], axis=1)
    np.testing.assert_allclose(moved_m[1:], 0.02 * distance_m)
    middles = [
        g.ref_from_board_rotation @ rig.board_m.mean(axis=0) + g.ref_from_board_m
        for g in (truth, start)
    ]
    moved_m = np.linalg.norm(middles[1] - middles[0], axis=1)
    np.testing.assert_allclose(moved_m, 0.02 * distance_m)


def test_files_keep_everything(rig: Problem, tmp_path: Path) -> None:
    rig.save(tmp_path / "problem.npz")
    back = Problem.load(tmp_path / "problem.npz")
    np.testing.assert_array_equal(back.pixels, rig.pixels)
    np.testing.assert_array_equal(back.camera_index, rig.camera_index)
    for field in fields(Geometry):
        for name in ("truth", "start"):
            np.testing.assert_array_equal(
                getattr(getattr(back, name), field.name), getattr(getattr(rig, name), field.name)
            )


def test_error_ratio_counts_sigmas(rig: Problem, rng: np.random.Generator) -> None:
    n = 8 * 9 + 7 * 6
    deviations = rng.uniform(0.5, 2.0, n) * 1e-6
    errors = 3 * float(rig.sigma_px) * deviations * rng.choice([-1, 1], n)
    poses = np.concatenate([np.zeros((1, 6)), errors[72:].reshape(7, 6)])
    truth = rig.truth
    solution = Solution(
        cost=0,
        polished_cost=0,
        iterations=0,
        cpu_s=0,
        growth_mb=0,
        covariance_cpu_s=0,
        covariance=np.diag(deviations**2),
        lens=truth.lens + errors[:72].reshape(8, 9),
        cam_from_ref_rotation=Rotation.from_rotvec(poses[:, :3]).as_matrix()
        @ truth.cam_from_ref_rotation,
        cam_from_ref_m=truth.cam_from_ref_m + poses[:, 3:],
    )
    assert error_ratio(rig, solution) == pytest.approx(3)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_memory_is_that_of_the_process_itself() -> None:
    ballast = np.ones(40_000_000)  # 320 MB, which a child's getrusage would start from
    code = (
        "import numpy as np; from benchmarks.solver.exchange import measured; "
        "print(measured(lambda: np.ones(10_000_000).sum())[1].growth_mb)"
    )
    answer = subprocess.check_output([sys.executable, "-c", code], cwd=_PROJECT, text=True)  # noqa: S603
    assert ballast.all()
    # 80 MB and what the interpreter takes; the kernel counts pages in batches
    assert 0.95 * 80 < float(answer) < 90


def test_absent_peer_is_not_run(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--only", "small", "--runs", "1"])
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[2] for row in rows if row[:2] == ["| small", "mrcal"]] == ["not run"]
    (ours,) = [row for row in rows if row[:2] == ["| small", "calichrome"]]
    assert float(ours[2]) > 0
    # the mean square of nine ratios, correlated or not, is 1 with a standard deviation <= sqrt(2)
    assert 0 < float(ours[7]) < np.sqrt(1 + 3 * np.sqrt(2))
