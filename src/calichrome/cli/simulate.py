"""``calichrome simulate``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from calichrome.cli.terminal import Command, Output
from calichrome.errors import RecordingError
from calichrome.synthetic import random_scene, write_recording
from calichrome.target import Target, colour_checker_palette, design_target, load_target

__all__ = ["Simulate", "standard_target"]


@dataclass(frozen=True, kw_only=True)
class Simulate(Command):
    """Render a recording of a board by a rig of cameras, with its truth."""

    output: Annotated[Path, Output]
    """Folder to write; it must not exist or be empty."""
    target: Path | None = None
    """target.json; default: 10x9 squares of 30 mm with the 24 colours of the ColorChecker."""
    cameras: int = 2
    """Number of cameras."""
    frames: int = 12
    """Number of board poses."""
    size: str = "640x480"
    """Width x height of the pictures, pixels."""
    noise: float = 1.0
    """Noise as a multiple of a good small camera's."""
    print_error: float = 0.0
    """Standard deviation of the printed colours about the nominal ones, in L, a and b."""
    seed: int = 0
    """Of lenses, places, poses and noise."""

    def run(self) -> int:
        """Render and write."""
        if self.seed < 0 or not 0 <= self.noise < math.inf:
            raise RecordingError(f"--seed {self.seed} --noise {self.noise}: give 0 or more")
        target = standard_target() if self.target is None else load_target(self.target)
        scene = random_scene(
            target,
            self.cameras,
            self.frames,
            _size_wh(self.size),
            self.seed,
            noise=self.noise,
            palette_error_lab_sd=self.print_error,
        )
        with self.progress() as progress:
            write_recording(
                scene, self.output, lambda done, total: progress("rendering", done, total)
            )
        self.show(
            f"Wrote {self.output}: {self.cameras} cameras, {self.frames} frames, and truth.json",
            {"recording": str(self.output)},
        )
        return 0


def standard_target() -> Target:
    """Return the board of `target make` without options."""
    palette = colour_checker_palette()
    return design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=palette)


def _size_wh(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise RecordingError(f"--size {text}: write WIDTHxHEIGHT, like 640x480")
    return int(width), int(height)
