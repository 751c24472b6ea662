"""How names of files become cameras and frames (docs/file-format.md)."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from calichrome.errors import RecordingError
from calichrome.imaging import Image, Unreadable, open_recording, write_picture

_PIXELS = np.zeros((2, 3), np.uint8)


def _recording(folder: Path, names: Iterable[str]) -> Path:
    for name in names:
        write_picture(folder / name, _PIXELS)
    return folder


def _frames(folder: Path, pattern: str | None = None) -> dict[str, list[str]]:
    recording = open_recording(folder, pattern=pattern)
    return {camera: list(frames) for camera, frames in recording.files.items()}


def test_default_layout(tmp_path: Path) -> None:
    names = ["left/1.png", "left/2.png", "right/1.jpg", "right/2.png"]
    recording = open_recording(_recording(tmp_path, names))
    assert recording.cameras == ("left", "right")
    assert recording.files["right"]["1"] == tmp_path / "right" / "1.jpg"
    assert recording.n_pictures == 4
    assert recording.ignored == ()
    assert "left, right" in recording.reading


def test_flat_folder_is_one_camera(tmp_path: Path) -> None:
    assert _frames(_recording(tmp_path, ["b.png", "a.tif"])) == {"cam0": ["a", "b"]}


def test_camera_name_is_taken_out_of_the_frames(tmp_path: Path) -> None:
    names = ["left/left01.png", "left/left_02.png", "right/right01.png", "right/02-right.png"]
    assert _frames(_recording(tmp_path, names)) == {"left": ["01", "02"], "right": ["01", "02"]}


def test_camera_name_stays_where_frames_are_common_as_they_are(tmp_path: Path) -> None:
    names = ["a/a1.png", "a/2.png", "b/a1.png", "b/2.png"]
    assert _frames(_recording(tmp_path, names)) == {"a": ["2", "a1"], "b": ["2", "a1"]}


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("{camera}_{frame}", ["l_1.png", "r_1.png"]),
        ("{camera:l|r}{frame}", ["l1.png", "r1.png"]),
        ("{frame}-{camera}", ["1-l.png", "1-r.png"]),
        ("{camera}/{camera}{frame}", ["l/l1.png", "r/r1.png"]),
        ("{frame}/{camera}", ["1/l.png", "1/r.png"]),
        ("shots/{camera}/{frame}/image", ["shots/l/1/image.png", "shots/r/1/image.png"]),
    ],
)
def test_patterns(tmp_path: Path, pattern: str, names: list[str]) -> None:
    assert _frames(_recording(tmp_path, names), pattern) == {"l": ["1"], "r": ["1"]}


def test_repeated_field_must_be_equal(tmp_path: Path) -> None:
    names = ["l/l1.png", "r/r1.png", "r/l2.png"]
    recording = open_recording(_recording(tmp_path, names), pattern="{camera}/{camera}{frame}")
    assert recording.ignored == (tmp_path / "r" / "l2.png",)


def test_what_does_not_match_is_ignored(tmp_path: Path) -> None:
    names = ["l_1.png", "r_1.png", "thumb.png"]
    recording = open_recording(_recording(tmp_path, names), pattern="{camera}_{frame}")
    assert [path.name for path in recording.ignored] == ["thumb.png"]


def test_hidden_files_and_other_kinds_are_no_pictures(tmp_path: Path) -> None:
    _recording(tmp_path, ["1.png", ".hidden.png", ".cache/2.png"])
    (tmp_path / "notes.txt").write_text("notes")
    (tmp_path / "folder.png").mkdir()
    recording = open_recording(tmp_path)
    assert list(recording.files["cam0"]) == ["1"]
    assert recording.ignored == ()


def test_background_is_no_view(tmp_path: Path) -> None:
    names = ["l/1.png", "l/background.png", "l/background2.png", "r/1.png", "background/l.png"]
    recording = open_recording(_recording(tmp_path, names))
    assert {camera: list(frames) for camera, frames in recording.files.items()} == {
        "l": ["1"],
        "r": ["1"],
    }
    assert len(recording.ignored) == 3


def test_frames_are_in_natural_order(tmp_path: Path) -> None:
    names = ["view10.png", "view9.png", "view1.png", "final.png"]
    ordered = ["final", "view1", "view9", "view10"]
    assert _frames(_recording(tmp_path, names)) == {"cam0": ordered}


def test_two_files_of_one_frame(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"frame 1 of camera a.*remove one"):
        open_recording(_recording(tmp_path, ["a/1.png", "a/1.jpg", "b/1.png"]))


def test_pictures_beside_folders_of_pictures(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"say which with --pattern"):
        open_recording(_recording(tmp_path, ["a/1.png", "1.png"]))


def test_pictures_that_lie_deeper(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"deeper .* --pattern"):
        open_recording(_recording(tmp_path, ["day/a/1.png", "day/b/1.png"]))


def test_chosen_cameras_keep_their_order(tmp_path: Path) -> None:
    folder = _recording(tmp_path, ["a/1.png", "b/1.png", "c/1.png"])
    assert open_recording(folder, cameras=("c", "a")).cameras == ("a", "c")


def test_stated_encoding_and_bits_reach_the_picture(tmp_path: Path) -> None:
    for camera in ("a", "b"):
        write_picture(tmp_path / camera / "1.png", np.full((2, 2, 3), 4095, np.uint16))
    (tmp_path / "recording.toml").write_text(
        'encoding = "rec709"\n[cameras.a]\nencoding = "linear"\nbits = 12\n'
    )
    recording = open_recording(tmp_path)
    a, b = (recording.read(camera, "1") for camera in ("a", "b"))
    assert isinstance(a, Image)
    assert isinstance(b, Image)
    assert (a.encoding, a.bits, b.encoding, b.bits) == ("linear", 12, "rec709", 16)
    np.testing.assert_allclose(a.linear(), 1)


def test_pattern_of_recording_toml_yields_to_the_command_line(tmp_path: Path) -> None:
    _recording(tmp_path, ["l_1.png", "r_1.png"])
    (tmp_path / "recording.toml").write_text('pattern = "{frame}"\n')
    assert _frames(tmp_path) == {"cam0": ["l_1", "r_1"]}
    assert _frames(tmp_path, "{camera}_{frame}") == {"l": ["1"], "r": ["1"]}


def test_unreadable_picture_is_an_answer(tmp_path: Path) -> None:
    _recording(tmp_path, ["1.png"])
    (tmp_path / "2.png").write_text("no picture")
    assert isinstance(open_recording(tmp_path).read("cam0", "2"), Unreadable)
