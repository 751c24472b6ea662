"""Noise of cameras and views, told from residuals whose truth is known."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.bundle import Free, Observations, ObservedView
from calichrome.geometry.bundle.noise import median_noise, view_noise
from calichrome.geometry.lenses import BrownConrady

_N_CORNERS = 54
_BOARD = np.zeros((_N_CORNERS, 3))
_SIGMA_PX = np.array([0.2, 0.5])


def _observations(n_frames: int) -> Observations:
    """Two cameras that see every frame."""
    pixels, ids = np.zeros((_N_CORNERS, 2)), np.arange(_N_CORNERS)
    views = [ObservedView(c, f, ids, pixels) for c in (0, 1) for f in range(n_frames)]
    return Observations.pack(views, _BOARD, (BrownConrady, BrownConrady), n_frames)


def _lengths(
    observations: Observations, sigma: FloatArray, rng: np.random.Generator
) -> list[FloatArray]:
    """Lengths of 2-D residuals of the noise of each view, (V, N) by chunk."""
    return [
        sigma[chunk.views, None]
        * np.linalg.norm(rng.normal(size=(2, *chunk.corner_ids.shape)), axis=0)
        for chunk in observations.chunks
    ]


def _noise(
    observations: Observations, lengths: list[FloatArray], *, views_differ: bool
) -> FloatArray:
    free = Free(
        lenses=np.zeros((2, 9), dtype=bool),
        cameras=np.zeros(2, dtype=bool),
        shape=np.zeros(0, dtype=bool),
    )
    kept = [chunk.filled for chunk in observations.chunks]
    return view_noise(observations, lengths, kept, free, views_differ=views_differ)


def test_the_median_tells_the_noise_of_a_camera_among_outliers(rng: np.random.Generator) -> None:
    observations = _observations(100)
    sigma = _SIGMA_PX[observations.camera]
    lengths = _lengths(observations, sigma, rng)
    noise = median_noise(observations, lengths)
    # four sigma of a median of 5400: 1 / (2 f(m) m sqrt(n)) with the Rayleigh density f
    np.testing.assert_allclose(noise / sigma, 1, atol=4 * 0.722 / np.sqrt(5400))
    for part in lengths:
        part[rng.uniform(size=part.shape) < 0.02] = 100
    # 2 % of outliers: the median is the quantile 0.5 / 0.98 of the rest, 1.5 % longer
    spoiled = median_noise(observations, lengths)
    np.testing.assert_allclose(spoiled / noise, 1.015, atol=0.01)


def test_views_of_equal_noise_have_that_of_their_camera(rng: np.random.Generator) -> None:
    observations = _observations(100)
    sigma = _SIGMA_PX[observations.camera]
    lengths = _lengths(observations, sigma, rng)
    by_camera = _noise(observations, lengths, views_differ=False)
    np.testing.assert_array_equal(_noise(observations, lengths, views_differ=True), by_camera)
    for camera in (0, 1):
        own = by_camera[observations.camera == camera]
        assert np.ptp(own) == 0
        # no pose was fitted to these residuals, but the three unknowns of each view are counted
        unspent = own[0] * np.sqrt((2 * _N_CORNERS - 3) / (2 * _N_CORNERS))
        relative_sigma = 1 / np.sqrt(2 * 2 * _N_CORNERS * 100)
        assert unspent == pytest.approx(_SIGMA_PX[camera], rel=4 * relative_sigma)


def test_views_of_unlike_noise_are_told_apart(rng: np.random.Generator) -> None:
    """Nearer the truth than the camera's noise, and than what each view says alone."""
    observations = _observations(60)
    sigma = _SIGMA_PX[observations.camera] * np.exp(rng.normal(0, 0.1, 120))
    lengths = _lengths(observations, sigma, rng)
    by_camera = _noise(observations, lengths, views_differ=False)
    by_view = _noise(observations, lengths, views_differ=True)
    alone = np.empty(120)
    for chunk, values in zip(observations.chunks, lengths, strict=True):
        alone[chunk.views] = np.sqrt((values**2).mean(axis=1) / 2)

    def error(noise: FloatArray) -> float:
        ratio = np.log(noise / sigma)
        return float(np.sqrt(((ratio - ratio.mean()) ** 2).mean()))

    assert error(by_view) < 0.9 * error(alone)
    assert error(by_view) < 0.9 * error(by_camera)


def test_corners_left_out_say_nothing(rng: np.random.Generator) -> None:
    observations = _observations(50)
    sigma = _SIGMA_PX[observations.camera]
    lengths = _lengths(observations, sigma, rng)
    kept = [rng.uniform(size=part.shape) < 0.8 for part in lengths]
    spoiled = [np.where(inside, part, 1e3) for inside, part in zip(kept, lengths, strict=True)]
    free = Free(
        lenses=np.ones((2, 9), dtype=bool),
        cameras=np.array([False, True]),
        shape=np.zeros(0, dtype=bool),
    )
    found, expected = (
        view_noise(observations, some, kept, free, views_differ=True) for some in (spoiled, lengths)
    )
    np.testing.assert_array_equal(found, expected)
