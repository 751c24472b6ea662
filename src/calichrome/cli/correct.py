"""``calichrome correct``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from calichrome.apply import Kernel, OutputSpace
from calichrome.cli.terminal import Command, Flag, Output
from calichrome.cli.video_lines import video_json, video_lines
from calichrome.geometry.rectified_area import ValidArea
from calichrome.imaging import VideoSettings
from calichrome.pipeline.correct import correct
from calichrome.pipeline.new_view import NewView
from calichrome.rig import load_rig

__all__ = ["Correct"]

_KERNELS: dict[Kernel, str] = {
    "native": "the C kernels",
    "opencv": "OpenCV and numpy, slowly: calichrome was installed without a C compiler",
}


@dataclass(frozen=True, kw_only=True)
class Correct(Command):
    """Correct the colours, and if asked the distortion, of pictures and videos."""

    rig: Positional[Path]
    """rig.json."""
    source: Positional[Path]
    """A picture or video, a folder of one camera (with --camera), or a recording."""
    output: Annotated[Path, Output]
    """Folder for <camera>/<frame> and <camera>.mp4."""
    camera: str | None = None
    """Which camera took a single picture or video, or a flat folder."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    colour: OutputSpace = "srgb"
    """Colour space of the output; xyz-d65 writes float32 TIFF in the order X, Y, Z."""
    undistort: Flag = False
    """Remove lens distortion, keeping size and K."""
    valid_area: ValidArea | None = None
    """Undistort and choose K: all of the picture is seen (all), or no black border (valid)."""
    keep_size: Flag = False
    """With --valid-area: keep the size and change the scale, instead of the other way round."""
    new_camera: str | None = None
    """Undistort to the K and size of this camera of the rig, or of a JSON file with them."""
    videos: VideoSettings = field(default_factory=VideoSettings)
    """How videos are encoded."""
    force: Flag = False
    """Write into an existing folder; files of the same names are replaced."""

    def run(self) -> int:
        """Correct and report."""
        view = NewView(
            undistort=self.undistort,
            valid_area=self.valid_area,
            keep_size=self.keep_size,
            new_camera=self.new_camera,
        )
        rig = load_rig(self.rig)
        with self.progress() as progress:
            result = correct(
                rig,
                self.source,
                self.output,
                camera=self.camera,
                pattern=self.pattern,
                space=self.colour,
                view=view,
                settings=self.videos,
                force=self.force,
                progress=progress,
            )
        n_pictures = len(result.written) - len(result.videos)
        parts = [
            f"{count} {what}{'' if count == 1 else 's'}"
            for count, what in ((n_pictures, "picture"), (len(result.videos), "video"))
            if count
        ]
        lines = [f"Wrote {' and '.join(parts)} to {self.output}"]
        lines += [f"  left out {path}: {reason}" for path, reason in result.skipped]
        lines += video_lines(result.videos)
        lines.append(f"Pixels were corrected by {_KERNELS[result.kernel]}")
        self.show(
            "\n".join(lines),
            {
                "written": [str(path) for path in result.written],
                "skipped": [
                    {"file": str(path), "reason": reason} for path, reason in result.skipped
                ],
                "videos": video_json(result.videos),
                "kernel": result.kernel,
            },
        )
        return self.verdict(rig)
