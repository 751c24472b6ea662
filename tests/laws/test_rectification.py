"""Rectified pairs: rows correspond, disparity is depth, the frame fits, and OpenCV as oracle."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from calichrome.apply import rectifying_map
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.lenses import BrownConrady, Lens
from calichrome.geometry.lenses.kannala_brandt import KannalaBrandt
from calichrome.geometry.rectification import Rectification, RectifiedCamera, rectify_pair
from calichrome.geometry.rectified_area import Framing, PrincipalPoints, ValidArea

_SIZE_A_WH, _SIZE_B_WH = (640, 480), (800, 500)
LENS_A = BrownConrady(fx=610, fy=602, cx=322, cy=238, k1=-0.2, k2=0.08, p1=1e-3, p2=-7e-4)
LENS_B = BrownConrady(fx=755, fy=760, cx=390, cy=261, k1=-0.15, k2=0.05)
# 180 degrees across the diagonal of 640 x 480: its corners lie beside the camera, and behind it
FISHEYE = KannalaBrandt(fx=250, fy=251, cx=321, cy=237, k1=-0.01, k2=0.003)

ALL, VALID = Framing(area="all"), Framing(area="valid")
FRAMINGS = [
    Framing(area=area, principal_points=points)
    for area in ("all", "valid")
    for points in ("common", "own")
]
framings = pytest.mark.parametrize("framing", FRAMINGS, ids=str)


def _placed(motion: Pose, framing: Framing = ALL) -> Rectification:
    return rectify_pair(LENS_A, LENS_B, motion, _SIZE_A_WH, _SIZE_B_WH, framing)


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


CONVERGING = Pose.from_rotvec([0.02, 0.5, 0.01], [-0.45, 0.01, 0.12])  # 29 degrees
# each with b right of, left of, below and above a
PLACES = {
    "right": Pose.from_rotvec([0.02, 0.06, 0.01], [-0.2, 0.01, 0.02]),
    "left": Pose.from_rotvec([0.02, -0.06, 0.01], [0.2, 0.01, 0.02]),
    "below": Pose.from_rotvec([-0.06, 0.01, 0.03], [0.01, -0.2, 0.02]),
    "above": Pose.from_rotvec([0.06, 0.01, 0.03], [0.01, 0.2, 0.02]),
    "converging": CONVERGING,
    "rolled": Pose.from_rotvec([0.0, 0.0, 1.2], [-0.16, -0.1, 0.0]),
}
places = pytest.mark.parametrize("b_from_a", PLACES.values(), ids=PLACES.keys())


@given(b_from_a=motions())
@settings(deadline=None)
def test_rectifying_turns_are_rotations(b_from_a: Pose) -> None:
    found = _placed(b_from_a)
    for side in (found.a, found.b):
        rotation = side.rect_from_cam
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-12)
    # both cameras look the same way, displaced along one axis
    turn_a = Pose(found.a.rect_from_cam.T, np.zeros(3))
    apart = Pose(found.b.rect_from_cam, np.zeros(3)) @ b_from_a @ turn_a
    np.testing.assert_allclose(apart.rotation, np.eye(3), atol=1e-12)
    along = int(found.vertical)
    np.testing.assert_allclose(np.delete(apart.trans_m, along), 0, atol=1e-13)
    assert found.baseline_m == pytest.approx(-apart.trans_m[along], rel=1e-12)
    assert abs(found.baseline_m) == pytest.approx(np.linalg.norm(b_from_a.trans_m), rel=1e-12)


@framings
@places
def test_rows_correspond_and_disparity_is_depth(
    b_from_a: Pose, framing: Framing, rng: np.random.Generator
) -> None:
    found = _placed(b_from_a, framing)
    points_a = rng.uniform([-0.2, -0.15, 0.8], [0.2, 0.15, 1.2], (50, 3))
    points_rect = points_a @ found.a.rect_from_cam.T
    pixels_a = found.rectify_points("a", LENS_A.project(points_a))
    pixels_b = found.rectify_points("b", LENS_B.project(b_from_a.apply(points_a)))
    # 1e-9 px of the lens become up to 3e-9 px of the plane, which is stretched
    np.testing.assert_allclose(_project(found.a.projection, points_rect), pixels_a, atol=3e-9)
    np.testing.assert_allclose(_project(found.b.projection, points_rect), pixels_b, atol=3e-9)
    across, along = 1 - int(found.vertical), int(found.vertical)
    np.testing.assert_allclose(pixels_a[:, across], pixels_b[:, across], atol=3e-9)  # px

    disparity = (pixels_a - pixels_b)[:, along]
    if framing.principal_points == "common":
        np.testing.assert_array_equal(found.a.matrix, found.b.matrix)
        assert (np.sign(disparity) == np.sign(found.baseline_m)).all()
    assert found.a.matrix[0, 0] == found.b.matrix[0, 0]  # one scale, for both axes
    assert (np.diag(found.a.matrix)[:2] == np.diag(found.b.matrix)[:2]).all()
    columns = np.column_stack([pixels_a, disparity, np.ones(len(points_a))])
    homogeneous = columns @ found.disparity_to_depth.T
    recovered = homogeneous[:, :3] / homogeneous[:, 3:]
    # 3e-9 px of a disparity of 40 px or more
    np.testing.assert_allclose(recovered, points_rect, atol=1e-9)


@given(b_from_a=motions())
@settings(deadline=None)
def test_order_of_the_pair_only_swaps(b_from_a: Pose) -> None:
    forth = rectify_pair(LENS_A, LENS_B, b_from_a, _SIZE_A_WH, _SIZE_B_WH)
    back = rectify_pair(LENS_B, LENS_A, b_from_a.inverse(), _SIZE_B_WH, _SIZE_A_WH)
    np.testing.assert_allclose(back.a.rect_from_cam, forth.b.rect_from_cam, atol=1e-12)
    np.testing.assert_allclose(back.b.rect_from_cam, forth.a.rect_from_cam, atol=1e-12)
    np.testing.assert_allclose(back.a.matrix, forth.b.matrix, atol=1e-8)
    assert back.baseline_m == pytest.approx(-forth.baseline_m, rel=1e-12)
    assert back.vertical == forth.vertical
    assert (back.a.share, back.b.share) == (forth.b.share, forth.a.share)


@pytest.mark.parametrize("flags", [cv2.CALIB_ZERO_DISPARITY, 0], ids=["common", "own"])
@given(b_from_a=motions())
@settings(deadline=None)
def test_opencv_turns_alike(b_from_a: Pose, flags: int) -> None:
    assume(np.linalg.norm(b_from_a.rotvec_rad) > 1e-5)  # it takes smaller turns (1e-7) for none
    points: PrincipalPoints = "common" if flags else "own"
    found = _placed(b_from_a, Framing(principal_points=points))
    along = int(found.vertical)
    half = Rotation.from_rotvec(-0.5 * b_from_a.rotvec_rad).as_matrix()
    baseline = half @ b_from_a.trans_m
    # it finds the second turn by an arc cosine, which has eps / angle of error
    assume(np.linalg.norm(np.delete(baseline, along)) > 1e-6 * np.linalg.norm(baseline))
    rotation_a, rotation_b, projection_a, projection_b, q, *_ = cv2.stereoRectify(
        LENS_A.matrix,
        np.zeros(5),
        LENS_B.matrix,
        np.zeros(5),
        _SIZE_A_WH,
        np.array(b_from_a.rotation),
        np.array(b_from_a.trans_m)[:, None],
        flags=flags,
        alpha=-1,
    )
    np.testing.assert_allclose(found.a.rect_from_cam, rotation_a, atol=1e-9)
    np.testing.assert_allclose(found.b.rect_from_cam, rotation_b, atol=1e-9)
    # focal length and centre are a choice, their places in P1, P2 and Q are not
    assert ((found.a.projection != 0) == (projection_a != 0)).all()
    assert ((found.b.projection != 0) == (projection_b != 0)).all()
    assert found.b.projection[:, 3] / found.focal_px == pytest.approx(
        projection_b[:, 3] / projection_b[0, 0], abs=1e-9
    )
    for p1, p2, their_q in (
        (found.a.projection, found.b.projection, found.disparity_to_depth),
        (projection_a, projection_b, q),
    ):
        offset = p2[along, 3] / p2[0, 0]
        expected = [
            [1, 0, 0, -p1[0, 2]],
            [0, 1, 0, -p1[1, 2]],
            [0, 0, 0, p1[0, 0]],
            [0, 0, -1 / offset, (p1[along, 2] - p2[along, 2]) / offset],
        ]
        np.testing.assert_allclose(their_q, expected, rtol=1e-9, atol=1e-9)


@places
def test_opencv_moves_points_and_pictures_alike(b_from_a: Pose, rng: np.random.Generator) -> None:
    found = _placed(b_from_a)
    pixels = rng.uniform([0, 0], [639, 479], (200, 2))
    distortion = np.array([-0.2, 0.08, 1e-3, -7e-4, 0])  # k1 k2 p1 p2 k3
    # copies: OpenCV refuses arrays that cannot be written
    rotation, matrix = found.a.rect_from_cam.copy(), found.a.matrix.copy()
    exactly = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-13)
    moved = cv2.undistortPoints(
        pixels[:, None], LENS_A.matrix, distortion, R=rotation, P=matrix, criteria=exactly
    )
    np.testing.assert_allclose(found.rectify_points("a", pixels), moved[:, 0], atol=1e-6)
    source = rectifying_map(LENS_A, found.a.rect_from_cam, found.a.matrix, found.size_wh)
    x, y = cv2.initUndistortRectifyMap(
        LENS_A.matrix, distortion, rotation, matrix, found.size_wh, cv2.CV_32FC1
    )
    inside = (source > 0).all(axis=2) & (source < [639, 479]).all(axis=2)
    assert inside.mean() > 0.2
    # 1e-3 px: both maps are float32
    np.testing.assert_allclose(source[inside], np.stack([x, y], axis=2)[inside], atol=1e-3)


def _border(size_wh: tuple[int, int]) -> FloatArray:
    x, y = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    edge = (x == 0) | (y == 0) | (x == size_wh[0] - 1) | (y == size_wh[1] - 1)
    return np.column_stack([x[edge], y[edge]]).astype(np.float64)


@pytest.mark.parametrize("points", ["common", "own"])
@places
def test_all_of_both_pictures_at_the_largest_scale(b_from_a: Pose, points: PrincipalPoints) -> None:
    found = _placed(b_from_a, Framing(area="all", principal_points=points))
    shown_a = found.rectify_points("a", _border(_SIZE_A_WH))
    shown_b = found.rectify_points("b", _border(_SIZE_B_WH))
    last = np.array(found.size_wh) - 1
    both = np.concatenate([shown_a, shown_b])
    # between two pixels of a border, which is sampled every 2 px, it bends by less than 0.01 px
    assert (both > -0.01).all()
    assert (both < last + 0.01).all()
    assert found.a.share == found.b.share == 1
    extents = [both] if points == "common" else [shown_a, shown_b, both[:, [1, 1]]]
    widest = np.max([np.ptp(item, axis=0) for item in extents], axis=0)
    assert (widest / last).max() == pytest.approx(1, abs=1e-4)


def _all_from_inside(
    found: Rectification, focal: float, middles: tuple[FloatArray, FloatArray]
) -> bool:
    """Whether frames of that scale round these places of the plane show nothing but pictures."""
    frame = _border(found.size_wh) - (np.array(found.size_wh) - 1) / 2
    for lens, size_wh, side, middle in zip(
        (LENS_A, LENS_B), (_SIZE_A_WH, _SIZE_B_WH), (found.a, found.b), middles, strict=True
    ):
        plane = middle + frame / focal
        rays = np.column_stack([plane, np.ones(len(plane))]) @ side.rect_from_cam
        pixels = lens.project(rays)
        inside = (pixels >= -1e-6) & (pixels <= np.array(size_wh) - 1 + 1e-6)
        if not (lens.sees(rays).all() and inside.all()):
            return False
    return True


@pytest.mark.parametrize("points", ["common", "own"])
@places
def test_valid_is_the_largest_frame_inside_both(
    b_from_a: Pose, points: PrincipalPoints, rng: np.random.Generator
) -> None:
    found = _placed(b_from_a, Framing(area="valid", principal_points=points))
    half_wh = (np.array(found.size_wh) - 1) / 2
    middle_a, middle_b = ((half_wh - s.matrix[:2, 2]) / found.focal_px for s in (found.a, found.b))
    assert _all_from_inside(found, found.focal_px, (middle_a, middle_b))
    for side, lens, size_wh in ((found.a, LENS_A, _SIZE_A_WH), (found.b, LENS_B, _SIZE_B_WH)):
        source = rectifying_map(lens, side.rect_from_cam, side.matrix, found.size_wh)
        assert (source >= 0).all()
        assert (source <= np.array(size_wh) - 1).all()
    # nothing is gained elsewhere: 2 % is more than the grid of 1/800 of the field can lose
    along, reach = int(found.vertical), half_wh / found.focal_px
    larger = found.focal_px / 1.02
    assert not _all_from_inside(found, larger, (middle_a, middle_b))
    for _ in range(200):
        shift_a, shift_b = rng.uniform(-0.3, 0.3, (2, 2)) * reach
        if points == "common":
            shift_b = shift_a
        shift_b[1 - along] = shift_a[1 - along]
        moved = middle_a + shift_a, middle_b + shift_b
        assert not _all_from_inside(found, larger, moved)


def test_own_principal_points_keep_the_scale() -> None:
    """Twice the share of the pictures without borders, for cameras that converge by 29 degrees."""
    shares = [
        _placed(CONVERGING, Framing(area="valid", principal_points=points)).a.share
        for points in ("common", "own")
    ]
    assert shares[1] > 2 * shares[0]


WIDE: dict[str, Lens] = {
    "fisheye": FISHEYE,
    # folds 29 degrees from the axis, in the middle of the left half of the picture
    "folding": BrownConrady(fx=400, fy=400, cx=320, cy=240, k1=-1.1),
}


@pytest.mark.parametrize("area", ["all", "valid"])
@pytest.mark.parametrize("lens", WIDE.values(), ids=WIDE.keys())
def test_pixels_without_a_place_on_the_plane(
    lens: Lens, area: ValidArea, rng: np.random.Generator
) -> None:
    border = lens.unproject(_border(_SIZE_A_WH))
    assert not (border[:, 2] > 0).all()  # behind the camera, or nowhere
    b_from_a = PLACES["right"]
    found = rectify_pair(lens, lens, b_from_a, _SIZE_A_WH, _SIZE_A_WH, Framing(area=area))
    # not shrunk to nothing by rays at 90 degrees: what lies beyond 75 is left out, and said
    assert found.focal_px > 479 / 2 / np.tan(np.deg2rad(75.01))
    assert max(found.a.share, found.b.share) < 0.999
    points_a = rng.uniform([-0.3, -0.2, 0.8], [0.3, 0.2, 1.2], (50, 3))
    pixels_a = found.rectify_points("a", lens.project(points_a))
    pixels_b = found.rectify_points("b", lens.project(b_from_a.apply(points_a)))
    np.testing.assert_allclose(pixels_a[:, 1], pixels_b[:, 1], atol=1e-8)
    source = rectifying_map(lens, found.a.rect_from_cam, found.a.matrix, found.size_wh)
    inside = ((source >= 0) & (source <= np.array(_SIZE_A_WH) - 1)).all(axis=2)
    assert inside.all() == (area == "valid")
    nowhere = found.rectify_points("a", _border(_SIZE_A_WH))
    assert (np.isnan(nowhere).all(axis=1) == ~(_turned(found.a, border) > 0)).all()


def _turned(side: RectifiedCamera, rays_cam: FloatArray) -> FloatArray:
    return np.asarray((rays_cam @ side.rect_from_cam.T)[:, 2])


def _facing(angle: float) -> Pose:
    """Cameras that look at a point 1 m away from both, from that far apart round it."""
    ref_from_b = Pose.from_rotvec([0, -angle, 0], [np.sin(angle), 0, 1 - np.cos(angle)])
    return ref_from_b.inverse()


def _apart(yaw: float) -> Pose:
    """Cameras side by side, each turned outwards."""
    a_from_ref = Pose.from_rotvec([0, yaw, 0], [0, 0, 0])
    ref_from_b = Pose.from_rotvec([0, yaw, 0], [0.3, 0, 0])
    return (a_from_ref @ ref_from_b).inverse()


@pytest.mark.parametrize(
    ("b_from_a", "says"),
    [
        (_facing(np.pi), "no plane shows both"),  # face to face
        (_facing(2.2), "no plane shows both"),
        (Pose.from_rotvec([0, 0, 0], [0, 0, -0.3]), "no plane shows both"),  # one before the other
        (Pose.from_rotvec([0.1, 0, 0], [0.02, 0.03, -0.3]), "no plane shows both"),
        (_apart(0.7), "no field of view"),
        (Pose.from_rotvec([1.2, 0, 0], [-0.3, 0, 0]), "no field of view"),  # one up, one down
        (Pose.from_rotvec([0, 0.2, 0], [0, 0, 0]), "at one place"),
    ],
)
def test_cameras_that_no_plane_shows(b_from_a: Pose, says: str) -> None:
    with pytest.raises(SolveError, match=says):
        _placed(b_from_a)
    with pytest.raises(SolveError, match=says):
        rectify_pair(LENS_B, LENS_A, b_from_a.inverse(), _SIZE_B_WH, _SIZE_A_WH)


@pytest.mark.parametrize("yaw", [-0.7, 0, 0.3])
def test_cameras_that_share_some_of_their_field(yaw: float) -> None:
    """The clean twins of cameras that look apart."""
    assert _placed(_apart(yaw)).focal_px > 0


def test_a_quarter_of_a_ring_is_still_rectified(rng: np.random.Generator) -> None:
    """Cameras 90 degrees apart: the clean twin of those that face each other."""
    b_from_a = _facing(np.pi / 2)
    with pytest.raises(SolveError, match="its own principal point"):
        _placed(b_from_a, VALID)
    for area in ("all", "valid"):
        found = _placed(b_from_a, Framing(area=area, principal_points="own"))
        points_a = rng.uniform([-0.1, -0.1, 0.9], [0.1, 0.1, 1.1], (20, 3))
        rows_a = found.rectify_points("a", LENS_A.project(points_a))[:, 1]
        rows_b = found.rectify_points("b", LENS_B.project(b_from_a.apply(points_a)))[:, 1]
        np.testing.assert_allclose(rows_a, rows_b, atol=1e-8)
