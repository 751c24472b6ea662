"""The real recordings, searched once: pictures in, observations out."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.imaging import open_recording
from calichrome.observations import BoardView, Dataset
from calichrome.pipeline.detect import DetectionSettings, detect_recording, find_target
from calichrome.target import Target

__all__ = [
    "RECORDINGS",
    "ZHANG",
    "ZHANG_FIXED",
    "PointBoard",
    "RealSet",
    "Recorded",
    "zhang_recorded",
]

ZHANG = {"fx": 832.50, "fy": 832.53, "cx": 303.96, "cy": 206.59, "k1": -0.2286, "k2": 0.1904}
"""Z. Zhang, MSR-TR-98-71: his camera (with a skew of 0.2, which no lens here has)."""

ZHANG_FIXED = {"p1": 0.0, "p2": 0.0, "k3": 0.0}
_ZHANG_SIZE_WH = (640, 480)
_ZHANG_SQUARES = 8


@dataclass(frozen=True, slots=True)
class RealSet:
    """Where a recording is and what it shows.

    Parameters
    ----------
    folder, pattern, target
        As `calichrome calibrate` takes them.
    reference
        Camera whose frame is ref.
    """

    folder: str
    pattern: str
    target: str
    reference: str

    def read(self, data: Path, cache: Path | None = None) -> "Recorded | None":
        """Search the pictures; None if they are not there."""
        if not (data / self.folder).is_dir():
            return None
        recording = open_recording(data / self.folder, pattern=self.pattern)
        target = find_target(recording, self.target, None)
        settings = DetectionSettings(cache=cache, no_cache=cache is None)
        found = detect_recording(recording, target, settings=settings)
        return Recorded(found.dataset, target, self.reference)


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What was seen."""

    dataset: Dataset
    target: Target
    reference: str


RECORDINGS: Mapping[str, RealSet] = {
    item.folder: item
    for item in (
        RealSet("opencv_stereo", "{camera:left|right}{frame}", "chessboard:9x6:30mm", "left"),
        RealSet(
            "boofcv_bumblebee2_chess", "{camera:left|right}{frame}", "chessboard:4x6:30mm", "left"
        ),
        RealSet(
            "boofcv_trinocular_odd", "{camera}/{camera}{frame}", "chessboard:9x13:30mm", "middle"
        ),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PointBoard(Target):
    """A board whose points lie on no grid.

    Parameters
    ----------
    points : n triples, metres
    """

    points: tuple[tuple[float, float, float], ...]

    @property
    def corners_board(self) -> FloatArray:
        """The points, (n, 3)."""
        return np.array(self.points)


def zhang_recorded(data: Path) -> Recorded | None:
    """Return Zhang's five views of 64 squares (four corners each); lengths are his inches."""
    folder = data / "zhang1998"
    if not folder.is_dir():
        return None
    model = np.loadtxt(folder / "Model.txt").reshape(-1, 2)
    views = {
        str(number): BoardView(
            corner_ids=np.arange(len(model)),
            corners_px=np.loadtxt(folder / f"data{number}.txt").reshape(-1, 2),
        )
        for number in range(1, 6)
    }
    board = PointBoard(
        squares=(2 * _ZHANG_SQUARES + 1, 2 * _ZHANG_SQUARES + 1),
        square_m=(1.0, 1.0),
        points=tuple((float(x), float(y), 0.0) for x, y in model),
    )
    dataset = Dataset(sizes_wh={"camera": _ZHANG_SIZE_WH}, views={"camera": views})
    return Recorded(dataset, board, "camera")
