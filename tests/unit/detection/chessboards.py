"""Chessboards drawn from where their points are, for tests that need no camera."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray

Plane = NDArray[np.float32]

SIZE_WH = (640, 480)
_SAMPLES = 2  # per pixel and axis
_DARK, _BRIGHT, _AROUND = 40.0, 210.0, 120.0


def view(
    *, tilt_deg: float = 0, roll_deg: float = 0, square_px: float = 36, k1: float = 0
) -> Callable[[FloatArray], FloatArray]:
    """Map pixels (N, 2) to squares of a board whose middle is seen in the middle."""
    focal = float(SIZE_WH[0])
    tilt, roll = np.deg2rad([tilt_deg, roll_deg])
    turn = np.array(
        [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]
    ) @ np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    distance = focal / square_px
    plane = np.stack([turn[:, 0], turn[:, 1], [0, 0, distance]], axis=1)

    from_plane = np.linalg.inv(plane)

    def to_board(pixels: FloatArray) -> FloatArray:
        seen = (pixels - (np.array(SIZE_WH) - 1) / 2) / focal
        ideal = seen.copy()
        for _ in range(30 if k1 else 0):  # invert x (1 + k1 r^2)
            ideal = seen / (1 + k1 * (ideal**2).sum(axis=1, keepdims=True))
        board = ideal @ from_plane[:, :2].T + from_plane[:, 2]
        return np.asarray(board[:, :2] / board[:, 2:])

    return to_board


def draw(
    to_board: Callable[[FloatArray], FloatArray],
    *,
    corners_xy: tuple[int, int] = (8, 6),
    blur_px: float = 0.8,
    disc: float = 0.0,
) -> Plane:
    """Draw a board of corners_xy inner corners; corner (0, 0) and its square towards (+, +).

    Corner (ix, iy) is at (ix - (nx - 1) / 2, iy - (ny - 1) / 2); the square beyond (0, 0) is black.
    Discs of `disc` squares have the level between dark and bright.
    """
    width, height = SIZE_WH
    step = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    x = (np.arange(width)[:, None] + step).ravel()
    y = (np.arange(height)[:, None] + step).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    place = to_board(pixels) + (np.array(corners_xy) - 1) / 2
    square = np.floor(place)
    levels = np.where(square.sum(axis=1) % 2 == 0, _DARK, _BRIGHT)
    if disc:
        inside = np.linalg.norm(place - square - 0.5, axis=1) < disc / 2
        levels = np.where(inside, (_DARK + _BRIGHT) / 2, levels)
    margin = np.maximum(-place, place - (np.array(corners_xy) - 1)).max(axis=1)
    levels = np.where(margin > 1, _BRIGHT, levels)
    levels = np.where(margin > 2, _AROUND, levels)
    shape = height, _SAMPLES, width, _SAMPLES
    picture = levels.reshape(shape).mean(axis=(1, 3)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px), dtype=np.float32)


def noisy(picture: Plane, sigma: float, rng: np.random.Generator) -> Plane:
    """Add noise, round to 8 bit."""
    noise = rng.normal(0, sigma, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.float32)
