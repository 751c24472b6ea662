"""Pictures without the board: python -m benchmarks.detection.absent --photographs FOLDER.

Textures and clutter, chessboards of other counts, triangular and hexagonal checkers, tiled floors
in perspective, photographs. Each is searched for the board with discs and for the plain one of
the same size: any board that is found is false.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from benchmarks.detection import backgrounds
from benchmarks.detection.renderer import Shape
from benchmarks.detection.scenes import noisy, random_scene, render
from benchmarks.detection.surfaces import SQUARE_M, board_target, colour_look
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.detection import detect_board
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import Image, read_image
from calichrome.observations import BoardView
from calichrome.synthetic.coverage import Grid, soft_step
from calichrome.target import Target
from calichrome.target.board import chessboard

__all__ = ["main"]

_OTHER_CORNERS = (
    (6, 5),
    (7, 7),
    (9, 7),
    (8, 6),
    (9, 8),
    (11, 8),
    (5, 4),
    (10, 10),
    (8, 8),
    (16, 7),
)
_SUFFIXES = {".jpg", ".png", ".tif"}


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photographs", type=Path, help="folder without our board, searched whole")
    parser.add_argument("--pictures", type=int, default=200)
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    photographs = _photographs(options.photographs, options.pictures * 2 // 5)
    n_rendered = options.pictures - len(photographs)
    disc = board_target()
    plain = replace(disc, markers=())
    print("| pictures | number | false boards with discs | false plain boards |")
    print("|" + " --- |" * 4)
    total = np.zeros(3, dtype=int)
    for index, (name, make) in enumerate(_KINDS.items()):
        seeds = range(800_000 + index, 800_000 + n_rendered, len(_KINDS))
        total += _row(name, ((f"seed {seed}", make(seed)) for seed in seeds), disc, plain)
    total += _row("photographs", _read(photographs), disc, plain)
    print(f"| all | {' | '.join(map(str, total.tolist()))} |")


def _row(
    name: str, images: Iterator[tuple[str, Image]], disc: Target, plain: Target
) -> tuple[int, int, int]:
    n_images, n_false = 0, [0, 0]
    for label, image in images:
        n_images += 1
        for which, target in enumerate((disc, plain)):
            found = detect_board(image, target)
            if isinstance(found, BoardView):
                n_false[which] += 1
                print(f"false: {name}, {label}: {len(found.corner_ids)} corners")
    print(f"| {name} | {n_images} | {n_false[0]} | {n_false[1]} |")
    return n_images, n_false[0], n_false[1]


def _photographs(folder: Path | None, most: int) -> list[Path]:
    """Choose pictures evenly from all folders below."""
    if folder is None:
        return []
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    keep = np.linspace(0, len(paths) - 1, min(most, len(paths))).round().astype(int)
    return [paths[index] for index in np.unique(keep)]


def _read(paths: Sequence[Path]) -> Iterator[tuple[str, Image]]:
    for path in paths:
        image = read_image(path)
        if isinstance(image, Image):
            yield str(path), image


def _clutter(seed: int) -> Image:
    scene = random_scene(seed)
    rng = scene.rng(40)
    surroundings = backgrounds.cluttered(scene.size_wh, scene.psf_sigma_px, rng)
    clean = surroundings * np.float32(scene.exposure_dn)
    return Image(pixels=noisy(clean, scene, rng), encoding="linear", bits=8)


def _other_board(seed: int) -> Image:
    corners_xy = _OTHER_CORNERS[seed % len(_OTHER_CORNERS)]
    target = chessboard(corners_xy, (SQUARE_M, SQUARE_M))
    scene = random_scene(seed, target=target)
    clean = render(scene, "plain", colour_look(target))
    return Image(pixels=noisy(clean, scene, scene.rng(41)), encoding="linear", bits=8)


def _lines(position: Grid, px_per_unit: Grid) -> Grid:
    """Return a wave of -1 and 1 that changes at whole numbers."""
    line = np.round(position)
    sign = np.float32(1) - np.float32(2) * (line % np.float32(2))
    return np.asarray(sign * soft_step((position - line) * px_per_unit), dtype=np.float32)


def _triangles(u: Grid, v: Grid, u_px: Grid, v_px: Grid) -> Grid:
    """Triangles of side 2 / sqrt 3: lines in three directions, colours change across each."""
    waves = [
        _lines(np.float32(np.cos(turn)) * u + np.float32(np.sin(turn)) * v, np.minimum(u_px, v_px))
        for turn in np.pi * np.array([0, 1 / 3, 2 / 3])
    ]
    return np.asarray((1 + waves[0] * waves[1] * waves[2]) / 2, dtype=np.float32)


def _hexagons(u: Grid, v: Grid, _: Grid, __: Grid) -> Grid:
    """Hexagons of pitch 1 in three shades; edges jump from sample to sample."""
    # Cube coordinates of hexagons, rounded to the nearest cell
    q = (np.sqrt(3) / 3 * u - v / 3) * np.sqrt(3)
    r = (2 / 3 * v) * np.sqrt(3)
    rounded = [np.round(value) for value in (q, r, -q - r)]
    excess = [np.abs(a - b) for a, b in zip(rounded, (q, r, -q - r), strict=True)]
    first = (excess[0] > excess[1]) & (excess[0] > excess[2])
    second = ~first & (excess[1] > excess[2])
    cell_q = np.where(first, -rounded[1] - rounded[2], rounded[0])
    cell_r = np.where(second, -rounded[0] - rounded[2], rounded[1])
    return np.asarray(((cell_q - cell_r) % 3) / 2, dtype=np.float32)


def _stretched(aspect: float) -> Shape:
    """Checkers without end, of rectangles."""
    scale = np.float32(aspect)

    def shape(u: Grid, v: Grid, u_px: Grid, v_px: Grid) -> Grid:
        wave = _lines(u, u_px) * _lines(v / scale, v_px * scale)
        return np.asarray((1 + wave) / 2, dtype=np.float32)

    return shape


def _floor(seed: int, shape: Shape) -> Image:
    """Cover the whole picture with a pattern in perspective, in two colours."""
    scene = random_scene(seed)
    rng = scene.rng(42)
    width, height = scene.size_wh
    # 1.6 widths: no corner of the picture looks more than 90 deg away from the normal
    lens = BrownConrady(fx=1.6 * width, fy=1.6 * width, cx=width / 2, cy=height / 2, k1=-0.1)
    tilt_rad, roll_rad = rng.uniform(0, 1.1), rng.uniform(0, 2 * np.pi)
    turn = Rotation.from_rotvec([tilt_rad, 0, 0]) * Rotation.from_rotvec([0, 0, roll_rad])
    side_px = rng.uniform(25, 150) * width / 1280
    pose = Pose(turn.as_matrix(), np.array([0, 0, lens.fx * SQUARE_M / side_px]))
    placed = replace(scene, lens=lens, cam_from_board=pose)
    window = slice(0, height), slice(0, width)
    share = placed.canvas.draw(shape, window)[0][..., None]
    levels = _two_colours(rng).astype(np.float32)
    clean = (levels[0] + share * (levels[1] - levels[0])) * np.float32(scene.exposure_dn)
    return Image(pixels=noisy(clean, scene, rng), encoding="linear", bits=8)


def _two_colours(rng: np.random.Generator) -> FloatArray:
    """Black and white, or two colours of floors."""
    if rng.integers(2):
        return np.array([[0.04] * 3, [0.85] * 3])
    return np.stack([rng.uniform(0.03, 0.2, 3), rng.uniform(0.3, 0.85, 3)])


_KINDS: dict[str, Callable[[int], Image]] = {
    "clutter without a board": _clutter,
    "chessboards of other counts": _other_board,
    "triangular checkers": lambda seed: _floor(seed, _triangles),
    "hexagonal tiles": lambda seed: _floor(seed, _hexagons),
    "square tiles": lambda seed: _floor(seed, _stretched(1.0)),
    "oblong tiles": lambda seed: _floor(seed, _stretched(1.6)),
}


if __name__ == "__main__":
    main()
