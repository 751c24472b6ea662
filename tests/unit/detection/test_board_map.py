"""The map from the board to the picture."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography
from calichrome.detection.board_map import BoardMap

_SIZE_WH = (1280, 960)
_HOMOGRAPHY = np.array([[60, 5, 300], [-8, 50, 200], [0.02, 0.01, 1.0]])
_LATTICE = np.stack(np.meshgrid(np.arange(8.0), np.arange(7.0)), axis=-1).reshape(-1, 2)


def _seen(points: FloatArray, k1: float = -0.25) -> FloatArray:
    ideal = apply_homography(_HOMOGRAPHY, points)
    centre = np.array([645.0, 475.0])
    away = (ideal - centre) / 800
    r2 = (away**2).sum(axis=1)
    return np.asarray(centre + 800 * away * (1 + k1 * r2 + 0.03 * r2**2)[:, None])


def test_distorted_board_is_mapped_exactly() -> None:
    board_map = BoardMap.fit(_LATTICE, _seen(_LATTICE), _SIZE_WH, _isotropic(1e-4))
    between = _LATTICE[:-8] + 0.5
    np.testing.assert_allclose(board_map(between), _seen(between), atol=1e-3)
    outside = np.array([[-1.0, -1.0], [8.0, 7.0]])
    np.testing.assert_allclose(board_map(outside), _seen(outside), atol=1e-2)


def test_one_wild_corner_does_not_bend_the_map() -> None:
    corners = _seen(_LATTICE)
    corners[20] += 3
    board_map = BoardMap.fit(_LATTICE, corners, _SIZE_WH, _isotropic(0.02))
    others = np.delete(np.arange(len(_LATTICE)), 20)
    np.testing.assert_allclose(board_map(_LATTICE[others]), corners[others], atol=0.02)


def test_jacobian_is_that_of_the_map() -> None:
    board_map = BoardMap.fit(_LATTICE, _seen(_LATTICE), _SIZE_WH, _isotropic(1e-3))
    at = np.array([3.2, 2.7])
    step = 0.01
    numeric = [
        (board_map(at + step * unit) - board_map(at - step * unit)) / (2 * step)
        for unit in np.eye(2)
    ]
    np.testing.assert_allclose(board_map.jacobian(at), np.transpose(numeric), rtol=1e-4)


def test_straight_lines_have_no_curvature() -> None:
    board_map = BoardMap.fit(
        _LATTICE, apply_homography(_HOMOGRAPHY, _LATTICE), _SIZE_WH, _isotropic(1e-3)
    )
    np.testing.assert_allclose(board_map.edges(_LATTICE).curvature, 0, atol=1e-7)


def test_covariance_is_the_scatter(rng: np.random.Generator) -> None:
    sigma = 0.01
    points, bends, predicted = [], [], []
    for _ in range(150):
        corners = _seen(_LATTICE) + rng.normal(scale=sigma, size=_LATTICE.shape)
        board_map = BoardMap.fit(_LATTICE, corners, _SIZE_WH, _isotropic(sigma))
        points.append(board_map(_LATTICE))
        edges = board_map.edges(_LATTICE)
        bends.append(edges.curvature)
        spread = np.einsum("nii->ni", board_map.covariance_at(_LATTICE))
        predicted.append([spread, edges.variance])
    # 150 draws tell a variance to 12 %; the coordinates share about 12 parameters
    of_points, of_bends = np.mean(predicted, axis=0)
    assert np.mean(np.var(points, axis=0) / of_points) == pytest.approx(1, abs=0.15)
    assert np.mean(np.var(bends, axis=0) / of_bends) == pytest.approx(1, abs=0.15)


def test_misfit_tells_wrong_covariances(rng: np.random.Generator) -> None:
    corners = _seen(_LATTICE) + rng.normal(scale=0.02, size=_LATTICE.shape)
    misfit = BoardMap.fit(_LATTICE, corners, _SIZE_WH, _isotropic(0.01)).misfit
    assert misfit == pytest.approx(4, rel=0.4)  # 100 degrees of freedom: 14 % a sigma


def _isotropic(sigma: float) -> FloatArray:
    return np.broadcast_to(sigma**2 * np.eye(2), (len(_LATTICE), 2, 2))
