"""``calichrome simulate``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from calichrome.cli.terminal import Command, Output
from calichrome.errors import RecordingError
from calichrome.pipeline.detect import Progress
from calichrome.synthetic import random_scene, write_recording
from calichrome.synthetic.workspace import workspace_scene, write_workspace
from calichrome.target import Target, colour_checker_palette, design_target, load_target

__all__ = ["Simulate", "size_from", "standard_target"]


@dataclass(frozen=True, kw_only=True)
class Simulate(Command):
    """Render recordings by a rig of cameras, with their truth: of a board, or of moving balls."""

    output: Annotated[Path, Output]
    """Folder to write; it must not exist or be empty."""
    scene: Literal["board", "workspace"] = "board"
    """board: a rig that looks at a board. workspace: a ring of cameras about coloured balls that
    move; OUTPUT/calibration shows the board, OUTPUT/workspace is for `observe`."""
    target: Path | None = None
    """target.json; default: 10x9 squares of 30 mm with the 24 colours of the ColorChecker; in a
    workspace of 80 mm."""
    cameras: int | None = None
    """Number of cameras; default: 2, in a workspace 6."""
    frames: int | None = None
    """Number of board poses, default 12; in a workspace of frames with the balls, default 200."""
    balls: int = 12
    """Number of balls in a workspace."""
    size: str | None = None
    """Width x height of the pictures, pixels; default: 640x480, in a workspace different ones."""
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
        with self.progress() as progress:
            return self._workspace(progress) if self.scene == "workspace" else self._board(progress)

    def _board(self, progress: Progress) -> int:
        scene = random_scene(
            standard_target() if self.target is None else load_target(self.target),
            2 if self.cameras is None else self.cameras,
            12 if self.frames is None else self.frames,
            size_from(self.size or "640x480"),
            self.seed,
            noise=self.noise,
            palette_error_lab_sd=self.print_error,
        )
        write_recording(scene, self.output, lambda done, total: progress("rendering", done, total))
        n_frames = len(scene.world_from_board)
        self.show(
            f"Wrote {self.output}: {len(scene.cameras)} cameras, {n_frames} frames, and truth.json",
            {"recording": str(self.output)},
        )
        return 0

    def _workspace(self, progress: Progress) -> int:
        workspace = workspace_scene(
            self.seed,
            target=None if self.target is None else load_target(self.target),
            n_cameras=6 if self.cameras is None else self.cameras,
            n_balls=self.balls,
            n_frames=200 if self.frames is None else self.frames,
            size_wh=None if self.size is None else size_from(self.size),
            noise=self.noise,
            palette_error_lab_sd=self.print_error,
        )
        write_workspace(workspace, self.output, progress)
        self.show(
            f"Wrote {self.output}/calibration with {len(workspace.scene.world_from_board)} board "
            f"poses, and {self.output}/workspace with {len(workspace.balls)} balls in "
            f"{workspace.n_frames} frames; each with truth.json",
            {key: str(self.output / key) for key in ("calibration", "workspace")},
        )
        return 0


def standard_target() -> Target:
    """Return the board of `target make` without options."""
    palette = colour_checker_palette()
    return design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=palette)


def size_from(text: str) -> tuple[int, int]:
    """Read the ``WIDTHxHEIGHT`` of --size."""
    width, cross, height = text.partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise RecordingError(f"--size {text}: write WIDTHxHEIGHT, like 640x480")
    return int(width), int(height)
