"""Ways to go wrong with a recording: each gives its finding, and its clean twin does not.

Observations are projected from known rigs, so that nothing but the mishap is wrong.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding
from calichrome.core.pose import Pose
from calichrome.geometry.bow_check import bow_left_out
from calichrome.geometry.lenses import BrownConrady, KannalaBrandt, Lens
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import BoardView, Dataset, write_observations
from calichrome.pipeline.judge_geometry import judge_geometry
from calichrome.pipeline.solve_geometry import SolvedGeometry
from calichrome.target import chessboard

Rng = np.random.Generator
Views = Mapping[str, Mapping[str, BoardView]]

_BOARD = replace(chessboard((11, 8), (0.025, 0.025)), square_size_measured=True)
_MIDDLE = _BOARD.corners_board.mean(axis=0)
_SIZE_WH = (960, 720)
_LENS = BrownConrady(fx=760, fy=761, cx=482, cy=357, k1=-0.2, k2=0.06, p1=2e-4, p2=-3e-4)
_NOISE_PX = 0.2


def _cameras(n_cameras: int) -> dict[str, Pose]:
    """cams_from_middle of cameras 20 degrees apart, 0.6 m from the middle they look at."""
    cameras = {}
    for index in range(n_cameras):
        angle = np.radians(20) * (index - (n_cameras - 1) / 2)
        place = [0.6 * np.sin(angle), 0.03 * (-1) ** index, -0.6 * np.cos(angle)]
        cameras["abcd"[index]] = Pose.from_rotvec([0, -angle, 0], place).inverse()
    return cameras


def _held(n_frames: int = 12, *, tilt_rad: float = 0.65) -> dict[str, Pose]:
    """middle_from_boards, tilted up to an angle, each elsewhere."""
    rng = np.random.default_rng(n_frames)
    boards = {}
    for index in range(n_frames):
        way, tilt = rng.uniform(0, 2 * np.pi), tilt_rad * np.sqrt(rng.uniform(0.1, 1))
        turn = Pose.from_rotvec([tilt * np.cos(way), tilt * np.sin(way), 0], np.zeros(3))
        turn = turn @ Pose.from_rotvec([0, 0, rng.uniform(-0.3, 0.3)], np.zeros(3))
        place = rng.uniform(-1, 1, 3) * [0.12, 0.08, 0.12]
        boards[f"{index:02d}"] = _centred(turn.rotation, place)
    return boards


def _centred(rotation: FloatArray, place: FloatArray) -> Pose:
    return Pose(rotation, place - rotation @ _MIDDLE)


def _bowed(sagitta_m: float) -> FloatArray:
    points = _BOARD.corners_board.copy()
    height = sagitta_m * (2 * (points[:, 0] - _MIDDLE[0]) / np.ptp(points[:, 0])) ** 2
    points[:, 2] = height - height.mean()
    return points


def _seen(
    camera_from_middle: Pose,
    boards: Mapping[str, Pose],
    rng: Rng,
    *,
    lens: Lens = _LENS,
    noise_px: float = _NOISE_PX,
    gross: float = 0.0,
    points: FloatArray = _BOARD.corners_board,
) -> dict[str, BoardView]:
    """Corners in the picture of each board of which a dozen are."""
    views = {}
    for frame, board in boards.items():
        points_cam = (camera_from_middle @ board).apply(points)
        exact = np.where(lens.sees(points_cam)[:, None], lens.project(points_cam), np.nan)
        angle, far = rng.uniform(0, 2 * np.pi, len(points)), rng.uniform(3, 20, len(points))
        off = far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        pixels = exact + rng.normal(0, noise_px, exact.shape)
        pixels += off * (rng.random(len(points)) < gross)[:, None]
        inside = ((pixels >= 0) & (pixels <= np.array(_SIZE_WH) - 1)).all(axis=1)
        if inside.sum() >= 12:
            views[frame] = _view(np.flatnonzero(inside), pixels[inside])
    return views


def _view(corner_ids: Any, pixels: FloatArray) -> BoardView:  # noqa: ANN401 (any integers)
    return BoardView(corner_ids=np.asarray(corner_ids), corners_px=pixels)


def _rig(n_cameras: int, rng: Rng, n_frames: int = 12, **how: Any) -> dict[str, Any]:  # noqa: ANN401
    cameras = _cameras(n_cameras)
    return {name: _seen(pose, _held(n_frames), rng, **how) for name, pose in cameras.items()}


def _judged(
    views: Views, settings: RigSettings | None = None, size_wh: tuple[int, int] = _SIZE_WH
) -> list[Finding]:
    """Solve and judge, without the errors on frames left out, which take longest."""
    dataset = Dataset(sizes_wh=dict.fromkeys(views, size_wh), views=views)
    settings = settings or RigSettings()
    solution = solve_rig(dataset, _BOARD, settings)
    bow = None if settings.warp else bow_left_out(solution, _BOARD, settings)
    geometry = SolvedGeometry(
        solution=solution, held_out=dict.fromkeys(views), rig_settings=settings, bow=bow
    )
    return list(judge_geometry(geometry, _BOARD))


def _critical(findings: Sequence[Finding]) -> set[str]:
    return {item.code for item in findings if item.severity == "critical"}


def _only(findings: Sequence[Finding], code: str) -> Finding:
    (item,) = [item for item in findings if item.code == code]
    return item


# --- nothing is wrong -----------------------------------------------------------------------------


@pytest.mark.parametrize("n_cameras", [1, 2, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("noise_px", "gross", "sagitta_m"), [(0.05, 0.01, 0), (0.3, 0.01, 5e-4)])
def test_good_recordings_are_trusted(
    n_cameras: int, noise_px: float, gross: float, sagitta_m: float, rng: Rng
) -> None:
    points = _bowed(sagitta_m)
    views = _rig(n_cameras, rng, noise_px=noise_px, gross=gross, points=points)
    found = _judged(views)
    assert _critical(found) == set()
    assert {item.code for item in found} >= {"outliers_left_out"}
    assert ("bowed_board" in {item.code for item in found}) == (sagitta_m > 0)


def test_outliers_left_out_fires(rng: Rng) -> None:
    views = _rig(1, rng)
    first = views["a"]["00"]
    pixels = first.corners_px.copy()
    pixels[5] += 9
    found = _judged({"a": views["a"] | {"00": replace(first, corners_px=pixels)}})
    assert _only(found, "outliers_left_out").data["n_left_out"] == 1


def test_outliers_left_out_does_not_fire(rng: Rng) -> None:
    assert "outliers_left_out" not in {item.code for item in _judged(_rig(1, rng))}


# --- views that say too little --------------------------------------------------------------------


def test_too_few_views_fires(rng: Rng) -> None:
    item = _only(_judged(_rig(1, rng, 2)), "too_few_views")
    assert item.data["n_views"] == 2
    assert "±" in item.text


def test_too_few_views_does_not_fire(rng: Rng) -> None:
    found = _judged(_rig(1, rng, 3))
    assert "few_views" in {item.code for item in found}
    assert "too_few_views" not in _critical(found)


@pytest.mark.parametrize("tilt", [(0, 0, 0), (0.4, 0, 0), (0.3, -0.3, 0.1)])
@pytest.mark.parametrize("n_cameras", [1, 2])
def test_parallel_boards_are_weak_geometry(
    tilt: tuple[float, float, float], n_cameras: int, rng: Rng
) -> None:
    """Facing the camera or tilted alike, at several distances."""
    turn = Pose.from_rotvec(tilt, np.zeros(3)).rotation
    boards = {
        frame: _centred(turn, board.apply(_MIDDLE[None])[0]) for frame, board in _held().items()
    }
    views = {name: _seen(pose, boards, rng) for name, pose in _cameras(n_cameras).items()}
    assert "weak_geometry" in _critical(_judged(views))


def _shaken(millimetres: float, degrees: float, rng: Rng) -> dict[str, Pose]:
    first = _held(3)["00"]
    boards = {}
    for index in range(20):
        turn = Pose.from_rotvec(np.radians(degrees) * rng.normal(size=3), np.zeros(3))
        middle = first.apply(_MIDDLE[None])[0] + millimetres / 1e3 * rng.normal(size=3)
        boards[f"{index:02d}"] = _centred((turn @ first).rotation, middle)
    return boards


@pytest.mark.parametrize(("millimetres", "degrees"), [(0, 0), (0.6, 0.2)])
def test_repeated_views_fires(millimetres: float, degrees: float, rng: Rng) -> None:
    """A board on a stand, and one in a hand: twenty times the same."""
    views = {"a": _seen(_cameras(1)["a"], _shaken(millimetres, degrees, rng), rng)}
    item = _only(_judged(views), "repeated_views")
    assert item.data["n_distinct"] == 1


def test_repeated_views_does_not_fire(rng: Rng) -> None:
    """Three places, seen seven times each."""
    held = _held(3)
    boards = {f"{frame}-{again}": board for frame, board in held.items() for again in range(7)}
    assert "repeated_views" not in _critical(_judged({"a": _seen(_cameras(1)["a"], boards, rng)}))


def _cropped(views: Mapping[str, BoardView], share: float) -> dict[str, BoardView]:
    cropped = {}
    for frame, view in views.items():
        kept = (view.corners_px < share * np.array(_SIZE_WH)).all(axis=1)
        if kept.sum() >= 12:
            cropped[frame] = _view(view.corner_ids[kept], view.corners_px[kept])
    return cropped


def test_poor_coverage_fires(rng: Rng) -> None:
    """Camera a sees corners in the upper left quarter of its picture only."""
    views = _rig(2, rng, 20)
    found = _judged(views | {"a": _cropped(views["a"], 0.5)})
    assert _only(found, "poor_coverage").data["camera"] == "a"


def test_poor_coverage_does_not_fire(rng: Rng) -> None:
    """Boards that reach beyond the border are fine."""
    views = _rig(2, rng, 20)
    assert _critical(_judged(views | {"a": _cropped(views["a"], 0.85)})) == set()


def test_terms_held_fires(rng: Rng) -> None:
    """Small boards in the middle of the picture do not show the third radial term."""
    item = _only(_judged(_rig(1, rng)), "terms_held")
    assert item.data["names"] == ["k3"]


def test_board_taken_as_flat_fires(rng: Rng) -> None:
    views = {"a": _seen(_cameras(1)["a"], _shaken(0.6, 0.2, rng), rng)}
    assert "board_taken_as_flat" in {item.code for item in _judged(views)}


def test_board_taken_as_flat_does_not_fire(rng: Rng) -> None:
    assert "board_taken_as_flat" not in {item.code for item in _judged(_rig(1, rng))}


# --- cameras that contradict each other -----------------------------------------------------------


def _later(board: Pose, millimetres: float) -> Pose:
    step = np.array([0.8, 0.6, 0]) * millimetres / 1e3
    return Pose(board.rotation, board.trans_m + step)


@pytest.mark.parametrize("n_cameras", [2, 3])
@pytest.mark.parametrize("millimetres", [2, 20])
def test_unsynchronised_frame_fires(n_cameras: int, millimetres: float, rng: Rng) -> None:
    views = _rig(n_cameras, rng)
    late = {"04": _later(_held()["04"], millimetres)}
    views["b"] |= _seen(_cameras(n_cameras)["b"], late, rng)
    item = _only(_judged(views), "unsynchronised")
    assert item.data["frames"] == ["04"]
    assert "b" in item.data["cameras"]  # type: ignore[operator]


def test_unsynchronised_frame_does_not_fire(rng: Rng) -> None:
    """A hand that trembles by 0.05 mm."""
    views = _rig(2, rng)
    views["b"] |= _seen(_cameras(2)["b"], {"04": _later(_held()["04"], 0.05)}, rng)
    assert _critical(_judged(views)) == set()


@pytest.mark.parametrize("n_cameras", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_swapped_files_are_unsynchronised(n_cameras: int, rng: Rng) -> None:
    """Of two cameras in one frame, and of two frames of one camera."""
    views = _rig(n_cameras, rng)
    a, b = views["a"], views["b"]
    crossed = {"a": a | {"04": b["04"]}, "b": b | {"04": a["04"]}}
    assert _only(_judged(views | crossed), "unsynchronised").data["frames"] == ["04"]
    shuffled = {"b": b | {"04": b["07"], "07": b["04"]}}
    assert _only(_judged(views | shuffled), "unsynchronised").data["frames"] == ["04", "07"]


def _moved(n_cameras: int, millimetres: float, degrees: float, rng: Rng) -> list[Finding]:
    views, cameras, boards = _rig(n_cameras, rng), _cameras(n_cameras), _held()
    turn = np.radians(degrees) * np.array([0.6, 0.6, 0.5])
    motion = Pose.from_rotvec(turn, millimetres / 1e3 * np.array([0.6, -0.5, 0.6]))
    half = {frame: board for frame, board in boards.items() if frame >= "06"}
    views["b"] |= _seen(motion @ cameras["b"], half, rng)
    return _judged(views)


@pytest.mark.parametrize(
    ("n_cameras", "millimetres", "degrees"),
    [(2, 5, 0.5), (2, 100, 10), (3, 20, 2), pytest.param(4, 5, 0.5, marks=pytest.mark.slow)],
)
def test_camera_moved_fires(n_cameras: int, millimetres: float, degrees: float, rng: Rng) -> None:
    item = _only(_moved(n_cameras, millimetres, degrees, rng), "camera_moved")
    assert item.data["first"] == "06"
    # of two cameras, nobody can tell which
    assert set(item.data["cameras"]) == ({"b"} if n_cameras > 2 else {"a", "b"})  # type: ignore[arg-type]
    assert item.data["angle_rad"] == pytest.approx(np.radians(degrees), rel=0.1)


def test_camera_moved_does_not_fire(rng: Rng) -> None:
    assert _critical(_moved(2, 0.02, 0.002, rng)) == set()


def test_files_swapped_half_way_are_a_moved_camera(rng: Rng) -> None:
    views = _rig(2, rng)
    a, b = views["a"], views["b"]
    late = [frame for frame in a if frame >= "06" and frame in b]
    crossed = {"a": a | {f: b[f] for f in late}, "b": b | {f: a[f] for f in late}}
    assert "camera_moved" in _critical(_judged(crossed))


def test_turned_views_fires(rng: Rng) -> None:
    """Of three cameras, two tell which one counted from the other end."""
    views = _rig(3, rng, 8)
    view = views["b"]["04"]
    ids = _BOARD.n_corners - 1 - view.corner_ids
    found = _judged(views | {"b": views["b"] | {"04": replace(view, corner_ids=ids)}})
    assert _only(found, "turned_views").data["views"] == ["b/04"]
    assert _critical(found) == set()  # it was repaired


def test_turned_views_does_not_fire(rng: Rng) -> None:
    assert "turned_views" not in {item.code for item in _judged(_rig(2, rng))}


# --- boards and lenses that are not as described --------------------------------------------------


def test_bent_board_fires(rng: Rng) -> None:
    """1 mm on 250 mm, taken as flat by --no-warp."""
    item = _only(_judged(_rig(2, rng, points=_bowed(1e-3)), RigSettings(warp=False)), "bent_board")
    assert item.data["sagitta_m"] == pytest.approx(1e-3, rel=0.2)


def test_bent_board_does_not_fire(rng: Rng) -> None:
    flat = _rig(2, rng)
    assert _critical(_judged(flat, RigSettings(warp=False))) == set()
    bent = _rig(2, rng, points=_bowed(1e-3))
    assert _critical(_judged(bent)) == set()  # it was allowed for


def test_bowed_board_fires(rng: Rng) -> None:
    item = _only(_judged(_rig(2, rng, points=_bowed(1e-3))), "bowed_board")
    assert item.data["sagitta_m"] == pytest.approx(1e-3, rel=0.2)


def test_bowed_board_does_not_fire(rng: Rng) -> None:
    assert "bowed_board" not in {item.code for item in _judged(_rig(2, rng))}


def _wide(degrees: float, rng: Rng) -> dict[str, BoardView]:
    """A fisheye that has the given angle across its picture, and boards all over it."""
    focal = 480 / np.radians(degrees / 2)
    lens = KannalaBrandt(fx=focal, fy=focal, cx=480, cy=358, k1=-0.01, k2=-0.002)
    boards = {}
    for index in range(16):
        way = rng.uniform(0, 2 * np.pi)
        out = min(np.radians(degrees / 2) * np.sqrt(rng.uniform()), 1.3)
        ahead = Pose.from_rotvec([-out * np.sin(way), out * np.cos(way), 0], np.zeros(3))
        tilt = rng.uniform(-0.5, 0.5, 3) * [1, 1, 0.5]
        turn = ahead @ Pose.from_rotvec(tilt, np.zeros(3))
        boards[f"{index:02d}"] = _centred(
            turn.rotation, ahead.apply(np.array([[0, 0, rng.uniform(0.25, 0.45)]]))[0]
        )
    return _seen(Pose.identity(), boards, rng, lens=lens)


@pytest.mark.parametrize("degrees", [110, 150])
def test_lens_misfit_fires(degrees: float, rng: Rng) -> None:
    assert "lens_misfit" in _critical(_judged({"a": _wide(degrees, rng)}))


@pytest.mark.parametrize("degrees", [110, 150])
def test_lens_misfit_does_not_fire(degrees: float, rng: Rng) -> None:
    views = {"a": _wide(degrees, rng)}
    assert _critical(_judged(views, RigSettings(lens="kannala-brandt"))) == set()


def test_terms_held_does_not_fire(rng: Rng) -> None:
    found = _judged({"a": _wide(110, rng)}, RigSettings(lens="kannala-brandt"))
    assert "terms_held" not in {item.code for item in found}


@pytest.mark.parametrize("n_cameras", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_half_size_pictures_contradict_a_fixed_lens(n_cameras: int, rng: Rng) -> None:
    views = _rig(n_cameras, rng)
    half = {
        name: {frame: _view(v.corner_ids, (v.corners_px - 0.5) / 2) for frame, v in own.items()}
        for name, own in views.items()
    }
    fixed = {"a": {name: getattr(_LENS, name) for name in ("fx", "fy", "cx", "cy")}}
    settings = RigSettings(fixed=fixed)
    assert _critical(_judged(half, settings, (480, 360)))
    assert _critical(_judged(views, settings)) == set()
    assert _critical(_judged(half, None, (480, 360))) == set()


def _mirrored(views: Mapping[str, BoardView]) -> dict[str, BoardView]:
    flip = np.array([-1, 1])
    return {
        frame: _view(view.corner_ids, view.corners_px * flip + [_SIZE_WH[0] - 1, 0])
        for frame, view in views.items()
    }


@pytest.mark.parametrize("n_cameras", [1, 2])
def test_mirrored_views_fires(n_cameras: int, rng: Rng) -> None:
    views = _rig(n_cameras, rng, 8)
    found = _judged({name: _mirrored(own) for name, own in views.items()})
    assert {item.data["camera"] for item in found if item.code == "mirrored_views"} == set(views)
    (one, *_) = [
        item for item in _judged(views | {"a": _mirrored(views["a"])})
        if item.code == "mirrored_views"
    ]  # fmt: skip
    assert one.data["camera"] == "a"


def test_mirrored_views_does_not_fire(rng: Rng) -> None:
    assert "mirrored_views" not in _critical(_judged(_rig(2, rng)))


# --- through the command line ---------------------------------------------------------------------


def _words(folder: Path, views: Views) -> list[str]:
    dataset = Dataset(sizes_wh=dict.fromkeys(views, _SIZE_WH), views=views)
    write_observations(dataset, [], folder / "c.csv")
    words = ["calibrate", "--corners", str(folder / "c.csv"), "--target", "chessboard:11x8:25mm"]
    for name in views:
        words += ["--size", f"{name}=960x720"]
    return [*words, "-o", str(folder / "rig.json")]


def test_exit_codes(cli: Any, rng: Rng, tmp_path: Path) -> None:  # noqa: ANN401 (a fixture)
    views = _rig(2, rng, 10)
    assert cli(*_words(tmp_path, views)).code == 0
    swapped = views["a"] | {"04": views["b"]["04"]}
    (tmp_path / "swapped").mkdir()
    outcome = cli(*_words(tmp_path / "swapped", views | {"a": swapped}))
    assert outcome.code == 3
    assert "critical unsynchronised" in outcome.out


def test_nan_corner_is_refused(refused: Any, rng: Rng, tmp_path: Path) -> None:  # noqa: ANN401
    words = _words(tmp_path, _rig(1, rng))
    path = tmp_path / "c.csv"
    head, first, *rest = path.read_text().splitlines()
    first = ",".join([*first.split(",")[:3], "nan", *first.split(",")[4:]])
    path.write_text("\n".join([head, first, *rest]) + "\n")
    refused(*words, says=["c.csv", "2"])
