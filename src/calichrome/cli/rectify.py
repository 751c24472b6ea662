"""``calichrome rectify``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from calichrome.apply import OutputSpace
from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.cli.video_lines import video_json, video_lines
from calichrome.errors import RecordingError
from calichrome.geometry.rectified_area import Framing, PrincipalPoints, ValidArea
from calichrome.imaging import VideoSettings
from calichrome.pipeline.rectify import rectify
from calichrome.rig import load_rig

__all__ = ["Rectify"]


@dataclass(frozen=True, kw_only=True)
class Rectify(Command):
    """Turn two cameras by calculation until their rows correspond."""

    rig: Positional[Path]
    """rig.json."""
    source: Positional[Path]
    """The recording."""
    pair: tuple[str, ...]
    """The two cameras, like left,right."""
    output: Annotated[Path, Output]
    """Folder for <camera>/<frame>.png or <camera>.mp4, and rectification.json."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    valid_area: ValidArea = "all"
    """all: both pictures whole, with black borders; valid: the largest part without."""
    principal_points: PrincipalPoints = "common"
    """common: disparity is 0 at infinity; own: keeps the scale of cameras that converge."""
    colour: OutputSpace = "srgb"
    """Colour space of the output; a camera without colour calibration stays as it is."""
    sheet: Path | None = None
    """Also write the first frame side by side, with lines along which points correspond."""
    videos: VideoSettings = field(default_factory=VideoSettings)
    """How videos are encoded."""
    force: Flag = False
    """Write into an existing folder; files of the same names are replaced."""

    def run(self) -> int:
        """Rectify and report."""
        names = names_from(self.pair)
        if len(names) != 2:
            raise RecordingError(f"--pair wants two cameras, like left,right; got {len(names)}")
        rig = load_rig(self.rig)
        with self.progress() as progress:
            done = rectify(
                rig,
                (names[0], names[1]),
                self.source,
                self.output,
                pattern=self.pattern,
                space=self.colour,
                framing=Framing(area=self.valid_area, principal_points=self.principal_points),
                sheet=self.sheet,
                settings=self.videos,
                force=self.force,
                progress=progress,
            )
        result = done.rectification
        text = (
            f"Wrote rectified {'videos' if done.videos else 'pictures'} of "
            f"{' and '.join(names)} to {self.output}: f "
            f"{result.focal_px:.2f} px, baseline {abs(result.baseline_m) * 1e3:.2f} mm, "
            f"{'columns' if result.vertical else 'rows'} correspond; they show "
            f"{result.a.share:.0%} and {result.b.share:.0%} of the pictures"
        )
        if result.baseline_m < 0:
            where = "above" if result.vertical else "left of"
            text += (
                f"\n{names[1]} is {where} {names[0]}, so disparities are negative; a matcher that "
                f"wants positive ones takes --pair {names[1]},{names[0]}"
            )
        self.show(
            "\n".join([text, *video_lines(done.videos)]),
            {
                "P1": result.a.projection.tolist(),
                "P2": result.b.projection.tolist(),
                "shares": [result.a.share, result.b.share],
                "videos": video_json(done.videos),
            },
        )
        return self.verdict(rig)
