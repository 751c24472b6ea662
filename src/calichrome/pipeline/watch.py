"""A recording as instants: what all cameras show of a scene, in linear light, with the time."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import UInt8Array
from calichrome.core.findings import Finding, finding
from calichrome.errors import RecordingError
from calichrome.imaging import Image, Pixels, Recording, Unreadable, open_recording
from calichrome.pipeline.check import read_as_calibrated
from calichrome.pipeline.correctors import CameraCorrectors
from calichrome.pipeline.workers import n_cores
from calichrome.rig import Rig
from calichrome.tracking import Picture

__all__ = ["Instant", "Viewer", "Watch", "open_watch"]

_ASSUMED_FPS = 30.0  # where no time is known; places do not depend on it
_APART = 0.25  # of the interval between instants, by which the times of cameras may differ


Viewer = Callable[[str], UInt8Array | Unreadable]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instant:
    """One frame of all cameras.

    Parameters
    ----------
    frame
        Its name.
    time_s
        Since the clock's start; mean of the cameras.
    pictures : camera -> (H, W, 3) float32
        Linear light; cameras without a readable picture are left out.
    """

    frame: str
    time_s: float
    pictures: Mapping[str, Picture]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Watch:
    """A recording of a scene by the cameras of a rig.

    Parameters
    ----------
    rig
        The calibration.
    scene, empty
        Frames with the objects, and those of the empty scene; of the rig's cameras alone.
    times_s
        frame -> seconds, in the order of time.
    time_unit_s
        Seconds per unit of the times that are reported: not 1 where frames stand for time.
    in_colour
        Pictures are XYZ under D65; else linear camera values.
    corrected
        False: camera values are taken as sRGB.
    findings
        Of the recording.
    """

    rig: Rig
    scene: Recording
    empty: Recording
    times_s: Mapping[str, float]
    time_unit_s: float
    in_colour: bool
    corrected: bool
    findings: tuple[Finding, ...]

    @property
    def cameras(self) -> tuple[str, ...]:
        """Those that watch."""
        return self.scene.cameras

    def empty_pictures(self, camera: str) -> Iterator[Picture]:
        """Yield what a camera shows of the empty scene."""
        convert = self._converter(camera)
        for frame in self.empty.files[camera]:
            image = self.empty.read(camera, frame)
            if not isinstance(image, Unreadable):
                yield convert(image)

    def instants(self, unreadable: list[tuple[str, str, str]]) -> Iterator[Instant]:
        """Read frame after frame, all cameras side by side.

        Parameters
        ----------
        unreadable
            (camera, frame, reason) of pictures that could not be read are added to it.
        """
        converters = {camera: self._converter(camera) for camera in self.cameras}

        def read(camera: str, frame: str) -> Picture | Unreadable:
            image = self.scene.read(camera, frame)
            return image if isinstance(image, Unreadable) else converters[camera](image)

        with ThreadPoolExecutor(min(n_cores(), len(self.cameras))) as pool:
            for frame, time_s in self.times_s.items():
                own = [camera for camera in self.cameras if frame in self.scene.files[camera]]
                pictures = {}
                for camera, found in zip(own, pool.map(read, own, [frame] * len(own)), strict=True):
                    if isinstance(found, Unreadable):
                        unreadable.append((camera, frame, found.reason))
                    else:
                        pictures[camera] = found
                yield Instant(frame=frame, time_s=time_s, pictures=pictures)

    def viewer(self, camera: str) -> "Viewer":
        """Return what gives the pictures of one camera to look at: frame -> (H, W, 3), sRGB."""
        corrected = self.in_colour and self.corrected
        entry = self.rig.cameras[camera]
        correctors = CameraCorrectors(camera, entry, "srgb", None) if corrected else None

        def show(frame: str) -> UInt8Array | Unreadable:
            if frame not in self.scene.files[camera]:
                return Unreadable("there is no such picture")
            image = self.scene.read(camera, frame)
            if isinstance(image, Unreadable):
                return image
            if correctors is not None:
                return _eight_bits(correctors.apply(image, self.scene.folder / camera))
            return _eight_bits(encode(image.linear(), "srgb").astype(np.float32))

        return show

    def _converter(self, camera: str) -> "_Converter":
        entry = self.rig.cameras[camera]
        corrected = self.in_colour and self.corrected
        correctors = CameraCorrectors(camera, entry, "xyz-d65", None) if corrected else None
        return _Converter(
            camera, self.scene.folder / camera, entry.size_wh, correctors, self.in_colour
        )


def _eight_bits(pixels: Pixels) -> UInt8Array:
    if pixels.dtype == np.float32:
        pixels = np.rint(np.clip(pixels, 0, 1) * 255)
    elif pixels.dtype == np.uint16:
        pixels = pixels // 257
    return np.asarray(pixels, dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class _Converter:
    """From a picture as stored to linear light."""

    camera: str
    place: Path
    size_wh: tuple[int, int]
    correctors: CameraCorrectors | None
    in_colour: bool

    def __call__(self, image: Image) -> Picture:
        if image.size_wh != self.size_wh:
            raise RecordingError(
                f"camera {self.camera}: a picture is {image.size_wh[0]}x{image.size_wh[1]}, the "
                f"camera was calibrated at {self.size_wh[0]}x{self.size_wh[1]}; record at that size"
            )
        if self.correctors is not None:
            return np.asarray(self.correctors.apply(image, self.place), dtype=np.float32)
        linear = image.linear()
        if self.in_colour:
            linear = linear @ np.linalg.inv(RGB_FROM_XYZ["srgb"]).T
        return linear.astype(np.float32)


def open_watch(
    rig: Rig,
    folder: Path,
    *,
    pattern: str | None = None,
    background: tuple[int, int] | None = None,
    fps: float | None = None,
    corrected: bool = True,
) -> Watch:
    """Find what a rig recorded of a scene.

    Parameters
    ----------
    rig
        The calibration.
    folder
        As for `calibrate`; frames whose names begin with ``background`` show the empty scene, of
        videos ``background/<camera>.mp4``.
    pattern
        As for `calibrate`.
    background
        First and last frame (indices) that show the empty scene.
    fps
        Frames per second where timestamps.csv does not tell the times.
    corrected
        False: take the values of the cameras as sRGB.

    Raises
    ------
    RecordingError
        If fewer than two cameras of the rig are there, or a camera has no frames of the empty
        scene.
    """
    recording = open_recording(folder, pattern=pattern)
    cameras = [camera for camera in rig.cameras if camera in recording.cameras]
    if len(cameras) < 2:
        raise RecordingError(
            f"{folder}: has the cameras {', '.join(recording.cameras)}, the rig "
            f"{', '.join(rig.cameras)}; places in space need two cameras of the rig, named as in "
            f"the calibration"
        )
    recording = read_as_calibrated(
        rig, replace(recording, files={camera: recording.files[camera] for camera in cameras})
    )
    times_s, time_unit_s, findings = _times(recording, fps)
    scene, empty = _split(recording, tuple(times_s), background)
    in_colour = all(rig.cameras[camera].colour is not None for camera in cameras)
    if not in_colour:
        bare = [camera for camera in cameras if rig.cameras[camera].colour is None]
        text = (
            f"camera{'s' if len(bare) > 1 else ''} {', '.join(bare)}: no colour calibration; "
            f"objects are told apart by place and size alone. Calibrate with the colour target."
        )
        findings = (*findings, finding("colour_not_calibrated", text, cameras=bare))
    kept = {frame for own in scene.files.values() for frame in own}
    return Watch(
        rig=rig,
        scene=scene,
        empty=empty,
        times_s={frame: time_s for frame, time_s in times_s.items() if frame in kept},
        time_unit_s=time_unit_s,
        in_colour=in_colour,
        corrected=corrected,
        findings=findings,
    )


def _split(
    recording: Recording, frames: Sequence[str], background: tuple[int, int] | None
) -> tuple[Recording, Recording]:
    """Frames of the scene, and of the empty scene."""
    if background is None:
        scene, empty = recording, recording.of_background()
    else:
        first, last = background
        chosen = set(frames[first : last + 1])
        if not 0 <= first <= last < len(frames):
            raise RecordingError(
                f"--background {first}:{last}: the recording has the frames 0 to {len(frames) - 1}"
            )
        scene, empty = (
            replace(
                recording,
                files={
                    camera: {frame: own[frame] for frame in own if (frame in chosen) is wanted}
                    for camera, own in recording.files.items()
                },
            )
            for wanted in (False, True)
        )
    missing = [camera for camera in recording.cameras if len(empty.files.get(camera, ())) < 2]
    if missing:
        raise RecordingError(
            f"{recording.folder}: camera {missing[0]} has fewer than two frames of the empty "
            f"scene; record a dozen of them as {missing[0]}/background0000.png and so on (of "
            f"videos, background/{missing[0]}.mp4), or name them with --background FIRST:LAST"
        )
    return scene, empty


def _times(
    recording: Recording, fps: float | None
) -> tuple[dict[str, float], float, tuple[Finding, ...]]:
    """Time of every frame in order, the unit it is reported in, and what to remark."""
    frames = list(dict.fromkeys(frame for own in recording.files.values() for frame in own))
    stamps = recording.times_s()
    by_frame = {frame: [own[frame] for own in stamps.values() if frame in own] for frame in frames}
    if all(by_frame.values()):
        times_s = {frame: float(np.mean(own)) for frame, own in by_frame.items()}
        ordered = dict(sorted(times_s.items(), key=lambda item: item[1]))
        return ordered, 1.0, _judge_times(recording.folder, ordered, by_frame)
    if stamps:
        missing = next(frame for frame, own in by_frame.items() if not own)
        raise RecordingError(
            f"{recording.folder / 'timestamps.csv'}: frame {missing} has no time; add its rows, or "
            f"move the file away and give --fps"
        )
    if fps is not None:
        return {frame: index / fps for index, frame in enumerate(frames)}, 1.0, ()
    text = (
        "Neither timestamps.csv nor --fps tells the time: it is counted in frames, and speeds are "
        "metres per frame."
    )
    times_s = {frame: index / _ASSUMED_FPS for index, frame in enumerate(frames)}
    return times_s, 1 / _ASSUMED_FPS, (finding("time_unknown", text),)


def _judge_times(
    folder: Path, times_s: Mapping[str, float], by_frame: Mapping[str, Sequence[float]]
) -> tuple[Finding, ...]:
    values = np.array(list(times_s.values()))
    intervals = np.diff(values)
    if (intervals <= 0).any():
        at = list(times_s)[int(np.argmin(intervals)) + 1]
        raise RecordingError(
            f"{folder / 'timestamps.csv'}: frame {at} has the time of another frame; correct it"
        )
    spread = max(max(own) - min(own) for own in by_frame.values())
    if len(intervals) and spread > _APART * float(np.median(intervals)):
        text = (
            f"The cameras took one frame up to {spread * 1e3:.0f} ms apart: an object at 1 m/s is "
            f"then seen {spread * 1e3:.0f} mm apart. Use a common trigger, or pair frames by time."
        )
        return (finding("frames_apart", text, spread_s=spread),)
    return ()
