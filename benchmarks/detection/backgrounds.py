"""What lies around the board: plain walls, and clutter made to mislead detectors."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, UInt8Array

__all__ = ["cluttered", "plain", "tiles"]

Rgb = NDArray[np.float32]
"""(H, W, 3) linear sRGB, 0..1."""

_SHIFT = 4  # bits of sub-pixel position in OpenCV's drawing


def plain(size_wh: tuple[int, int], rng: np.random.Generator) -> Rgb:
    """Return a wall of one colour with a gentle gradient."""
    width, height = size_wh
    colour = rng.uniform(0.1, 0.6) * rng.uniform(0.8, 1.2, 3)
    x, y = np.linspace(-0.5, 0.5, width), np.linspace(-0.5, 0.5, height)[:, None]
    slope = rng.uniform(-0.3, 0.3, 2)
    shade = 1 + slope[0] * x + slope[1] * y
    return np.asarray(shade[..., None] * colour, dtype=np.float32)


def cluttered(size_wh: tuple[int, int], psf_sigma_px: float, rng: np.random.Generator) -> Rgb:
    """Return texture with lines, polygons, framed rectangles and small pieces of checkers."""
    width = size_wh[0]
    canvas = _texture(size_wh, rng)
    scale = width / 1280
    for _ in range(rng.integers(10, 30)):
        _polygon(canvas, rng.uniform(0, 1, 2) * size_wh, rng.uniform(20, 160) * scale, rng)
    for _ in range(rng.integers(10, 40)):
        ends = (rng.uniform(-0.1, 1.1, (2, 2)) * size_wh * 2**_SHIFT).astype(int)
        thickness = int(rng.integers(1, 2 + int(6 * scale)))
        first, last = (tuple(map(int, end)) for end in ends)
        cv2.line(canvas, first, last, _colour(rng), thickness, cv2.LINE_AA, _SHIFT)
    for _ in range(rng.integers(3, 8)):
        _framed(canvas, rng.uniform(0, 1, 2) * size_wh, rng.uniform(40, 200) * scale, rng)
    for _ in range(rng.integers(2, 6)):
        piece = int(rng.integers(2, 5)), int(rng.integers(2, 5))
        tiles(canvas, rng.uniform(0, 1, 2) * size_wh, rng.uniform(8, 40) * scale, piece, rng)
    linear = (canvas.astype(np.float32) / 255) ** 2
    return np.asarray(cv2.GaussianBlur(linear, (0, 0), psf_sigma_px), dtype=np.float32)


def tiles(
    canvas: UInt8Array,
    centre: FloatArray,
    side_px: float,
    squares: tuple[int, int],
    rng: np.random.Generator,
) -> None:
    """Paint a turned and sheared piece of checkers of two colours, in place."""
    turn = rng.uniform(0, np.pi)
    axes = side_px * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    axes[1] *= rng.uniform(0.5, 1)
    colours = _colour(rng), _colour(rng)
    for iy in range(squares[1]):
        for ix in range(squares[0]):
            cell = np.array([[ix, iy], [ix + 1, iy], [ix + 1, iy + 1], [ix, iy + 1]]) - (
                np.array(squares) / 2
            )
            _fill(canvas, centre + cell @ axes, colours[(ix + iy) % 2])


def _texture(size_wh: tuple[int, int], rng: np.random.Generator) -> UInt8Array:
    """Noise of several scales around a mean colour."""
    width, height = size_wh
    total = np.zeros((height, width, 3), dtype=np.float32)
    for cells, strongest in ((6, 25), (24, 25), (96, 15), (384, 8)):
        coarse = rng.normal(0, 1, (cells, cells, 3)).astype(np.float32)
        coarse = 0.7 * coarse.mean(axis=2, keepdims=True) * np.sqrt(3) + 0.3 * coarse
        total += cv2.resize(coarse, size_wh, interpolation=cv2.INTER_CUBIC) * rng.uniform(
            1, strongest
        )
    texture: UInt8Array = np.clip(rng.uniform(60, 170) + total, 5, 250).astype(np.uint8)
    return texture


def _polygon(
    canvas: UInt8Array, centre: FloatArray, radius: float, rng: np.random.Generator
) -> None:
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
    radii = radius * rng.uniform(0.3, 1, len(angles))
    spokes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    _fill(canvas, centre + radii[:, None] * spokes, _colour(rng))


def _framed(canvas: UInt8Array, centre: FloatArray, half: float, rng: np.random.Generator) -> None:
    turn = rng.uniform(0, np.pi)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    rim = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [half, half * rng.uniform(0.4, 1)]
    _fill(canvas, centre + rim @ axes, _colour(rng))
    _fill(canvas, centre + rng.uniform(0.5, 0.95) * rim @ axes, _colour(rng))


def _fill(canvas: UInt8Array, points: FloatArray, colour: tuple[int, ...]) -> None:
    fixed = np.round(points * 2**_SHIFT).astype(np.int32)
    cv2.fillPoly(canvas, [fixed], colour, cv2.LINE_AA, _SHIFT)


def _colour(rng: np.random.Generator) -> tuple[int, ...]:
    """Return greys and colours, dark and bright, as square roots of linear values."""
    base = rng.uniform(20, 245)
    return tuple(int(v) for v in np.clip(base * rng.uniform(0.8, 1.2, 3), 0, 255))
