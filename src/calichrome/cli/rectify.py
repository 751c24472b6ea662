"""``calichrome rectify``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional

from calichrome.apply import OutputSpace
from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.errors import RecordingError
from calichrome.pipeline.correct import rectify
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
    """Folder for <camera>/<frame>.png and rectification.json."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    colour: OutputSpace = "srgb"
    """Colour space of the output; a camera without colour calibration stays as it is."""
    sheet: Path | None = None
    """Also write the first frame side by side, with lines along which points correspond."""
    force: Flag = False
    """Replace the output folder."""

    def run(self) -> int:
        """Rectify and report."""
        names = names_from(self.pair)
        if len(names) != 2:
            raise RecordingError(f"--pair wants two cameras, like left,right; got {len(names)}")
        with self.progress() as progress:
            result = rectify(
                load_rig(self.rig),
                (names[0], names[1]),
                self.source,
                self.output,
                pattern=self.pattern,
                space=self.colour,
                sheet=self.sheet,
                force=self.force,
                progress=progress,
            )
        axis = int(result.vertical)
        baseline_mm = abs(result.projection_b[axis, 3] / result.matrix[0, 0]) * 1e3
        self.show(
            f"Wrote rectified pictures of {' and '.join(names)} to {self.output}: f "
            f"{result.matrix[0, 0]:.2f} px, baseline {baseline_mm:.2f} mm, "
            f"{'columns' if result.vertical else 'rows'} correspond",
            {"P1": result.projection_a.tolist(), "P2": np.asarray(result.projection_b).tolist()},
        )
        return 0
