"""Pictures that are not clean: encoded, compressed, demosaiced, sharpened, cut, covered."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from benchmarks.detection.renderer import Picture
from benchmarks.detection.scenes import Scene, noisy, render
from benchmarks.detection.surfaces import colour_look
from numpy.typing import NDArray

from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from calichrome.imaging import Image

__all__ = [
    "VARIANTS",
    "PartialView",
    "cut",
    "hand",
    "shows_enough",
    "taken",
    "visible_corners",
]

_NEAR = 0.25
"""A corner is visible if everything within so many squares of it is."""


def _linear(scene: Scene, rng: np.random.Generator) -> Image:
    return Image(pixels=noisy(render(scene), scene, rng), encoding="linear", bits=8)


def _linear_colour(scene: Scene, rng: np.random.Generator) -> Image:
    clean = render(scene, look=colour_look(scene.target))
    return Image(pixels=noisy(clean, scene, rng), encoding="linear", bits=8)


def _srgb_pixels(scene: Scene, rng: np.random.Generator) -> UInt8Array:
    clean = render(scene)
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * np.float32(scene.noise_dn)
    light = np.clip((clean + noise) / 255, 0, 1).astype(np.float64)
    return np.rint(255 * encode(light, "srgb")).astype(np.uint8)


def _srgb(scene: Scene, rng: np.random.Generator) -> Image:
    return Image(pixels=_srgb_pixels(scene, rng), encoding="srgb", bits=8)


def _jpeg(scene: Scene, rng: np.random.Generator) -> Image:
    encoded = cv2.imencode(".jpg", _srgb_pixels(scene, rng), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
    return Image(pixels=_decoded(encoded), encoding="srgb", bits=8)


def _jpeg_linear(scene: Scene, rng: np.random.Generator) -> Image:
    plain = noisy(render(scene), scene, rng)
    encoded = cv2.imencode(".jpg", plain, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
    return Image(pixels=_decoded(encoded), encoding="linear", bits=8)


def _decoded(encoded: NDArray[np.uint8]) -> UInt8Array:
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def _demosaiced(scene: Scene, rng: np.random.Generator) -> Image:
    """RGGB mosaic, noise, then bilinear interpolation."""
    clean = render(scene, look=colour_look(scene.target))
    colour_at = np.ones(clean.shape[:2], dtype=np.intp)
    colour_at[::2, ::2], colour_at[1::2, 1::2] = 0, 2
    mosaic = np.take_along_axis(clean, colour_at[..., None], axis=2)[..., 0]
    raw = noisy(mosaic, scene, rng).astype(np.float32)
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], dtype=np.float32) / 4
    square = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], dtype=np.float32) / 4
    kernels = (square, cross, square)
    channels = [
        cv2.filter2D(np.where(colour_at == channel, raw, 0), -1, kernels[channel])
        for channel in range(3)
    ]
    pixels = np.clip(np.rint(np.stack(channels, axis=-1)), 0, 255).astype(np.uint8)
    return Image(pixels=pixels, encoding="linear", bits=8)


def _sharpened(scene: Scene, rng: np.random.Generator) -> Image:
    """Unsharp mask of sigma 1 and amount 1."""
    picture = noisy(render(scene), scene, rng).astype(np.float32)
    sharp = 2 * picture - cv2.GaussianBlur(picture, (0, 0), 1.0)
    pixels = np.clip(np.rint(sharp), 0, 255).astype(np.uint8)
    return Image(pixels=pixels, encoding="linear", bits=8)


VARIANTS: Mapping[str, Callable[[Scene, np.random.Generator], Image]] = {
    "linear 8 bit grey": _linear,
    "linear 8 bit RGB": _linear_colour,
    "sRGB 8 bit": _srgb,
    "sRGB, JPEG q90": _jpeg,
    "linear, JPEG q90": _jpeg_linear,
    "Bayer, bilinear demosaic": _demosaiced,
    "unsharp mask": _sharpened,
}
"""Pictures of the board with discs, by name."""


@dataclass(frozen=True, slots=True, eq=False)
class PartialView:
    """A picture of a part of the board.

    Parameters
    ----------
    clean : (h, w, 3) float
        Without noise.
    hidden : (h, w) bool
        Where something lies before the board.
    corners_px : (N, 2) float
        True corners, seen or not, by id.
    visible : (N,) bool
        Corners around which everything is seen.
    squares : (ny, nx) bool
        Squares that are wholly seen.
    """

    clean: Picture
    hidden: BoolArray
    corners_px: FloatArray
    visible: BoolArray
    squares: BoolArray

    @property
    def share(self) -> float:
        """Share of the squares that are wholly seen."""
        return float(self.squares.mean())


def visible_corners(
    scene: Scene, hidden: BoolArray, origin_xy: IntArray
) -> tuple[BoolArray, BoolArray]:
    """Tell which corners (N,) and squares (ny, nx) are seen.

    Parameters
    ----------
    hidden : (h, w) bool
        Where something lies before the board; what is outside is not seen either.
    origin_xy : (2,) int
        Pixel of the whole picture that is (0, 0) of `hidden`.
    """
    t = np.linspace(-1, 1, 13)
    grid = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    corners = _is_clear(scene, scene.corners_uv[:, None] + _NEAR * grid, hidden, origin_xy)
    nx, ny = scene.target.squares
    ix, iy = np.meshgrid(np.arange(nx), np.arange(ny))
    centres = np.stack([ix, iy], axis=-1)[:, :, None] - 0.5
    squares = _is_clear(scene, centres + 0.5 * grid, hidden, origin_xy)
    return corners, squares


def _is_clear(
    scene: Scene, points_uv: FloatArray, hidden: BoolArray, origin_xy: IntArray
) -> BoolArray:
    """Whether all of the points along the last but one axis are seen."""
    pixels = np.rint(scene.canvas.pixels_of(points_uv) - origin_xy).astype(int)
    height, width = hidden.shape
    inside = ((pixels >= 1) & (pixels < [width - 1, height - 1])).all(axis=-1)
    x = np.clip(pixels[..., 0], 0, width - 1)
    y = np.clip(pixels[..., 1], 0, height - 1)
    return np.asarray((inside & ~hidden[y, x]).all(axis=-1))


def shows_enough(scene: Scene, view: PartialView) -> bool:
    """Whether a block of 4x3 or 3x4 squares with 6 discs or more is wholly seen."""
    discs = np.zeros(view.squares.shape, dtype=int)
    ix, iy = scene.target.marker_squares.T
    discs[iy, ix] = 1
    for shape in ((4, 3), (3, 4)):
        seen = np.lib.stride_tricks.sliding_window_view(view.squares, shape)
        blocks = seen.all(axis=(2, 3))
        # Six discs in the part that shows, not necessarily in one block of it
        if blocks.any() and discs[view.squares].sum() >= 6:
            return True
    return False


def cut(scene: Scene, clean: Picture, rng: np.random.Generator) -> PartialView:
    """Cut the picture through the board by one border or two."""
    height, width = clean.shape[:2]
    corners = scene.corners_px
    low, high = corners.min(axis=0), corners.max(axis=0)
    x0, y0, x1, y1 = 0, 0, width, height
    n_cuts = int(rng.integers(1, 3))
    for axis in rng.permutation(2)[:n_cuts]:
        place = int(low[axis] + rng.uniform(0.1, 0.9) * (high[axis] - low[axis]))
        keeps_end = bool(rng.integers(2))
        if axis == 0:
            x0, x1 = (place, x1) if keeps_end else (x0, place)
        else:
            y0, y1 = (place, y1) if keeps_end else (y0, place)
    part = clean[y0:y1, x0:x1]
    hidden = np.zeros(part.shape[:2], dtype=bool)
    origin = np.array([x0, y0])
    return PartialView(part, hidden, corners - origin, *visible_corners(scene, hidden, origin))


def hand(
    scene: Scene, clean: Picture, skin_dn: NDArray[np.float32], rng: np.random.Generator
) -> PartialView:
    """Put a hand before the board: an arm, a palm and fingers with a smooth outline.

    Parameters
    ----------
    skin_dn : (3,) float
        Linear level of skin where the light is strongest.
    """
    height, width = clean.shape[:2]
    corners = scene.corners_px
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float(np.linalg.norm(high - low))
    palm = corners[rng.integers(len(corners))] + rng.normal(0, 0.1, 2) * extent
    size = rng.uniform(0.1, 0.3) * extent
    turn = rng.uniform(0, 2 * np.pi)
    mask = np.zeros((height, width), dtype=np.uint8)
    _ellipse(mask, palm, (size, 0.8 * size), turn)
    back = np.array([np.cos(turn), np.sin(turn)])
    _ellipse(mask, palm - 3 * size * back, (3 * size, 0.55 * size), turn)
    for finger in np.linspace(-0.7, 0.7, 4):
        along = turn + finger * rng.uniform(0.7, 1.1)
        way = np.array([np.cos(along), np.sin(along)])
        _ellipse(mask, palm + 1.2 * size * way, (0.8 * size, 0.16 * size), along)
    soft = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), max(0.02 * size, 1.0))
    share = cv2.GaussianBlur((soft > 0.5).astype(np.float32), (0, 0), scene.psf_sigma_px)
    shade = 0.75 + 0.25 * cv2.GaussianBlur(soft, (0, 0), max(0.15 * size, 1.0))
    covered = share[..., None] * (shade[..., None] * skin_dn - clean) + clean
    hidden = np.asarray(share > 0.01)
    zero = np.zeros(2, dtype=np.int64)
    return PartialView(covered, hidden, corners, *visible_corners(scene, hidden, zero))


def _ellipse(
    mask: UInt8Array, centre: FloatArray, axes: tuple[float, float], turn_rad: float
) -> None:
    at = int(centre[0]), int(centre[1])
    sizes = max(int(axes[0]), 1), max(int(axes[1]), 1)
    cv2.ellipse(mask, at, sizes, float(np.degrees(turn_rad)), 0, 360, 255, -1)


def taken(
    view: PartialView, scene: Scene, matrix: FloatArray, gain: float, rng: np.random.Generator
) -> Image:
    """Take the picture with a camera of any colour response.

    Parameters
    ----------
    matrix : (3, 3) float
        rgb @ matrix is what the camera's channels say (`random_cast`).
    gain
        Exposure.
    """
    seen = np.minimum(view.clean @ (gain * matrix).astype(np.float32), 250)
    return Image(pixels=noisy(seen, scene, rng), encoding="linear", bits=8)
