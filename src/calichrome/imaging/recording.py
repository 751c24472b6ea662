"""A folder of pictures or videos, read as cameras and frames."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from calichrome.errors import RecordingError
from calichrome.imaging.files import MAX_MEGAPIXELS, PICTURE_SUFFIXES, read_image, read_size
from calichrome.imaging.header import Unreadable
from calichrome.imaging.image import Image
from calichrome.imaging.recording_file import CameraEntry, RecordingFile, read_recording_file
from calichrome.imaging.recording_names import Files, most_shared, natural_order, read_names
from calichrome.imaging.recording_times import read_picture_times
from calichrome.imaging.recording_videos import (
    VideoFrames,
    open_background_videos,
    open_videos,
    video_files,
)
from calichrome.imaging.video import read_frame

__all__ = ["Recording", "open_recording", "picture_files"]

_BACKGROUND = "background"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """Where the picture of each camera and frame is.

    Parameters
    ----------
    folder
        The recording.
    files
        camera id -> frame id -> file that holds it; same frame id = same instant.
    ignored
        Pictures that the reading leaves out.
    reading
        How the names were understood, in words.
    settings
        recording.toml.
    max_megapixels
        Larger pictures are refused before decoding.
    videos
        Where the frames are those of videos.
    background
        camera id -> frame id -> file of the empty scene; these are no frames of the recording.
    background_videos
        Where those are frames of videos.
    """

    folder: Path
    files: Mapping[str, Mapping[str, Path]]
    ignored: tuple[Path, ...] = ()
    reading: str = ""
    settings: RecordingFile = field(default_factory=RecordingFile)
    max_megapixels: float = MAX_MEGAPIXELS
    videos: VideoFrames = field(default_factory=VideoFrames)
    background: Mapping[str, Mapping[str, Path]] = field(default_factory=dict)
    background_videos: VideoFrames = field(default_factory=VideoFrames)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera ids, sorted."""
        return tuple(self.files)

    @property
    def n_pictures(self) -> int:
        """Number of pictures."""
        return sum(len(frames) for frames in self.files.values())

    def entry(self, camera_id: str) -> CameraEntry:
        """Return what recording.toml says of a camera."""
        return self.settings.camera(camera_id)

    def read(self, camera_id: str, frame_id: str) -> Image | Unreadable:
        """Read one picture with the encoding stated for its camera."""
        entry = self.entry(camera_id)
        encoding = None if entry.encoding == "unknown" else entry.encoding
        if camera_id in self.videos.videos:
            number = self.videos.table.numbers[camera_id][frame_id]
            video = self.videos.videos[camera_id]
            return read_frame(video, number, encoding=encoding, bits=entry.bits)
        return read_image(
            self.files[camera_id][frame_id],
            encoding=encoding,
            bits=entry.bits,
            max_megapixels=self.max_megapixels,
        )

    def of_background(self) -> "Recording":
        """Return the frames of the empty scene as a recording of their own."""
        return replace(
            self,
            files=self.background,
            videos=self.background_videos,
            background={},
            background_videos=VideoFrames(),
        )

    def read_size(self, camera_id: str) -> tuple[int, int] | Unreadable:
        """Return width and height of a camera's first picture that can be read, undecoded."""
        if camera_id in self.videos.videos:
            return self.videos.videos[camera_id].size_wh
        size: tuple[int, int] | Unreadable = Unreadable("there is no picture")
        for path in self.files[camera_id].values():
            size = read_size(path, max_megapixels=self.max_megapixels)
            if not isinstance(size, Unreadable):
                return size
        return size

    def times_s(self) -> Mapping[str, Mapping[str, float]]:
        """Return camera id -> frame id -> seconds, as far as timestamps.csv says it.

        Raises
        ------
        RecordingError
            If the file is not as described.
        """
        if self.videos.videos:
            return self.videos.table.times_s
        return read_picture_times(self.folder / "timestamps.csv", self.files)

    def content_sum(self, camera_id: str, frame_id: str) -> str:
        """Return the SHA-256 sum that `Image.sha256` of a frame will be, without decoding it.

        Raises
        ------
        OSError
            If the file cannot be read.
        """
        if camera_id in self.videos.videos:
            number = self.videos.table.numbers[camera_id][frame_id]
            return self.videos.videos[camera_id].frame_sum(number)
        with self.files[camera_id][frame_id].open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()


def picture_files(folder: Path) -> list[Path]:
    """All picture files below a folder, sorted; hidden ones are left out."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in PICTURE_SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def open_recording(
    folder: Path,
    *,
    pattern: str | None = None,
    cameras: Sequence[str] = (),
    max_megapixels: float = MAX_MEGAPIXELS,
    synchronous: bool = True,
) -> Recording:
    """Find the cameras and frames of a folder.

    Parameters
    ----------
    folder
        ``folder/<camera>/<frame>.png``, a flat folder of one camera, what `pattern` says, or
        videos ``folder/<camera>.mp4``; some of each only if not `synchronous`.
    pattern
        See `NamePattern`; over what recording.toml says.
    cameras
        Use only these cameras; empty: all.
    max_megapixels
        Refuse larger pictures before decoding.
    synchronous
        Refuse several cameras without a common frame.

    Raises
    ------
    RecordingError
        If there are no pictures, several ways to read them, or no common frame.
    """
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist"
        raise RecordingError(f"{folder} {what}; give the folder that holds the pictures")
    settings = read_recording_file(folder / "recording.toml")
    paths, clips = picture_files(folder), video_files(folder)
    text = pattern or settings.pattern
    videos = background_videos = VideoFrames()
    stills = [path for path in paths if path.relative_to(folder).parts[0] != _BACKGROUND]
    if clips:
        if synchronous or not stills:
            _check_only_videos(folder, stills, clips, text)
        videos = open_videos(folder, clips, cameras=cameras, max_megapixels=max_megapixels)
        files, reading = _read_videos(videos)
        background_videos = open_background_videos(folder / _BACKGROUND, videos, max_megapixels)
        if stills:
            files, reading = _with_pictures(files, *read_names(folder, stills, text))
    elif not paths:
        kinds = ", ".join(PICTURE_SUFFIXES)
        raise RecordingError(
            f"{folder}: holds no pictures ({kinds}) and no videos; raw files are not read by this "
            f"release: extract them as linear 16-bit TIFF"
        )
    else:
        files, reading = read_names(folder, paths, text)
    files, background = _split_background(files)
    background.update(_read_videos(background_videos)[0])
    _check_entries(settings, {path.stem for path in clips} | set(files), folder)
    files = _only(files, cameras, folder)
    if synchronous:
        _check_common_frames(files, folder)
    used = {path for frames in files.values() for path in frames.values()}
    return Recording(
        folder=folder,
        files={
            camera: {
                frame: files[camera][frame] for frame in sorted(files[camera], key=natural_order)
            }
            for camera in sorted(files, key=natural_order)
        },
        ignored=tuple(path for path in paths if path not in used),
        reading=reading,
        settings=settings,
        max_megapixels=max_megapixels,
        videos=videos,
        background={
            camera: {frame: own[frame] for frame in sorted(own, key=natural_order)}
            for camera, own in background.items()
            if camera in files
        },
        background_videos=background_videos,
    )


def _check_only_videos(
    folder: Path, stills: Sequence[Path], clips: Sequence[Path], pattern: str | None
) -> None:
    if stills:
        raise RecordingError(
            f"{folder}: holds videos (like {clips[0].name}) and pictures (like "
            f"{stills[0].relative_to(folder)}); put one kind into another folder"
        )
    if pattern is not None:
        raise RecordingError(
            f"{folder}: holds videos, of which the name is the camera and the number the frame; "
            f"leave out --pattern"
        )


def _read_videos(videos: VideoFrames) -> tuple[Files, str]:
    numbers = videos.table.numbers
    files = {
        camera: dict.fromkeys(numbers[camera], video.path)
        for camera, video in videos.videos.items()
    }
    extra = f"; {videos.table.reading}" if videos.table.reading else ""
    return files, f"videos are cameras: {', '.join(sorted(files, key=natural_order))}{extra}"


def _with_pictures(files: Files, pictures: Files, reading: str) -> tuple[Files, str]:
    for camera in pictures:
        if camera in files:
            raise RecordingError(
                f"camera {camera} has pictures and a video; put one of them into another folder"
            )
    return files | pictures, f"videos are cameras: {', '.join(files)}; {reading}"


def _split_background(files: Files) -> tuple[Files, Files]:
    """Frames of the scene, and those of the empty scene."""
    kept: Files = {}
    background: Files = {}
    for camera, frames in files.items():
        if camera == _BACKGROUND:
            continue
        for frame, path in frames.items():
            group = background if frame.startswith(_BACKGROUND) else kept
            group.setdefault(camera, {})[frame] = path
    return kept, background


def _check_entries(settings: RecordingFile, known: Collection[str], folder: Path) -> None:
    unknown = [camera for camera in settings.cameras if camera not in known]
    if unknown and known:
        raise RecordingError(
            f"{folder / 'recording.toml'}: cameras.{unknown[0]} is not among the cameras "
            f"{', '.join(sorted(known))}; correct the name"
        )


def _only(files: Files, cameras: Sequence[str], folder: Path) -> Files:
    missing = [camera for camera in cameras if camera not in files]
    if missing:
        raise RecordingError(
            f"{folder}: has no camera {', '.join(missing)}; there are {', '.join(sorted(files))}"
        )
    if not files:
        raise RecordingError(f"{folder}: holds only background pictures; record views of a board")
    return {camera: files[camera] for camera in cameras} if cameras else files


def _check_common_frames(files: Files, folder: Path) -> None:
    if len(files) > 1 and most_shared(files) < 2:
        examples = "; ".join(
            f"{camera}: {', '.join(sorted(frames)[:3])}" for camera, frames in sorted(files.items())
        )
        raise RecordingError(
            f"{folder}: no frame name is common to two cameras ({examples}); give pictures of one "
            f"instant the same name, or say where it is in the name with --pattern"
        )
