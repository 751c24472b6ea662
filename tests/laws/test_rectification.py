"""Rectified pairs: rows correspond, disparity is depth, and OpenCV as oracle."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.rectification import Rectification, rectify_pair

_SIZE_WH = (640, 480)
LENS_A = BrownConrady(fx=610, fy=602, cx=322, cy=238, k1=-0.2, k2=0.08, p1=1e-3, p2=-7e-4)
LENS_B = BrownConrady(fx=655, fy=660, cx=310, cy=251, k1=-0.15, k2=0.05)


def _placed(motion: Pose) -> Rectification:
    return rectify_pair(LENS_A, LENS_B, motion, _SIZE_WH, _SIZE_WH)


def _project(projection: FloatArray, points_rect: FloatArray) -> FloatArray:
    homogeneous = np.concatenate([points_rect, np.ones((len(points_rect), 1))], axis=1)
    mapped = homogeneous @ projection.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


# b to the right of a, to its left, below and above, up to 20 degrees turned
baselines = st.sampled_from([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])
turns = hnp.arrays(np.float64, 3, elements=st.floats(-0.2, 0.2))
offsets = hnp.arrays(np.float64, 3, elements=st.floats(-0.2, 0.2))


@st.composite
def motions(draw: st.DrawFn) -> Pose:
    x, y = draw(baselines)
    return Pose.from_rotvec(draw(turns), 0.2 * (np.array([x, y, 0.0]) + draw(offsets)))


@given(b_from_a=motions())
def test_rectifying_turns_are_rotations(b_from_a: Pose) -> None:
    found = _placed(b_from_a)
    for rotation in (found.rotation_a, found.rotation_b):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-12)
    # both cameras look the same way, displaced along one axis
    apart = Pose(found.rotation_b, np.zeros(3)) @ b_from_a @ Pose(found.rotation_a.T, np.zeros(3))
    np.testing.assert_allclose(apart.rotation, np.eye(3), atol=1e-12)
    along = int(found.vertical)
    np.testing.assert_allclose(np.delete(apart.trans_m, along), 0, atol=1e-13)
    assert found.vertical == (abs(b_from_a.trans_m[1]) > abs(b_from_a.trans_m[0]))


@given(b_from_a=motions(), seed=st.integers(0, 1000))
def test_rows_correspond_and_disparity_is_depth(b_from_a: Pose, seed: int) -> None:
    found = _placed(b_from_a)
    rng = np.random.default_rng(seed)
    points_a = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 5], (20, 3))
    points_rect = points_a @ found.rotation_a.T
    pixels_a = _project(found.projection_a, points_rect)
    points_b = b_from_a.apply(points_a) @ found.rotation_b.T
    pixels_b = _project(found.projection_a, points_b)  # b's own frame: the common pinhole
    # P2 gives the same pixels from the frame of the first camera
    np.testing.assert_allclose(_project(found.projection_b, points_rect), pixels_b, atol=1e-9)
    across, along = 1 - int(found.vertical), int(found.vertical)
    np.testing.assert_allclose(pixels_a[:, across], pixels_b[:, across], atol=1e-9)  # px

    disparity = (pixels_a - pixels_b)[:, along]
    ones = np.ones(len(points_a))
    columns = np.stack([pixels_a[:, 0], pixels_a[:, 1], disparity, ones], axis=1)
    homogeneous = columns @ found.disparity_to_depth.T
    recovered = homogeneous[:, :3] / homogeneous[:, 3:]
    # relative: 1e-12 px of a disparity of 10 px or more
    np.testing.assert_allclose(recovered, points_rect, rtol=1e-9, atol=1e-9)


@given(b_from_a=motions())
def test_order_of_the_pair_only_swaps(b_from_a: Pose) -> None:
    forth = rectify_pair(LENS_A, LENS_B, b_from_a, _SIZE_WH, _SIZE_WH)
    back = rectify_pair(LENS_B, LENS_A, b_from_a.inverse(), _SIZE_WH, _SIZE_WH)
    np.testing.assert_allclose(back.rotation_a, forth.rotation_b, atol=1e-12)
    np.testing.assert_allclose(back.rotation_b, forth.rotation_a, atol=1e-12)
    np.testing.assert_allclose(back.matrix, forth.matrix, atol=1e-9)
    along = int(forth.vertical)
    np.testing.assert_allclose(
        back.projection_b[along, 3], -forth.projection_b[along, 3], atol=1e-9
    )


@given(b_from_a=motions())
def test_opencv_turns_alike(b_from_a: Pose) -> None:
    assume(np.linalg.norm(b_from_a.rotvec_rad) > 1e-5)  # it takes smaller turns (1e-7) for none
    found = _placed(b_from_a)
    rotation_a, rotation_b, projection_a, projection_b, q, *_ = cv2.stereoRectify(
        LENS_A.matrix,
        np.zeros(5),
        LENS_B.matrix,
        np.zeros(5),
        _SIZE_WH,
        np.array(b_from_a.rotation),
        np.array(b_from_a.trans_m)[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=-1,
    )
    np.testing.assert_allclose(found.rotation_a, rotation_a, atol=1e-9)
    np.testing.assert_allclose(found.rotation_b, rotation_b, atol=1e-9)
    # focal length and centre are a choice, their places in P1, P2 and Q are not
    assert ((found.projection_a != 0) == (projection_a != 0)).all()
    assert ((found.projection_b != 0) == (projection_b != 0)).all()
    assert found.projection_b[:, 3] / found.matrix[0, 0] == pytest.approx(
        projection_b[:, 3] / projection_b[0, 0], abs=1e-9
    )
    assert found.disparity_to_depth[3, 2] == pytest.approx(q[3, 2], rel=1e-9)


def test_pictures_stay_in_the_middle() -> None:
    found = _placed(Pose.from_rotvec([0.02, 0.1, 0.01], [-0.2, 0.01, 0.02]))
    middle = (np.array([_SIZE_WH], dtype=float) - 1) / 2
    places = []
    for lens, rotation in ((LENS_A, found.rotation_a), (LENS_B, found.rotation_b)):
        places.append(_project(found.projection_a, lens.unproject(middle) @ rotation.T)[0])
    np.testing.assert_allclose(np.mean(places, axis=0), middle[0], atol=1e-9)
