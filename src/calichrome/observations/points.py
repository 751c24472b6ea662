"""Points that somebody else has found in the pictures, as a table."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import FileFormatError
from calichrome.observations.table import covariance_cells, float_cell, read_table

__all__ = ["ImagePoints", "read_points"]

_COLUMNS = ("camera", "frame", "point", "x", "y")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImagePoints:
    """N points, each of one frame, in some cameras.

    Parameters
    ----------
    names : N times (frame, point)
        In the order in which they were first mentioned.
    pixels : camera -> (N, 2) float, pixels
        As recorded, with the distortion of the lens; nan where not seen.
    cov_px2 : camera -> (N, 2, 2) float, pixels squared
        nan where not said.
    """

    names: tuple[tuple[str, str], ...]
    pixels: Mapping[str, FloatArray]
    cov_px2: Mapping[str, FloatArray]


def read_points(path: Path, sizes_wh: Mapping[str, tuple[int, int]]) -> ImagePoints:
    """Read ``camera,frame,point,x,y`` and, if they are there, ``sigma`` or ``sxx,sxy,syy``.

    Parameters
    ----------
    path
        CSV with a header; the order of columns and rows does not matter, other columns are ignored.
    sizes_wh
        Picture sizes of the cameras that there are, pixels.

    Raises
    ------
    FileFormatError
        Naming the line: of an unknown camera, a position that is no number or outside the picture,
        a covariance that is none, or a point that stands twice.
    """
    rows: dict[str, dict[tuple[str, str], list[float]]] = {}
    names: dict[tuple[str, str], int] = {}
    for line, row in read_table(path, _COLUMNS):
        camera, name = row["camera"], (row["frame"], row["point"])
        if camera not in sizes_wh:
            raise FileFormatError(
                f"{path}, line {line}: the rig has no camera {camera!r}; it has "
                f"{', '.join(sizes_wh)}"
            )
        place = [float_cell(row, key, path, line) for key in ("x", "y")]
        if not all(map(math.isfinite, place)):
            raise FileFormatError(f"{path}, line {line}: x and y must be finite numbers")
        width, height = sizes_wh[camera]
        if not (-0.5 <= place[0] <= width - 0.5 and -0.5 <= place[1] <= height - 0.5):
            raise FileFormatError(
                f"{path}, line {line}: ({place[0]:g}, {place[1]:g}) lies outside the pictures of "
                f"{camera}, which have {width}x{height} pixels"
            )
        own = rows.setdefault(camera, {})
        if name in own:
            raise FileFormatError(
                f"{path}, line {line}: point {name[1]} of frame {name[0]} stands twice for camera "
                f"{camera}; remove one"
            )
        own[name] = place + covariance_cells(row, path, line)
        names.setdefault(name, len(names))
    tables = {camera: np.full((len(names), 5), np.nan) for camera in rows}
    for camera, own in rows.items():
        tables[camera][[names[name] for name in own]] = list(own.values())
    return ImagePoints(
        names=tuple(names),
        pixels={camera: table[:, :2] for camera, table in tables.items()},
        cov_px2={
            camera: table[:, [2, 3, 3, 4]].reshape(-1, 2, 2) for camera, table in tables.items()
        },
    )
