"""A folder of videos, ``RECORDING/<camera>.mp4``, read as cameras and frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calichrome.errors import RecordingError
from calichrome.imaging.recording_times import FrameTable, plain_frames, read_timestamps
from calichrome.imaging.video import VIDEO_SUFFIXES, Video, open_video

__all__ = ["VideoFrames", "open_background_videos", "open_videos", "video_files"]

_BACKGROUND = "background"


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoFrames:
    """The videos of a recording; `table` names their frames."""

    videos: Mapping[str, Video] = field(default_factory=dict)
    table: FrameTable = field(default_factory=lambda: FrameTable(numbers={}))


def video_files(folder: Path) -> list[Path]:
    """All video files of a folder but its background, sorted; hidden ones are left out."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in VIDEO_SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and path.relative_to(folder).parts[0] != _BACKGROUND
        and path.stem != _BACKGROUND
    )


def open_videos(
    folder: Path, paths: Sequence[Path], *, cameras: Sequence[str], max_megapixels: float
) -> VideoFrames:
    """Read every video's header and name its frames, by timestamps.csv or by their numbers.

    Parameters
    ----------
    folder
        The recording.
    paths
        Its videos.
    cameras
        Open only these; empty: all.
    max_megapixels
        Refuse larger frames.

    Raises
    ------
    RecordingError
        If the videos lie deeper than one level, or one of them cannot be read.
    """
    deeper = [path for path in paths if path.parent != folder]
    if deeper:
        raise RecordingError(
            f"{folder}: its videos lie deeper than RECORDING/<camera>.mp4, like "
            f"{deeper[0].relative_to(folder)}; put one video per camera into the folder itself"
        )
    by_camera: dict[str, Path] = {}
    for path in paths:
        if path.stem in by_camera:
            raise RecordingError(
                f"{by_camera[path.stem]} and {path} are both camera {path.stem}; remove one"
            )
        by_camera[path.stem] = path
    missing = [camera for camera in cameras if camera not in by_camera]
    if missing:
        raise RecordingError(
            f"{folder}: has no camera {', '.join(missing)}; there are {', '.join(by_camera)}"
        )
    videos = {
        camera: open_video(path, max_megapixels=max_megapixels)
        for camera, path in by_camera.items()
        if not cameras or camera in cameras
    }
    n_frames = {camera: video.n_frames for camera, video in videos.items()}
    stamps = folder / "timestamps.csv"
    table = (
        read_timestamps(stamps, n_frames, others=by_camera.keys() - videos.keys())
        if stamps.is_file()
        else plain_frames(n_frames)
    )
    return VideoFrames(videos=videos, table=table)


def open_background_videos(folder: Path, videos: VideoFrames, max_megapixels: float) -> VideoFrames:
    """Open the videos ``<folder>/<camera>.mp4`` of the empty scene, of cameras in `videos`."""
    if not folder.is_dir():
        return VideoFrames()
    opened = {
        path.stem: open_video(path, max_megapixels=max_megapixels)
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in VIDEO_SUFFIXES and path.stem in videos.videos
    }
    table = plain_frames({camera: video.n_frames for camera, video in opened.items()})
    return VideoFrames(videos=opened, table=table)
