"""Where a ColorChecker card is in a picture.

Even squares of one size that lie in a lattice may be its patches; the colours tell which of them
are, and which way up the card is. Up to half of it may be covered.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.detection.card import CardReading, is_convex, measure_card
from calichrome.imaging import Image
from calichrome.observations import NotFound
from calichrome.target import colour_checker_palette

__all__ = ["find_card"]

_SIDES_PX = (1000, 2000)  # longest sides at which a picture is searched: large cards, then small
_EDGES = (15, 8, 30)
"""Steps between neighbouring pixels, of 255, that bound a patch: noise makes smaller ones, and dark
patches on a dark frame have no larger ones. """
_LEAST_AREA_PX = 36  # of a square, after the size was reduced
_FILLED, _OBLONG = 0.75, 1.8  # share of its rectangle that a patch fills, and that one's sides
_ALIKE = 1.6  # times that the sides of neighbouring patches, and their distances, may differ
_NEAR = 2.2  # sides of a patch to its neighbours: 1.1 to 1.4 straight on
_NEIGHBOURS = 4  # of a patch, the nearest ones: two of them span the lattice
_MOST_LATTICES = 10  # the largest ones, in a picture at one size: a card's is the first or second
_SQUARENESS = 0.6  # sine of the angle of the lattice: 37 degrees from the normal to a corner view
_OFF = 0.15  # pitches that a patch may be off its place: lenses bend the lattice that much
_FEWEST_PATCHES = 8  # of which a lattice is made: twice what a plane-to-plane map needs
_ROUNDS, _SHARP_PX = 5, 0.2  # of reweighting, and the error from which a patch loses weight
_LONG, _SHORT = 6, 4
_HELD = 0.8  # share of the lattice that must lie within the card
_MISMATCH = 0.35
"""Of something that is called a card. For 51 cameras and lights a card has 0.03 to 0.06, with ten
patches covered by a leaf 0.20 at most, cards of 24 other colours (Munsell chips) 0.54 to 0.80."""
_DRAWS = 300  # with half of the patches covered 19 draws are free of them on average
_DIM = 0.02  # reflectance, added to a patch's own: dark ones carry stray light


def find_card(image: Image) -> CardReading | NotFound:
    """Find a ColorChecker card of 24 patches, of any make, and measure it."""
    if not image.is_colour:
        return NotFound("the picture is grey; a card of colours needs a colour picture")
    reference = np.array([colour.xyz_d65 for colour in colour_checker_palette()])
    tones = _tones(image)
    for side, edge in product(_SIDES_PX, _EDGES):
        if side > _SIDES_PX[0] >= max(image.size_wh):
            break  # it cannot be searched any larger
        for lattice in _lattices(tones, side, edge):
            corners = [quad for quad in _placements(lattice) if is_convex(quad)]
            readings = [measure_card(image, quad) for quad in corners]
            mismatches = [_mismatch(reading.rgb, reference) for reading in readings]
            if mismatches and min(mismatches) <= _MISMATCH:
                return readings[int(np.argmin(mismatches))]
    return NotFound(
        "no ColorChecker card of 24 patches in sight; show it larger, whole and facing the "
        "camera, or give the centres of its corner patches"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Lattice:
    """Squares that lie in a lattice.

    Parameters
    ----------
    to_px : (3, 3) float
        From nodes to pixels.
    nodes : (N, 2) int
        Those that hold a square.
    """

    to_px: FloatArray
    nodes: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Squares:
    """Even squares: centres (N, 2) and sides (N,)."""

    centres: FloatArray
    sides: FloatArray


def _tones(image: Image) -> NDArray[np.uint8]:
    """Return the picture as a display shows it, BGR."""
    if image.pixels.dtype == np.uint8 and image.encoding != "linear":
        return np.ascontiguousarray(image.pixels[..., ::-1])
    light = image.linear()
    top = max(float(np.quantile(light, 0.995)), 1e-6)
    shown = encode(np.clip(light / top, 0, 1), "srgb")
    return np.ascontiguousarray(np.rint(255 * shown).astype(np.uint8)[..., ::-1])


def _lattices(tones: NDArray[np.uint8], side_px: int, edge: float) -> Iterator[_Lattice]:
    """Yield lattices, in pixels of the picture, largest first and none that is part of another."""
    factor = min(side_px / max(tones.shape), 1.0)
    reduced = cv2.resize(tones, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    squares = _even_squares(np.asarray(reduced, dtype=np.uint8), edge)
    found = [
        _grown(squares, seed, axes)
        for seed in range(len(squares.centres))
        for axes in _axes(squares, seed)
    ]
    shift = 0.5 / factor - 0.5
    to_full = np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]])
    yielded: list[set[int]] = []
    for to_px, nodes in sorted(found, key=lambda item: -len(item[1])):
        members = set(nodes.values())
        if len(members) < _FEWEST_PATCHES or len(yielded) == _MOST_LATTICES:
            return
        if not any(members <= other for other in yielded):
            yielded.append(members)
            yield _Lattice(to_full @ to_px, np.array(list(nodes)))


def _even_squares(tones: NDArray[np.uint8], edge: float) -> _Squares:
    """Find even areas that are about square."""
    smooth = cv2.medianBlur(tones, 5)
    steps = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).max(axis=2)
    even = np.asarray(steps < edge, dtype=np.uint8)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(even, connectivity=4)
    largest = even.size / (_LONG * _SHORT)
    kept, sides = [], []
    for label in range(1, len(stats)):
        x, y, width, height, area = stats[label]
        if not _LEAST_AREA_PX < area < largest:
            continue
        inside = labels[y : y + height, x : x + width] == label
        rims, _ = cv2.findContours(
            np.asarray(inside, dtype=np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        _, rectangle, _ = cv2.minAreaRect(max(rims, key=len))
        short, long = sorted(length + 1 for length in rectangle)
        if long < _OBLONG * short and area > _FILLED * long * short:
            kept.append(label)
            sides.append(np.sqrt(area))
    return _Squares(centres[kept], np.array(sides))


def _axes(squares: _Squares, seed: int) -> Iterator[FloatArray]:
    """Yield steps (2, 2) to two neighbours of a square, which may span a lattice: right-handed."""
    away = squares.centres - squares.centres[seed]
    distance = np.linalg.norm(away, axis=1)
    side = squares.sides[seed]
    near = (distance > 0) & (distance < _NEAR * side)
    near &= (squares.sides < _ALIKE * side) & (squares.sides > side / _ALIKE)
    nearest = [index for index in np.argsort(distance) if near[index]][:_NEIGHBOURS]
    for j, k in product(nearest, repeat=2):
        turn = away[j, 0] * away[k, 1] - away[j, 1] * away[k, 0]
        alike = max(distance[[j, k]]) < _ALIKE * min(distance[[j, k]])
        if alike and turn > _SQUARENESS * distance[j] * distance[k]:
            yield np.stack([away[j], away[k]], axis=1)


def _grown(
    squares: _Squares, seed: int, axes: FloatArray
) -> tuple[FloatArray, dict[tuple[int, int], int]]:
    """Add neighbour after neighbour to a lattice; return its map to pixels and who is where."""
    to_px = np.eye(3)
    to_px[:2, :2], to_px[:2, 2] = axes, squares.centres[seed]
    nodes = {(0, 0): seed}
    while True:
        at = apply_homography(np.asarray(np.linalg.inv(to_px)), squares.centres)
        nearest = np.rint(at)
        off = np.abs(at - nearest).max(axis=1)
        added = False
        for index in np.argsort(off):
            node = (int(nearest[index, 0]), int(nearest[index, 1]))
            if off[index] > _OFF:
                break
            if node not in nodes and _fits(nodes, node) and index not in nodes.values():
                side = squares.sides[[nodes[other] for other in _beside(nodes, node)]].mean()
                if side / _ALIKE < squares.sides[index] < _ALIKE * side:
                    nodes[node], added = int(index), True
        if not added:
            return to_px, nodes
        places = np.array(list(nodes), dtype=np.float64)
        if len(nodes) >= _FEWEST_PATCHES // 2 and np.ptp(places, axis=0).min() > 0:
            to_px = _plane_map(places, squares.centres[list(nodes.values())])


def _plane_map(places: FloatArray, centres: FloatArray) -> FloatArray:
    """Map of nodes to pixels: affine for few nodes, with perspective for many."""
    if len(places) >= _FEWEST_PATCHES and np.ptp(places, axis=0).min() > 1:
        weights = np.ones(len(places))
        for _ in range(_ROUNDS):  # a patch that is covered in part has its middle elsewhere
            to_px = fit_homography(places, centres, weights)
            off = np.linalg.norm(apply_homography(to_px, places) - centres, axis=1)
            weights = 1 / np.maximum(off, _SHARP_PX) ** 2
        return to_px
    design = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    to_px = np.eye(3)
    to_px[:2] = np.linalg.lstsq(design, centres, rcond=None)[0].T
    return to_px


def _beside(nodes: dict[tuple[int, int], int], node: tuple[int, int]) -> list[tuple[int, int]]:
    x, y = node
    return [other for other in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)) if other in nodes]


def _fits(nodes: dict[tuple[int, int], int], node: tuple[int, int]) -> bool:
    """Tell whether a node touches the others and leaves them within the size of a card."""
    short, long = sorted(np.ptp(np.array([*nodes, node]), axis=0) + 1)
    return bool(_beside(nodes, node)) and short <= _SHORT and long <= _LONG


def _placements(lattice: _Lattice) -> Iterator[FloatArray]:
    """Yield corners (4, 2), in pixels, of every card that may hold a lattice, both ways up."""
    low, high = lattice.nodes.min(axis=0), lattice.nodes.max(axis=0)
    for width, height in ((_LONG, _SHORT), (_SHORT, _LONG)):
        size = np.array([width, height])
        first, last = high - size, low + 1
        for x, y in product(range(first[0], last[0] + 1), range(first[1], last[1] + 1)):
            within = lattice.nodes - np.array([x, y])
            if ((within >= 0) & (within < size)).all(axis=1).mean() < _HELD:
                continue
            right, bottom = x + width - 1, y + height - 1
            quad = np.array([[x, y], [right, y], [right, bottom], [x, bottom]], dtype=np.float64)
            corners = apply_homography(lattice.to_px, quad)
            turn = 0 if width > height else 1
            yield np.roll(corners, -turn, axis=0)
            yield np.roll(corners, 2 - turn, axis=0)


def _mismatch(rgb: FloatArray, reference: FloatArray) -> float:
    """Median relative error of the matrix that takes half of the patches best to the reference.

    The matrix is the best of many that were drawn through four patches each, so that what covers
    up to half of a card does not matter (least median of squares; P. Rousseeuw, J. Am. Stat.
    Assoc. 79, 1984).
    """
    seen = np.isfinite(rgb).all(axis=1)
    if seen.sum() < _FEWEST_PATCHES:
        return float("inf")
    rgb, reference = rgb[seen], reference[seen]
    rng = np.random.default_rng(0)
    drawn = rng.permuted(np.tile(np.arange(len(rgb)), (_DRAWS, 1)), axis=1)[:, :4]
    matrices = np.linalg.pinv(rgb[drawn]) @ reference[drawn]
    errors = np.abs(rgb @ matrices - reference) / (reference + _DIM)
    return float(np.median(errors.max(axis=2), axis=1).min())
