"""Which pixels tell where a corner is: those beside its two edges, clear of discs."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import BoardMap, EdgeBend

__all__ = ["CornerPixels", "Discs", "DiscsInPicture", "clear_of_discs", "pixels_along_edges"]

_CLEARANCES = 2.5 * 0.6 ** np.arange(5)
"""Distances from a disc that pixels keep, in sigmas of the blur, tried in this order until enough
pixels are left: at 2.5 sigma a disc's edge still adds 0.6 % of its step."""
_ENOUGH_PIXELS = 24


@dataclass(frozen=True, slots=True, eq=False)
class CornerPixels:
    """Pixels of N corners, sorted by corner.

    Parameters
    ----------
    corner : (P,) int
    column, row : (P,) int
    """

    corner: IntArray
    column: IntArray
    row: IntArray

    def __len__(self) -> int:
        return len(self.corner)

    @property
    def points(self) -> FloatArray:
        """Centres (P, 2) as (x, y)."""
        return np.stack([self.column, self.row], axis=1).astype(np.float64)

    def only(self, chosen: BoolArray) -> "CornerPixels":
        """Return the chosen ones."""
        return CornerPixels(self.corner[chosen], self.column[chosen], self.row[chosen])

    def ranges(self, n_corners: int) -> IntArray:
        """Return where each corner's pixels begin and end, (N + 1,)."""
        return np.asarray(np.searchsorted(self.corner, np.arange(n_corners + 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Discs:
    """Discs of the board.

    Parameters
    ----------
    radius : (squares_y, squares_x, 2) float
        Half axes along x and y in squares, 0 where a square holds no disc. Square [iy, ix] lies up
        and left of corner (ix, iy).
    """

    radius: FloatArray

    def on(self, board_map: BoardMap) -> "DiscsInPicture":
        """Place the discs in a picture."""
        rows, columns = np.indices(self.radius.shape[:2])
        centres = np.asarray(np.stack([columns, rows], axis=-1) - 0.5, dtype=np.float64)
        to_disc = np.linalg.inv(board_map.jacobian(centres))
        with np.errstate(divide="ignore", invalid="ignore"):
            to_disc /= self.radius[..., None]
        return DiscsInPicture(board_map(centres), np.asarray(to_disc), self.radius[..., 0] > 0)


@dataclass(frozen=True, slots=True, eq=False)
class DiscsInPicture:
    """Ellipses of the discs: ``|to_disc (x - centre)| <= 1`` inside; indexed like `Discs`."""

    centres_px: FloatArray
    to_disc: FloatArray
    present: BoolArray

    def distance_px(self, points: FloatArray, squares: IntArray) -> FloatArray:
        """Distance (P,) of points from the rim of the disc in their square, negative inside.

        Measured along the ray from the centre; inf where the square holds no disc.
        """
        iy, ix = squares[:, 1], squares[:, 0]
        distance = np.full(len(points), np.inf)
        held = np.flatnonzero(self.present[iy, ix])
        away = points[held] - self.centres_px[iy[held], ix[held]]
        unit = np.einsum("nij,nj->ni", self.to_disc[iy[held], ix[held]], away)
        radii = np.maximum(np.hypot(*unit.T), 1e-9)
        distance[held] = np.hypot(*away.T) * (1 - 1 / radii)
        return distance


def pixels_along_edges(
    positions_px: FloatArray,
    edges: EdgeBend,
    reach: FloatArray,
    band_px: float,
    size_wh: tuple[int, int],
) -> CornerPixels:
    """List the pixels within `band_px` of the two edges of each corner, each once.

    Parameters
    ----------
    positions_px : (N, 2) float
    edges
        Of the N corners.
    reach : (N,) float
        How far along the edges, in squares to either side.
    """
    count = len(positions_px)
    # Segment 2 n is the edge along j of corner n, segment 2 n + 1 the edge along i.
    run = np.stack([edges.along_j, edges.along_i], axis=1).reshape(-1, 2)
    length = np.linalg.norm(run, axis=1)
    tangent = run / length[:, None]
    half_length = length * np.repeat(reach, 2)
    beyond = np.stack([edges.along_i, edges.along_j], axis=1).reshape(-1, 2)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    side = np.sign((normal * beyond).sum(axis=1))
    normal, curvature = normal * side[:, None], edges.curvature.reshape(-1)
    middle = np.repeat(positions_px, 2, axis=0)

    # Lines of pixels across the edge: one per step along the axis that the edge follows more.
    segments = np.arange(2 * count)
    major = np.abs(tangent).argmax(axis=1)
    minor = 1 - major
    along, across = tangent[segments, major], tangent[segments, minor]
    extent = half_length * np.abs(along)
    limit = np.array(size_wh)[major] - 1.0
    at = middle[segments, major]
    first = np.ceil(np.clip(at - extent, 0, limit)).astype(np.int64)
    last = np.floor(np.clip(at + extent, -1, limit)).astype(np.int64)
    lines = np.maximum(last - first + 1, 0)
    segment = np.repeat(segments, lines)
    begin = np.cumsum(lines) - lines
    line = np.arange(len(segment)) - begin[segment] + first[segment]
    offset = (line - middle[segment, major[segment]]) / along[segment]  # px along the edge
    bend = 0.5 * curvature[segment] * offset**2 / normal[segment, minor[segment]]
    centre = middle[segment, minor[segment]] + across[segment] * offset + bend
    across_px = band_px / np.abs(normal[segment, minor[segment]])
    width_px = np.array(size_wh)[minor[segment]]
    low = np.ceil(np.clip(centre - across_px, 0, width_px)).astype(np.int64)
    high = np.floor(np.clip(centre + across_px, -1, width_px - 1)).astype(np.int64)
    widths = np.maximum(high - low + 1, 0)
    of_line = np.repeat(np.arange(len(line)), widths)
    minor_at = np.arange(len(of_line)) - (np.cumsum(widths) - widths - low)[of_line]
    major_at, segment = line[of_line], segment[of_line]
    upright = major[segment] == 1
    column = np.where(upright, minor_at, major_at)
    row = np.where(upright, major_at, minor_at)

    corner = segment // 2
    # Pixels near both edges are listed with the first.
    n1 = normal[0::2]
    to_first = (column - positions_px[corner, 0]) * n1[corner, 0]
    to_first += (row - positions_px[corner, 1]) * n1[corner, 1]
    keep = (segment % 2 == 0) | (np.abs(to_first) > band_px)
    return CornerPixels(corner[keep], column[keep], row[keep])


def clear_of_discs(
    pixels: CornerPixels,
    positions_px: FloatArray,
    edges: EdgeBend,
    indices: IntArray,
    discs: DiscsInPicture,
    blur_px: float,
) -> CornerPixels:
    """Drop the pixels that a disc changes, as far as enough are left of each corner."""
    if not discs.present.any():
        return pixels
    jacobian = np.stack([edges.along_i, edges.along_j], axis=2)
    away = pixels.points - positions_px[pixels.corner]
    squares = np.einsum("nij,nj->ni", np.linalg.inv(jacobian)[pixels.corner], away) > 0
    distance = discs.distance_px(pixels.points, indices[pixels.corner] + squares)
    sigmas = distance / blur_px
    clear = np.stack([sigmas >= clearance for clearance in _CLEARANCES])
    starts = pixels.ranges(len(positions_px))
    totals = np.concatenate([np.zeros((len(clear), 1)), np.cumsum(clear, axis=1)], axis=1)
    counts = np.diff(totals[:, starts], axis=1)
    # The first clearance that leaves enough; the last if none does.
    enough = counts >= _ENOUGH_PIXELS
    enough[-1] = True
    chosen = enough.argmax(axis=0)
    return pixels.only(clear[chosen[pixels.corner], np.arange(len(pixels))])
