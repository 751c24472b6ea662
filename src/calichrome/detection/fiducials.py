"""Boards whose corners are named by codes: the codes say where to look, the corners are measured.

A code is read by OpenCV. It is believed only where a second one agrees with it, so that neither a
misread code nor another board names a corner. Corners are then expected where the nearest codes put
them, which follows a distorted picture, and refined in windows that keep clear of the codes: their
own corners, found from contours, are off by half a pixel and biased towards the outside.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from calichrome.core.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.target import CodedTarget

__all__ = ["detect_coded_board"]

_AGREE = 0.25
"""Two codes agree if one affine map carries both outlines to within this share of a side. A wrong
number, or a code of another board, is off by a side or more; perspective and distortion bend
neighbouring codes by less."""

_NEIGHBOURS = 6
"""Codes that a code is compared with: those around it, and one more ring where some are hidden."""

_NEAREST_CODES = 4
"""Codes that say where a corner is expected: on an interior corner those that touch it and two
more, so that a lens distortion is followed and half a pixel of a code's corner averaged."""

_MIN_WINDOW_PX = 2
"""Half-width of the smallest window in which corners are refined: with 1 they come out worse than
they were expected (0.36 against 0.29 px RMS), with 2 at 0.07 px (rendered squares of 24 px)."""

_LEAST_CONTRAST = 0.3
"""Contrast across a corner over the median of its board: a covered corner has none, or the wrong
sign; uneven light halves it at most."""


@dataclass(frozen=True, slots=True, eq=False)
class _Codes:
    """Codes that agree with each other.

    `outlines_board` (M, 4, 2) metres, `outlines_px` (M, 4, 2), `layout` as in `CodedTarget`.
    """

    outlines_board: FloatArray
    outlines_px: FloatArray
    layout: int


def detect_coded_board(image: Image, target: CodedTarget) -> BoardView | NotFound:
    """Find the corners of a ChArUco board or an AprilGrid, or of what is seen of it.

    Parameters
    ----------
    image
        Grey or colour, encoded or linear.
    target
        The board to look for.

    Returns
    -------
    BoardView
        Corners that touch a code that was read, with ids; no covariances.
    NotFound
        With a reason that a person at the camera can act on.
    """
    grey = image.grey()
    if target.inverted:
        grey = np.float32(255) - grey
    codes = _read_codes(grey, target)
    if isinstance(codes, str):
        return NotFound(f"{codes}{_remedy(image, grey, target)}")
    expected = _expect_corners(codes, target)
    corners_px, is_measured = _refine(grey, expected)
    is_seen = is_measured & _show_contrast(grey, corners_px, expected, target, codes.layout)
    ids = expected.corner_ids[is_seen]
    points = target.corners_board[ids, :2]
    if len(ids) < 4 or np.linalg.matrix_rank(points - points.mean(axis=0)) < 2:
        return NotFound(
            f"{len(codes.outlines_px)} codes were read, but {len(ids)} corners between them are "
            f"clear and large enough to measure; show more of the board, or bring it nearer"
        )
    return BoardView(corner_ids=ids, corners_px=corners_px[is_seen])


def _read_codes(grey: NDArray[np.float32], target: CodedTarget) -> _Codes | str:
    """Return the largest set of codes that agree, or why there is none."""
    ids, outlines_px = _detect_codes(grey, target)
    n_codes = len(target.code_outlines(0))
    foreign = sorted(set(ids[ids >= n_codes].tolist()))
    ids, outlines_px = ids[ids < n_codes], outlines_px[ids < n_codes]
    if len(ids) < 2:
        seen = "one code" if len(ids) else "no code"
        text = f"{seen} of the board ({target.dictionary}, 0 to {n_codes - 1}) could be read"
        others = ", ".join(map(str, foreign[:5]))
        return text + (f", but the codes {others}: another board?" if len(foreign) > 1 else "")
    return _arranged(ids, outlines_px, target)


def _arranged(ids: IntArray, outlines_px: FloatArray, target: CodedTarget) -> _Codes | str:
    """Choose the layout in which most codes agree, and those that do."""
    outlines = [target.code_outlines(layout)[ids] for layout in range(target.n_layouts)]
    groups = [_agreeing(board, outlines_px) for board in outlines]
    sizes = [len(found[0]) for found in groups]
    best = int(np.argmax(sizes))
    largest, *others = groups[best]
    if others and len(others[0]) > 2 and len(np.intersect1d(ids[largest], ids[others[0]])) > 1:
        return "two boards with the same codes are in sight; show one"
    if sizes[best] < 2 or 2 * sizes[best] <= len(ids):  # a row of another board may fit by chance
        return f"{len(ids)} codes were read that do not stand as on the target; check --target"
    if sizes.count(sizes[best]) > 1:
        return "the codes in sight do not tell the layout; add :legacy or :current to --target"
    return _Codes(outlines[best][largest], outlines_px[largest], best)


def _detect_codes(grey: NDArray[np.float32], target: CodedTarget) -> tuple[IntArray, FloatArray]:
    """Read all codes of the dictionary: ids (M,) and outlines (M, 4, 2) in pixels."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = target.border_bits
    number = getattr(cv2.aruco, f"DICT_{target.dictionary}")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    outlines, ids, _ = detector.detectMarkers(_as_bytes(grey))
    if ids is None:
        return np.zeros(0, np.int64), np.zeros((0, 4, 2))
    return ids.ravel().astype(np.int64), np.array(outlines, np.float64).reshape(-1, 4, 2)


def _as_bytes(grey: NDArray[np.float32]) -> UInt8Array:
    return np.rint(np.clip(grey, 0, 255)).astype(np.uint8)


def _agreeing(board: FloatArray, pixels: FloatArray) -> list[IntArray]:
    """Return groups of codes that agree with a neighbour, largest first; each (K,) positions."""
    centres = board.mean(axis=1)
    distances = np.linalg.norm(centres[:, None] - centres, axis=-1)
    nearest = np.argsort(distances, axis=1)[:, 1 : _NEIGHBOURS + 1]
    first = np.repeat(np.arange(len(board)), nearest.shape[1])
    second = nearest.ravel()
    residuals = _affine_residuals(board, pixels, first, second)
    sides = np.sqrt(np.abs(_areas(pixels)))
    agree = residuals <= _AGREE * np.minimum(sides[first], sides[second])
    graph = np.zeros((len(board), len(board)), dtype=bool)
    graph[first[agree], second[agree]] = True
    _, labels = connected_components(graph, directed=False)
    groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    return sorted(groups, key=len, reverse=True)


def _affine_residuals(
    board: FloatArray, pixels: FloatArray, first: IntArray, second: IntArray
) -> FloatArray:
    """Return the largest error of the best affine map of two codes at once, (P,), pixels."""
    source = np.concatenate([board[first], board[second]], axis=1)
    source = source - source.mean(axis=1, keepdims=True)
    source /= np.abs(source).max()
    design = np.concatenate([source, np.ones((*source.shape[:2], 1))], axis=2)
    seen = np.concatenate([pixels[first], pixels[second]], axis=1)
    errors = design @ (np.linalg.pinv(design) @ seen) - seen
    # a code that is held against itself twice in the picture fits nothing
    twin = np.linalg.norm(board[first] - board[second], axis=-1).max(axis=-1) == 0
    return np.where(twin, np.inf, np.linalg.norm(errors, axis=-1).max(axis=-1))


def _areas(outlines: FloatArray) -> FloatArray:
    diagonal, other = outlines[:, 2] - outlines[:, 0], outlines[:, 3] - outlines[:, 1]
    return np.asarray(diagonal[:, 0] * other[:, 1] - diagonal[:, 1] * other[:, 0]) / 2


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """Corners that touch a code that was read.

    `corner_ids` (N,); `homographies` (N, 3, 3) board metres to pixels around each; `corners_px`
    (N, 2); `half_widths` (N,) of windows that end where the codes begin, pixels: on rendered
    squares of 24 to 40 px one pixel less adds 0 to 45 % of error, one more 60 to 140 %.
    """

    corner_ids: IntArray
    homographies: FloatArray
    corners_px: FloatArray
    half_widths: IntArray


def _expect_corners(codes: _Codes, target: CodedTarget) -> _Expected:
    corners = target.corners_board[:, :2]
    gaps = np.linalg.norm(codes.outlines_board[None] - corners[:, None, None], axis=-1)
    reach_m = target.reach_m + 1e-3 * min(target.square_m)  # rounding of the sizes
    ids = np.flatnonzero((gaps <= reach_m).any(axis=(1, 2)))
    centres = codes.outlines_board.mean(axis=1)
    homographies, places, half_widths = [], [], []
    for corner in corners[ids]:
        nearest = np.argsort(np.linalg.norm(centres - corner, axis=1))[:_NEAREST_CODES]
        board, pixels = (part[nearest].reshape(-1, 2) for part in
                         (codes.outlines_board, codes.outlines_px))  # fmt: skip
        homography = fit_homography(board, pixels)
        steps = apply_homography(homography, corner + target.clearance_m * _STEPS)
        axes = 0.5 * np.stack([steps[0] - steps[1], steps[2] - steps[3]])
        clear_px = np.linalg.svd(axes, compute_uv=False)[-1]
        homographies.append(homography)
        places.append(apply_homography(homography, corner))
        half_widths.append(round(float(clear_px)))
    return _Expected(
        ids, np.array(homographies), np.array(places).reshape(-1, 2), np.array(half_widths)
    )


_STEPS = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])


def _refine(grey: NDArray[np.float32], expected: _Expected) -> tuple[FloatArray, BoolArray]:
    """Move corners to their saddles, (N, 2); and tell which stayed in a window large enough."""
    refined = expected.corners_px.copy()
    is_measured = expected.half_widths >= _MIN_WINDOW_PX
    is_measured &= _inside(grey, expected.corners_px, expected.half_widths + 1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    for half_width in np.unique(expected.half_widths[is_measured]):
        chosen = is_measured & (expected.half_widths == half_width)
        points = np.ascontiguousarray(expected.corners_px[chosen, None], dtype=np.float32)
        window = (int(half_width), int(half_width))
        refined[chosen] = cv2.cornerSubPix(grey, points, window, (-1, -1), criteria)[:, 0]
    moved = np.abs(refined - expected.corners_px).max(axis=1, initial=0)
    return refined, is_measured & (moved <= expected.half_widths)


def _inside(grey: NDArray[np.float32], points: FloatArray, margins: IntArray) -> BoolArray:
    last = np.array(grey.shape[::-1]) - 1
    return np.asarray(((points >= margins[:, None]) & (points <= last - margins[:, None])).all(-1))


def _show_contrast(
    grey: NDArray[np.float32],
    corners_px: FloatArray,
    expected: _Expected,
    target: CodedTarget,
    layout: int,
) -> BoolArray:
    """Tell at which corners the four squares are black and white as on the target, (N,)."""
    places = target.corners_board[expected.corner_ids, :2]
    quadrants = places[:, None] + 0.5 * target.clearance_m * _DIAGONALS
    pixels = np.array(
        [apply_homography(h, q) for h, q in zip(expected.homographies, quadrants, strict=True)]
    ).reshape(-1, 4, 2)
    pixels += (corners_px - expected.corners_px)[:, None]
    column, row = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
    column, row = np.clip(column, 0, grey.shape[1] - 1), np.clip(row, 0, grey.shape[0] - 1)
    levels = grey[row, column].astype(np.float64)
    iy, ix = np.divmod(expected.corner_ids, target.corners_xy[0])
    upper_left_black = ((ix + iy) % 2 == 0) == target.begins_black(layout)
    main, other = levels[:, :2], levels[:, 2:]
    black = np.where(upper_left_black[:, None], main, other)
    white = np.where(upper_left_black[:, None], other, main)
    contrast = white.min(axis=1) - black.max(axis=1)
    return np.asarray(contrast > _LEAST_CONTRAST * max(float(np.median(contrast)), 1.0))


_DIAGONALS = np.array([[-1.0, -1], [1, 1], [1, -1], [-1, 1]])
"""Upper left and lower right, then the two other squares at a corner."""


def _remedy(image: Image, grey: NDArray[np.float32], target: CodedTarget) -> str:
    """Say what a person can do about codes that cannot be read."""
    if not isinstance(_read_codes(np.float32(255) - grey, target), str):
        add = "remove :inverted from" if target.inverted else "add :inverted to"
        return f"; black and white are exchanged, {add} --target"
    clipped = float(image.is_clipped((slice(None), slice(None))).mean())
    if clipped > 0.2:
        return f"; {clipped:.0%} of the picture is overexposed, close the aperture"
    contrast = float(np.quantile(grey, 0.99) - np.quantile(grey, 0.01))
    if contrast < 40:
        return f"; the picture has only {contrast:.0f} of 255 levels, add light"
    return "; show the board nearer, sharp and without glare"
