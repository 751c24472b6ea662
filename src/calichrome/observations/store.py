"""Observations as NAME.csv, NAME.markers.csv and NAME.rejected.csv (docs/file-format.md)."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.files import refuse_existing
from calichrome.errors import FileFormatError
from calichrome.observations.board_view import BoardView, DiscSamples
from calichrome.observations.dataset import Dataset
from calichrome.observations.table import (
    covariance_cells,
    float_cell,
    integer_cell,
    read_table,
    write_table,
)
from calichrome.observations.vnl import read_vnl

__all__ = ["read_corners", "write_observations"]

_CORNERS = ("camera", "frame", "corner", "x", "y", "sxx", "sxy", "syy")
_MARKERS = (
    *("camera", "frame", "marker", "x", "y", "r", "g", "b"),
    *("rr", "rg", "rb", "gg", "gb", "bb", "n_px", "clipped"),
    *("white_r", "white_g", "white_b", "black_r", "black_g", "black_b"),
)


def write_observations(
    dataset: Dataset, rejected: Sequence[tuple[str, str, str]], path: Path, *, force: bool = False
) -> None:
    """Write the three files beside each other; `path` is NAME.csv.

    Parameters
    ----------
    dataset
        The views.
    rejected
        (camera, frame, reason) of every picture without a view.
    path
        The corner file.
    force
        Replace existing files.
    """
    beside = {kind: path.with_suffix(f".{kind}.csv") for kind in ("markers", "rejected")}
    for name in (path, *beside.values()):
        refuse_existing(name, force=force)
    write_table(path, _CORNERS, _corner_rows(dataset), force=force)
    write_table(beside["markers"], _MARKERS, _marker_rows(dataset), force=force)
    write_table(beside["rejected"], ("camera", "frame", "reason"), rejected, force=force)


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.8g}"


def _corner_rows(dataset: Dataset) -> Iterator[list[object]]:
    for camera, views in dataset.views.items():
        for frame, view in views.items():
            for index, corner in enumerate(view.corner_ids):
                cov = ["", "", ""]
                if view.cov_px is not None:
                    cov = [_number(view.cov_px[index][at]) for at in ((0, 0), (0, 1), (1, 1))]
                x, y = view.corners_px[index]
                yield [camera, frame, int(corner), f"{x:.6f}", f"{y:.6f}", *cov]


def _marker_rows(dataset: Dataset) -> Iterator[list[object]]:
    upper = np.triu_indices(3)
    for camera, views in dataset.views.items():
        for frame, view in views.items():
            for index in range(0 if view.discs is None else len(view.discs)):
                discs = view.discs
                assert discs is not None  # noqa: S101 (the range above is empty otherwise)
                values = [
                    *discs.centres_px[index],
                    *discs.mean_rgb[index],
                    *(discs.cov_rgb[index][upper] / max(int(discs.n_px[index]), 1)),
                ]
                levels = [*discs.white_rgb[index], *discs.black_rgb[index]]
                yield [
                    camera, frame, int(discs.marker_ids[index]), *map(_number, values),
                    int(discs.n_px[index]), _number(discs.clipped[index]), *map(_number, levels),
                ]  # fmt: skip


def read_corners(
    path: Path,
    sizes_wh: Mapping[str, tuple[int, int]],
    n_corners: int,
    *,
    pattern: str | None = None,
) -> Dataset:
    """Read NAME.csv and, if it is there, NAME.markers.csv; or mrcal's NAME.vnl.

    Parameters
    ----------
    path
        The corner file; the columns sxx, sxy, syy may be absent, empty, or one column ``sigma``.
    sizes_wh
        Picture sizes of the cameras, pixels.
    n_corners
        Number of inner corners of the target.
    pattern
        How file names in a .vnl are built; see `NamePattern`.

    Raises
    ------
    FileFormatError
        Naming the line and the column.
    """
    if path.suffix.lower() == ".vnl":
        return read_vnl(path, sizes_wh, n_corners, pattern=pattern)
    corners: dict[tuple[str, str], list[tuple[int, list[float]]]] = defaultdict(list)
    for line, row in read_table(path, _CORNERS[:5]):
        corner = integer_cell(row, "corner", path, line)
        if not 0 <= corner < n_corners:
            raise FileFormatError(
                f"{path}, line {line}: corner {corner}, but the target has corners 0 to "
                f"{n_corners - 1}; check --target"
            )
        values = [float_cell(row, key, path, line) for key in ("x", "y")]
        if not all(map(math.isfinite, values)):
            raise FileFormatError(f"{path}, line {line}: x and y must be finite numbers")
        values += covariance_cells(row, path, line)
        corners[row["camera"], row["frame"]].append((corner, values))
    beside = path.with_suffix(".markers.csv")
    discs = _read_markers(beside) if beside.is_file() else {}
    views: dict[str, dict[str, BoardView]] = {}
    for (camera, frame), rows in corners.items():
        if camera not in sizes_wh:
            raise FileFormatError(
                f"{path}: the picture size of camera {camera} is unknown; give the recording or "
                f"--size {camera}=WIDTHxHEIGHT"
            )
        rows.sort(key=lambda row: row[0])
        ids = [corner for corner, _ in rows]
        if len(set(ids)) != len(ids):
            raise FileFormatError(f"{path}: camera {camera}, frame {frame}: a corner stands twice")
        values_xy = np.array([values for _, values in rows])
        cov = values_xy[:, 2:]
        views.setdefault(camera, {})[frame] = BoardView(
            corner_ids=np.array(ids),
            corners_px=values_xy[:, :2],
            cov_px=None if np.isnan(cov).any() else cov[:, [0, 1, 1, 2]].reshape(-1, 2, 2),
            discs=discs.get((camera, frame)),
        )
    return Dataset(sizes_wh={camera: sizes_wh[camera] for camera in views}, views=views)


def _read_markers(path: Path) -> dict[tuple[str, str], DiscSamples]:
    table: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
    for line, row in read_table(path, _MARKERS):
        values = [float_cell(row, key, path, line) for key in _MARKERS[2:]]
        for key in ("marker", "n_px"):
            integer_cell(row, key, path, line)
        if not all(map(math.isfinite, values[1:3])):
            raise FileFormatError(f"{path}, line {line}: x and y must be finite numbers")
        table[row["camera"], row["frame"]].append(values)
    return {key: _samples(np.array(rows)) for key, rows in table.items()}


def _samples(rows: FloatArray) -> DiscSamples:
    upper = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    n_px = rows[:, 12].astype(np.int64)
    return DiscSamples(
        marker_ids=rows[:, 0].astype(np.int64),
        centres_px=rows[:, 1:3],
        mean_rgb=rows[:, 3:6],
        median_rgb=rows[:, 3:6],
        cov_rgb=rows[:, 6:12][:, upper] * n_px[:, None, None],
        n_px=n_px,
        clipped=rows[:, 13],
        white_rgb=rows[:, 14:17],
        black_rgb=rows[:, 17:20],
    )
