"""Several pictures of one print."""

import numpy as np
import pytest

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.print_reading import PrintReading, combine_readings
from calichrome.core.arrays import FloatArray

RELATIVE = np.array([[0.30, 0.25, 0.10], [0.20, 0.30, 0.25], [0.55, 0.60, 0.62]])
PAPER_Y = 0.85
NOISE = 0.002


def _reading(
    relative: FloatArray = RELATIVE,
    *,
    ids: tuple[int, ...] = (0, 1, 2),
    paper_y: float = PAPER_Y,
    level_sigma: float = 0.01,
    noise: float = NOISE,
    model: float = 1.0,
) -> PrintReading:
    cov = np.tile(noise**2 * np.eye(3), (len(ids), 1, 1))
    return PrintReading(
        marker_ids=np.array(ids),
        relative=relative[list(ids)],
        cov=cov,
        shared_cov=0 * cov,
        white=np.array([0.95, 1.0, 1.07]),
        black=np.array([0.05, 0.05, 0.05]),
        paper_y=paper_y,
        level_sigma=level_sigma,
        model_delta_e=model,
        clipped=np.zeros(3, dtype=bool),
    )


def test_discs_are_relative_to_the_paper() -> None:
    """A picture whose level is off moves all colours by one factor, and none against another."""
    one = combine_readings([_reading()], 3)
    other = combine_readings([_reading(paper_y=0.8)], 3)
    np.testing.assert_allclose(one.xyz_d65, PAPER_Y * RELATIVE)
    np.testing.assert_allclose(other.xyz_d65, 0.8 * RELATIVE)
    assert other.white_xyz_d65[1] == pytest.approx(0.8)


def test_better_levels_count_more_and_their_error_is_not_averaged_away() -> None:
    readings = [_reading(paper_y=0.80, level_sigma=0.04), _reading(paper_y=0.85, level_sigma=0.01)]
    both = combine_readings(readings, 3)
    assert 0.84 < both.white_xyz_d65[1] < 0.85
    alike = combine_readings([_reading() for _ in range(9)], 3)
    assert alike.level_sigma == pytest.approx(0.01)


def test_levels_that_scatter_more_than_stated_say_so() -> None:
    readings = [_reading(paper_y=y, level_sigma=0.005) for y in (0.80, 0.84, 0.88, 0.92)]
    assert combine_readings(readings, 3).level_sigma > 0.03


def test_a_highlight_in_one_picture_is_left_out() -> None:
    shining = RELATIVE + np.array([[0.0], [0.1], [0.0]])
    found = combine_readings([_reading(), _reading(), _reading(), _reading(shining)], 3)
    np.testing.assert_allclose(found.xyz_d65, PAPER_Y * RELATIVE)
    np.testing.assert_array_equal(found.n_pictures, [4, 3, 4])


def test_discs_that_no_picture_shows_are_nan() -> None:
    found = combine_readings([_reading(ids=(0, 2)), _reading(ids=(0,))], 3)
    np.testing.assert_array_equal(found.n_pictures, [2, 0, 1])
    assert np.isnan(found.xyz_d65[1]).all()


def test_noise_is_averaged_and_the_camera_is_not(rng: np.random.Generator) -> None:
    """The stated error is that of the mean of nine noisy pictures, model apart."""
    errors, stated = [], []
    for _ in range(60):
        noisy = [_reading(RELATIVE + rng.normal(0, NOISE, (3, 3)), model=0.0) for _ in range(9)]
        found = combine_readings(noisy, 3)
        errors.append(delta_e_2000_xyz(found.xyz_d65, PAPER_Y * RELATIVE))
        stated.append(found.sigma_delta_e)
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated)))
    assert 0.8 < ratio < 1.2
    with_camera = combine_readings([_reading(model=1.2) for _ in range(9)], 3)
    assert (with_camera.sigma_delta_e > 1.2).all()
    assert with_camera.model_delta_e == pytest.approx(1.2)
