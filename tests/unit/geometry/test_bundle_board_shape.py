"""Bow and aspect of a board: what they move, and that no pose can do the same."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.bundle import BoardShape
from calichrome.geometry.bundle.board_shape import BOW_TERMS


def _grid(nx: int, ny: int, square_m: tuple[float, float] = (0.03, 0.02)) -> FloatArray:
    x, y = np.meshgrid(np.arange(nx) * square_m[0], np.arange(ny) * square_m[1])
    return np.stack([x.ravel(), y.ravel(), np.zeros(nx * ny)], axis=1)


@pytest.mark.parametrize("corners_xy", [(3, 3), (9, 6), (6, 9), (11, 8), (4, 15)])
@pytest.mark.parametrize("n_missing", [0, 1])
def test_bow_is_orthogonal_to_flat_boards_and_within_itself(
    corners_xy: tuple[int, int], n_missing: int
) -> None:
    """On a whole grid symmetry does most of it; without its first corner nothing helps."""
    points = _grid(*corners_xy)[n_missing:]
    shape = BoardShape.bowed(points, 5)
    assert shape.names == BOW_TERMS
    assert not shape.basis[:, :2].any()  # along z only
    heights = np.stack([np.ones(len(points)), *points[:, :2].T, *shape.basis[:, 2]])
    heights /= np.linalg.norm(heights, axis=1, keepdims=True)
    products = heights @ heights.T
    np.testing.assert_allclose(products[3:, :3], 0, atol=1e-12)
    np.testing.assert_allclose(products[3:, 3:], np.eye(5), atol=1e-12)


def test_a_bow_parameter_is_a_sagitta_in_metres() -> None:
    points = _grid(9, 6)
    shape = BoardShape.bowed(points, 5)
    np.testing.assert_allclose(np.ptp(shape.basis[:, 2], axis=1), 1)
    # A sheet bent to a cylinder around y, of 250 mm chord and 1 mm sagitta; a circle differs from
    # a parabola by s (s / chord)^2, 2e-8 m
    x = np.linspace(-0.125, 0.125, 11)
    sheet = np.stack([np.tile(x, 8), np.repeat(np.arange(8) * 0.025, 11), np.zeros(88)], axis=1)
    radius = (0.125**2 + 0.001**2) / 0.002
    sagged = np.sqrt(radius**2 - sheet[:, 0] ** 2)
    fitted = BoardShape.bowed(sheet, 5)
    heights = fitted.basis[:, 2]
    parameters = heights @ sagged / (heights**2).sum(axis=1)
    np.testing.assert_allclose(parameters, [-0.001, 0, 0, 0, 0], atol=1e-7)
    left = sagged - parameters @ heights
    np.testing.assert_allclose(left, left.mean(), atol=1e-7)


def test_each_number_of_terms_continues_the_one_before() -> None:
    points = _grid(9, 6)
    most = BoardShape.bowed(points, 5)
    for n_terms in range(6):
        shape = BoardShape.bowed(points, n_terms)
        assert shape.names == BOW_TERMS[:n_terms]
        np.testing.assert_array_equal(shape.basis, most.basis[:n_terms])


def test_displacement_is_linear(rng: np.random.Generator) -> None:
    points = _grid(7, 5)
    shape = BoardShape.bowed(points, 3, aspect=True)
    a, b = rng.normal(size=(2, 5))
    moved = [shape.displaced(points, p) - points for p in (a, b, 2 * a - 3 * b)]
    np.testing.assert_allclose(moved[2], 2 * moved[0] - 3 * moved[1], atol=1e-12)
    np.testing.assert_array_equal(shape.displaced(points, np.zeros(5)), points)


def test_aspect_and_shear_are_what_no_motion_and_no_stretch_can_do() -> None:
    points = _grid(7, 5)
    shape = BoardShape.bowed(points, 0, aspect=True)
    assert shape.names == ("aspect", "shear")
    x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T
    one, none = np.ones_like(x), np.zeros_like(x)
    for field in ((one, none), (none, one), (-y, x), (x, y)):
        for term in shape.basis:
            along = term[0] @ field[0] + term[1] @ field[1]
            assert abs(along) < 1e-12 * np.linalg.norm(term) * np.linalg.norm(field)
    assert abs(np.vdot(*shape.basis)) < 1e-12
    for term in shape.basis:
        assert np.linalg.norm(term, axis=0).max() == pytest.approx(1)
        assert not term[2].any()


def test_aspect_and_shear_span_all_linear_changes_of_the_plane() -> None:
    """Four of the six linear maps are motions and the scale; two are left."""
    points = _grid(7, 5)
    shape = BoardShape.bowed(points, 0, aspect=True)
    x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T
    none = np.zeros_like(x)
    known = [np.concatenate(pair) for pair in ((-y, x), (x, y))]
    terms = [np.concatenate(term[:2]) for term in shape.basis]
    basis = np.stack([*known, *terms], axis=1)
    for pair in ((x, none), (none, x), (y, none), (none, y)):
        field = np.concatenate(pair)
        rest = field - basis @ np.linalg.lstsq(basis, field, rcond=None)[0]
        assert np.abs(rest).max() < 1e-12


def test_a_flat_board_has_nothing_to_move() -> None:
    points = _grid(7, 5)
    for shape in (BoardShape.flat(points), BoardShape.bowed(points, 0)):
        assert len(shape) == 0
        np.testing.assert_array_equal(shape.displaced(points, np.zeros(0)), points)
