"""The world's frame: a board as the floor, or known points."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError, SolveError
from calichrome.geometry.rig_solution import RigSolution
from calichrome.observations import Dataset
from calichrome.pipeline.world import place_world
from calichrome.target import chessboard

_POINTS = chessboard((5, 4), (0.03, 0.03)).corners_board


def _rig(rng: np.random.Generator) -> RigSolution:
    boards = {
        frame: Pose(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)) for frame in "ab"
    }
    return RigSolution(
        dataset=Dataset(sizes_wh={}, views={}),
        reference="cam",
        lenses={},
        cams_from_ref={},
        ref_from_boards=boards,
        residuals_px={},
        inliers={},
        lens_cov={},
        pose_cov={},
        pairs={},
    )


def test_nothing_said_leaves_the_reference_camera(rng: np.random.Generator) -> None:
    world_from_ref = place_world(_rig(rng), _POINTS)
    np.testing.assert_array_equal(world_from_ref.rotation, np.eye(3))


def test_a_board_is_the_floor(rng: np.random.Generator) -> None:
    rig = _rig(rng)
    world_from_ref = place_world(rig, _POINTS, frame="b")
    corners = world_from_ref.apply(rig.ref_from_boards["b"].apply(_POINTS))
    np.testing.assert_allclose(corners, _POINTS * [1, -1, 1], atol=1e-12)
    above = rig.ref_from_boards["b"].apply(np.array([0.0, 0.0, -0.1]))  # towards the viewer
    np.testing.assert_allclose(world_from_ref.apply(above), [0, 0, 0.1], atol=1e-12)


def _csv(path: Path, rows: list[tuple[str, int, np.ndarray]]) -> Path:
    lines = [f"{frame},{corner},{','.join(map(repr, map(float, p)))}" for frame, corner, p in rows]
    path.write_text("\n".join(["frame,corner,x,y,z", *lines]) + "\n")
    return path


def test_known_points_give_their_frame(rng: np.random.Generator, tmp_path: Path) -> None:
    rig = _rig(rng)
    truth = Pose(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    rows = [
        (frame, corner, truth.apply(rig.ref_from_boards[frame].apply(_POINTS[corner])))
        for frame, corner in (("a", 0), ("a", 4), ("a", 19), ("b", 7))
    ]
    found = place_world(rig, _POINTS, points=_csv(tmp_path / "world.csv", rows))
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-9)
    np.testing.assert_allclose(found.trans_m, truth.trans_m, atol=1e-9)


def test_what_fixes_no_place_is_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    rig = _rig(rng)
    line = [("a", corner, np.array([corner * 0.03, 0, 0])) for corner in range(4)]
    with pytest.raises(SolveError, match="not on one line"):
        place_world(rig, _POINTS, points=_csv(tmp_path / "line.csv", line))
    with pytest.raises(SolveError, match="no board was found in frame c"):
        place_world(rig, _POINTS, frame="c")
    with pytest.raises(SolveError, match="either"):
        place_world(rig, _POINTS, frame="a", points=tmp_path / "line.csv")
    wrong = _csv(tmp_path / "wrong.csv", [("a", 20, np.zeros(3))])
    with pytest.raises(FileFormatError, match="line 2: corner must be 0 to 19"):
        place_world(rig, _POINTS, points=wrong)
    (tmp_path / "columns.csv").write_text("frame,x,y,z\n")
    with pytest.raises(FileFormatError, match="the columns must be"):
        place_world(rig, _POINTS, points=tmp_path / "columns.csv")
