"""A ColorChecker card in a picture: what the camera makes of its 24 patches."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray, checked, frozen
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.detection.pixels import NEARLY_FULL, linear_light
from calichrome.errors import DetectionError
from calichrome.imaging import Image

__all__ = [
    "CARD_CORNERS",
    "CARD_PLACES",
    "CardReading",
    "is_convex",
    "measure_card",
    "read_card_corners",
]

_COLUMNS, _ROWS = 6, 4
CARD_PLACES = frozen(
    np.stack(np.meshgrid(np.arange(_COLUMNS) - 2.5, np.arange(_ROWS) - 1.5), axis=-1).reshape(-1, 2)
)
"""Centres of the patches in the order of the chart, (24, 2), in pitches about its middle."""

CARD_CORNERS = (0, 5, 23, 18)
"""The corner patches, clockwise: dark skin, bluish green, black, white."""
_SAMPLED = 0.4
"""Side of the sampled square in pitches: half a patch, so that corners may be off by a sixth of
one."""
_CELLS = 3  # along a side of that square
_LEAST_PX = 2.0  # side of a cell
_TILTED = 30.0  # degrees from which the user is told: gloss and uneven light come with it; chosen
_SHORTEST, _LONGEST = 0.3, 3.0
"""Focal lengths in diagonals of the picture: of wide lenses (118 degrees across it) and of those
that see a card as if from afar."""
_RECEDES = 1.1
"""Times that the near end is larger than the far one: a lamp at the camera then lights it by a
fifth more. Chosen."""
_MAX_CORNER_BYTES = 10_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CardReading:
    """What one picture shows of the card; patches in the order of the chart.

    Parameters
    ----------
    corners_px : (4, 2) float
        Centres of the patches dark skin, bluish green, black and white.
    centres_px : (24, 2) float
        Of all patches.
    rgb : (24, 3) float
        Linear means, 0..1 of full scale; nan outside the picture.
    rgb_cov : (24, 3, 3) float
        Covariance of the means, from how the parts of a patch differ: a half covered patch has a
        large one.
    n_px : (24,) int
    clipped : (24,) float
        Share of pixels with a channel at full scale.
    tilt_deg
        Between the card's normal and the line of sight to its middle.
    recession
        Times that the card's nearest patch is larger than its farthest.
    """

    corners_px: FloatArray
    centres_px: FloatArray
    rgb: FloatArray
    rgb_cov: FloatArray
    n_px: IntArray
    clipped: FloatArray
    tilt_deg: float
    recession: float

    @property
    def places(self) -> FloatArray:
        """Where the patches are on the card, (24, 2), pitches about its middle."""
        return CARD_PLACES

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the user should know of the picture."""
        return tuple(self._remarks())

    def _remarks(self) -> Iterator[str]:
        if self.tilt_deg > _TILTED or self.recession > _RECEDES:
            yield (
                f"the card is tilted by about {self.tilt_deg:.0f} degrees, its near end is "
                f"{self.recession:.2f} times as large as its far end: light and gloss differ over "
                f"it; face it to the camera"
            )
        if n_clipped := int((self.clipped > 0).sum()):
            yield (
                f"{n_clipped} patches hold clipped pixels (up to {self.clipped.max():.0%} of a "
                f"patch); shorten the exposure"
            )
        if n_unseen := int((~np.isfinite(self.rgb).all(axis=1)).sum()):
            yield f"{n_unseen} patches lie outside the picture, or are too small to be measured"


def measure_card(image: Image, corners_px: FloatArray) -> CardReading:
    """Measure the patches of a card whose place is known.

    Parameters
    ----------
    image
        A colour picture.
    corners_px : (4, 2) float
        Centres of the four corner patches, clockwise from dark skin: then bluish green, black,
        white.

    Raises
    ------
    ValueError
        If they are no convex quadrangle.
    """
    corners = checked(corners_px, (4, 2), "corners_px")
    if not is_convex(corners):
        raise ValueError("corners_px: give the centres of the corner patches in order around it")
    to_px = fit_homography(CARD_PLACES[list(CARD_CORNERS)], corners)
    rgb, cov = np.full((24, 3), np.nan), np.full((24, 3, 3), np.nan)
    n_px, clipped = np.zeros(24, dtype=np.int64), np.zeros(24)
    for patch, place in enumerate(CARD_PLACES):
        cells, bad, count = _cells(image, to_px, place)
        n_px[patch], clipped[patch] = count, bad
        if cells is not None:
            rgb[patch] = cells.mean(axis=0)
            cov[patch] = np.cov(cells.T) / len(cells)
    scales = np.array([_jacobian(to_px, place) for place in CARD_PLACES])
    sides = np.sqrt(np.abs(np.linalg.det(scales)))
    return CardReading(
        corners_px=corners,
        centres_px=apply_homography(to_px, CARD_PLACES),
        rgb=rgb,
        rgb_cov=cov,
        n_px=n_px,
        clipped=clipped,
        tilt_deg=_tilt_deg(to_px, image.size_wh),
        recession=float(sides.max() / sides.min()),
    )


def read_card_corners(path: Path) -> FloatArray:
    """Read the centres of the corner patches from a CSV file, (4, 2).

    Parameters
    ----------
    path
        Header ``x,y``, then four rows in pixels, clockwise from dark skin; (0, 0) is the centre of
        the top-left pixel.

    Raises
    ------
    DetectionError
        If the file says anything else.
    """
    try:
        raw = path.read_bytes()[:_MAX_CORNER_BYTES]
        rows = [row for row in csv.reader(raw.decode("utf-8-sig").splitlines()) if any(row)]
        header, values = [cell.strip() for cell in rows[0]], rows[1:]
        corners = np.array([[float(cell) for cell in row] for row in values])
    except OSError as error:
        raise DetectionError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, IndexError, csv.Error):
        header, corners = [], np.empty(0)
    if header != ["x", "y"] or corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise DetectionError(
            f"{path}: write a line x,y and four lines with the centres of the corner patches in "
            f"pixels, clockwise from dark skin"
        )
    return corners


def is_convex(corners: FloatArray) -> bool:
    """Tell whether four points (4, 2) are the corners of a convex quadrangle, in order."""
    along = np.roll(corners, -1, axis=0) - corners
    after = np.roll(along, -1, axis=0)
    turns = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
    return bool((turns > 0).all() or (turns < 0).all())


def _jacobian(to_px: FloatArray, place: FloatArray) -> FloatArray:
    """Pixels per pitch at a place of the card, (2, 2)."""
    x, y, w = to_px @ np.append(place, 1)
    return np.asarray((to_px[:2, :2] - np.outer([x / w, y / w], to_px[2, :2])) / w)


def _tilt_deg(to_px: FloatArray, size_wh: tuple[int, int]) -> float:
    """Return the angle between the card's normal and the line of sight to its middle, degrees.

    Pitches along and across the card are equal and square to each other, which gives the focal
    length of a camera with square pixels and its axis in the middle of the picture. Where it comes
    out impossible, the card hardly recedes: then the angle is as if seen from afar.

    References
    ----------
    .. [1] Z. Zhang, "A Flexible New Technique for Camera Calibration", IEEE PAMI 22 (11), 2000,
       eq. 3 and 4.
    """
    middle_px = (np.array(size_wh) - 1) / 2
    diagonal = float(np.linalg.norm(size_wh))
    to_centred = np.array([[1, 0, -middle_px[0]], [0, 1, -middle_px[1]], [0, 0, diagonal]])
    along, across, middle = (to_centred @ to_px).T / diagonal
    flat = np.array([along[:2] @ across[:2], along[:2] @ along[:2] - across[:2] @ across[:2]])
    deep = np.array([along[2] * across[2], along[2] ** 2 - across[2] ** 2])
    # 1 / f^2, in diagonals of the picture
    square = -float(flat @ deep) / max(float(flat @ flat), 1e-300)
    if not 1 / _LONGEST**2 < square < 1 / _SHORTEST**2:
        long, short = np.linalg.svd(_jacobian(to_px, np.zeros(2)), compute_uv=False)
        return float(np.degrees(np.arccos(short / long)))
    to_ray = np.array([np.sqrt(square), np.sqrt(square), 1])
    normal, ray = np.cross(along * to_ray, across * to_ray), middle * to_ray
    cosine = abs(normal @ ray) / (np.linalg.norm(normal) * np.linalg.norm(ray))
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def _cells(
    image: Image, to_px: FloatArray, place: FloatArray
) -> tuple[FloatArray | None, float, int]:
    """Return the means of the cells of a patch (9, 3), the share clipped, and pixels.

    None if a cell is too small, or outside the picture.
    """
    sides = _SAMPLED / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rim = apply_homography(to_px, place + sides)
    low = np.floor(rim.min(axis=0)).astype(int)
    high = np.ceil(rim.max(axis=0)).astype(int) + 1
    size = np.linalg.svd(_jacobian(to_px, place), compute_uv=False)[1] * _SAMPLED / _CELLS
    if size < _LEAST_PX or (low < 0).any() or (high > image.size_wh).any():
        return None, 0.0, 0
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    from_px = np.asarray(np.linalg.inv(to_px))
    at = apply_homography(from_px, np.stack([x, y], axis=-1).reshape(-1, 2)) - place
    cell = np.floor((at / _SAMPLED + 0.5) * _CELLS).astype(int)
    inside: BoolArray = np.asarray(((cell >= 0) & (cell < _CELLS)).all(axis=1))
    numbers = image.pixels[y.ravel()[inside], x.ravel()[inside]]
    light = linear_light(image, numbers)
    index = cell[inside] @ np.array([1, _CELLS])
    count = np.bincount(index, minlength=_CELLS**2)
    sums = [np.bincount(index, weights=channel, minlength=_CELLS**2) for channel in light.T]
    bad = (numbers >= NEARLY_FULL * image.full_scale).any(axis=1).mean()
    return np.stack(sums, axis=1) / count[:, None], float(bad), int(inside.sum())
