from collections import Counter

import numpy as np
import pytest

from calichrome.errors import TargetError
from calichrome.target import (
    PaletteColour,
    SquareColour,
    Target,
    arrange_colours,
    check_target,
    design_target,
)
from calichrome.target.design import (
    LARGEST_DISC_RATIO,
    SMALLEST_DISC_RATIO,
    SMALLEST_SQUARE_PX,
    smallest_square_px,
)

Palette = tuple[PaletteColour, ...]


def _design(palette: Palette, squares: tuple[int, int] = (9, 6), ratio: float = 0.5) -> Target:
    return design_target(squares=squares, square_m=(0.03, 0.02), palette=palette, disc_ratio=ratio)


@pytest.mark.parametrize("squares", [(9, 9), (8, 6), (5, 7)])
def test_equal_parity_is_refused_and_the_named_boards_are_not(
    palette: Palette, squares: tuple[int, int]
) -> None:
    nx, ny = squares
    with pytest.raises(TargetError, match=rf"print {nx + 1}x{ny} or {nx}x{ny + 1} squares"):
        _design(palette, squares)
    for named in ((nx + 1, ny), (nx, ny + 1)):
        assert _design((), named).has_unique_orientation


@pytest.mark.parametrize("ratio", [0.63, 0.95, 0.4, float("nan")])
def test_discs_too_large_or_too_small_are_refused(palette: Palette, ratio: float) -> None:
    with pytest.raises(TargetError, match=r"use 0\.\d+ or (less|more)"):
        _design(palette, ratio=ratio)


def test_limits_of_the_ratio_follow_from_window_and_blur() -> None:
    # notes on detection: w <= (0.5 - 0.354 ratio) s - (1 + sigma_psf), w = 0.18 s
    assert smallest_square_px(LARGEST_DISC_RATIO) <= SMALLEST_SQUARE_PX
    assert smallest_square_px(LARGEST_DISC_RATIO + 0.005) > SMALLEST_SQUARE_PX
    s = smallest_square_px(0.5)
    assert 0.18 * s == pytest.approx((0.5 - 0.354 * 0.5) * s - 2)
    # 3x3 pixels (corner at 1.5 sqrt 2) and 2 px of blur fit into the smallest disc, just
    radius_px = SMALLEST_DISC_RATIO * SMALLEST_SQUARE_PX / 2
    assert 0 <= radius_px - (1.5 * 2**0.5 + 2) < 0.1  # the ratio has two digits


def test_colours_repeat_equally_and_stand_on_the_other_lightness(standard_target: Target) -> None:
    counts = Counter(marker.name for marker in standard_target.markers)
    assert len(counts) == 24
    assert set(counts.values()) == {2}  # round(0.6 * 90 / 24)
    for marker in standard_target.markers:
        lightness = 116 * marker.xyz_d65[1] ** (1 / 3) - 16
        assert marker.background == ("white" if lightness < 50 else "black")
        assert marker.diameter_m == pytest.approx(0.015)


def test_our_boards_give_no_reason_for_remarks(standard_target: Target) -> None:
    assert check_target(standard_target) == []


def test_a_palette_too_large_names_a_board_that_holds_it(palette: Palette) -> None:
    with pytest.raises(TargetError, match=r"7x5|8x5") as caught:  # 16 bright colours: 32 squares
        _design(palette, (6, 5))
    named = str(caught.value).partition("print ")[2].partition(" ")[0]
    nx, ny = (int(number) for number in named.split("x"))
    assert len(_design(palette, (nx, ny)).markers) == 24


def test_a_board_too_large_to_search_is_refused(palette: Palette) -> None:
    with pytest.raises(TargetError, match="fewer and larger squares"):
        _design(palette, (60, 41))


def test_a_name_given_twice_is_refused(palette: Palette) -> None:
    with pytest.raises(TargetError, match="cyan twice"):
        _design((*palette, *(colour for colour in palette if colour.name == "cyan")))


def test_few_colours_fill_the_board_as_far_as_their_squares_go() -> None:
    black = Target(squares=(7, 4), square_m=(0.03, 0.03)).black_squares
    colour_of_square = arrange_colours(black, ["black"] * 3)
    # 0.6 of 28 squares would be 6 times each, but only 14 squares are black
    assert np.bincount(colour_of_square[black] + 1).tolist() == [2, 4, 4, 4]
    assert (colour_of_square[~black] == -1).all()


def test_an_empty_palette_is_a_plain_chessboard() -> None:
    target = _design(())
    assert target.markers == ()
    assert target.squares == (9, 6)


def test_seeds_decide() -> None:
    black = Target(squares=(7, 6), square_m=(0.03, 0.03)).black_squares
    kinds: list[SquareColour] = ["black", "black", "black", "black", "white", "white", "white"]
    first, again, other = (arrange_colours(black, kinds, seed=seed) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()
