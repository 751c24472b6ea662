"""``calichrome correct``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from calichrome.apply import OutputSpace
from calichrome.cli.terminal import Command, Flag, Output
from calichrome.pipeline.correct import correct
from calichrome.rig import load_rig

__all__ = ["Correct"]


@dataclass(frozen=True, kw_only=True)
class Correct(Command):
    """Correct the colours, and if asked the distortion, of pictures."""

    rig: Positional[Path]
    """rig.json."""
    source: Positional[Path]
    """A picture, a folder of one camera (with --camera), or a recording."""
    output: Annotated[Path, Output]
    """Folder for <camera>/<frame>."""
    camera: str | None = None
    """Which camera took a single picture or a flat folder."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    colour: OutputSpace = "srgb"
    """Colour space of the output; xyz-d65 writes float32 TIFF in the order X, Y, Z."""
    undistort: Flag = False
    """Remove lens distortion, keeping size and K."""
    force: Flag = False
    """Replace the output folder."""

    def run(self) -> int:
        """Correct and report."""
        with self.progress() as progress:
            written, skipped = correct(
                load_rig(self.rig),
                self.source,
                self.output,
                camera=self.camera,
                pattern=self.pattern,
                space=self.colour,
                undistort=self.undistort,
                force=self.force,
                progress=progress,
            )
        lines = [f"Wrote {len(written)} picture{'' if len(written) == 1 else 's'} to {self.output}"]
        lines += [f"  left out {path}: {reason}" for path, reason in skipped]
        self.show(
            "\n".join(lines),
            {
                "written": [str(path) for path in written],
                "skipped": [{"file": str(path), "reason": reason} for path, reason in skipped],
            },
        )
        return 0
