"""Recordings that grow: complete after each frame, whatever happens in between."""

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest

from calichrome.errors import OutputError
from calichrome.imaging import Image, Pixels, open_recording, write_picture
from calichrome.imaging.recording_writer import SUMS, RecordingWriter


def _pictures(rng: np.random.Generator) -> dict[str, Pixels]:
    return {
        "left": rng.integers(0, 256, (12, 16, 3), dtype=np.uint8),
        "right": rng.integers(0, 65536, (12, 16), dtype=np.uint16),
    }


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_what_was_written_is_read(tmp_path: Path, rng: np.random.Generator) -> None:
    writer = RecordingWriter(tmp_path / "new")
    pictures = {frame: _pictures(rng) for frame in ("000", "001")}
    for frame, own in pictures.items():
        sums = writer.add(frame, own, {"left": int(frame) + 0.25, "right": int(frame) + 0.26})
        for camera, value in sums.items():
            content = (tmp_path / "new" / camera / f"{frame}.png").read_bytes()
            assert hashlib.sha256(content).hexdigest() == value
    recording = open_recording(tmp_path / "new")
    assert recording.cameras == ("left", "right")
    for frame, own in pictures.items():
        for camera, pixels in own.items():
            image = recording.read(camera, frame)
            assert isinstance(image, Image)
            np.testing.assert_array_equal(image.pixels, pixels)
    with (tmp_path / "new" / "timestamps.csv").open(encoding="utf-8", newline="") as stream:
        assert list(csv.reader(stream))[:3] == [
            ["camera", "frame", "time_s"],
            ["left", "000", "0.250000"],
            ["right", "000", "0.260000"],
        ]
    sums_text = (tmp_path / "new" / SUMS).read_text(encoding="utf-8")
    assert [line.split("  ")[1] for line in sums_text.splitlines()] == [
        "left/000.png", "right/000.png", "left/001.png", "right/001.png",
    ]  # fmt: skip


def test_a_frame_that_lacks_a_camera_is_no_frame(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C between two cameras leaves the frames before, and nothing of this one."""
    writer = RecordingWriter(tmp_path)
    times = {"left": 0.0, "right": 0.0}
    writer.add("000", _pictures(rng), times)
    before = _files(tmp_path)
    tables = {name: (tmp_path / name).read_bytes() for name in (SUMS, "timestamps.csv")}

    def interrupted(path: Path, pixels: Pixels) -> None:
        if path.parent.name == "right":
            raise KeyboardInterrupt
        write_picture(path, pixels)

    with monkeypatch.context() as patch:
        patch.setattr("calichrome.imaging.recording_writer.write_picture", interrupted)
        for unfinished, frame in ((writer, "001"), (RecordingWriter(tmp_path / "new"), "000")):
            with pytest.raises(KeyboardInterrupt):
                unfinished.add(frame, _pictures(rng), times)
    assert not (tmp_path / "new").exists()
    with pytest.raises(KeyError):  # as late as it can be: the tables are half written
        writer.add("001", _pictures(rng), {"left": 1.0})
    assert _files(tmp_path) == before
    assert {name: (tmp_path / name).read_bytes() for name in tables} == tables
    assert writer.n_frames == 1


def test_two_recordings_do_not_share_a_folder(tmp_path: Path) -> None:
    (tmp_path / "000.png").write_bytes(b"")
    with pytest.raises(OutputError, match="holds something"):
        RecordingWriter(tmp_path)
