"""Pictures that show what a correction did."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, UInt8Array

__all__ = ["before_after_sheet", "crop_around", "picture_grid", "rectified_sheet"]

_TILE = 300  # px, side of one tile
_BAND = 26  # px, height of a caption
_GAP = 6
_PAPER, _INK = (250, 250, 248), (40, 40, 40)


def crop_around(picture: UInt8Array, points_px: FloatArray, margin: float = 0.16) -> UInt8Array:
    """Cut a square around some points out of a picture; outside is grey.

    Parameters
    ----------
    picture : (H, W, 3) uint8
    points_px : (N, 2) float
    margin
        Of the extent of the points, on every side.
    """
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    half = (0.5 + margin) * float((high - low).max())
    left, top = np.floor((low + high) / 2 - half).astype(int)
    side = int(np.ceil(2 * half))
    padded = cv2.copyMakeBorder(
        picture, side, side, side, side, cv2.BORDER_CONSTANT, value=(128, 128, 128)
    )
    return np.asarray(padded[top + side : top + 2 * side, left + side : left + 2 * side])


def before_after_sheet(
    columns: Sequence[tuple[str, UInt8Array, UInt8Array]],
    rows: tuple[str, str] = ("before: as recorded", "after: corrected"),
) -> UInt8Array:
    """Put the same thing, seen by several cameras, before and after correction on one sheet.

    Parameters
    ----------
    columns
        (caption, before, after) of each camera; pictures (h, w, 3) uint8, sRGB.
    rows
        Captions of the two rows.
    """
    bands = []
    for row, caption in enumerate(rows):
        tiles = [_tile((before, after)[row]) for _, before, after in columns]
        captions = [_caption(column[0], _TILE) for column in columns]
        title = _caption(caption, _width(len(columns)), bold=True)
        bands += [title, _beside(captions), _beside(tiles)]
    return np.concatenate(bands)


def picture_grid(tiles: Sequence[tuple[str, UInt8Array]], n_columns: int) -> UInt8Array:
    """Put captioned pictures (h, w, 3), uint8, on one sheet, row by row."""
    blank = np.full((_TILE, _TILE, 3), _PAPER, dtype=np.uint8)
    padding = [("", blank)] * (-len(tiles) % n_columns)
    every = [*tiles, *padding]
    rows = [every[start : start + n_columns] for start in range(0, len(every), n_columns)]
    bands = []
    for row in rows:
        pictures = [_tile(picture) for _, picture in row]
        height = max(round(_TILE * p.shape[0] / max(p.shape[:2])) for _, p in row)
        captions = [_caption(name, _TILE) for name, _ in row]
        bands += [_beside(captions), _beside([picture[:height] for picture in pictures])]
    return np.concatenate(bands)


def rectified_sheet(
    first: tuple[str, UInt8Array],
    second: tuple[str, UInt8Array],
    *,
    vertical: bool,
    n_lines: int = 16,
) -> UInt8Array:
    """Put a rectified pair together with lines along which points correspond.

    Parameters
    ----------
    first, second
        Caption and picture of each camera, of one size.
    vertical
        True if columns correspond.
    n_lines
        Number of lines.
    """
    axis = 0 if vertical else 1
    pictures = [np.concatenate([_caption(name, p.shape[1]), p]) for name, p in (first, second)]
    sheet: NDArray[np.uint8] = np.ascontiguousarray(np.concatenate(pictures, axis=axis))
    height, width = sheet.shape[:2]
    length = width if vertical else height - _BAND
    for index in range(1, n_lines):
        at = round(index * length / n_lines)
        start, end = ((at, 0), (at, height)) if vertical else ((0, at + _BAND), (width, at + _BAND))
        cv2.line(sheet, start, end, (230, 60, 40), 1, cv2.LINE_AA)
    return sheet


def _tile(picture: UInt8Array) -> UInt8Array:
    scale = _TILE / max(picture.shape[:2])
    size_wh = round(picture.shape[1] * scale), round(picture.shape[0] * scale)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    canvas = np.full((_TILE, _TILE, 3), _PAPER, dtype=np.uint8)
    canvas[: size_wh[1], : size_wh[0]] = cv2.resize(picture, size_wh, interpolation=how)
    return canvas


def _width(n_tiles: int) -> int:
    return n_tiles * _TILE + (n_tiles - 1) * _GAP


def _beside(tiles: Sequence[UInt8Array]) -> UInt8Array:
    gap = np.full((tiles[0].shape[0], _GAP, 3), _PAPER, dtype=np.uint8)
    parts = [part for tile in tiles for part in (tile, gap)]
    return np.concatenate(parts[:-1], axis=1)


def _caption(text: str, width: int, *, bold: bool = False) -> UInt8Array:
    band = np.full((_BAND, width, 3), _PAPER, dtype=np.uint8)
    cv2.putText(
        band, text, (6, _BAND - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1 + bold, cv2.LINE_AA
    )
    return band
