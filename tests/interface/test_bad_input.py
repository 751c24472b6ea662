"""What people do to a program: every mistake ends in one sentence that names it and the remedy."""

import json
import re
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

Cli = Callable[..., Any]
Refused = Callable[..., str]
Small = Callable[..., Path]
Change = Callable[[dict[str, Any]], None]


def _write(path: Path, pixels: np.ndarray[Any, Any]) -> None:
    assert cv2.imwrite(str(path), pixels)


def _cut(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _as_grey16(path: Path) -> None:
    """Store a picture as linear 16-bit grey under the same frame name."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    path.unlink()
    linear = np.rint((grey / 255) ** 2.2 * 65535).astype(np.uint16)
    _write(path.with_suffix(".png"), linear)


def _findings(outcome: Any, code: str) -> list[dict[str, Any]]:  # noqa: ANN401
    return [item for item in outcome.json["findings"] if item["code"] == code]


# --- recordings that cannot be read -------------------------------------------------------------


def test_folder_does_not_exist(refused: Refused, tmp_path: Path) -> None:
    folder = tmp_path / "nowhere"
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=[str(folder), "give the folder"])


def test_recording_is_a_file(refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(b"film")
    refused("calibrate", path, "-o", tmp_path / "r.json", says=[str(path), "give the folder"])


def test_name_longer_than_the_disk_allows(refused: Refused, tmp_path: Path) -> None:
    refused("calibrate", tmp_path / ("x" * 400), "-o", tmp_path / "r.json", says=["check the path"])


def test_no_pictures(refused: Refused, tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "notes.txt").write_text("nothing here")
    refused("calibrate", folder, "-o", tmp_path / "r.json", says=[str(folder), ".png", "extract"])


def test_only_background_pictures(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(2)
    for camera in ("cam0", "cam1"):
        for path in list((folder / camera).iterdir()):
            path.rename(path.with_name(f"background{path.name}"))
    refused("calibrate", folder, "-o", tmp_path / "r.json", says=["background", "record views"])


def test_no_common_frame(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(3)
    for path in list((folder / "cam1").iterdir()):
        path.rename(path.with_name(f"later{path.name}"))
    says = ["cam0: 000", "cam1: later000", "--pattern"]
    refused("calibrate", folder, "-o", tmp_path / "r.json", says=says)


def test_flat_folder_with_two_readings(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder, flat = small(3), tmp_path / "flat"
    flat.mkdir()
    for camera, name in (("cam0", "left"), ("cam1", "right")):
        for path in (folder / camera).iterdir():
            shutil.copy(path, flat / f"{name}{path.name}")
    shutil.copy(folder / "target.json", flat)
    says = ['--pattern "{frame}"', "6 frames", "left, right", '--pattern "{camera:left|right}']
    refused("calibrate", flat, "-o", tmp_path / "rig.json", says=says)


@pytest.mark.parametrize(
    ("pattern", "says"),
    [
        ("{camera}/x", "{frame}"),
        ("{cam}/{frame}", "{cam} is not a field"),
        ("{camera}/{frame", "must hold {frame}"),
        ("view{camera}/{frame}", "names look like cam0/000"),
    ],
)
def test_pattern(refused: Refused, small: Small, tmp_path: Path, pattern: str, says: str) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", "--pattern", pattern]
    refused(*words, says=[says, "--pattern"])


def test_unknown_camera_asked_for(refused: Refused, small: Small, tmp_path: Path) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", "--cameras", "cam0,cam7"]
    refused(*words, says=["cam7", "there are cam0, cam1"])


def test_unknown_reference_camera(refused: Refused, small: Small, tmp_path: Path) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", "--reference-camera", "middle"]
    refused(*words, says=["middle", "cam0, cam1", "correct"])


# --- pictures that are none, or odd ones ---------------------------------------------------------


@pytest.mark.parametrize("damage", ["text", "half a PNG", "half a JPEG", "empty"])
def test_bad_picture_among_good_ones(cli: Cli, small: Small, tmp_path: Path, damage: str) -> None:
    folder = small(4)
    path = folder / "cam0" / f"bad.{'jpg' if 'JPEG' in damage else 'png'}"
    if damage == "text":
        path.write_text("this is no picture")
    elif damage == "empty":
        path.touch()
    else:
        picture = cv2.imread(str(folder / "cam0" / "003.png"))
        assert picture is not None
        _write(path, picture)
        _cut(path)
    words = ["calibrate", folder, "--cameras", "cam0", "-o", tmp_path / "rig.json", "--json"]
    outcome = cli(*words)
    assert (outcome.code, outcome.err) == (0, "")
    (found,) = _findings(outcome, "unreadable_frame")
    assert (found["camera"], found["frame"]) == ("cam0", "bad")
    # it says what to do, not what a library threw
    remedy = "copy it again" if "half" in damage else "remove it"
    assert remedy in found["text"]
    assert outcome.json["cameras"]["cam0"]["n_views"] == 4
    assert (tmp_path / "rig.json").is_file()


@pytest.mark.parametrize("damage", ["text", "half"])
def test_no_picture_can_be_read(
    refused: Refused, small: Small, tmp_path: Path, damage: str
) -> None:
    folder = small(2)
    for path in (folder / "cam1").iterdir():
        if damage == "text":
            path.write_text("no picture")
        else:
            _cut(path)
    remedy = "remove it" if damage == "text" else "copy it again"
    says = ["camera cam1", "none of its pictures can be read", "000", remedy]
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


def test_pictures_of_two_sizes(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(3)
    path = folder / "cam1" / "002.png"
    picture = cv2.imread(str(path))
    assert picture is not None
    _write(path, cv2.resize(picture, (320, 240)))
    says = ["camera cam1", "640x480 (2", "320x240 (1, for example 002)", "remove"]
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


@pytest.mark.slow
def test_grey_16_bit_recording(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(4, toml=False)
    for path in [*(folder / "cam0").iterdir(), *(folder / "cam1").iterdir()]:
        _as_grey16(path)
    outcome = cli("calibrate", folder, "-o", tmp_path / "rig.json", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    named = {item["camera"] for item in _findings(outcome, "colour_not_calibrated")}
    assert named == {"cam0", "cam1"}
    assert all(camera["colour"] is None for camera in outcome.json["cameras"].values())
    # 0.05 px of corner noise and 8 bits less the tones above: as good as the colour pictures
    assert all(camera["rms_px"] < 0.15 for camera in outcome.json["cameras"].values())


@pytest.mark.slow
def test_one_grey_16_bit_picture_among_colour_ones(cli: Cli, small: Small, tmp_path: Path) -> None:
    """It serves the geometry, and does not change how the others are read."""
    folder = small(4, toml=False)
    _as_grey16(folder / "cam0" / "000.png")
    words = ["calibrate", folder, "--cameras", "cam0", "-o", tmp_path / "rig.json", "--json"]
    outcome = cli(*words)
    assert (outcome.code, outcome.err) == (0, "")
    camera = outcome.json["cameras"]["cam0"]
    assert camera["n_views"] == 4
    assert camera["colour"]["encoding"]["name"] == "srgb"


def _png_bomb(side: int) -> bytes:
    """A PNG of side x side pixels whose rows of zeros take next to nothing."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        checked = kind + content
        return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))

    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    squeeze = zlib.compressobj(1)
    rows = [squeeze.compress(bytes(1 + 3 * side)) for _ in range(side)]
    body = b"".join(rows) + squeeze.flush()
    parts = chunk(b"IHDR", header), chunk(b"IDAT", body), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


_MEASURED = """
import resource, sys, time
from calichrome.cli.main import main
import calichrome.pipeline.calibrate
import calichrome.detection
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start = time.monotonic()
code = main(sys.argv[1:])
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(code, (after - before) / 1024, time.monotonic() - start)
"""


def test_png_that_unpacks_to_gigabytes(small: Small, tmp_path: Path) -> None:
    folder = small(1)
    bomb = _png_bomb(20_000)  # 1.2 GB of pixels
    assert len(bomb) < 10_000_000
    for camera in ("cam0", "cam1"):
        (folder / camera / "000.png").write_bytes(bomb)
    words = [sys.executable, "-c", _MEASURED, "calibrate", str(folder), "-o", str(tmp_path / "r")]
    done = subprocess.run(words, capture_output=True, text=True, check=True)  # noqa: S603
    code, megabytes, seconds = map(float, done.stdout.split())
    assert code == 1
    (sentence,) = done.stderr.splitlines()
    assert sentence.startswith("calichrome: camera cam0")
    assert "megapixels" in sentence
    assert "--max-megapixels" in sentence
    assert megabytes < 200  # the files themselves and what is imported late
    assert seconds < 5  # OpenCV alone takes over 20 s to unpack such a file
    assert not (tmp_path / "r").exists()


def test_large_pictures_can_be_allowed_and_refused(
    refused: Refused, small: Small, tmp_path: Path
) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", "--max-megapixels", "0.2"]
    refused(*words, says=["camera cam0", "megapixels", "--max-megapixels"])


# --- boards that are not there, or not the one ----------------------------------------------------


def test_wrong_corner_count_names_what_is_seen(
    refused: Refused, small: Small, tmp_path: Path
) -> None:
    words = ["calibrate", small(3), "-o", tmp_path / "r.json", "--target", "chessboard:7x6:30mm"]
    refused(*words, says=["9x8", "7x6", "--target"])


def test_camera_without_any_detection(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(2)
    for path in (folder / "cam1").iterdir():
        _write(path, np.full((480, 640, 3), 120, np.uint8))
    says = ["camera cam1", "none of its 2 pictures", "add light", "--cameras"]
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


def test_no_board_anywhere_leaves_headers_only(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(2)
    for path in [*(folder / "cam0").iterdir(), *(folder / "cam1").iterdir()]:
        _write(path, np.full((480, 640, 3), 120, np.uint8))
    outcome = cli("detect", folder, "-o", tmp_path / "c.csv")
    assert outcome.code == 1
    (sentence,) = outcome.err.splitlines()
    assert re.match("calichrome: no board .*4 pictures.*c.rejected.csv", sentence)
    assert (tmp_path / "c.csv").read_text().splitlines() == ["camera,frame,corner,x,y,sxx,sxy,syy"]
    assert len((tmp_path / "c.rejected.csv").read_text().splitlines()) == 1 + 4


def test_unconnected_cameras(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(6)
    for camera, dropped in (("cam0", "012"), ("cam1", "345")):
        for digit in dropped:
            (folder / camera / f"00{digit}.png").unlink()
    # they share a frame name, but no view of the board
    _write(folder / "cam0" / "003.png", np.full((480, 640, 3), 120, np.uint8))
    _write(folder / "cam1" / "003.png", np.full((480, 640, 3), 120, np.uint8))
    shutil.copy(folder / "cam0" / "005.png", folder / "cam0" / "006.png")
    says = ["2 groups", "cam0 | cam1", "record"]
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


def test_mirror_image_of_a_both_odd_board_is_named(
    refused: Refused, data: Path, tmp_path: Path
) -> None:
    words = ["--pattern", "{camera}/{camera}{frame}", "--target", "chessboard:13x9:30mm"]
    folder = tmp_path / "odd"
    for camera in ("left", "middle"):
        (folder / camera).mkdir(parents=True)
        name = f"{camera}/{camera}1.jpg"
        shutil.copy(data / "boofcv_trinocular_odd" / name, folder / name)
    refused("calibrate", folder, "-o", tmp_path / "r.json", *words, says=["13x9", "is 9x13"])


# --- recording.toml -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('colr = "srgb"\n', ["unknown key colr", "known are", "encoding"]),
        ('[cameras.cam0]\nencodng = "srgb"\n', ["cameras.cam0.encodng", "known are", "bits"]),
        ('[cameras.cam0]\nencoding = "adobe"\n', ["cameras.cam0.encoding", "'srgb'", "correct it"]),
        ('[cameras.cam7]\nencoding = "srgb"\n', ["cameras.cam7", "cam0, cam1", "correct"]),
        ("[cameras.cam0.fixed]\nfocal = 3\n", ["camera cam0", "focal", "fx, fy"]),
        ("bits = 99\n", ["bits", "correct it"]),
        ("[[[\n", ["cannot be read as TOML", "repair it"]),
        ("a = " + "[" * 100_000, ["cannot be read as TOML", "repair it"]),
        ('reference_camera = "middle"\n', ["middle", "cam0, cam1", "recording.toml"]),
        ('square = "30"\n', ["'30' has no unit", "30mm"]),
    ],
)
def test_recording_toml(
    refused: Refused, small: Small, tmp_path: Path, text: str, says: list[str]
) -> None:
    folder = small(3)
    (folder / "recording.toml").write_text(text)
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


# --- target.json and --target ---------------------------------------------------------------------


def _set(*path: str | int, value: object) -> Change:
    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_set("markers", 0, "XYZ_D65", value=[1.0, float("nan"), 2.0]), ["NaN"]),
        (_set("markers", 1, "square", value=[0, 0]), ["disc 1", "two discs"]),
        (_set("markers", 1, "square", value=[77, 3]), ["disc 1", "(77, 3)", "outside"]),
        (_set("markers", 2, "diameter_m", value=0.5), ["disc 2", "500 mm", "does not fit"]),
        (_set("format_version", value=99), ["format_version"]),
        (_set("format", value="calichrome.rig"), ["format"]),
        (_set("squares", value=[2, 2]), ["2x2 squares", "4x4"]),
        (_set("top_left_square", value="white"), ["background", "correct"]),
    ],
)
def test_target_json(
    refused: Refused, small: Small, tmp_path: Path, change: Change, says: list[str]
) -> None:
    folder = small(1)
    path = folder / "target.json"
    content = json.loads(path.read_text())
    assert content["markers"][0]["square"] == [0, 0]
    change(content)
    path.write_text(json.dumps(content))
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=["target.json", *says])


@pytest.mark.parametrize("text", ["{squares:", "", "[" * 100_000, '{"a":' * 50_000, "\ud800"])
def test_target_json_is_no_json(refused: Refused, small: Small, tmp_path: Path, text: str) -> None:
    folder = small(1)
    (folder / "target.json").write_text(text, errors="surrogatepass")
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=["target.json"])


def test_target_is_not_known(refused: Refused, small: Small, tmp_path: Path) -> None:
    folder = small(1)
    (folder / "target.json").unlink()
    says = [str(folder), "--target chessboard:NxM:SIZE"]
    refused("calibrate", folder, "-o", tmp_path / "rig.json", says=says)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("chessboard:9x8:30", ["'30' has no unit", "30mm"]),
        ("chessboard:9x8:30furlong", ["30furlong", "mm, cm, m or in"]),
        ("chessboard:9x8:0mm", ["not a positive length"]),
        ("chessboard:9x8", ["write chessboard:NxM:SIZE"]),
        ("chessboard:9:8:30mm", ["write chessboard:NxM:SIZE"]),
        ("chessboard:2x8:30mm", ["3x9 squares", "4x4"]),
        ("chessbord:9x8:30mm", ["chessbord:9x8:30mm", "--target"]),
        ("nowhere.json", ["nowhere.json", "check --target"]),
    ],
)
def test_target_option(
    refused: Refused, small: Small, tmp_path: Path, text: str, says: list[str]
) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", "--target", text]
    refused(*words, says=says)


@pytest.mark.parametrize("text", ["30", "30x31", "-3mm", "wide"])
def test_square_option(refused: Refused, small: Small, tmp_path: Path, text: str) -> None:
    words = ["calibrate", small(1), "-o", tmp_path / "rig.json", f"--square={text}"]
    refused(*words, says=["--square", "mm"])


# --- outputs --------------------------------------------------------------------------------------


def _commands(recording: Path, rig: Path, output: Path) -> list[list[str | Path]]:
    return [
        ["calibrate", recording, "-o", output],
        ["detect", recording, "-o", output],
        ["correct", rig, recording, "-o", output],
        ["rectify", rig, recording, "--pair", "cam0,cam1", "-o", output],
        ["simulate", "--frames", "2", "--cameras", "1", "-o", output],
    ]


@pytest.mark.parametrize("index", range(5))
def test_output_below_a_file(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path, index: int
) -> None:
    (tmp_path / "file").write_text("a file")
    output = tmp_path / "file" / "out.json"
    words = _commands(small(2), simulated_rig, output)[index]
    refused(*words, says=[str(output), "choose another -o"])


@pytest.mark.parametrize("index", range(5))
def test_existing_output_keeps_its_bytes(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path, index: int
) -> None:
    output = tmp_path / "out.csv"
    if index < 2:
        output.write_text("mine")
    else:
        output.mkdir()
        (output / "mine.txt").write_text("mine")
    words = _commands(small(2), simulated_rig, output)[index]
    refused(*words, says=[str(output), "exists", "--force" if index < 4 else "another -o"])


def test_force_replaces(cli: Cli, small: Small, tmp_path: Path) -> None:
    output = tmp_path / "corners.csv"
    output.write_text("mine")
    outcome = cli("detect", small(1), "-o", output, "--force")
    assert outcome.code == 0
    assert output.read_text().startswith("camera,frame,corner")
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize("command", ["calibrate", "detect"])
def test_output_is_a_folder(
    refused: Refused, small: Small, tmp_path: Path, command: str, force: list[str]
) -> None:
    (tmp_path / "folder").mkdir()
    words = [command, small(1), "-o", tmp_path / "folder", *force]
    refused(*words, says=["is a folder", "name of a file"])


@pytest.mark.parametrize("command", ["correct", "rectify"])
def test_output_folder_is_a_file(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path, command: str
) -> None:
    (tmp_path / "file").write_text("mine")
    pair = ["--pair", "cam0,cam1"] if command == "rectify" else []
    words = [command, simulated_rig, small(1), *pair, "-o", tmp_path / "file", "--force"]
    refused(*words, says=["is a file", "name of a folder"])


def test_evidence_is_checked_before_the_work(
    refused: Refused, small: Small, tmp_path: Path
) -> None:
    (tmp_path / "rig.npz").write_bytes(b"mine")
    refused("calibrate", small(1), "-o", tmp_path / "rig.json", says=["rig.npz exists", "--force"])


def test_evidence_and_rig_want_two_names(refused: Refused, small: Small, tmp_path: Path) -> None:
    refused("calibrate", small(1), "-o", tmp_path / "rig.npz", says=["rig.npz", "-o rig.json"])


@pytest.mark.parametrize("where", ["itself", "around"])
@pytest.mark.parametrize("command", ["correct", "rectify"])
def test_force_does_not_replace_the_recording(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path, command: str, where: str
) -> None:
    recording = small(1, name="all/recording")
    output = recording if where == "itself" else tmp_path / "all"
    pair = ["--pair", "cam0,cam1"] if command == "rectify" else []
    words = [command, simulated_rig, recording, *pair, "-o", output, "--force"]
    refused(*words, says=[str(output), "which is read", "choose another -o"])


@pytest.mark.parametrize("name", ["sheet.xyz", "file/sheet.png"])
def test_sheet_of_rectify(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path, name: str
) -> None:
    (tmp_path / "file").write_text("a file")
    words = ["rectify", simulated_rig, small(1), "--pair", "cam0,cam1", "-o", tmp_path / "out"]
    refused(*words, "--sheet", tmp_path / name, says=[name])


def test_failing_detection_leaves_no_overlay(
    refused: Refused, small: Small, tmp_path: Path
) -> None:
    folder = small(2)
    _write(folder / "cam1" / "001.png", np.zeros((60, 80, 3), np.uint8))
    words = ["detect", folder, "-o", tmp_path / "c.csv", "--overlay", tmp_path / "drawn"]
    refused(*words, says=["camera cam1", "several sizes"])


# --- corner files ---------------------------------------------------------------------------------

_SIZES = ["--size", "cam0=640x480", "cam1=640x480"]


@pytest.fixture
def corners(cli: Cli, small: Small, tmp_path: Path) -> list[str]:
    """Lines of the corner file of a small recording, in ``tmp_path/recording``."""
    assert cli("detect", small(3), "-o", tmp_path / "found.csv").code == 0
    return (tmp_path / "found.csv").read_text().splitlines()


def _changed(lines: list[str], change: str) -> list[str]:
    cells = lines[3].split(",")
    spoiled = {
        "unknown corner": [*cells[:2], "72", *cells[3:]],
        "negative corner": [*cells[:2], "-1", *cells[3:]],
        "corner is text": [*cells[:2], "two", *cells[3:]],
        "nan": [*cells[:3], "nan", *cells[4:]],
        "outside": [*cells[:3], "1e300", *cells[4:]],
        "no covariance": [*cells[:5], "-1", "0", "1"],
        "short": cells[:4],
        "twice": lines[2].split(","),
    }
    if change == "missing columns":
        return [",".join(line.split(",")[:4]) for line in lines]
    if change == "header only":
        return lines[:1]
    if change == "empty":
        return []
    return [*lines[:3], ",".join(spoiled[change]), *lines[4:]]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("unknown corner", ["line 4", "corner 72", "0 to 71", "check --target"]),
        ("negative corner", ["line 4", "corner -1", "check --target"]),
        ("corner is text", ["line 4", "'two'"]),
        ("nan", ["line 4", "finite"]),
        ("outside", ["cam0", "frame 000", "outside the picture", "--size"]),
        ("no covariance", ["line 4", "covariance"]),
        ("short", ["line 4", "cells"]),
        ("twice", ["cam0", "frame 000", "twice"]),
        ("missing columns", ["lacks the columns y"]),
        ("header only", ["no corners", "run detect again"]),
        ("empty", ["lacks the columns camera"]),
    ],
)
def test_corner_file(
    refused: Refused, corners: list[str], tmp_path: Path, change: str, says: list[str]
) -> None:
    path = tmp_path / "changed.csv"
    path.write_text("\n".join(_changed(corners, change)) + "\n")
    target = tmp_path / "recording" / "target.json"
    words = ["calibrate", "--corners", path, "--target", target, "-o", tmp_path / "rig.json"]
    refused(*words, *_SIZES, says=["changed.csv", *says])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], ["target", "--target FILE"]),
        (["--target", "chessboard:9x8:30mm"], ["size of camera cam0", "--size cam0=WIDTHxHEIGHT"]),
        (["--target", "chessboard:9x8:30mm", *_SIZES[:2]], ["size of camera cam1", "--size"]),
        (["--target", "chessboard:9x8:30mm", "--size", "cam0=640"], ["--size cam0=640", "write"]),
        (["--target", "chessboard:9x8:30mm", "--size", "cam0=0x9"], ["--size cam0=0x9", "write"]),
        (["--target", "chessboard:9x8:30mm", *_SIZES, "--cameras", "cam7"], ["no camera cam7"]),
        (["--target", "chessboard:9x8:30mm", *_SIZES, "--square", "30"], ["--square", "30mm"]),
        (
            ["--target", "chessboard:9x8:30mm", "--size", "cam0=480x640", "cam1=640x480"],
            ["cam0", "outside the picture of 480x640", "--size"],
        ),
    ],
)
def test_corners_without_recording(
    refused: Refused, corners: list[str], tmp_path: Path, words: list[str], says: list[str]
) -> None:
    assert len(corners) > 100
    common = ["calibrate", "--corners", tmp_path / "found.csv", "-o", tmp_path / "rig.json"]
    refused(*common, *words, says=says)


def test_corners_honour_square_and_cameras(cli: Cli, corners: list[str], tmp_path: Path) -> None:
    assert len(corners) > 100
    words = ["--target", "chessboard:9x8:30mm", *_SIZES, "--square", "31mm", "--cameras", "cam1"]
    common = ["calibrate", "--corners", tmp_path / "found.csv", "-o", tmp_path / "rig.json"]
    outcome = cli(*common, *words, "--json")
    assert outcome.code == 0
    assert outcome.json["target"]["square_size_m"] == pytest.approx(0.031)
    assert list(outcome.json["cameras"]) == ["cam1"]


def test_corner_file_is_missing(refused: Refused, tmp_path: Path) -> None:
    words = ["calibrate", "--corners", tmp_path / "no.csv", "-o", tmp_path / "rig.json"]
    refused(*words, says=["no.csv", "`detect`"])


def test_nothing_to_calibrate(refused: Refused, tmp_path: Path) -> None:
    refused("calibrate", "-o", tmp_path / "rig.json", says=["RECORDING", "--corners"])


# --- rig.json -------------------------------------------------------------------------------------


def _without(*path: str) -> Change:
    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        del place[path[-1]]

    return change


_LENS = "cameras", "cam0", "lens"
_RIGS: list[tuple[Change | str, list[str]]] = [
    ("{", ["valid JSON", "calibrate again"]),
    ("[]", ["not a rig file", "`calibrate`"]),
    ("[" * 100_000, ["valid JSON", "calibrate again"]),
    ('{"a":' * 50_000, ["valid JSON", "calibrate again"]),
    (_set("format_version", value=2), ["format_version 2", "1 to 1"]),
    (_set("format", value="calichrome.target"), ["not a rig file"]),
    (_without("cameras"), ["cameras"]),
    (_without(*_LENS, "fx"), ["fx"]),
    (_set(*_LENS, "model", value="fish"), ["lens model fish"]),
    (_set("cameras", "cam1", "cam_from_ref", "rotation", value=[[1, 0, 0]] * 3), ["rotation"]),
    (_set("reference_camera", value="cam9"), ["reference_camera cam9"]),
    (_set("target", "squares", value=[1, 1]), ["1x1 squares"]),
    (_set("cameras", "cam0", "colour", "model", value="magic"), ["colour model magic"]),
]


@pytest.mark.parametrize("command", ["correct", "rectify"])
@pytest.mark.parametrize(("change", "says"), _RIGS)
def test_rig_file(
    refused: Refused,
    small: Small,
    simulated_rig: Path,
    tmp_path: Path,
    command: str,
    change: Change | str,
    says: list[str],
) -> None:
    path = tmp_path / "damaged.json"
    if isinstance(change, str):
        path.write_text(change)
    else:
        content = json.loads(simulated_rig.read_text())
        change(content)
        path.write_text(json.dumps(content))
    pair = ["--pair", "cam0,cam1"] if command == "rectify" else []
    refused(command, path, small(1), *pair, "-o", tmp_path / "out", says=says)


def test_rig_cannot_write_outside_its_output(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path
) -> None:
    content = json.loads(simulated_rig.read_text())
    camera = content["cameras"]["cam0"]
    content |= {"cameras": {"../../elsewhere": camera}, "reference_camera": "../../elsewhere"}
    path = tmp_path / "sly.json"
    path.write_text(json.dumps(content))
    picture = small(1) / "cam0" / "000.png"
    says = ["../../elsewhere", "no name for a folder"]
    refused("correct", path, picture, "-o", tmp_path / "a" / "b", says=says)


# --- correct and rectify --------------------------------------------------------------------------


@pytest.fixture
def picture(small: Small) -> Path:
    return small(1) / "cam0" / "000.png"


def test_correct_picture_of_another_size(
    refused: Refused, picture: Path, simulated_rig: Path, tmp_path: Path
) -> None:
    _write(picture, np.zeros((240, 320, 3), np.uint8))
    words = ["correct", simulated_rig, picture, "--camera", "cam0", "-o", tmp_path / "out"]
    refused(*words, says=[str(picture), "320x240", "640x480", "record at that size"])


def test_correct_grey_picture(
    refused: Refused, cli: Cli, picture: Path, simulated_rig: Path, tmp_path: Path
) -> None:
    _as_grey16(picture)
    words = ["correct", simulated_rig, picture, "--camera", "cam0", "-o", tmp_path / "out"]
    refused(*words, says=[str(picture), "grey", "--colour none"])
    assert cli(*words, "--colour", "none", "--undistort").code == 0  # the remedy works


def test_correct_unknown_camera(
    refused: Refused, picture: Path, simulated_rig: Path, tmp_path: Path
) -> None:
    words = ["correct", simulated_rig, picture, "-o", tmp_path / "out"]
    refused(*words, "--camera", "cam9", says=["no camera cam9", "cam0, cam1"])
    refused(*words, says=[str(picture), "--camera", "cam0, cam1"])


def test_correct_recording_of_other_cameras(
    refused: Refused, small: Small, simulated_rig: Path, tmp_path: Path
) -> None:
    folder = small(1, toml=False)
    (folder / "cam0").rename(folder / "top")
    words = ["correct", simulated_rig, folder, "-o", tmp_path / "out"]
    refused(*words, says=["camera top", "cam0, cam1", "rename"])


@pytest.mark.parametrize("damage", ["text", "half", "missing", "suffix"])
def test_correct_what_is_no_picture(
    refused: Refused, picture: Path, simulated_rig: Path, tmp_path: Path, damage: str
) -> None:
    if damage == "text":
        picture.write_text("no picture")
    elif damage == "half":
        _cut(picture)
    elif damage == "missing":
        picture.unlink()
    else:
        picture = picture.rename(picture.with_suffix(".txt"))
    words = ["correct", simulated_rig, picture, "--camera", "cam0", "-o", tmp_path / "out"]
    refused(*words, says=[str(picture)])


@pytest.mark.parametrize(
    ("pair", "says"),
    [
        ("cam0,cam9", ["no camera cam9", "cam0, cam1"]),
        ("cam0", ["--pair", "two cameras"]),
        ("cam0,cam0", ["--pair cam0,cam0", "twice"]),
        ("cam0,cam1,cam0", ["--pair", "two cameras"]),
    ],
)
def test_rectify_unknown_pair(
    refused: Refused,
    small: Small,
    simulated_rig: Path,
    tmp_path: Path,
    pair: str,
    says: list[str],
) -> None:
    words = ["rectify", simulated_rig, small(1), "--pair", pair, "-o", tmp_path / "out"]
    refused(*words, says=says)


# --- wrong usage ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["calibrat", "recording"],
        ["calibrate", "recording", "--colour", "yes"],
        ["calibrate", "recording", "--method", "magic"],
        ["calibrate", "recording", "--max-megapixels", "many"],
        ["correct", "rig.json"],
        ["correct", "rig.json", "recording", "-o", "out", "--colour", "pink"],
        ["detect"],
    ],
)
def test_wrong_usage(cli: Cli, words: list[str]) -> None:
    outcome = cli(*words)
    assert outcome.code == 2
    assert outcome.err
    assert "Traceback" not in outcome.err
    assert outcome.out == ""


# --- rigs that are not to be trusted --------------------------------------------------------------


@pytest.mark.parametrize("doubted", [True, False])
def test_what_is_made_with_a_doubted_rig(
    cli: Cli, small: Small, simulated_rig: Path, tmp_path: Path, *, doubted: bool
) -> None:
    """It is made, and said not to be trusted."""
    described = json.loads(simulated_rig.read_text())
    if doubted:
        finding = {"code": "view_angles", "severity": "critical", "text": "All boards parallel."}
        described["findings"].append(finding)
        described["trustworthy"] = False
    rig, recording = tmp_path / "rig.json", small(1)
    rig.write_text(json.dumps(described))
    for words in (
        ["correct", rig, recording, "-o", tmp_path / "out"],
        ["rectify", rig, recording, "--pair", "cam0,cam1", "-o", tmp_path / "pair"],
        ["export", rig, "--to", "opencv", "-o", tmp_path / "opencv"],
    ):
        outcome = cli(*words)
        assert outcome.code == (3 if doubted else 0), outcome.err
        assert ("All boards parallel" in outcome.err) == doubted
    assert (tmp_path / "out" / "cam0").is_dir()
