"""The light of a view is a smooth surface through its white squares."""

import numpy as np
import pytest

from calichrome.colour.light import READING_REACH_SQUARES, Neighbourhoods, fit_light, light_at
from calichrome.core.arrays import FloatArray
from calichrome.detection import square_levels
from calichrome.target import Target


def _grid(n_columns: int, n_rows: int) -> FloatArray:
    x, y = np.meshgrid(np.linspace(100, 500, n_columns), np.linspace(80, 380, n_rows))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _field(positions: FloatArray, order: int) -> FloatArray:
    """Up to 40 % of fall-off, each channel its own."""
    x, y = ((positions - [300, 230]) / 400).T
    quadratic = 0.3 * x**2 - 0.2 * x * y + 0.25 * y**2 if order == 2 else 0
    level = 0.7 + 0.2 * x - 0.1 * y - quadratic
    return np.stack([level, 0.8 * level + 0.05 * x, 0.5 + 0.1 * y + 0 * x], axis=1)


@pytest.mark.parametrize(("n_columns", "n_rows", "order"), [(6, 4, 2), (4, 3, 2), (3, 2, 1)])
def test_exact_fields_are_reproduced(n_columns: int, n_rows: int, order: int) -> None:
    positions = _grid(n_columns, n_rows)
    truth = _field(positions, order)
    np.testing.assert_allclose(light_at(positions, truth), truth, rtol=1e-10)


def test_unit_and_origin_do_not_matter(rng: np.random.Generator) -> None:
    positions = _grid(6, 4)
    white = _field(positions, 2) * rng.normal(1, 0.01, (24, 1))
    expected = light_at(positions, white)
    np.testing.assert_allclose(light_at(positions * 1e-3 + 12, white), expected, rtol=1e-9)


def test_unknown_whites_are_filled_in() -> None:
    positions = _grid(6, 4)
    truth = _field(positions, 2)
    white = truth.copy()
    white[[3, 10, 11]] = np.nan
    white[17, 1] = np.nan  # one clipped channel spoils the reading
    np.testing.assert_allclose(light_at(positions, white), truth, rtol=1e-9)


def test_one_shadowed_square_is_ignored(rng: np.random.Generator) -> None:
    positions = _grid(6, 4)
    truth = _field(positions, 2)
    noisy = truth * rng.normal(1, 0.003, truth.shape)
    shadowed = noisy.copy()
    shadowed[8] *= 0.5
    error = np.abs(light_at(positions, shadowed) / truth - 1).max()
    # A plain fit would be pulled by 7 %; noise of 0.3 % and what is left of the shadow: 2 %.
    assert error < 0.02
    assert np.abs(_plain_fit(positions, shadowed) / truth - 1).max() > 0.05


def _plain_fit(positions: FloatArray, white: FloatArray) -> FloatArray:
    x, y = ((positions - [300, 230]) / 400).T
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    solution, *_ = np.linalg.lstsq(design, white, rcond=None)
    return np.asarray(design @ solution)


def test_few_whites_give_their_median() -> None:
    positions = _grid(5, 1)
    white = np.array([[0.5, 0.6, 0.7]] * 4 + [[0.1, 0.1, 0.1]])
    np.testing.assert_array_equal(light_at(positions, white), [[0.5, 0.6, 0.7]] * 5)


def test_no_whites_give_no_light() -> None:
    assert np.isnan(light_at(_grid(3, 2), np.full((6, 3), np.nan))).all()


def _bowl(places: FloatArray) -> FloatArray:
    """Light that falls off by a fifth from the middle of the board to its edge."""
    x, y = places.T / 0.15
    level = 0.6 - 0.15 * x**2 - 0.1 * y**2 + 0.05 * x
    return np.asarray(level[:, None] * np.array([1.0, 0.9, 0.8]))


def test_neighbourhoods_are_those_of_the_detection(standard_target: Target) -> None:
    assert READING_REACH_SQUARES == square_levels._NEIGHBOUR_SQUARES
    around = Neighbourhoods.around_discs(standard_target)
    nx, ny = standard_target.squares
    levels = np.full((ny, nx, 3), 0.05)
    centres = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1) - 0.5
    places = (centres * np.array(standard_target.square_m)).reshape(-1, 2).astype(np.float64)
    white = ~standard_target.black_squares
    levels[white] = _bowl(places).reshape(ny, nx, 3)[white]
    measured = square_levels.SquareLevels(
        rgb=levels,
        cov_rgb=np.zeros((ny, nx, 3, 3)),
        n_samples=np.full((ny, nx), 50),
        clipped=np.zeros((ny, nx)),
        covered=np.zeros((ny, nx), dtype=bool),
    )
    read = square_levels.levels_at_discs(standard_target, measured, "white")
    np.testing.assert_allclose(around.weights @ _bowl(around.squares_board), read, rtol=1e-9)


@pytest.mark.parametrize("lens", [False, True])
def test_curved_light_is_read_at_the_disc_itself(standard_target: Target, *, lens: bool) -> None:
    around = Neighbourhoods.around_discs(standard_target)
    discs, squares = around.discs_board, around.squares_board
    gain, square_gain = np.ones((len(discs), 3)), np.ones((len(discs), len(squares), 3))
    if lens:
        gain *= np.exp(-20 * (discs**2).sum(axis=1))[:, None]
        square_gain *= np.exp(-20 * (squares**2).sum(axis=1))[:, None]
    truth = _bowl(discs) * gain
    read = np.einsum("mq,mqk->mk", around.weights, _bowl(squares)[None] * square_gain)
    assert np.abs(read / truth - 1).max() > 0.01  # a plane through squares misreads a bowl
    level, variance = fit_light(
        discs, read, squares=squares, weights=around.weights, gain=gain, square_gain=square_gain
    )
    np.testing.assert_allclose(level, truth, rtol=1e-9)
    assert (variance < 1e-15).all()


def test_scatter_of_the_light_is_what_its_variance_says(
    standard_target: Target, rng: np.random.Generator
) -> None:
    around = Neighbourhoods.around_discs(standard_target)
    truth = _bowl(around.squares_board)
    squares, told = [], []
    for _ in range(200):
        noisy = truth + rng.normal(0, 0.003, truth.shape)
        level, variance = fit_light(
            around.discs_board,
            around.weights @ noisy,
            squares=around.squares_board,
            weights=around.weights,
        )
        squares.append((level - _bowl(around.discs_board)) ** 2)
        told.append(variance)
    ratio = np.mean(squares, axis=0) / np.mean(told, axis=0)
    # 200 draws: 10 % for a single disc and channel; discs go together, and reweighting adds 4 %
    assert np.median(ratio) == pytest.approx(1, abs=0.15)
