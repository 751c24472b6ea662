"""Correctors by camera, whose errors name the camera and the file."""

from pathlib import Path

from calichrome.apply import Corrector, FrameFormat, Kernel, OutputSpace, SourceMap
from calichrome.errors import CalichromeError, RecordingError
from calichrome.imaging import Image, Pixels, StreamFormat, Unreadable, Video, read_image
from calichrome.rig import Camera

__all__ = ["CameraCorrectors", "read_picture"]


class CameraCorrectors:
    """One camera's correctors, one for each way in which its pictures are stored.

    Parameters
    ----------
    name, camera
        From a rig.
    space, source_map
        As for `Corrector`.

    Raises
    ------
    CalichromeError
        If the camera has no colour to correct, or its name is no file name.
    """

    def __init__(
        self, name: str, camera: Camera, space: OutputSpace, source_map: SourceMap | None
    ) -> None:
        if name == ".." or Path(name).name != name:  # it becomes a folder, and must stay inside OUT
            raise RecordingError(f"camera {name!r} is no name for a folder; rename it in rig.json")
        if space != "none" and camera.colour is None:
            raise CalichromeError(
                f"camera {name} has no colour calibration; use --colour none, or calibrate with "
                f"the colour target"
            )
        self._camera, self._space, self._source_map = camera, space, source_map
        self._by_format: dict[FrameFormat, Corrector] = {}

    @property
    def kernel(self) -> Kernel | None:
        """Which code runs; None before the first picture."""
        return next((corrector.kernel for corrector in self._by_format.values()), None)

    def of_video(self, video: Video, form: StreamFormat) -> Corrector:
        """Return the corrector of a video's frames.

        Raises
        ------
        CalichromeError
            If they cannot be corrected so.
        """
        wanted_wh = self._camera.size_wh
        if video.size_wh != wanted_wh:
            raise CalichromeError(
                f"{video.path}: the video is {video.size_wh[0]}x{video.size_wh[1]}, the camera was "
                f"calibrated at {wanted_wh[0]}x{wanted_wh[1]}; record at that size"
            )
        colour = self._camera.colour
        frames = FrameFormat(
            dtype="uint16" if form.is_deep else "uint8",
            order="grey" if form.is_grey else "rgb",
            # where the calibration saw no picture, the file knows better than its depth
            encoding=video.encoding if colour is not None and colour.encoding is None else None,
        )
        return self._of_format(frames, video.path)

    def apply(self, image: Image, path: Path) -> Pixels:
        """Correct a picture.

        Raises
        ------
        CalichromeError
            If it does not fit the camera.
        """
        corrector = self._of_format(FrameFormat.of(image), path)
        try:
            return corrector.apply(image.pixels)
        except CalichromeError as error:
            raise CalichromeError(f"{path}: {error}") from error

    def _of_format(self, frames: FrameFormat, path: Path) -> Corrector:
        if frames not in self._by_format:
            try:
                self._by_format[frames] = Corrector(
                    self._camera, self._space, self._source_map, frames=frames
                )
            except CalichromeError as error:
                raise CalichromeError(f"{path}: {error}") from error
        return self._by_format[frames]


def read_picture(camera: Camera, path: Path, bits: int | None) -> Image | Unreadable:
    """Read a picture; `bits` as recording.toml says, else as the camera was calibrated."""
    # the corrector knows the camera's encoding
    return read_image(path, bits=bits or (None if camera.colour is None else camera.colour.bits))
