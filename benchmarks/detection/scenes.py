"""Random scenes of the board, rendered without noise, and the noise of a camera.

Linear pictures in DN of an 8-bit camera. The distribution is that of the table in
docs/detection.md: see `random_scene`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import cv2
import numpy as np
from benchmarks.detection import backgrounds
from benchmarks.detection.renderer import Bounds, Canvas, Picture, Shape, checkers, disc, rectangle
from benchmarks.detection.surfaces import Look, board_target, grey_look
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.target import Target

__all__ = [
    "CHARUCO_DICTIONARY",
    "CHARUCO_RATIO",
    "BoardKind",
    "Scene",
    "charuco_board",
    "light_field",
    "noisy",
    "random_scene",
    "render",
]

BoardKind = Literal["disc", "plain", "charuco"]

CHARUCO_DICTIONARY = cv2.aruco.DICT_4X4_50
CHARUCO_RATIO = 0.7

_SIZES_WH = ((1280, 960), (1920, 1200), (2048, 1536), (2592, 1944), (4000, 3000))
_SIZE_SHARES = (0.65, 0.25, 0.04, 0.03, 0.03)
"""65 % of 1.2 MP, 25 % of 2.3 MP, the rest 3, 5 and 12 MP."""

_MARGIN = 1.0
"""White paper around the squares, in squares."""

_VISIBLE_MARGIN = 0.3
"""The part of it that lies in the picture where the board comes near its border."""

_SMALLEST_SPACING_PX = 8.0
"""Of neighbouring corners: with a point spread of 1.5 px squares of 8 px are hardly resolved."""

_LARGEST_DN = 246.0
"""Nothing around the board is brighter; the paper itself stays below 244."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """One picture to be taken, and its truth.

    Parameters
    ----------
    seed
        Equal seeds give equal scenes.
    target
        The board with its discs.
    lens, cam_from_board, size_wh
        Camera and pose.
    psf_sigma_px
        Point spread, standard deviation of a Gaussian; the square pixel comes on top.
    noise_dn
        Standard deviation of the noise of a pixel, before it is rounded to whole DN.
    exposure_dn
        DN of the perfect diffuser where the light is strongest on the board.
    veil_dn
        Stray light over the whole picture; it keeps the noise of black clear of zero.
    light : (5,) float
        Unevenness: coefficients of x, y, x^2, xy, y^2 over the picture (-1..1 across its width).
    has_clutter
        Whether the surroundings are full of things.
    tilt_rad
        Angle of the board's normal to the optical axis.
    """

    seed: int
    target: Target
    lens: BrownConrady
    cam_from_board: Pose
    size_wh: tuple[int, int]
    psf_sigma_px: float
    noise_dn: float
    exposure_dn: float
    veil_dn: float
    light: tuple[float, ...]
    has_clutter: bool
    tilt_rad: float

    @property
    def canvas(self) -> Canvas:
        """The board plane in units of one square."""
        unit_m = self.target.square_m[0]
        return Canvas(self.lens, self.cam_from_board, self.size_wh, unit_m, self.psf_sigma_px)

    @property
    def plain_target(self) -> Target:
        """The board without its discs."""
        return replace(self.target, markers=())

    @property
    def corners_px(self) -> FloatArray:
        """True inner corners, (N, 2), in the order of the ids."""
        return self.canvas.pixels_of(self.corners_uv)

    @property
    def corners_uv(self) -> FloatArray:
        """Inner corners in squares, (N, 2)."""
        return np.asarray(self.target.corners_board[:, :2] / self.target.square_m)

    @property
    def spacing_px(self) -> FloatArray:
        """Distance of every corner to its nearest neighbour on the board, (N,)."""
        steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        around = self.canvas.pixels_of(self.corners_uv[:, None] + steps)
        offsets = around - self.corners_px[:, None]
        return np.asarray(np.linalg.norm(offsets, axis=-1).min(axis=1))

    @property
    def paper(self) -> Bounds:
        """Rectangle of the paper, in squares."""
        nx, ny = self.target.squares
        return -1 - _MARGIN, nx - 1 + _MARGIN, -1 - _MARGIN, ny - 1 + _MARGIN

    @property
    def megapixels(self) -> float:
        """Pixels of the picture, millions."""
        return self.size_wh[0] * self.size_wh[1] / 1e6

    def rng(self, purpose: int) -> np.random.Generator:
        """Return random numbers that only this purpose of this scene uses."""
        return np.random.default_rng([self.seed, purpose])


def random_scene(seed: int, *, target: Target | None = None) -> Scene:
    """Draw a scene.

    Parameters
    ----------
    seed
        Equal seeds give equal scenes.
    target
        Another board than `board_target()`, with square squares.

    Notes
    -----
    65 % 1.2 MP, 25 % 2.3 MP, the rest 3-12 MP; board 10-90 % of the picture's width (before it is
    tilted); tilt 0-60 deg, any roll; focal length 0.8-1.6 widths, k1 -0.25..0.1, k2 -0.05..0.1,
    tangential 5e-4; PSF sigma 0.5-1.5 px, noise 1-5 DN, white at 100-243 DN, black at 8-24, light
    falling by up to a quarter across the board; corners 8 px apart or more; every other scene has
    clutter.
    """
    rng = np.random.default_rng([seed, 0])
    board = board_target() if target is None else target
    size_wh = _SIZES_WH[int(rng.choice(len(_SIZES_WH), p=_SIZE_SHARES))]
    focal = size_wh[0] * rng.uniform(0.8, 1.6)
    centre = (np.array(size_wh) - 1) / 2 + rng.normal(0, 0.01, 2) * size_wh[0]
    k1, k2 = rng.uniform(-0.25, 0.1), rng.uniform(-0.05, 0.1)
    p1, p2 = rng.uniform(-5e-4, 5e-4, 2)
    lens = BrownConrady(
        fx=focal, fy=focal * rng.uniform(0.998, 1.002), cx=centre[0], cy=centre[1],
        k1=k1, k2=k2, p1=p1, p2=p2,
    )  # fmt: skip
    cam_from_board, tilt_rad = _random_pose(board, lens, size_wh, rng)
    return Scene(
        seed=seed,
        target=board,
        lens=lens,
        cam_from_board=cam_from_board,
        size_wh=size_wh,
        psf_sigma_px=rng.uniform(0.5, 1.5),
        noise_dn=rng.uniform(1, 5),
        exposure_dn=rng.uniform(110, 255),
        veil_dn=rng.uniform(4, 14),
        light=tuple(rng.uniform(-0.12, 0.12, 5)),
        has_clutter=seed % 2 == 1,
        tilt_rad=tilt_rad,
    )


def light_field(scene: Scene) -> Picture:
    """Return the light across the picture, (H, W), 1 where it is strongest on the board."""
    width, height = scene.size_wh
    x = (np.arange(width, dtype=np.float32) - width / 2) / (width / 2)
    y = ((np.arange(height, dtype=np.float32) - height / 2) / (width / 2))[:, None]
    a, b, c, d, e = (np.float32(value) for value in scene.light)
    field = 1 + a * x + b * y + c * x * x + d * x * y + e * y * y
    window = scene.canvas.window(scene.paper)
    return np.asarray(field / (field.max() if window is None else field[window].max()))


def render(scene: Scene, board: BoardKind = "disc", look: Look | None = None) -> Picture:
    """Render without noise.

    Parameters
    ----------
    look
        Levels of the surfaces; luminances without.

    Returns
    -------
    (H, W) or (H, W, 3) float
        Linear, DN; (H, W) if the look has one channel.
    """
    look = grey_look(scene.target) if look is None else look
    make = backgrounds.cluttered if scene.has_clutter else _plain
    surroundings = make(scene.size_wh, scene.psf_sigma_px, scene.rng(1))
    picture = surroundings @ look.mix.astype(np.float32)
    _cover(picture, scene, scene.paper, rectangle(scene.paper), look.white, None)
    nx, ny = scene.target.squares
    squares = (-1.0, nx - 1.0, -1.0, ny - 1.0)
    black_first = scene.target.top_left == "black"
    pattern = checkers(scene.target.squares, black_first=black_first)
    _cover(picture, scene, squares, pattern, look.black, look.white)
    if board == "disc":
        _draw_discs(picture, scene, look)
    elif board == "charuco":
        for bounds, is_black in _charuco_cells(scene.target.squares):
            levels = (look.black, look.white) if is_black else (look.white, look.black)
            _cover(picture, scene, bounds, rectangle(bounds), *levels)
    picture *= light_field(scene)[..., None] * np.float32(scene.exposure_dn)
    picture += np.float32(scene.veil_dn)
    np.minimum(picture, np.float32(_LARGEST_DN), out=picture)
    return picture[..., 0] if picture.shape[2] == 1 else picture


def noisy(clean: Picture, scene: Scene, rng: np.random.Generator) -> UInt8Array:
    """Add the scene's noise and round to 8 bit."""
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * np.float32(scene.noise_dn)
    return np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)


def _plain(size_wh: tuple[int, int], _: float, rng: np.random.Generator) -> NDArray[np.float32]:
    return backgrounds.plain(size_wh, rng)


def _cover(
    picture: Picture,
    scene: Scene,
    bounds: Bounds,
    shape: Shape,
    level: FloatArray,
    under: FloatArray | None,
) -> None:
    """Put a shape of one level into the picture, in place; on a ground of known level or any."""
    canvas = scene.canvas
    window = canvas.window(bounds)
    if window is None:
        return
    share = canvas.draw(shape, window)[0][..., None]
    ground = picture[window] if under is None else under.astype(np.float32)
    picture[window] += share * (level.astype(np.float32) - ground)


def _draw_discs(picture: Picture, scene: Scene, look: Look) -> None:
    for marker, level in zip(scene.target.markers, look.discs, strict=True):
        u, v = marker.square[0] - 0.5, marker.square[1] - 0.5
        radius = marker.diameter_m / scene.target.square_m[0] / 2
        around = (u - radius, u + radius, v - radius, v + radius)
        ground = look.black if marker.background == "black" else look.white
        _cover(picture, scene, around, disc((u, v), radius), level, ground)


def charuco_board(squares: tuple[int, int]) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's board with squares of 1 and the scenes' markers."""
    dictionary = cv2.aruco.getPredefinedDictionary(CHARUCO_DICTIONARY)
    return cv2.aruco.CharucoBoard(squares, 1.0, CHARUCO_RATIO, dictionary)


@cache
def _charuco_cells(squares: tuple[int, int]) -> list[tuple[Bounds, bool]]:
    """Rectangles that turn a chessboard into OpenCV's: black markers, then their white bits."""
    board = charuco_board(squares)
    dictionary = cv2.aruco.getPredefinedDictionary(CHARUCO_DICTIONARY)
    cells: list[tuple[Bounds, bool]] = []
    for marker_id, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        u, v = np.asarray(corners)[0, :2] - 1.0  # OpenCV's origin is the board's outer corner
        cells.append(((u, u + CHARUCO_RATIO, v, v + CHARUCO_RATIO), True))
        bits = dictionary.generateImageMarker(int(marker_id), 6) > 127
        side = CHARUCO_RATIO / 6
        for row, line in enumerate(bits):
            cells.extend(
                ((u + first * side, u + last * side, v + row * side, v + (row + 1) * side), False)
                for first, last in _runs(line.tolist())
            )
    return cells


def _runs(line: Iterable[bool]) -> list[tuple[int, int]]:
    """First and last-plus-one of the runs of true values."""
    flags = np.diff(np.concatenate([[0], np.asarray(list(line), dtype=int), [0]]))
    starts, ends = np.flatnonzero(flags == 1), np.flatnonzero(flags == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _random_pose(
    target: Target,
    lens: BrownConrady,
    size_wh: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[Pose, float]:
    """Draw tilt, roll, place and distance until the board lies as it should."""
    while True:
        share = rng.uniform(0.1, 0.9)
        for _ in range(40):
            tilt_rad, towards = math.radians(rng.uniform(0, 60)), rng.uniform(0, 2 * math.pi)
            axis = tilt_rad * np.array([math.cos(towards), math.sin(towards), 0])
            turn = Rotation.from_rotvec(axis) * Rotation.from_rotvec(
                [0, 0, rng.uniform(0, 2 * math.pi)]
            )
            place_px = rng.uniform(0.05, 0.95, 2) * size_wh
            pose = _at(target, lens, turn.as_matrix(), place_px, share * size_wh[0])
            if pose is not None and _is_usable(target, lens, pose, size_wh):
                return pose, tilt_rad


def _at(
    target: Target,
    lens: BrownConrady,
    rotation: FloatArray,
    place_px: FloatArray,
    width_px: float,
) -> Pose | None:
    """Put the board's centre on a pixel's ray, as far away as makes it so wide; None if it can't.

    The width is that of the squares without the margin where they are not foreshortened.
    """
    ray = lens.unproject(place_px[None])[0]
    if not np.isfinite(ray).all():
        return None
    nx, ny = target.squares
    side = target.square_m[0]
    middle = np.array([nx / 2 - 1, ny / 2 - 1, 0]) * side
    return Pose(rotation, lens.fx * nx * side / width_px * ray - rotation @ middle)


def _is_usable(
    target: Target, lens: BrownConrady, cam_from_board: Pose, size_wh: tuple[int, int]
) -> bool:
    seen = cam_from_board.apply(_outline(target, _VISIBLE_MARGIN))
    if not lens.sees(seen).all():
        return False
    pixels = lens.project(seen)
    if not ((pixels > 2) & (pixels < np.array(size_wh) - 3)).all():
        return False
    nx, ny = target.corners_xy
    grid = lens.project(cam_from_board.apply(target.corners_board)).reshape(ny, nx, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    return bool(min(steps) >= _SMALLEST_SPACING_PX)


def _outline(target: Target, margin: float) -> FloatArray:
    """Points around the squares, `margin` squares further out, (N, 3), metres."""
    nx, ny = target.squares
    t = np.linspace(0, 1, 17)
    u = -1 - margin + (nx + 2 * margin) * t
    v = -1 - margin + (ny + 2 * margin) * t
    sides = [(u, v[:1]), (u, v[-1:]), (u[:1], v), (u[-1:], v)]
    flat = np.concatenate([np.stack(np.broadcast_arrays(a, b), axis=-1) for a, b in sides])
    return np.concatenate([flat * target.square_m, np.zeros((len(flat), 1))], axis=1)
