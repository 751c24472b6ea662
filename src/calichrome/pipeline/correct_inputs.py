"""What is to be corrected: pictures and videos, and which camera took them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from calichrome.errors import RecordingError
from calichrome.imaging import (
    MAX_MEGAPIXELS,
    PICTURE_SUFFIXES,
    VIDEO_SUFFIXES,
    Recording,
    Video,
    open_recording,
    open_video,
    video_files,
)
from calichrome.rig import Rig

__all__ = ["CorrectInputs", "Picture", "correct_inputs"]


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture to correct; `bits` as recording.toml says, else None."""

    camera: str
    frame: str
    path: Path
    bits: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectInputs:
    """What is to be corrected.

    Parameters
    ----------
    pictures
        In order of cameras.
    videos
        By camera.
    timestamps
        timestamps.csv of the recording, if it has one.
    names
        Camera of the recording -> camera of the rig.
    """

    pictures: tuple[Picture, ...] = ()
    videos: Mapping[str, Video]
    timestamps: Path | None = None
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Every camera once."""
        names = [picture.camera for picture in self.pictures]
        return tuple(dict.fromkeys([*names, *self.videos]))


def correct_inputs(
    rig: Rig, source: Path, camera: str | None, pattern: str | None
) -> CorrectInputs:
    """Find pictures and videos of a file, a folder or a recording.

    Parameters
    ----------
    rig
        Its cameras are the ones that may occur.
    source
        The file or folder.
    camera
        Which camera took a single file or a flat folder.
    pattern
        How file names are built.

    Raises
    ------
    RecordingError
        If there is nothing, or it is not clear which camera took it.
    """
    if camera is not None and camera not in rig.cameras:
        raise RecordingError(f"the rig has no camera {camera}; it has {', '.join(rig.cameras)}")
    if source.is_file():
        return _of_file(rig, source, camera)
    recording, names = _opened(rig, source, camera, pattern)
    for name in names.values():
        if name not in rig.cameras:
            raise RecordingError(
                f"{source}: camera {name} is not in the rig ({', '.join(rig.cameras)}); rename its "
                f"folder or video, or say with --camera which one it is"
            )
    videos = recording.videos.videos
    stamps = source / "timestamps.csv"
    return CorrectInputs(
        pictures=tuple(
            Picture(names[own], frame, path, recording.entry(own).bits)
            for own, frames in recording.files.items()
            if own not in videos
            for frame, path in frames.items()
        ),
        videos={names[own]: video for own, video in videos.items()},
        timestamps=stamps if stamps.is_file() else None,
        names=names,
    )


def _of_file(rig: Rig, source: Path, camera: str | None) -> CorrectInputs:
    suffix = source.suffix.lower()
    if suffix in PICTURE_SUFFIXES:
        name = camera or _only_camera(rig, source)
        return CorrectInputs(pictures=(Picture(name, source.stem, source),), videos={})
    if suffix in VIDEO_SUFFIXES:
        name = camera or (source.stem if source.stem in rig.cameras else _only_camera(rig, source))
        return CorrectInputs(videos={name: open_video(source, max_megapixels=MAX_MEGAPIXELS)})
    raise RecordingError(
        f"{source}: is no picture ({', '.join(PICTURE_SUFFIXES)}) and no video "
        f"({', '.join(VIDEO_SUFFIXES)}); give one, or a folder of them"
    )


def _opened(
    rig: Rig, source: Path, camera: str | None, pattern: str | None
) -> tuple[Recording, Mapping[str, str]]:
    """Open a recording; say which camera of the rig each of its cameras is."""
    if camera is not None and pattern is None:
        return _flat(source, camera)
    recording = open_recording(source, pattern=pattern, synchronous=False)
    if recording.cameras == ("cam0",) and "cam0" not in rig.cameras:
        return recording, {"cam0": camera or _only_camera(rig, source)}
    return recording, {name: name for name in recording.cameras}


def _flat(source: Path, camera: str) -> tuple[Recording, Mapping[str, str]]:
    """Open a folder of what one camera took: its pictures, or one video."""
    clips = video_files(source)
    recording = open_recording(source, pattern=None if clips else "{frame}", synchronous=False)
    if len(recording.cameras) > 1:
        raise RecordingError(
            f"{source}: holds {len(recording.cameras)} cameras ({', '.join(recording.cameras)}), "
            f"and --camera {camera} names one; give its file"
        )
    return recording, {recording.cameras[0]: camera}


def _only_camera(rig: Rig, source: Path) -> str:
    if len(rig.cameras) > 1:
        raise RecordingError(
            f"{source}: say with --camera which one took it ({', '.join(rig.cameras)})"
        )
    return next(iter(rig.cameras))
