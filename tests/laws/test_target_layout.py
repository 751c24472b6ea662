"""Any two parts of a board differ: checked square by square, without the arrays of the search."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.target import Target, design_target, layout_quality
from calichrome.target.board import SquareColour
from calichrome.target.palette import colour_checker_palette

Cell = tuple[SquareColour, str | None]  # kind of the square, name of its disc
Part = tuple[tuple[Cell, ...], ...]

# What the decision page promises for these boards (docs/decisions/0001-layout-of-colours.md).
LEAST_DIFFERING = 6
FEWEST_DISCS = 6
LEAST_RESIDUAL = 0.15


@pytest.fixture(scope="module", params=[(9, 6), (10, 9), (14, 9)], ids=["9x6", "10x9", "14x9"])
def target(request: pytest.FixtureRequest, standard_target: Target) -> Target:
    if request.param == standard_target.squares:
        return standard_target
    return design_target(
        squares=request.param, square_m=(0.03, 0.03), palette=colour_checker_palette()
    )


def _cells(target: Target) -> dict[tuple[int, int], Cell]:
    names = {marker.square: marker.name for marker in target.markers}
    nx, ny = target.squares
    return {
        (ix, iy): (target.square_colour(ix, iy), names.get((ix, iy)))
        for ix in range(nx)
        for iy in range(ny)
    }


def _quarter_turn(part: Part) -> Part:
    return tuple(zip(*part[::-1], strict=True))


def _parts(target: Target) -> Iterator[Part]:
    """Yield what a camera may see as 4 columns and 3 rows: each part upright and turned."""
    cells = _cells(target)
    nx, ny = target.squares
    for columns, rows in ((4, 3), (3, 4)):
        for x in range(nx - columns + 1):
            for y in range(ny - rows + 1):
                part: Part = tuple(
                    tuple(cells[x + dx, y + dy] for dx in range(columns)) for dy in range(rows)
                )
                if columns == 3:
                    part = _quarter_turn(part)
                yield part
                yield _quarter_turn(_quarter_turn(part))


def _flat(part: Part) -> list[Cell]:
    return [cell for row in part for cell in row]


def _confusable(target: Target) -> Iterator[tuple[list[Cell], list[Cell]]]:
    for first, second in combinations([_flat(part) for part in _parts(target)], 2):
        if first[0][0] == second[0][0]:
            yield first, second


def test_no_two_parts_look_alike(target: Target) -> None:
    least = min(
        sum(a != b for a, b in zip(first, second, strict=True))
        for first, second in _confusable(target)
    )
    assert least >= LEAST_DIFFERING
    quality = layout_quality(target)
    assert quality is not None
    assert quality.least_differing == least


def test_every_part_shows_enough_discs(target: Target) -> None:
    counts = [sum(name is not None for _, name in _flat(part)) for part in _parts(target)]
    assert min(counts) >= FEWEST_DISCS
    quality = layout_quality(target)
    assert quality is not None
    assert (quality.n_placements, quality.fewest_discs) == (len(counts), min(counts))


def test_no_light_explains_an_exchange_of_parts(target: Target) -> None:
    """The residual of the best affine map, by numpy's least squares pair by pair."""
    rgb = {m.name: RGB_FROM_XYZ["srgb"] @ np.array(m.xyz_d65) for m in target.markers}
    white, black = np.full(3, 0.85), np.full(3, 0.04)  # neutral; as assumed for unmeasured paper
    least = np.inf
    for pair in _confusable(target):
        if sum((a[1] is None) != (b[1] is None) for a, b in zip(*pair, strict=True)) > 2:
            continue
        for source, seen in (pair, pair[::-1]):
            both = [(a[1], b[1]) for a, b in zip(source, seen, strict=True) if a[1] and b[1]]
            x = np.array([*(rgb[a] for a, _ in both), white, black])
            y = np.array([*(rgb[b] for _, b in both), white, black])
            x1 = np.column_stack([x, np.ones(len(x))])
            residual = y - x1 @ np.linalg.lstsq(x1, y, rcond=None)[0]
            spread = y - y.mean(axis=0)
            least = min(least, float(np.linalg.norm(residual) / np.linalg.norm(spread)))
    assert least >= LEAST_RESIDUAL
    quality = layout_quality(target)
    assert quality is not None
    # the ridge of 1e-9 in the batched solution, and white as D65 to four digits
    assert quality.least_residual == pytest.approx(least, abs=1e-3)


def test_parts_of_a_regular_board_are_known_to_look_alike(standard_target: Target) -> None:
    """The judgement can fail: one colour on every black square."""
    marker = next(m for m in standard_target.markers if m.background == "black")
    markers = tuple(
        replace(marker, square=(int(ix), int(iy)))
        for iy, ix in np.argwhere(standard_target.black_squares)
    )
    quality = layout_quality(replace(standard_target, markers=markers))
    assert quality is not None
    assert (quality.least_differing, quality.least_presence) == (0, 0)
    assert quality.least_residual == pytest.approx(0, abs=1e-6)
    assert quality.share_with_enough_discs == 1


def test_a_plain_board_has_no_layout_to_judge() -> None:
    assert layout_quality(Target(squares=(9, 6), square_m=(0.03, 0.03))) is None
