"""Rigid motions form a group, and small steps act as `Pose` says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose, cross_matrix


def _vectors(largest: float, length: int = 3) -> st.SearchStrategy[FloatArray]:
    return hnp.arrays(np.float64, length, elements=st.floats(-largest, largest))


poses = st.builds(Pose.from_rotvec, _vectors(3.0), _vectors(10.0))
vectors = _vectors(10.0)

# numbers of up to 50 m, ten or so roundings of 7e-15 each
_ATOL = 1e-12


@given(a_from_b=poses, b_from_c=poses, points_c=hnp.arrays(
    np.float64, (4, 3), elements=st.floats(-10, 10)))  # fmt: skip
def test_composition_is_application(a_from_b: Pose, b_from_c: Pose, points_c: FloatArray) -> None:
    composed = (a_from_b @ b_from_c).apply(points_c)
    np.testing.assert_allclose(composed, a_from_b.apply(b_from_c.apply(points_c)), atol=_ATOL)


@given(a_from_b=poses, b_from_c=poses, c_from_d=poses)
def test_composition_is_associative(a_from_b: Pose, b_from_c: Pose, c_from_d: Pose) -> None:
    left, right = (a_from_b @ b_from_c) @ c_from_d, a_from_b @ (b_from_c @ c_from_d)
    np.testing.assert_allclose(left.rotation, right.rotation, atol=_ATOL)
    np.testing.assert_allclose(left.trans_m, right.trans_m, atol=_ATOL)


@given(a_from_b=poses)
def test_inverse_undoes(a_from_b: Pose) -> None:
    for motion in (a_from_b @ a_from_b.inverse(), a_from_b.inverse() @ a_from_b):
        np.testing.assert_allclose(motion.rotation, np.eye(3), atol=_ATOL)
        np.testing.assert_allclose(motion.trans_m, 0, atol=_ATOL)


@given(a_from_b=poses)
def test_identity_is_neutral(a_from_b: Pose) -> None:
    for motion in (a_from_b @ Pose.identity(), Pose.identity() @ a_from_b):
        np.testing.assert_allclose(motion.rotation, a_from_b.rotation, atol=_ATOL)
        np.testing.assert_allclose(motion.trans_m, a_from_b.trans_m, atol=_ATOL)


@given(a_from_b=poses, p=vectors, q=vectors)
def test_distances_and_handedness_stay(a_from_b: Pose, p: FloatArray, q: FloatArray) -> None:
    moved = a_from_b.apply(np.stack([p, q]))
    assert np.linalg.norm(moved[0] - moved[1]) == pytest.approx(np.linalg.norm(p - q), abs=_ATOL)
    assert np.linalg.det(a_from_b.rotation) == pytest.approx(1, abs=_ATOL)


@given(rotvec=_vectors(1.7), trans=vectors)
def test_rotation_vector_round_trip(rotvec: FloatArray, trans: FloatArray) -> None:
    # below pi (1.7 sqrt 3 = 2.94), where the vector is unique; arccos costs digits near pi
    found = Pose.from_rotvec(rotvec, trans).rotvec_rad
    np.testing.assert_allclose(found, rotvec, atol=1e-9)


@given(a_from_b=poses, step=_vectors(1e-4, 6), point=vectors)
def test_small_steps_are_first_order(a_from_b: Pose, step: FloatArray, point: FloatArray) -> None:
    """x -> x + omega x (R x) + tau, as every Jacobian here assumes."""
    turned = a_from_b.rotation @ point
    moved = a_from_b.perturbed(step).apply(point)
    expected = turned + a_from_b.trans_m + np.cross(step[:3], turned) + step[3:]
    # second order: |omega|^2 |x| / 2 with |omega| < 1.8e-4 and |x| < 18
    np.testing.assert_allclose(moved, expected, atol=3e-7)


@given(a_from_b=poses, step=_vectors(1.0, 6))
def test_steps_of_any_size_stay_rigid(a_from_b: Pose, step: FloatArray) -> None:
    moved = a_from_b.perturbed(step)
    np.testing.assert_allclose(moved.rotation @ moved.rotation.T, np.eye(3), atol=_ATOL)
    undone = moved.rotation @ a_from_b.rotation.T
    np.testing.assert_allclose(undone, Pose.from_rotvec(step[:3], np.zeros(3)).rotation, atol=_ATOL)


@given(v=vectors, w=vectors)
def test_cross_matrix_is_the_cross_product(v: FloatArray, w: FloatArray) -> None:
    np.testing.assert_allclose(cross_matrix(v) @ w, np.cross(v, w), atol=_ATOL)
    np.testing.assert_array_equal(cross_matrix(np.stack([v, w]))[1], cross_matrix(w))


@given(a_from_b=poses, rotvec=_vectors(0.3))
def test_mean_lies_in_the_middle(a_from_b: Pose, rotvec: FloatArray) -> None:
    step = np.concatenate([rotvec, rotvec])
    middle = Pose.mean([a_from_b.perturbed(step), a_from_b.perturbed(-step), a_from_b])
    np.testing.assert_allclose(middle.rotation, a_from_b.rotation, atol=1e-9)  # eigenvector
    np.testing.assert_allclose(middle.trans_m, a_from_b.trans_m, atol=_ATOL)


@pytest.mark.parametrize(
    "rotation", [np.diag([1.0, 1, -1]), 2 * np.eye(3), np.eye(3) + np.eye(3, k=1)]
)
def test_what_is_no_rotation_is_refused(rotation: FloatArray) -> None:
    with pytest.raises(ValueError, match="not a proper rotation"):
        Pose(rotation, np.zeros(3))


def test_a_pose_cannot_be_changed() -> None:
    rotation = np.eye(3)
    pose = Pose(rotation, np.zeros(3))
    rotation[0, 0] = 5
    assert pose.rotation[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        pose.trans_m[0] = 1
