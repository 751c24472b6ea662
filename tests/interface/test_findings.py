"""Every finding fires where it should, and only there.

Geometry and colour are judged from observations without pictures, what is said of files from files.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import ExifTags
from PIL import Image as PillowImage

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.rig_fit import ColourSettings
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import SEVERITIES, Finding
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.rig_solve import solve_rig
from calichrome.observations import BoardView, Dataset, DiscSamples
from calichrome.pipeline.calibrate import calibrate_dataset
from calichrome.pipeline.detect import _file_findings
from calichrome.pipeline.detection_cache import Seen
from calichrome.pipeline.judge import judge_target
from calichrome.pipeline.judge_geometry import judge_geometry
from calichrome.pipeline.solve_colour import solve_colour
from calichrome.pipeline.solve_geometry import GeometrySettings, SolvedGeometry, solve_geometry
from calichrome.synthetic import random_scene, write_recording
from calichrome.target import Paper, Target, chessboard

Cli = Callable[..., Any]
Small = Callable[..., Path]

_SIZE_WH = (640, 480)
_LENS = BrownConrady(fx=600, fy=601, cx=322, cy=238, k1=-0.2, k2=0.05, p1=1e-4, p2=-2e-4)
_NOISE_PX = 0.1
_BOARD = replace(chessboard((8, 7), (0.03, 0.03)), square_size_measured=True)
_CAMERAS: Mapping[str, Pose] = {
    "a": Pose.identity(),
    "b": Pose.from_rotvec([0, 0.3, 0], [-0.25, 0, 0.04]),
    "c": Pose.from_rotvec([0, -0.3, 0], [0.25, 0, 0.04]),
}
_WHITE_RGB = np.array([0.75, 0.8, 0.7])
_RGB_FROM_XYZ = np.array([[1.9, -0.6, -0.3], [-0.7, 1.6, 0.1], [0.1, -0.2, 1.0]])


def _held(n_frames: int, tilt_rad: float = 0.6) -> dict[str, Pose]:
    """Boards about 0.7 m away, tilted each to another side."""
    centre = _BOARD.corners_board.mean(axis=0)
    poses = {}
    for index in range(n_frames):
        angle = 2.4 * index
        turn = Pose.from_rotvec(
            [tilt_rad * np.cos(angle), tilt_rad * np.sin(angle), 0.2 * np.sin(index)], np.zeros(3)
        )
        place = [0.08 * np.sin(1.7 * index), 0.05 * np.cos(2.9 * index), 0.62 + 0.015 * index]
        poses[f"{index:02d}"] = Pose(np.eye(3), np.array(place)) @ turn @ Pose(np.eye(3), -centre)
    return poses


def _seen(
    boards: Mapping[str, Pose],
    rng: np.random.Generator,
    *,
    target: Target = _BOARD,
    camera: str = "a",
    discs: DiscSamples | None = None,
) -> dict[str, BoardView]:
    views = {}
    for frame, ref_from_board in boards.items():
        points = (_CAMERAS[camera] @ ref_from_board).apply(target.corners_board)
        pixels = _LENS.project(points) + rng.normal(0, _NOISE_PX, (target.n_corners, 2))
        assert ((pixels > 0) & (pixels < _SIZE_WH)).all()  # or the scene is not what it says
        views[frame] = BoardView(
            corner_ids=np.arange(target.n_corners), corners_px=pixels, discs=discs
        )
    return views


def _dataset(**views: Mapping[str, BoardView]) -> Dataset:
    return Dataset(sizes_wh=dict.fromkeys(views, _SIZE_WH), views=views)


def _moved(view: BoardView, offsets_px: FloatArray) -> BoardView:
    return replace(view, corners_px=view.corners_px + offsets_px)


def _judged(views: Mapping[str, BoardView], target: Target = _BOARD) -> tuple[Finding, ...]:
    """Solve camera a and judge it, without the errors on frames left out, which take longest."""
    return _judged_rig(_dataset(a=views), target)


def _judged_rig(dataset: Dataset, target: Target) -> tuple[Finding, ...]:
    solution = solve_rig(dataset, target)
    geometry = SolvedGeometry(
        solution=solution, held_out=dict.fromkeys(dataset.cameras), rig_settings=None
    )
    return _remarkable((*judge_target(target), *judge_geometry(geometry, target)))


def _remarkable(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Leave out that k3 was held: these boards stay in the middle of the picture."""
    return tuple(item for item in findings if item.code != "terms_held")


def _codes(findings: Iterable[Finding]) -> set[str]:
    findings = list(findings)
    assert all(item.severity == SEVERITIES[item.code] for item in findings)
    return {item.code for item in findings}


# --- geometry -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def quiet() -> tuple[Finding, ...]:
    """Two good cameras, a measured board of 56 corners, ten tilted views: nothing to remark."""
    rng = np.random.default_rng(1)
    boards = _held(10)
    views = {camera: _seen(boards, rng, camera=camera) for camera in ("a", "b")}
    rig = calibrate_dataset(_dataset(**views), _BOARD).rig
    assert rig.trustworthy
    return _remarkable(rig.findings)


def test_good_observations_give_no_finding(quiet: tuple[Finding, ...]) -> None:
    assert _codes(quiet) == set()


def test_few_views_fires(rng: np.random.Generator) -> None:
    (item,) = _judged(_seen(_held(9), rng))
    assert item.code == "few_views"
    assert item.data["n_views"] == 9
    assert "±" in item.text  # what it costs
    assert "15 to 25" in item.text


def test_few_views_does_not_fire(rng: np.random.Generator) -> None:
    assert _codes(_judged(_seen(_held(10), rng))) == set()


def test_small_board_fires(rng: np.random.Generator) -> None:
    board = replace(chessboard((9, 6), (0.03, 0.03)), square_size_measured=True)
    assert _codes(_judged(_seen(_held(10), rng, target=board), board)) == {"small_board"}


def test_small_board_does_not_fire(quiet: tuple[Finding, ...]) -> None:
    assert _BOARD.n_corners == 56  # 8x7, the paper's
    assert "small_board" not in _codes(quiet)


def test_scale_unverified_fires(rng: np.random.Generator) -> None:
    board = replace(_BOARD, square_size_measured=False)
    assert _codes(_judged(_seen(_held(10), rng), board)) == {"scale_unverified"}


def test_scale_unverified_does_not_fire(quiet: tuple[Finding, ...]) -> None:
    assert "scale_unverified" not in _codes(quiet)


def test_weak_geometry_fires(rng: np.random.Generator) -> None:
    """All boards parallel to the picture: focal length and distance are one number."""
    found = _judged(_seen(_held(10, tilt_rad=0), rng))
    assert "weak_geometry" in _codes(found)
    assert "Tilt the board" in found[-1].text


def test_weak_geometry_does_not_fire(rng: np.random.Generator) -> None:
    """Tilts of 15 degrees are poor, yet enough to trust the result."""
    assert _codes(_judged(_seen(_held(10, tilt_rad=0.26), rng))) == set()


def _judged_solution(rng: np.random.Generator, *, converged: bool) -> set[str]:
    """Judge ten tilted views; that solves which give up say so is a law of the solver's tests."""
    solution = solve_rig(_dataset(a=_seen(_held(10), rng)), _BOARD)
    assert solution.converged
    geometry = SolvedGeometry(
        solution=replace(solution, converged=converged), held_out={"a": None}, rig_settings=None
    )
    return _codes(_remarkable(judge_geometry(geometry, _BOARD)))


def test_not_converged_fires(rng: np.random.Generator) -> None:
    assert _judged_solution(rng, converged=False) == {"not_converged"}


def test_not_converged_does_not_fire(rng: np.random.Generator) -> None:
    assert _judged_solution(rng, converged=True) == set()


def _pair(rng: np.random.Generator, motion_m: float) -> tuple[Finding, ...]:
    """Camera b looks later: in every third frame the board has moved on."""
    boards = _held(10)
    later = {
        frame: Pose(np.eye(3), np.array([motion_m, 0, 0])) @ pose if index % 3 == 0 else pose
        for index, (frame, pose) in enumerate(boards.items())
    }
    views = {"a": _seen(boards, rng), "b": _seen(later, rng, camera="b")}
    return _judged_rig(_dataset(**views), _BOARD)


def test_unsynchronised_fires(rng: np.random.Generator) -> None:
    (item,) = _pair(rng, 0.003)  # 3 mm at 0.7 m: 2.6 px
    assert item.code == "unsynchronised"
    assert item.data["cameras"] == ["a", "b"]
    assert "Hold it still" in item.text


def test_unsynchronised_does_not_fire(rng: np.random.Generator) -> None:
    """A hand that trembles by a tenth of the noise of a corner is no motion."""
    assert _codes(_pair(rng, 1e-5)) == set()


def test_views_disagree_fires(rng: np.random.Generator) -> None:
    views = _seen(_held(10), rng)
    views["05"] = _moved(views["05"], rng.normal(0, 3, (_BOARD.n_corners, 2)))
    (item,) = [item for item in _judged(views) if item.severity == "critical"]
    assert item.code == "views_disagree"
    assert item.data["frames"] == ["05"]


def test_views_disagree_does_not_fire(rng: np.random.Generator) -> None:
    """A view of twice the noise of the others is no stranger."""
    views = _seen(_held(10), rng)
    more = np.sqrt(3) * _NOISE_PX
    views["05"] = _moved(views["05"], rng.normal(0, more, (_BOARD.n_corners, 2)))
    assert _codes(_judged(views)) == set()


def _waved(rng: np.random.Generator, amplitude_px: float) -> tuple[Finding, ...]:
    """Look through a glass that no Brown-Conrady lens describes."""
    views = {
        frame: _moved(view, amplitude_px * np.sin(view.corners_px / 12))
        for frame, view in _seen(_held(10), rng).items()
    }
    return _judged(views)


def test_poor_fit_fires(rng: np.random.Generator) -> None:
    assert _codes(_waved(rng, 1.5)) == {"poor_fit"}


def test_poor_fit_does_not_fire(rng: np.random.Generator) -> None:
    """Waves of the size of the noise."""
    assert _codes(_waved(rng, 0.1)) == set()


# --- colour ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def colour_board(standard_target: Target) -> Target:
    """The standard board, all of it measured."""
    return replace(
        standard_target,
        square_size_measured=True,
        colours_measured=True,
        paper=Paper(white_xyz_d65=(0.80, 0.85, 0.88)),
    )


def _discs(
    target: Target, *, gain: float = 1.0, gamma: float = 1.0, clipped: float = 0.0
) -> DiscSamples:
    """Discs as a linear camera sees them: light `gain`, then a wrongly removed encoding."""
    n = len(target.markers)
    rgb = np.clip(target.marker_xyz_d65 @ _RGB_FROM_XYZ.T, 1e-3, None) * _WHITE_RGB
    rgb = (gain * rgb) ** gamma
    white = np.broadcast_to((0.85 * gain * _WHITE_RGB) ** gamma, (n, 3))
    return DiscSamples(
        marker_ids=np.arange(n),
        centres_px=target.marker_centres_board[:, :2] * 1000 + 100,
        mean_rgb=rgb,
        median_rgb=rgb,
        cov_rgb=np.broadcast_to(1e-6 * np.eye(3), (n, 3, 3)),
        n_px=np.full(n, 60),
        clipped=np.where(np.arange(n) == 3, clipped, 0.0),
        white_rgb=white,
        black_rgb=0.05 * white,
    )


def _with_discs(
    target: Target, rng: np.random.Generator, discs: Mapping[str, list[DiscSamples]]
) -> Dataset:
    """Give cameras ten views each that hold these discs in turn."""
    boards = _held(10)
    views = {}
    for camera, samples in discs.items():
        seen = _seen(boards, rng, target=target, camera=camera)
        views[camera] = {
            frame: replace(view, discs=samples[index % len(samples)])
            for index, (frame, view) in enumerate(seen.items())
        }
    return _dataset(**views)


def _judged_colour(dataset: Dataset, target: Target) -> list[Finding]:
    """Judge target and colours; of the geometry only the poses count."""
    solved = solve_geometry(dataset, target, GeometrySettings(), fixed={}, lenses={}).solution
    encodings: dict[str, EncodingName | ToneCurve | None] = dict.fromkeys(dataset.cameras, "srgb")
    colour = solve_colour(dataset, target, solved, encodings, ColourSettings())
    return [*judge_target(target), *colour.findings]


@pytest.fixture(scope="module")
def quiet_colour(colour_board: Target) -> tuple[Finding, ...]:
    rng = np.random.default_rng(2)
    # the board turns from the lamp in some frames: darker in both cameras, which is no jump
    discs = [_discs(colour_board, gain=gain) for gain in (1.0, 0.9, 0.6, 1.1, 1.0)]
    dataset = _with_discs(colour_board, rng, {"a": discs, "b": discs})
    rig = calibrate_dataset(dataset, colour_board).rig
    assert all(camera.colour is not None for camera in rig.cameras.values())
    return _remarkable(rig.findings)


def test_good_colours_give_no_finding(quiet_colour: tuple[Finding, ...]) -> None:
    assert _codes(quiet_colour) == set()


def test_nominal_unmeasured_fires(colour_board: Target) -> None:
    nominal = replace(colour_board, colours_measured=False)
    assert _codes(judge_target(nominal)) == {"nominal_unmeasured"}


def test_nominal_unmeasured_does_not_fire(quiet_colour: tuple[Finding, ...]) -> None:
    assert "nominal_unmeasured" not in _codes(quiet_colour)
    assert not _BOARD.colours_measured
    assert _codes(judge_target(_BOARD)) == set()  # a board without colours


def test_paper_white_unknown_fires(colour_board: Target) -> None:
    assert _codes(judge_target(replace(colour_board, paper=Paper()))) == {"paper_white_unknown"}


def test_paper_white_unknown_does_not_fire(quiet_colour: tuple[Finding, ...]) -> None:
    assert "paper_white_unknown" not in _codes(quiet_colour)
    assert _codes(judge_target(_BOARD)) == set()


def test_colour_not_calibrated_fires(colour_board: Target, rng: np.random.Generator) -> None:
    dataset = _dataset(a=_seen(_held(10), rng, target=colour_board))  # grey: there are no discs
    (item,) = _judged_colour(dataset, colour_board)
    assert (item.code, item.data["camera"]) == ("colour_not_calibrated", "a")


def test_colour_not_calibrated_does_not_fire(
    quiet: tuple[Finding, ...], quiet_colour: tuple[Finding, ...]
) -> None:
    assert "colour_not_calibrated" not in _codes(quiet_colour)
    assert "colour_not_calibrated" not in _codes(quiet)  # nothing was asked for


def test_clipped_discs_fires(colour_board: Target, rng: np.random.Generator) -> None:
    discs = [_discs(colour_board, clipped=0.02), _discs(colour_board)]
    (item,) = _judged_colour(_with_discs(colour_board, rng, {"a": discs}), colour_board)
    assert item.code == "clipped_discs"
    assert item.data["n_clipped"] == 5  # one disc in every other of ten views


def test_clipped_discs_does_not_fire(quiet_colour: tuple[Finding, ...]) -> None:
    assert "clipped_discs" not in _codes(quiet_colour)


def test_exposure_changes_fires(colour_board: Target, rng: np.random.Generator) -> None:
    """One camera brightens one frame by half."""
    steady = _discs(colour_board)
    jumping = [steady] * 4 + [_discs(colour_board, gain=1.5)] + [steady] * 5
    dataset = _with_discs(colour_board, rng, {"a": [steady], "b": jumping})
    (item,) = _judged_colour(dataset, colour_board)
    assert item.code == "exposure_changes"
    assert item.data["frame"] == "04"
    factor = float(str(item.data["ratio"]))
    # with two cameras either may be the one that jumped
    assert max(factor, 1 / factor) == pytest.approx(1.5, rel=0.01)


@pytest.mark.slow
def test_exposure_changes_names_the_camera(colour_board: Target, rng: np.random.Generator) -> None:
    """Of three cameras, the one that jumps against both others."""
    steady = _discs(colour_board)
    jumping = [steady] * 4 + [_discs(colour_board, gain=1.5)] + [steady] * 5
    views = {"a": [steady], "b": jumping, "c": [_discs(colour_board, gain=0.7)]}
    (item,) = _judged_colour(_with_discs(colour_board, rng, views), colour_board)
    assert (item.data["camera"], item.data["frame"]) == ("b", "04")
    assert item.data["ratio"] == pytest.approx(1.5, rel=0.01)


def test_exposure_changes_does_not_fire(
    quiet_colour: tuple[Finding, ...], render_rig: dict[str, Any]
) -> None:
    assert "exposure_changes" not in _codes(quiet_colour)
    assert not _of(render_rig, "exposure_changes")


def test_encoding_doubtful_fires(colour_board: Target, rng: np.random.Generator) -> None:
    """Rec. 709 taken for sRGB acts like an exponent of about 0.85."""
    dataset = _with_discs(colour_board, rng, {"a": [_discs(colour_board, gamma=0.85)]})
    (item,) = _judged_colour(dataset, colour_board)
    assert item.code == "encoding_doubtful"
    assert item.data["slope"] == pytest.approx(0.85, abs=0.03)


@pytest.mark.slow
def test_encoding_doubtful_fires_on_pictures(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(3)
    fires = {}
    for encoding in ("linear", "srgb"):  # they are sRGB
        (folder / "recording.toml").write_text(f'encoding = "{encoding}"\n')
        fires[encoding] = bool(_of(_calibrated(cli, folder, tmp_path), "encoding_doubtful"))
    assert fires == {"linear": True, "srgb": False}


def test_encoding_estimated_fires(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(3)
    (folder / "recording.toml").write_text('encoding = "unknown"\n')
    rig = _calibrated(cli, folder, tmp_path)
    assert _of(rig, "encoding_estimated")
    assert {camera["colour"]["encoding"]["name"] for camera in rig["cameras"].values()} == {"srgb"}


def test_encoding_estimated_does_not_fire(quiet_colour: tuple[Finding, ...]) -> None:
    assert "encoding_estimated" not in _codes(quiet_colour)


def test_encoding_doubtful_does_not_fire(
    quiet_colour: tuple[Finding, ...], cli: Cli, standard_target: Target, tmp_path: Path
) -> None:
    """A print whose colours are off by 3 in L, a and b is no wrong encoding."""
    assert "encoding_doubtful" not in _codes(quiet_colour)
    scene = random_scene(standard_target, 1, 3, (640, 480), seed=5, palette_error_lab_sd=3)
    write_recording(scene, tmp_path / "print")
    rig = _calibrated(cli, tmp_path / "print", tmp_path)
    assert rig["cameras"]["cam0"]["colour"] is not None
    assert not _of(rig, "encoding_doubtful")


def test_target_contradicted_fires(colour_board: Target, rng: np.random.Generator) -> None:
    """A mirrored picture of a colour board gives other discs in the same places."""
    discs = _discs(colour_board)
    mixed = replace(discs, mean_rgb=discs.mean_rgb[::-1].copy())
    (item, *_) = _judged_colour(_with_discs(colour_board, rng, {"a": [mixed]}), colour_board)
    assert (item.code, item.severity) == ("target_contradicted", "critical")


def test_target_contradicted_does_not_fire(
    quiet_colour: tuple[Finding, ...], colour_board: Target, rng: np.random.Generator
) -> None:
    """Nor does it for a wrong encoding, which is another finding."""
    assert "target_contradicted" not in _codes(quiet_colour)
    dataset = _with_discs(colour_board, rng, {"a": [_discs(colour_board, gamma=0.45)]})
    assert "target_contradicted" not in _codes(_judged_colour(dataset, colour_board))


# --- files ----------------------------------------------------------------------------------------


def _as_jpeg(path: Path, tags: Mapping[int, Any], exposure: Mapping[int, Any]) -> None:
    exif = PillowImage.Exif()
    for tag, value in tags.items():
        exif[tag] = value
    details = exif.get_ifd(ExifTags.IFD.Exif)
    for tag, value in exposure.items():
        details[tag] = value
    with PillowImage.open(path) as picture:
        picture.save(path.with_suffix(".jpg"), quality=97, subsampling=0, exif=exif)
    path.unlink()


def _calibrated(cli: Cli, folder: Path, tmp_path: Path) -> dict[str, Any]:
    words = ["--cameras", "cam0", "--json", "--force", "-o", tmp_path / "rig.json"]
    outcome = cli("calibrate", folder, *words)
    assert (outcome.code, outcome.err) == (0, "")
    rig: dict[str, Any] = outcome.json
    return rig


def _of(rig: dict[str, Any], code: str) -> list[dict[str, Any]]:
    return [item for item in rig["findings"] if item["code"] == code]


@pytest.mark.slow
@pytest.mark.parametrize("last_s", [0.02, 0.01])
def test_exif_exposure(cli: Cli, small: Small, tmp_path: Path, last_s: float) -> None:
    folder = small(4)
    for index, path in enumerate(sorted((folder / "cam0").iterdir())):
        seconds = last_s if index == 3 else 0.01
        _as_jpeg(path, {}, {ExifTags.Base.ExposureTime: seconds, ExifTags.Base.FNumber: 4.0})
    found = _of(_calibrated(cli, folder, tmp_path), "exposure_changes")
    assert len(found) == (1 if last_s == 0.02 else 0)
    assert all("exposure_s" in item["text"] for item in found)


def test_rotation_tag_ignored_fires(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4)
    paths = sorted((folder / "cam0").iterdir())
    for path in paths:
        _as_jpeg(path, {ExifTags.Base.Orientation: 6 if path in paths[:2] else 1}, {})
    rig = _calibrated(cli, folder, tmp_path)
    (found,) = _of(rig, "rotation_tag_ignored")
    assert found["frames"] == ["000", "001"]
    assert rig["cameras"]["cam0"]["size_wh"] == [640, 480]  # not applied


def test_rotation_tag_ignored_does_not_fire(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4)
    for path in sorted((folder / "cam0").iterdir()):
        _as_jpeg(path, {ExifTags.Base.Orientation: 1}, {})
    assert not _of(_calibrated(cli, folder, tmp_path), "rotation_tag_ignored")


def test_unreadable_frame_fires(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4)
    (folder / "cam0" / "004.tif").write_bytes(b"II*\0 and no more")
    (found,) = _of(_calibrated(cli, folder, tmp_path), "unreadable_frame")
    assert (found["camera"], found["frame"]) == ("cam0", "004")


def test_no_board_frame_fires(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4)
    assert cv2.imwrite(str(folder / "cam0" / "004.png"), np.full((480, 640, 3), 90, np.uint8))
    (found,) = _of(_calibrated(cli, folder, tmp_path), "no_board_frame")
    assert found["frames"] == ["004"]
    assert "add light" in found["text"]


def _simulated_codes(simulated_rig: Path) -> set[str]:
    return {item["code"] for item in json.loads(simulated_rig.read_text())["findings"]}


def test_unreadable_frame_does_not_fire(simulated_rig: Path) -> None:
    assert "unreadable_frame" not in _simulated_codes(simulated_rig)


def test_no_board_frame_does_not_fire(simulated_rig: Path) -> None:
    assert "no_board_frame" not in _simulated_codes(simulated_rig)


def test_background_is_no_missing_board(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4)
    shutil.copy(folder / "cam0" / "003.png", folder / "cam0" / "background1.png")
    rig = _calibrated(cli, folder, tmp_path)
    assert rig["cameras"]["cam0"]["n_views"] == 4
    assert not _of(rig, "no_board_frame")


# --- all of them ----------------------------------------------------------------------------------


@pytest.mark.parametrize("code", SEVERITIES)
def test_every_code_has_both_tests(code: str) -> None:
    here = Path(__file__).parent
    text = "".join(path.read_text("utf-8") for path in sorted(here.glob("test_*.py")))
    assert f"def test_{code}_fires" in text
    assert f"def test_{code}_does_not_fire" in text


def test_documentation_lists_exactly_the_codes() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "findings.md").read_text("utf-8")
    rows = [line for line in text.splitlines() if line.startswith(("| `", "#"))]
    listed = [row.split("`")[1] for row in rows if "`" in row]
    assert sorted(listed) == sorted(SEVERITIES)
    for row in rows:
        if "`" in row:
            assert SEVERITIES[row.split("`")[1]] in row


def test_critical_finding_gives_exit_code_3(cli: Cli, tmp_path: Path) -> None:
    """Done, written, and not to be trusted."""
    rng = np.random.default_rng(3)
    lines = ["camera,frame,corner,x,y"]
    for frame, view in _seen(_held(10, tilt_rad=0), rng).items():
        for corner, (x, y) in zip(view.corner_ids, view.corners_px, strict=True):
            lines.append(f"a,{frame},{corner},{x:.4f},{y:.4f}")
    (tmp_path / "c.csv").write_text("\n".join(lines) + "\n")
    words = ["--target", "chessboard:8x7:30mm", "--size", "a=640x480"]
    outcome = cli("calibrate", "--corners", tmp_path / "c.csv", *words, "-o", tmp_path / "r.json")
    assert outcome.code == 3
    assert outcome.err == ""
    assert "Trustworthy: NO" in outcome.out
    assert "critical weak_geometry" in outcome.out
    assert not json.loads((tmp_path / "r.json").read_text())["trustworthy"]


def _seen_with(cov_scale: float) -> dict[tuple[str, str], Seen]:
    corners = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    view = BoardView(
        corner_ids=np.arange(20),
        corners_px=30 * corners,
        cov_px=np.broadcast_to(0.01 * np.eye(2), (20, 2, 2)),
        cov_scale=cov_scale,
    )
    return {("cam0", str(frame)): Seen(found=view, size_wh=(640, 480)) for frame in range(3)}


@pytest.mark.parametrize("cov_scale", [0.3, 3.0])
def test_correlated_noise_fires(cov_scale: float) -> None:
    (found,) = _file_findings(_seen_with(cov_scale))
    assert found.code == "correlated_noise"
    assert found.data["cov_scale"] == cov_scale


@pytest.mark.parametrize("cov_scale", [0.8, 1.0, 1.3])
def test_correlated_noise_does_not_fire(cov_scale: float) -> None:
    assert not _file_findings(_seen_with(cov_scale))
