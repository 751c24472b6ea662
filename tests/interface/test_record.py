"""``record``: folders that calibrate, and cameras that misbehave, by name."""

import csv
import errno
import io
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calichrome.cli import record as command
from calichrome.core.arrays import UInt8Array
from calichrome.core.findings import Finding
from calichrome.errors import RecordingError
from calichrome.imaging import Image, open_recording
from calichrome.imaging.devices import CvCamera, Setting
from calichrome.imaging.recording_writer import RecordingWriter
from calichrome.pipeline.record import Recorded, record
from calichrome.target import Target, load_target, target_to_json

Cli = Callable[..., Any]
Refused = Callable[..., str]
Run = Callable[..., Recorded]


class Camera:
    """A camera that can misbehave in each of the ways that cameras do."""

    def __init__(
        self,
        *,
        unlockable: tuple[str, ...] = (),
        drifting: tuple[str, ...] = (),
        late_s: float = 0.0,
        frozen_from: int | None = None,
        n_shots: int = 1000,
    ) -> None:
        self._unlockable, self._drifting, self._late_s = unlockable, drifting, late_s
        self._frozen_from, self._n_shots = frozen_from, n_shots
        self._n_retrieved = 0

    def lock(self) -> tuple[Setting, ...]:
        names = ("exposure", "gain", "white balance", "focus")
        return tuple(Setting(name, 100.0, name not in self._unlockable) for name in names)

    def settings(self) -> Mapping[str, float]:
        names = ("exposure", "gain", "white balance", "focus")
        if self._n_retrieved >= self._n_shots:
            return dict.fromkeys(names, -1.0)  # what OpenCV reads from a camera that is gone
        return {name: 130.0 if name in self._drifting else 100.0 for name in names}

    def grab(self) -> bool:
        time.sleep(0.002 + self._late_s)
        return self._n_retrieved < self._n_shots

    def retrieve(self) -> UInt8Array:
        shown = self._n_retrieved
        if self._frozen_from is not None:
            shown = min(shown, self._frozen_from)
        self._n_retrieved += 1
        return np.full((8, 8, 3), shown, np.uint8)

    def release(self) -> None:
        pass


@pytest.fixture
def run(tmp_path: Path) -> Run:
    def recorded(*, count: int | None = 3, **devices: Camera) -> Recorded:
        writer = RecordingWriter(tmp_path / "recording")
        return record(devices, writer, lambda _number: True, count=count)

    return recorded


def _codes(done: Recorded) -> list[str]:
    return [item.code for item in done.findings]


def _only(done: Recorded) -> Finding:
    assert len(done.findings) == 1, done.findings
    return done.findings[0]


def test_cameras_that_behave_give_no_finding(run: Run, tmp_path: Path) -> None:
    done = run(left=Camera(), right=Camera())
    assert done.findings == ()
    assert [shot.frame_id for shot in done.shots] == ["000", "001", "002"]
    assert all(shot.spread_s < 0.1 for shot in done.shots)
    assert len(list((tmp_path / "recording").rglob("*.png"))) == 6


def test_setting_not_locked_fires(run: Run) -> None:
    done = run(left=Camera(), right=Camera(unlockable=("focus", "white balance")))
    found = _only(done)
    assert (found.code, found.severity) == ("setting_not_locked", "warning")
    assert found.data["camera"] == "right"
    assert "refused to lock white balance, focus" in found.text
    assert not done.settings["right"][3].locked


def test_setting_not_locked_fires_for_one_that_changes_all_the_same(run: Run) -> None:
    found = _only(run(left=Camera(drifting=("exposure",))))
    assert found.code == "setting_not_locked"
    assert "locked exposure, but changed it" in found.text


def test_setting_not_locked_does_not_fire(run: Run) -> None:
    assert "setting_not_locked" not in _codes(run(left=Camera()))


def test_slow_camera_fires(run: Run) -> None:
    found = _only(run(left=Camera(), right=Camera(late_s=0.2)))
    assert (found.code, found.data["camera"]) == ("slow_camera", "right")


def test_slow_camera_does_not_fire_within_three_frames(run: Run) -> None:
    assert _codes(run(left=Camera(), right=Camera(late_s=0.03))) == []


def test_frozen_camera_fires(run: Run) -> None:
    found = _only(run(count=5, left=Camera(), right=Camera(frozen_from=2)))
    assert (found.code, found.severity) == ("frozen_camera", "critical")
    assert found.data["camera"] == "right"
    assert found.data["frames"] == ["003", "004"]


def test_frozen_camera_does_not_fire(run: Run) -> None:
    assert _codes(run(count=5, left=Camera(), right=Camera())) == []


def test_camera_lost_fires_and_keeps_what_is_complete(run: Run, tmp_path: Path) -> None:
    done = run(count=9, left=Camera(), right=Camera(n_shots=4))
    found = _only(done)
    assert (found.code, found.severity) == ("camera_lost", "critical")
    assert found.data == {"camera": "right", "frames": 4}
    assert done.lost == ("right",)
    folder = tmp_path / "recording"
    for camera in ("left", "right"):
        assert len(list((folder / camera).iterdir())) == 4
    assert len((folder / "timestamps.csv").read_text("utf-8").splitlines()) == 1 + 8


def test_camera_lost_does_not_fire(run: Run) -> None:
    assert _codes(run(count=4, left=Camera(), right=Camera())) == []


def test_a_camera_that_never_gives_a_picture_is_named(run: Run, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no frame was recorded: camera right gave no picture"):
        run(left=Camera(), right=Camera(n_shots=0))
    assert not (tmp_path / "recording").exists()


def test_ctrl_c_keeps_what_is_complete(tmp_path: Path) -> None:
    def ready(number: int) -> bool:
        if number == 2:
            raise KeyboardInterrupt
        return True

    before = threading.active_count()
    done = record({"left": Camera()}, RecordingWriter(tmp_path / "recording"), ready)
    assert len(done.shots) == 2
    assert done.findings == ()
    assert threading.active_count() == before


def test_ctrl_c_before_the_first_frame_leaves_nothing(tmp_path: Path) -> None:
    def ready(_number: int) -> bool:
        raise KeyboardInterrupt

    with pytest.raises(RecordingError, match="no frame was recorded"):
        record({"left": Camera()}, RecordingWriter(tmp_path / "recording"), ready)
    assert not (tmp_path / "recording").exists()


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> dict[int | str, Camera]:
    """What the command opens in place of OpenCV's cameras, by source."""
    cameras: dict[int | str, Camera] = {0: Camera(), 1: Camera(), "/dev/video7": Camera()}
    monkeypatch.setattr(command, "CvCamera", lambda source, _size_wh: cameras[source])
    monkeypatch.setattr(command, "_STILL_S", 0.01)
    return cameras


def test_the_command_says_what_it_did(
    cli: Cli, fakes: dict[int | str, Camera], tmp_path: Path
) -> None:
    assert fakes
    words = ["--every", "20ms", "--count", "2", "-o", tmp_path / "rec"]
    outcome = cli("record", "--cameras", "0,side=1,/dev/video7", *words)
    assert outcome.code == 0, outcome
    assert "camera cam0: locked exposure 100, gain 100, white balance 100, focus 100" in outcome.out
    assert "frame 001: grabbed within" in outcome.out
    assert outcome.err.count("\a") == 2
    with (tmp_path / "rec" / "timestamps.csv").open(encoding="utf-8", newline="") as stream:
        assert {row["camera"] for row in csv.DictReader(stream)} == {"cam0", "side", "video7"}


def test_the_command_warns_of_a_camera_and_ends_with_3_when_one_is_lost(
    cli: Cli, fakes: dict[int | str, Camera], tmp_path: Path
) -> None:
    words = ["--every", "20ms", "--no-beep", "--count", "4"]
    fakes[1] = Camera(unlockable=("focus",))
    outcome = cli("record", "--cameras", "0,1", *words, "-o", tmp_path / "a")
    assert outcome.code == 0
    assert "warning  setting_not_locked: Camera cam1 refused to lock focus" in outcome.out
    assert "\a" not in outcome.err
    fakes[1] = Camera(n_shots=2)
    outcome = cli("record", "--cameras", "0,1", *words, "-o", tmp_path / "b", "--json")
    assert outcome.code == 3
    assert [item["code"] for item in outcome.json["findings"]] == ["camera_lost"]
    assert len(outcome.json["frames"]) == 2
    assert outcome.json["settings"]["cam0"]["gain"] == {"value": 100.0, "locked": True}


def test_a_full_disk_leaves_a_recording_with_its_target(
    cli: Cli,
    fakes: dict[int | str, Camera],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    standard_target: Target,
) -> None:
    assert fakes
    board, folder = tmp_path / "board.json", tmp_path / "rec"
    board.write_text(json.dumps(target_to_json(standard_target)), encoding="utf-8")
    add = RecordingWriter.add

    def until_full(writer: RecordingWriter, *arguments: Any) -> dict[str, str]:  # noqa: ANN401
        if writer.n_frames == 2:
            raise OSError(errno.ENOSPC, "No space left on device", str(folder))
        return add(writer, *arguments)

    monkeypatch.setattr(RecordingWriter, "add", until_full)
    words = ["--every", "20ms", "--no-beep", "--target", board, "-o", folder]
    outcome = cli("record", "--cameras", "0", *words)
    assert outcome.code == 1
    assert "No space left" in outcome.err
    assert load_target(folder / "target.json") == load_target(board)
    assert len(list((folder / "cam0").iterdir())) == 2


def test_keys_take_frames_until_q(
    cli: Cli,
    fakes: dict[int | str, Camera],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert fakes
    monkeypatch.setattr("sys.stdin", io.StringIO("\n\nq\n\n"))
    outcome = cli("record", "--cameras", "0", "--key", "-o", tmp_path / "rec")
    assert outcome.code == 0
    assert len(list((tmp_path / "rec" / "cam0").iterdir())) == 2
    assert "Enter takes frame 002, q ends" in outcome.err


@pytest.fixture
def heeded_sigint() -> Iterator[None]:
    """A shell without a terminal starts its background jobs with this signal ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heeded_sigint")
def test_ctrl_c_ends_the_command_with_0(
    cli: Cli, fakes: dict[int | str, Camera], tmp_path: Path
) -> None:
    class Pressing(Camera):
        def retrieve(self) -> UInt8Array:
            if self._n_retrieved == 2:
                signal.raise_signal(signal.SIGINT)  # Python hands it to the main thread
            return super().retrieve()

    fakes[0] = Pressing()
    words = ["--every", "20ms", "--no-beep", "-o", tmp_path / "rec"]
    outcome = cli("record", "--cameras", "0,1", *words)
    assert outcome.code == 0, outcome
    assert "Wrote" in outcome.out
    assert {len(list(path.iterdir())) for path in (tmp_path / "rec").glob("cam*")} == {2}


def test_a_video_is_recorded_through_opencv_until_it_ends(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nearest to a camera that a machine without one has: a real backend, to its last frame."""
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (160, 48))
    for edge in range(160):
        writer.write(np.where(np.arange(160) < edge, 220, 30)[None, :, None].repeat(48, 0)
                     .repeat(3, 2).astype(np.uint8))  # fmt: skip
    writer.release()
    grab = CvCamera.grab

    def paced(camera: CvCamera) -> bool:
        time.sleep(0.01)  # as a camera does, and a file does not
        return grab(camera)

    monkeypatch.setattr(CvCamera, "grab", paced)
    words = ["--every", "0s", "--no-beep", "--size", "160x48", "-o", tmp_path / "rec", "--json"]
    outcome = cli("record", "--cameras", f"cam0={path}", *words)
    assert outcome.code == 3, outcome
    codes = {item["code"] for item in outcome.json["findings"]}
    assert codes == {"camera_lost", "setting_not_locked"}
    recording = open_recording(tmp_path / "rec")
    images = [recording.read("cam0", frame["frame"]) for frame in outcome.json["frames"]]
    assert len(images) == recording.n_pictures > 0
    edges = [
        float((image.pixels > 125).mean()) * 160 for image in images if isinstance(image, Image)
    ]
    assert edges == sorted(edges)
    assert edges[0] > 25  # a second passed for its automatics


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--cameras", "0,0"], "named twice"),
        (["--cameras", "left=0,left=1"], "named twice"),
        (["--cameras", "background=0"], "has no name"),
        (["--cameras", "synthetic:x"], "synthetic:0"),
        (["--cameras", ","], "empty"),
        (["--cameras", "0", "--every", "2"], "like 2s"),
        (["--cameras", "0", "--count", "0"], "1 or more"),
        (["--cameras", "0", "--size", "big"], "WIDTHxHEIGHT"),
        (["--cameras", "97"], "camera 97 cannot be opened"),
    ],
)
def test_what_cannot_be_recorded_is_refused(
    words: list[str], says: str, refused: Refused, tmp_path: Path
) -> None:
    refused("record", *words, "-o", tmp_path / "rec", says=[says])


def test_a_folder_that_holds_something_is_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "000.png").write_bytes(b"")
    refused("record", "--cameras", "synthetic:0", "-o", tmp_path / "rec", says=["holds something"])


@pytest.mark.slow
def test_two_synthetic_cameras_calibrate_unchanged(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    words = ["--every", "100ms", "--count", "12", "--no-beep", "-o", folder]
    outcome = cli("record", "--cameras", "synthetic:0,right=synthetic:1", *words)
    assert outcome.code == 0, outcome
    outcome = cli("calibrate", folder, "-o", tmp_path / "rig.json")
    assert outcome.code == 0, outcome
    rig = json.loads((tmp_path / "rig.json").read_text("utf-8"))
    assert set(rig["cameras"]) == {"cam0", "right"}
    assert rig["trustworthy"]
    for camera in rig["cameras"].values():
        assert camera["n_views"] == 12
        assert camera["held_out_rms_px"] < 0.1
        assert camera["colour"]["delta_e_2000"]["held_out_mean"] < 3
    assert rig["inter_camera_delta_e_2000"]["mean"] < 3
