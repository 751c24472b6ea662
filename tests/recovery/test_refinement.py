"""Corners are recovered to the noise, with the covariance that the noise gives them.

Pictures are sampled 16 times per pixel and axis, blurred there and averaged over square pixels:
nothing of the corner model is used to make them.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.homography import apply_homography
from calichrome.detection.board_map import BoardMap
from calichrome.detection.corner_pixels import Discs
from calichrome.detection.levels import Levels
from calichrome.detection.refinement import RefinedCorners, refine_corners

_SAMPLES = 16
_SIZE_WH = (220, 180)
_CORNERS_XY = (5, 4)
_INDICES = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
_WHITE = _INDICES.sum(axis=1) % 2 == 1
_BLACK_LEVEL, _WHITE_LEVEL = 0.08, 0.8
_BLUR = 0.8
_NO_DISCS = Discs(np.zeros((5, 6, 2)))
_HALF_DISCS = Discs(np.full((5, 6, 2), 0.25))


def _homography(shift: tuple[float, float] = (0, 0)) -> FloatArray:
    return np.array([[30, 4, 45 + shift[0]], [-3, 28, 50 + shift[1]], [0.012, -0.006, 1.0]])


def _picture(homography: FloatArray, disc_ratio: float = 0) -> NDArray[np.float32]:
    width, height = _SIZE_WH
    x = (np.arange(width * _SAMPLES) + 0.5) / _SAMPLES - 0.5
    y = (np.arange(height * _SAMPLES) + 0.5) / _SAMPLES - 0.5
    points = np.asarray(np.stack(np.meshgrid(x, y), axis=-1), dtype=np.float64)
    board = apply_homography(np.asarray(np.linalg.inv(homography)), points)
    cell = np.floor(board)
    white = (cell.sum(axis=-1) % 2 == 1) | (cell < -1).any(axis=-1) | (cell >= [5, 4]).any(axis=-1)
    values = np.where(white, _WHITE_LEVEL, _BLACK_LEVEL).astype(np.float32)
    if disc_ratio:
        inside = np.hypot(*np.moveaxis(board - cell - 0.5, -1, 0)) < disc_ratio / 2
        values[inside] = 0.35
    values *= (1 + 0.15 * (points[..., 0] / width - 0.5)).astype(np.float32)
    blurred = ndimage.gaussian_filter(values, _BLUR * _SAMPLES, truncate=5)
    return np.asarray(blurred.reshape(height, _SAMPLES, width, _SAMPLES).mean(axis=(1, 3)))


def _levels(picture: NDArray[np.floating]) -> Levels:
    def levels(column: IntArray, row: IntArray) -> FloatArray:
        return np.asarray(picture[row, column], dtype=np.float64)

    return levels


def _refined(
    picture: NDArray[np.floating], start: FloatArray, discs: Discs = _NO_DISCS
) -> RefinedCorners:
    return refine_corners([_levels(picture)], start, _INDICES, _WHITE, discs, _map_of(start))


def _map_of(start: FloatArray) -> BoardMap:
    return BoardMap.fit(_INDICES.astype(np.float64), start, _SIZE_WH, lens_only=True)


@pytest.fixture(scope="module")
def clean() -> NDArray[np.float32]:
    return _picture(_homography())


@pytest.fixture(scope="module")
def truth() -> FloatArray:
    return apply_homography(_homography(), _INDICES.astype(np.float64))


def _noisy(
    clean: NDArray[np.float32], sigma: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    return np.rint((clean + rng.normal(scale=sigma, size=clean.shape)) * 255) / 255


@pytest.mark.parametrize("phase", [(0.0, 0.0), (0.25, 0.5), (0.6, 0.15), (0.5, 0.5)])
def test_no_bias_over_the_phase_of_the_pixels(
    phase: tuple[float, float], rng: np.random.Generator
) -> None:
    homography = _homography(phase)
    expected = apply_homography(homography, _INDICES.astype(np.float64))
    found = _refined(_picture(homography), expected + rng.uniform(-0.3, 0.3, (20, 2)))
    assert found.fitted.all()
    np.testing.assert_allclose(found.corners_px, expected, atol=0.003)


@pytest.mark.parametrize("ratio", [0, 0.5])
def test_covariance_is_the_scatter(
    ratio: float, truth: FloatArray, rng: np.random.Generator
) -> None:
    clean = _picture(_homography(), ratio)
    squared = []
    for _ in range(40):
        start = truth + rng.uniform(-0.3, 0.3, truth.shape)
        found = _refined(_noisy(clean, 0.01, rng), start, _HALF_DISCS if ratio else _NO_DISCS)
        error = found.corners_px - truth
        squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov_px), error))
    # 800 corners with two coordinates: one sigma is 3.5 %
    assert np.mean(squared) == pytest.approx(2, rel=0.12)
    assert np.median(np.linalg.norm(error, axis=1)) < 0.012


def test_disagreement_shows_noise_that_is_not_white(
    clean: NDArray[np.float32], truth: FloatArray, rng: np.random.Generator
) -> None:
    squared, disagreement = [], []
    for _ in range(20):
        noise = ndimage.uniform_filter(rng.normal(scale=0.03, size=clean.shape), 3)
        found = _refined(clean + noise, truth + rng.uniform(-0.2, 0.2, truth.shape))
        error = found.corners_px - truth
        squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov_px), error))
        disagreement.append(found.disagreement)
    assert np.mean(disagreement) > 3
    assert np.mean(squared) == pytest.approx(2, rel=0.3)


def test_dust_on_an_edge_is_left_out(
    clean: NDArray[np.float32], truth: FloatArray, rng: np.random.Generator
) -> None:
    picture = _noisy(clean, 0.004, rng)
    column, row = np.rint(truth[7] + [7, 0]).astype(int)
    picture[row - 1 : row + 2, column - 1 : column + 2] = 0.9
    found = _refined(picture, truth)
    np.testing.assert_allclose(found.corners_px[7], truth[7], atol=0.03)


def test_covered_corner_is_set_apart(
    clean: NDArray[np.float32], truth: FloatArray, rng: np.random.Generator
) -> None:
    picture = _noisy(clean, 0.004, rng)
    column, row = np.rint(truth[6]).astype(int)
    picture[row - 9 : row + 10, column - 9 : column + 10] = 0.3
    found = _refined(picture, truth + 0.1)
    assert not found.fitted[6]
    others = np.delete(np.arange(20), 6)
    assert found.fitted[others].all()
    np.testing.assert_allclose(found.corners_px[others], truth[others], atol=0.03)
    assert np.sqrt(found.cov_px[6, 0, 0]) >= 0.1


def test_a_start_far_off_the_others_is_pulled_in(
    clean: NDArray[np.float32], truth: FloatArray, rng: np.random.Generator
) -> None:
    start = truth.copy()
    start[9] += 2.0
    found = _refined(_noisy(clean, 0.004, rng), start)
    np.testing.assert_allclose(found.corners_px[9], truth[9], atol=0.03)


def test_clipped_white_does_not_pull(
    clean: NDArray[np.float32], truth: FloatArray, rng: np.random.Generator
) -> None:
    picture = np.minimum(_noisy(1.6 * clean, 0.004, rng), 1.0)
    assert (picture[20:160, 40:190] == 1).mean() > 0.3
    found = _refined(picture, truth + rng.uniform(-0.3, 0.3, truth.shape))
    np.testing.assert_allclose(found.corners_px, truth, atol=0.03)


@pytest.mark.parametrize("encoded", [True, False])
def test_edges_tell_whether_the_picture_is_encoded(
    encoded: bool,  # noqa: FBT001 (parameter)
    clean: NDArray[np.float32],
    truth: FloatArray,
    rng: np.random.Generator,
) -> None:
    picture = _noisy(clean ** (1 / 2.2) if encoded else clean, 0.004, rng)
    readings = [_levels(picture**2.2), _levels(picture)]
    found = refine_corners(readings, truth, _INDICES, _WHITE, _NO_DISCS, _map_of(truth))
    assert found.reading == (0 if encoded else 1)
    np.testing.assert_allclose(found.corners_px, truth, atol=0.02)
