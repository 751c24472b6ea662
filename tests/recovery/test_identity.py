"""Parts of boards put back in their place by colour, for cameras and lights unknown to the finder.

No pictures: what squares look like is computed from spectra, with the errors that prints, light,
noise, full scale and fingers bring, so that thousands of views can be tried.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from calichrome.colorimetry.difference import lab_from_xyz, xyz_from_lab
from calichrome.colorimetry.reference import (
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
)
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.identity import candidate_placements, choose_by_colour
from calichrome.detection.square_looks import SquareLooks
from calichrome.synthetic.spectra import black_ink, paper_white
from calichrome.target import Target, colour_checker_palette, design_target

_LIGHTS = ("A", "D65", "LED-B4")
_TURNS = [np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]])]
_TURNS += [-turn for turn in _TURNS]


@dataclass(frozen=True)
class _Lattice:
    indices: IntArray
    black_parity: int


@dataclass(frozen=True)
class _Conditions:
    """Sizes of what goes wrong; shares and levels of the step from black to white."""

    noise: float = 0.01
    print_lab_sd: float = 3.0
    fingers: float = 0.02
    overexposed: float = 0.2


_USUAL = _Conditions()
_ROUGH = _Conditions(noise=0.02, print_lab_sd=5.0, fingers=0.1)


@pytest.fixture(scope="module")
def small_target() -> Target:
    """9x6 squares, each colour once."""
    return design_target(squares=(9, 6), square_m=(0.03, 0.03), palette=colour_checker_palette())


@pytest.fixture(scope="module")
def seen_colours() -> list[FloatArray]:
    """Colours (24, 3) of the palette, 0 black and 1 white, for each camera and light."""
    reflectances = np.array(list(colour_checker_spectra().values()))
    colours = []
    for sensitivity in camera_sensitivities().values():
        for light in _LIGHTS:
            weights = sensitivity * illuminant(light)[:, None]
            white, black = paper_white() @ weights, black_ink() @ weights
            colours.append((reflectances @ weights - black) / (white - black))
    return colours


def _print_and_develop(
    colours: FloatArray, conditions: _Conditions, rng: np.random.Generator
) -> FloatArray:
    """Add the errors of a print, and the colour matrix of a camera."""
    xyz = np.array([colour.xyz_d65 for colour in colour_checker_palette()])
    lab = lab_from_xyz(xyz) + rng.normal(0, conditions.print_lab_sd, xyz.shape)
    colours = colours * np.clip(xyz_from_lab(lab) / xyz, 0.3, 3)
    mixing = rng.normal(0, 0.12, (3, 3))
    matrix = np.eye(3) + mixing - mixing.mean(axis=1, keepdims=True)
    saturation = rng.uniform(1, 1.4)
    grey = colours.mean(axis=1, keepdims=True)
    return np.asarray((grey + saturation * (colours - grey)) @ matrix.T)


def _view(
    target: Target,
    window: tuple[int, int],
    colours: FloatArray,
    conditions: _Conditions,
    rng: np.random.Generator,
    *,
    mirrored: bool = False,
) -> tuple[_Lattice, SquareLooks, IntArray]:
    """Show a window of squares somewhere on the board; also its true corner ids."""
    width, height = window if rng.integers(2) else window[::-1]
    nx, ny = target.squares
    x, y = rng.integers(nx - width + 1), rng.integers(ny - height + 1)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    squares = np.stack([x + columns.ravel(), y + rows.ravel()], axis=1)
    kept = (columns > 0) & (rows > 0)
    corners = squares[kept.ravel()] - 1  # the upper left corner of each square but the first

    turn = _TURNS[rng.integers(4)]
    if mirrored:
        turn = turn @ np.array([[-1, 0], [0, 1]])
    first = (corners @ turn).min(axis=0)
    # Centres of squares lie half a square off the corners before they are turned.
    cells = np.floor((squares - 0.5) @ turn - first).astype(np.int64)
    black = target.black_squares[squares[:, 1], squares[:, 0]]
    parity = int((cells[0].sum() + (0 if black[0] else 1)) % 2)
    across = (columns > 0).astype(int) + (columns < width - 1)
    along = (rows > 0).astype(int) + (rows < height - 1)
    levels, clipped, white_clipped = _levels(target, squares, black, colours, conditions, rng)
    looks = SquareLooks(
        cells=cells,
        black=black,
        n_corners=(across * along).ravel(),
        levels=levels,
        variance=np.full(levels.shape, conditions.noise**2),
        clipped=clipped,
        white_clipped=white_clipped,
    )
    lattice = _Lattice(corners @ turn - first, parity)
    return lattice, looks, corners @ [1, target.corners_xy[0]]


def _levels(
    target: Target,
    squares: IntArray,
    black: BoolArray,
    colours: FloatArray,
    conditions: _Conditions,
    rng: np.random.Generator,
) -> tuple[FloatArray, BoolArray, BoolArray]:
    names = [colour.name for colour in colour_checker_palette()]
    printed = {marker.square: names.index(marker.name) for marker in target.markers}
    levels = np.where(black[:, None], 0.0, np.ones(3))
    for index, square in enumerate(map(tuple, squares.tolist())):
        if square in printed:
            levels[index] = colours[printed[square]]
    # light is not quite that of the neighbours; stray light lifts everything
    levels = levels * (1 + rng.normal(0, 0.03, (len(levels), 1))) + rng.normal(0, 0.01)
    covered = rng.random(len(levels)) < conditions.fingers
    levels[covered] = rng.uniform(0, 1.1, (covered.sum(), 1)) * rng.uniform(0.6, 1, 3)
    levels += rng.normal(0, conditions.noise, levels.shape)
    white_clipped = np.zeros(3, dtype=bool)
    if rng.random() < conditions.overexposed:
        gain = rng.uniform(0.8, 1.4, 3)
        white_clipped = gain > 1
        levels = levels * np.where(white_clipped, gain, 1)
    clipped = white_clipped & (levels >= 1)
    return np.where(clipped, 1.0, levels), clipped, white_clipped


@dataclass(frozen=True)
class _Tally:
    n_views: int
    n_placed: int
    n_wrong: int
    refusals: tuple[str, ...]


def _try(
    target: Target,
    colours: list[FloatArray],
    rng: np.random.Generator,
    n_views: int,
    *,
    window: tuple[int, int] = (4, 3),
    conditions: _Conditions = _USUAL,
    claimed: Target | None = None,
    mirrored: bool = False,
) -> _Tally:
    """Place views of a board, which the finder may be told to be another one."""
    n_wrong = 0
    refusals = []
    believed = target if claimed is None else claimed
    for _ in range(n_views):
        seen = _print_and_develop(colours[rng.integers(len(colours))], conditions, rng)
        lattice, looks, ids = _view(target, window, seen, conditions, rng, mirrored=mirrored)
        candidates = candidate_placements(lattice, believed)
        chosen = choose_by_colour(candidates, looks, believed)
        if isinstance(chosen, str):
            refusals.append(chosen)
        elif claimed is not None or mirrored:
            n_wrong += 1
        else:
            n_wrong += not np.array_equal(candidates.corner_ids(chosen, lattice, believed), ids)
    return _Tally(n_views, n_views - len(refusals), n_wrong, tuple(refusals))


@pytest.mark.slow
def test_windows_of_4x3_squares_are_placed(
    standard_target: Target,
    small_target: Target,
    seen_colours: list[FloatArray],
    rng: np.random.Generator,
) -> None:
    """Both boards show 6 discs or more in every such window."""
    for target in (standard_target, small_target):
        tally = _try(target, seen_colours, rng, 500)
        assert tally.n_wrong == 0
        assert tally.n_placed >= 0.98 * tally.n_views


@pytest.mark.slow
def test_smaller_windows_are_placed_or_refused(
    standard_target: Target, seen_colours: list[FloatArray], rng: np.random.Generator
) -> None:
    placed = []
    for window in ((3, 2), (3, 3), (5, 4)):
        tally = _try(standard_target, seen_colours, rng, 200, window=window)
        assert tally.n_wrong == 0
        placed.append(tally.n_placed)
    assert all(fewer <= more for fewer, more in pairwise(placed))


def test_fingers_and_poor_prints_do_not_mislead(
    small_target: Target, seen_colours: list[FloatArray], rng: np.random.Generator
) -> None:
    tally = _try(small_target, seen_colours, rng, 400, conditions=_ROUGH)
    assert tally.n_wrong == 0


def test_mirrored_views_are_named(
    standard_target: Target, seen_colours: list[FloatArray], rng: np.random.Generator
) -> None:
    tally = _try(standard_target, seen_colours, rng, 200, window=(5, 4), mirrored=True)
    assert tally.n_placed == 0
    n_named = sum("mirrored" in reason for reason in tally.refusals)
    assert n_named >= 0.95 * tally.n_views


def test_views_of_another_board_are_refused(
    standard_target: Target,
    small_target: Target,
    seen_colours: list[FloatArray],
    rng: np.random.Generator,
) -> None:
    tally = _try(small_target, seen_colours, rng, 300, claimed=standard_target)
    assert tally.n_placed == 0


@pytest.mark.slow
@pytest.mark.parametrize("conditions", [_USUAL, _ROUGH], ids=["usual", "rough"])
def test_no_placement_is_wrong(
    standard_target: Target,
    small_target: Target,
    seen_colours: list[FloatArray],
    rng: np.random.Generator,
    conditions: _Conditions,
) -> None:
    for target in (standard_target, small_target):
        for window in ((3, 2), (3, 3), (4, 3), (5, 4)):
            tally = _try(target, seen_colours, rng, 700, window=window, conditions=conditions)
            assert tally.n_wrong == 0, window
