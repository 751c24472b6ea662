"""Corner files of mrcal: a vnlog of ``filename x y level``, one row per corner.

The corners of a picture stand row by row, as on our boards, beginning at the upper left of the
picture (mrgingham). So which corner comes first depends on how the cameras are held; on a board
that looks the same after a turn the rig decides it later.
"""

import math
import os.path
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import FileFormatError, RecordingError
from calichrome.imaging.recording_names import read_names
from calichrome.observations.board_view import BoardView
from calichrome.observations.dataset import Dataset

__all__ = ["read_vnl"]

_MAX_BYTES = 1_000_000_000
_SEEN = 1e-12  # weights at or below are mrcal's "ignore"
Sizes = Mapping[str, tuple[int, int]]


def read_vnl(path: Path, sizes_wh: Sizes, n_corners: int, *, pattern: str | None = None) -> Dataset:
    """Read mrcal's corners.vnl.

    Parameters
    ----------
    path
        The columns filename, x, y, and level or weight, if there is one; "-" where a corner was
        not seen. A picture without a board has one such row.
    sizes_wh
        Picture sizes of the cameras, pixels.
    n_corners
        Number of corners of the target.
    pattern
        How the file names are built, see `NamePattern`; None: the layout is recognised.

    Returns
    -------
    Dataset
        Covariances follow the levels (noise doubles with each) or weights (its inverse), with 1 px
        for level 0 and weight 1: only their ratios are known. Without other levels there are none.

    Raises
    ------
    FileFormatError
        Naming the line or the picture.

    References
    ----------
    .. [1] D. Kogan, mrcal, "compute_chessboard_corners", and mrgingham(1).
    """
    pictures = _read_rows(path)
    names = list(pictures)
    views: dict[str, dict[str, BoardView]] = {}
    for name, camera, frame in _cameras_and_frames(path, names, sizes_wh, pattern):
        rows = np.array(pictures[name])
        if len(rows) == 1 and np.isnan(rows).any() and n_corners > 1:
            continue
        if len(rows) != n_corners:
            raise FileFormatError(
                f"{path}: {name} has {len(rows)} corners, the target has {n_corners}; correct "
                f"--target"
            )
        if camera not in sizes_wh:
            raise FileFormatError(
                f"{path}: the picture size of camera {camera} is unknown; give the recording or "
                f"--size {camera}=WIDTHxHEIGHT"
            )
        views.setdefault(camera, {})[frame] = _view(rows)
    return Dataset(sizes_wh={camera: sizes_wh[camera] for camera in views}, views=views)


def _view(rows: FloatArray) -> BoardView:
    seen = np.flatnonzero(np.isfinite(rows).all(axis=1))
    sigma = rows[seen, 2]
    return BoardView(
        corner_ids=seen,
        corners_px=rows[seen, :2],
        cov_px=None if (sigma == 1).all() else sigma[:, None, None] ** 2 * np.eye(2),
    )


def _read_rows(path: Path) -> dict[str, list[list[float]]]:
    """Return for each picture its rows of x, y, sigma; nan where not seen."""
    pictures: dict[str, list[list[float]]] = {}
    columns: list[str] | None = None
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{path}: is larger than 1 GB, which no such file is")
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read as text ({error})") from error
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if columns is None and text.startswith("#") and text[1:2] not in ("#", "!"):
            columns = _checked_columns(path, text[1:].split())
        text = text.partition("#")[0].strip()
        if not text:
            continue
        if columns is None:
            raise FileFormatError(f"{path}: lacks its first line, like # filename x y level")
        cells = text.split()
        # mrgingham writes "filename - -" in tables of four columns
        cells += ["-"] * (len(columns) - len(cells) if len(cells) >= 3 else 0)
        if len(cells) != len(columns):
            raise FileFormatError(f"{path}, line {number}: wrong number of cells")
        row = dict(zip(columns, cells, strict=True))
        pictures.setdefault(row["filename"], []).append(_numbers(row, path, number))
    return pictures


def _checked_columns(path: Path, columns: list[str]) -> list[str]:
    missing = [name for name in ("filename", "x", "y") if name not in columns]
    if missing or len(set(columns)) != len(columns):
        raise FileFormatError(
            f"{path}: has the columns {' '.join(columns) or '(none)'}; wanted are filename x y, "
            f"and level or weight"
        )
    return columns


def _numbers(row: Mapping[str, str], path: Path, line: int) -> list[float]:
    unseen = [math.nan] * 3
    kind = next((name for name in ("level", "weight") if name in row), None)
    cells = [row["x"], row["y"]] + ([row[kind]] if kind else [])
    if "-" in cells:
        return unseen
    try:
        x, y, *last = map(float, cells)
    except ValueError as error:
        raise FileFormatError(f"{path}, line {line}: {' '.join(cells)} are no numbers") from error
    if not all(map(math.isfinite, (x, y, *last))):
        raise FileFormatError(f"{path}, line {line}: {' '.join(cells)} must be finite")
    if min(x, y) < 0 or (kind == "level" and last[0] < 0) or (kind == "weight" and last[0] < _SEEN):
        return unseen
    if kind == "level" and last[0] > 20:
        raise FileFormatError(f"{path}, line {line}: level {last[0]:g} is no level")
    sigma = 1.0 if kind is None else 2 ** last[0] if kind == "level" else 1 / last[0]
    return [x, y, sigma]


def _cameras_and_frames(
    path: Path, names: Sequence[str], sizes_wh: Sizes, pattern: str | None
) -> list[tuple[str, str, str]]:
    """Return (name, camera, frame) of every picture whose name can be read."""
    if not names:
        return []
    beside = path.parent.absolute()
    places = {Path(os.path.normpath(beside / name)): name for name in names}
    folder = Path(os.path.commonpath([place.parent for place in places]))
    if folder.name in sizes_wh and pattern is None:
        folder = folder.parent  # all pictures of one camera, which has a name
    try:
        files, _ = read_names(folder, list(places), pattern)
    except RecordingError as error:
        raise FileFormatError(f"{path}: {error}") from error
    return [
        (places[place], camera, frame)
        for camera, frames in files.items()
        for frame, place in frames.items()
    ]
