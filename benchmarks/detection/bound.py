"""What the pixels allow: the Cramer-Rao covariance of every corner, and an oracle that attains it.

The bound is that of the plain board: pixels of the cell that reaches half a square from the corner
on all sides; unknown are the corner's position, the directions of both edges, gain and offset.
Noise is the scene's, before rounding to 8 bit (rounding adds 1/12 DN^2: at most 4 % of the
standard deviation, at 1 DN), so that no estimator gains by it.
"""

from dataclasses import dataclass

import numpy as np
from benchmarks.detection.renderer import Picture, checkers
from benchmarks.detection.scenes import Scene, light_field
from benchmarks.detection.surfaces import BLACK, WHITE

from calichrome.core.arrays import FloatArray, IntArray, UInt8Array

__all__ = ["Cells", "corner_cells", "cramer_rao", "oracle"]

HALF_CELL = 0.5
"""Half width of the cell of a corner, in squares."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Pixels around every corner and how they depend on the unknowns.

    Parameters
    ----------
    pixels : list of (P, 2) int
        Row and column of the pixels of each corner.
    jacobians : list of (P, 6) float
        Derivatives of the picture, DN, by x, y (px), the directions of the two edges (rad), gain
        and offset.
    """

    pixels: list[IntArray]
    jacobians: list[FloatArray]


def corner_cells(scene: Scene) -> Cells:
    """Differentiate the noise-free picture of the plain board around every corner.

    Notes
    -----
    The renderer gives g, the derivative by position. Each edge moves pixels along its own normal
    only, g = a_1 n_1 + a_2 n_2, which splits g between them; turning edge i about the corner
    moves the point at distance t along it by t, so its derivative is t a_i.
    """
    canvas = scene.canvas
    nx, ny = scene.target.squares
    window = canvas.window((-1, nx - 1, -1, ny - 1))
    if window is None:
        raise ValueError("bound: the board lies outside the picture")
    black_first = scene.target.top_left == "black"
    shape = checkers(scene.target.squares, black_first=black_first)
    share, *slopes = canvas.draw(shape, window, derivatives=True)
    contrast = light_field(scene)[window] * np.float32(scene.exposure_dn * (BLACK - WHITE))
    u, v = canvas.plane(window, 0)
    pixels, jacobians = [], []
    for corner_uv, corner_px in zip(scene.corners_uv, scene.corners_px, strict=True):
        box = _box(scene, corner_uv, window)
        inside = (np.abs(u[box] - corner_uv[0]) < HALF_CELL) & (
            np.abs(v[box] - corner_uv[1]) < HALF_CELL
        )
        rows, columns = np.nonzero(inside)
        at = rows + box[0].start, columns + box[1].start
        first = window[0].start, window[1].start
        yx = np.stack([at[0] + first[0], at[1] + first[1]], axis=1)
        offsets = yx[:, ::-1] - corner_px
        scale = contrast[at].astype(np.float64)
        g = np.stack([slopes[0][at], slopes[1][at]], axis=1) * scale[:, None]
        pixels.append(yx)
        jacobians.append(
            np.column_stack(
                [g, _edge_turns(scene, corner_uv, g, offsets), share[at], scale * 0 + 1]
            )
        )
    return Cells(pixels, jacobians)


def cramer_rao(scene: Scene, cells: Cells) -> FloatArray:
    """Return the smallest covariance of the position of every corner, (N, 2, 2), px^2."""
    information = np.stack([jacobian.T @ jacobian for jacobian in cells.jacobians])
    return np.asarray(np.linalg.inv(information)[:, :2, :2] * scene.noise_dn**2)


def oracle(scene: Scene, cells: Cells, clean: Picture, picture: UInt8Array) -> FloatArray:
    """Return the corners of one least-squares step from the truth, (N, 2).

    Parameters
    ----------
    clean, picture : (H, W)
        The plain board without and with noise.
    """
    residual = picture.astype(np.float32) - clean
    steps = [
        np.linalg.lstsq(jacobian, residual[tuple(at.T)].astype(np.float64), rcond=None)[0][:2]
        for at, jacobian in zip(cells.pixels, cells.jacobians, strict=True)
    ]
    return np.asarray(scene.corners_px + np.array(steps))


def _edge_turns(
    scene: Scene, corner_uv: FloatArray, g: FloatArray, offsets: FloatArray
) -> FloatArray:
    """Differentiate by the directions of the lines of constant u and of constant v, (P, 2)."""
    step = 1e-3
    axes = np.array([[step, 0], [-step, 0], [0, step], [0, -step]])
    around = scene.canvas.pixels_of(corner_uv + axes)
    tangents = np.stack([around[0] - around[1], around[2] - around[3]])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    shares = np.linalg.solve(normals.T, g.T).T
    return np.asarray(shares * (offsets @ tangents.T))


def _box(scene: Scene, corner_uv: FloatArray, window: tuple[slice, slice]) -> tuple[slice, slice]:
    """Rows and columns, within the window, that hold the cell of a corner."""
    t = np.linspace(-HALF_CELL, HALF_CELL, 5)
    cell = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    pixels = scene.canvas.pixels_of(corner_uv + cell)
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(pixels.max(axis=0)).astype(int) + 2
    y0, x0 = window[0].start, window[1].start
    return (
        slice(max(int(low[1]) - y0, 0), int(high[1]) - y0),
        slice(max(int(low[0]) - x0, 0), int(high[0]) - x0),
    )
