"""Several cameras recorded together, each frame at one instant as nearly as they can."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count as count_from

import numpy as np

from calichrome.core.findings import Finding, finding
from calichrome.errors import RecordingError
from calichrome.imaging.devices import CameraDevice, Setting
from calichrome.imaging.image import Pixels
from calichrome.imaging.recording_writer import RecordingWriter

__all__ = ["Recorded", "Shot", "record"]

# Choice: three frames at 30 per second. A hand that tries to hold a board still moves it by some
# 10 mm per second: 1 mm meanwhile, where `calibrate` begins to call cameras unsynchronised.
_SLOW_S = 0.1
_DRIFTED = 0.02  # share by which a value that was locked has changed; as drivers round


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame: when each camera had its picture, seconds since the recording began."""

    frame_id: str
    times_s: Mapping[str, float]

    @property
    def spread_s(self) -> float:
        """From the first camera to the last."""
        return max(self.times_s.values()) - min(self.times_s.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What a recording came to.

    Parameters
    ----------
    settings
        By camera, as locked.
    shots
        The frames that were written.
    lost
        Cameras that gave no more pictures; the recording ended there.
    findings
        What to doubt.
    """

    settings: Mapping[str, Sequence[Setting]]
    shots: tuple[Shot, ...]
    lost: tuple[str, ...]
    findings: tuple[Finding, ...]


def record(
    devices: Mapping[str, CameraDevice],
    writer: RecordingWriter,
    ready: Callable[[int], bool],
    *,
    count: int | None = None,
    locked: Callable[[str, Sequence[Setting]], None] = lambda _camera, _settings: None,
    taken: Callable[[Shot], None] = lambda _shot: None,
) -> Recorded:
    """Record until `count` frames are there, `ready` says so, a camera is gone, or Ctrl-C.

    Parameters
    ----------
    devices
        By camera id.
    writer
        Where frames go as soon as they are complete.
    ready
        Called before each frame with its number; returns when it is to be taken, False to end.
    count
        How many frames; None: as many as there come.
    locked, taken
        Called for each camera when its settings are locked, and after each frame.

    Raises
    ------
    RecordingError
        If not a single frame was recorded.

    Notes
    -----
    While `ready` waits, every camera throws its frames away in a thread of its own, so that no
    queue of a driver holds old ones. The first frame that arrives afterwards is the one: all
    cameras grab, then all retrieve.
    """
    settings: dict[str, tuple[Setting, ...]] = {}
    shots: list[Shot] = []
    repeated: dict[str, list[str]] = {camera: [] for camera in devices}
    lost: tuple[str, ...] = ()
    last: dict[str, str] = {}
    began = time.monotonic()
    with ThreadPoolExecutor(len(devices)) as pool:
        try:
            found = pool.map(lambda device: device.lock(), devices.values())
            for camera, settings[camera] in zip(devices, found, strict=True):
                locked(camera, settings[camera])
            for times, pictures in _instants(devices, pool, ready):
                lost = tuple(camera for camera in devices if camera not in pictures)
                if lost:
                    break
                shot = Shot(
                    f"{len(shots):03d}", {camera: times[camera] - began for camera in devices}
                )
                sums = writer.add(shot.frame_id, pictures, shot.times_s)
                shots.append(shot)
                for camera, frames in repeated.items():
                    if sums[camera] == last.get(camera):
                        frames.append(shot.frame_id)
                last = sums
                taken(shot)
                if len(shots) == count:
                    break
        except KeyboardInterrupt:
            pass  # the usual end of a recording; what is complete stays
    if not shots:
        gone = f": camera {', '.join(lost)} gave no picture; check its cable" if lost else ""
        raise RecordingError(f"no frame was recorded{gone}")
    findings = [
        *_unlocked(settings, {c: d.settings() for c, d in devices.items() if c not in lost}),
        *_late(shots),
        *_frozen(repeated),
        *_gone(lost, len(shots)),
    ]
    return Recorded(settings=settings, shots=tuple(shots), lost=lost, findings=tuple(findings))


def _instants(
    devices: Mapping[str, CameraDevice], pool: Executor, ready: Callable[[int], bool]
) -> Iterator[tuple[dict[str, float], dict[str, Pixels]]]:
    """Yield when each camera grabbed, and its picture; of a camera that is gone, none."""
    for number in count_from(0):
        shutter = threading.Event()
        grabs = [pool.submit(_grab_after, device, shutter) for device in devices.values()]
        try:
            go_on = ready(number)
        finally:
            shutter.set()
        times = {
            camera: at
            for camera, grab in zip(devices, grabs, strict=True)
            if (at := grab.result()) is not None
        }
        if not go_on:
            return
        decoded = pool.map(lambda camera: devices[camera].retrieve(), times)
        pictures = {
            camera: picture
            for camera, picture in zip(times, decoded, strict=True)
            if picture is not None
        }
        yield times, pictures


def _grab_after(device: CameraDevice, shutter: threading.Event) -> float | None:
    """Let frames pass until the shutter opens; return when the next one came."""
    while True:
        wanted = shutter.is_set()
        if not device.grab():
            return None
        if wanted:
            return time.monotonic()


def _unlocked(
    settings: Mapping[str, Sequence[Setting]], now: Mapping[str, Mapping[str, float]]
) -> Iterator[Finding]:
    """Judge what was locked, and what it is `now` of cameras that are still there."""
    for camera, own in settings.items():
        refused = [item.name for item in own if not item.locked]
        later = now.get(camera, {})
        changed = [
            item.name
            for item in own
            if item.locked
            and not math.isclose(later.get(item.name, item.value), item.value, rel_tol=_DRIFTED)
        ]
        if refused or changed:
            did = [f"refused to lock {', '.join(refused)} (or has none)"] if refused else []
            did += [f"locked {', '.join(changed)}, but changed it"] if changed else []
            yield finding(
                "setting_not_locked",
                f"Camera {camera} {' and '.join(did)}. Lock it with the camera's own program or "
                f"driver, or keep light and distance the same.",
                camera=camera, refused=refused, changed=changed,
            )  # fmt: skip


def _late(shots: Sequence[Shot]) -> Iterator[Finding]:
    for camera in shots[0].times_s:
        late = [shot.times_s[camera] - min(shot.times_s.values()) for shot in shots]
        typical = float(np.median(late))
        if typical > _SLOW_S:
            yield finding(
                "slow_camera",
                f"Camera {camera} has its picture {typical * 1e3:.0f} ms after the first camera. "
                f"Hold the board still for each shot; give it a USB port of its own, smaller "
                f"pictures or more light.",
                camera=camera, late_s=typical,
            )  # fmt: skip


def _frozen(repeated: Mapping[str, Sequence[str]]) -> Iterator[Finding]:
    for camera, frames in repeated.items():
        if frames:
            yield finding(
                "frozen_camera",
                f"Camera {camera} gave the picture of the frame before in {', '.join(frames[:6])}"
                f"{f' and {len(frames) - 6} more' if len(frames) > 6 else ''}: it hangs. Plug it "
                f"in again and record anew, or delete these frames.",
                camera=camera, frames=list(frames),
            )  # fmt: skip


def _gone(lost: Sequence[str], n_frames: int) -> Iterator[Finding]:
    for camera in lost:
        yield finding(
            "camera_lost",
            f"Camera {camera} gave no picture after {n_frames} frames, and the recording ended "
            f"there; these frames are kept. Check its cable and record again.",
            camera=camera, frames=n_frames,
        )  # fmt: skip
