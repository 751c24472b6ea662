"""The one entry: a picture in, the board or the reason why not out."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.detection.board_map import BoardMap
from calichrome.detection.corner_pixels import Discs
from calichrome.detection.discs import BoardToPixels, measure_discs
from calichrome.detection.fiducials import detect_coded_board
from calichrome.detection.grid import Lattice, find_lattices
from calichrome.detection.identity import Placement, identify
from calichrome.detection.levels import best_mix, readings_of
from calichrome.detection.reasons import why_no_board
from calichrome.detection.refinement import RefinedCorners, refine_corners
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.target import CodedTarget, Target

__all__ = ["detect_board"]

_MIN_SPACING_PX = 6.0
"""Below this a corner's blur reaches half way to its neighbours, and what is fitted is not one
corner."""

_BY_FAR = 2.0  # times the other's squares
_SPARSE = 2  # corners of a row that may be none


def detect_board(image: Image, target: Target) -> BoardView | NotFound:
    """Find the board, or the part of it that is seen, in one picture.

    Parameters
    ----------
    image
        Grey or colour, encoded or linear.
    target
        The board to look for. Only one with discs can be told from a part of it.

    Returns
    -------
    BoardView
        Corners with ids and covariances; discs where the target has them and the picture is in
        colour.
    NotFound
        With a reason that a person at the camera can act on.
    """
    if isinstance(target, CodedTarget):
        return detect_coded_board(image, target)
    reason = ""
    for tones in _tones(image):
        placed = _place(image, tones, target)
        if not isinstance(placed, str):
            return _measure(image, target, placed)
        reason = reason or placed
    return NotFound(reason)


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """A lattice that is the target; `spacing_px` is the median side of its squares."""

    lattice: Lattice
    placement: Placement
    spacing_px: float


def _tones(image: Image) -> Iterator[NDArray[np.float32]]:
    """Yield the picture in grey, and if that is not enough the channel of most contrast.

    Under coloured light black and white may differ in one channel alone.
    """
    yield image.grey()
    if image.is_colour:
        step = max(1, min(image.size_wh) // 300)
        sample = image.pixels[::step, ::step].reshape(-1, 3)
        contrast = np.ptp(np.quantile(sample, [0.02, 0.98], axis=0), axis=0)
        channel = np.ascontiguousarray(image.pixels[..., int(contrast.argmax())])
        yield replace(image, pixels=channel).grey()


def _place(image: Image, tones: NDArray[np.float32], target: Target) -> _Placed | str:
    """Find the lattice that is the target, or say why there is none."""
    lattices = find_lattices(tones)
    if not lattices:
        return why_no_board(image, tones, target)
    placed: list[_Placed] = []
    reason = ""
    for found in lattices:
        lattice = _without_rim(found, target)
        indices, to_pixels = lattice.indices.astype(np.float64), lattice.board_map
        spacing = float(np.median(np.linalg.norm(to_pixels.jacobian(indices), axis=1)))
        if spacing < _MIN_SPACING_PX:
            small = f"squares of {spacing:.0f} px are too small to measure; bring the board nearer"
            reason = reason or small
            continue
        placement = identify(image, lattice, to_pixels, target)
        if isinstance(placement, str):
            reason = reason or placement
        else:
            placed.append(_Placed(lattice, placement, spacing))
    return _only_one(placed) if placed else reason


def _without_rim(lattice: Lattice, target: Target) -> Lattice:
    """Drop rows of one or two corners at the rim of a lattice that is larger than the target.

    What a hand or the surroundings make of the rim of the board now and then looks like a corner.
    """
    most = np.sort(target.corners_xy)
    while (np.sort(lattice.indices.max(axis=0) + 1) > most).any():
        extent = lattice.indices.max(axis=0)
        too_long = np.flatnonzero(extent >= most[1])
        if not len(too_long):  # either may be the long side
            too_long = np.flatnonzero(extent >= most[0])
        rims = [lattice.indices[:, axis] == end for axis in too_long for end in (0, extent[axis])]
        sparse = min(rims, key=np.count_nonzero)
        if np.count_nonzero(sparse) > _SPARSE:
            break
        lattice = lattice.only(~sparse)
    return lattice


def _only_one(placed: list[_Placed]) -> _Placed | str:
    """Take the board that is by far the nearest; the others are on screens, posters, in mirrors."""
    first, *others = sorted(placed, key=lambda one: one.spacing_px, reverse=True)
    for other in others:
        same = np.isin(other.placement.corner_ids, first.placement.corner_ids).any()
        if same and first.spacing_px < _BY_FAR * other.spacing_px:
            return "two boards are in the picture; show one at a time, or cover the other"
    return first


def _measure(image: Image, target: Target, placed: _Placed) -> BoardView:
    """Refine the corners and measure the discs."""
    order = np.argsort(placed.placement.corner_ids)
    corner_ids = placed.placement.corner_ids[order]
    start_px = placed.lattice.corners_px[order]
    nx = target.corners_xy[0]
    indices = np.stack([corner_ids % nx, corner_ids // nx], axis=1)
    lattice = indices.astype(np.float64)
    board_map = BoardMap.fit(lattice, start_px, image.size_wh, lens_only=True)
    edges = board_map.edges(lattice)
    white = ~target.black_squares[indices[:, 1] + 1, indices[:, 0] + 1]
    readings = readings_of(image, best_mix(image, start_px, edges, white))
    refined = refine_corners(readings, start_px, indices, white, _discs_of(target), board_map)
    discs = None
    if target.markers and image.is_colour:
        to_pixels = _to_pixels(refined, lattice, target, image.size_wh)
        discs = measure_discs(image, target, to_pixels, corner_ids)
    return BoardView(
        corner_ids=corner_ids,
        corners_px=refined.corners_px,
        cov_px=refined.cov_px,
        cov_scale=refined.disagreement if np.isfinite(refined.disagreement) else 1.0,
        half_turn_ambiguous=placed.placement.half_turn_ambiguous,
        discs=discs,
    )


def _discs_of(target: Target) -> Discs:
    squares_x, squares_y = target.squares
    radius = np.zeros((squares_y, squares_x, 2))
    for marker in target.markers:
        ix, iy = marker.square
        radius[iy, ix] = 0.5 * marker.diameter_m / np.array(target.square_m)
    return Discs(radius)


def _to_pixels(
    refined: RefinedCorners, lattice: FloatArray, target: Target, size_wh: tuple[int, int]
) -> BoardToPixels:
    """Map board points (N, 3) in metres to pixels."""
    board_map = BoardMap.fit(lattice, refined.corners_px, size_wh, refined.cov_px)
    side = np.array(target.square_m)

    def to_pixels(points_board: FloatArray) -> FloatArray:
        return board_map(points_board[:, :2] / side)

    return to_pixels
