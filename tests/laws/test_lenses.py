"""What every lens model keeps: inverse, derivatives, the end of its picture; OpenCV as oracle."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import LENSES, BrownConrady, KannalaBrandt, Lens, Rational

PROJECTIVE: dict[str, BrownConrady | Rational] = {
    "barrel": BrownConrady(fx=610, fy=602, cx=322, cy=238, k1=-0.5, k2=0.08, p1=1e-3, p2=-7e-4),
    "pincushion": BrownConrady(fx=1500, fy=1490, cx=700, cy=500, k1=0.5, k2=0.1, k3=0.02, p1=-2e-3),
    "moustache": BrownConrady(fx=800, fy=805, cx=640, cy=480, k1=-0.4, k2=0.4, k3=-0.1, p2=0.01),
    "quotient": Rational.from_parameters(
        np.array([600, 603, 641, 478, 0.4, -0.05, 5e-4, -8e-4, 1e-3, 0.75, 0.05, 2e-3])
    ),
    "quotient-pole": Rational(fx=900, fy=900, cx=640, cy=480, k1=0.2, p1=2e-3, k4=-0.3, k5=-0.1),
}
FISHEYES = {
    "fisheye": KannalaBrandt(fx=420, fy=421, cx=640, cy=480, k1=-0.02, k2=5e-3, k3=-3e-3, k4=6e-4),
    "equidistant": KannalaBrandt(fx=300, fy=300, cx=500, cy=500),
    "fisheye-fold": KannalaBrandt(fx=380, fy=375, cx=610, cy=490, k1=-0.11, k2=-0.02, k3=4e-3),
}
EVERY: dict[str, Lens] = {**PROJECTIVE, **FISHEYES}

every_lens = pytest.mark.parametrize("lens", EVERY.values(), ids=EVERY.keys())
projective = pytest.mark.parametrize("lens", PROJECTIVE.values(), ids=PROJECTIVE.keys())
fisheyes = pytest.mark.parametrize("lens", FISHEYES.values(), ids=FISHEYES.keys())
models = pytest.mark.parametrize("model", LENSES.values(), ids=LENSES.keys())


def _directions(angle: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Unit vectors at `angle` from the axis."""
    return np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1
    )


def _points(
    rng: np.random.Generator, lens: Lens, n_points: int = 300, share: float = 0.9
) -> FloatArray:
    """Up to `share` of the angle that `lens` sees, at 0.2 to 5 m."""
    angle = rng.uniform(0, share * lens.max_angle_rad, n_points)
    points = _directions(angle, rng.uniform(0, 2 * np.pi, n_points))
    return points * rng.uniform(0.2, 5, (n_points, 1))


def _random_lens(model: type[Lens], rng: np.random.Generator) -> Lens:
    """Stronger than real lenses: k of some tenths, |p| up to 0.1, a third without p."""
    focal, strength = rng.uniform(500, 1500, 2), rng.normal(size=6)
    parameters = {"fx": focal[0], "fy": focal[1], "cx": 640.0, "cy": 480.0}
    if model is KannalaBrandt:
        parameters |= {f"k{n}": 0.3 / 4 ** (n - 1) * strength[n] for n in (1, 2, 3, 4)}
    else:
        spread = {"k2": 0.2, "k3": 0.1, "k4": 0.4, "k5": 0.2, "k6": 0.1}
        parameters |= {k: s * x for (k, s), x in zip(spread.items(), strength[1:], strict=True)}
        parameters["k1"] = rng.uniform(-0.6, 0.6)
        if rng.random() < 2 / 3:
            parameters["p1"], parameters["p2"] = 10 ** rng.uniform(-4, -1) * rng.normal(size=2)
    return model(**{name: parameters.get(name, 0.0) for name in model.NAMES})


@projective
def test_opencv_projects_alike(lens: BrownConrady | Rational, rng: np.random.Generator) -> None:
    points = _points(rng, lens, share=0.8)
    found = lens.project(points)
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), lens.matrix, lens.parameters[4:]
    )
    np.testing.assert_allclose(found, expected[:, 0], rtol=1e-12, atol=1e-9)  # px, rounding


@fisheyes
def test_opencv_projects_fisheyes_alike(lens: KannalaBrandt, rng: np.random.Generator) -> None:
    points = _points(rng, lens)
    points = points[points[:, 2] > 0.05]  # OpenCV divides by z
    zero, coeffs = np.zeros((1, 1, 3)), lens.parameters[4:]
    expected, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, lens.matrix, coeffs)
    np.testing.assert_allclose(lens.project(points), expected[:, 0], atol=1e-9)  # px, rounding
    plane = points[:, None, :2] / points[:, None, 2:]
    expected = cv2.fisheye.distortPoints(plane, lens.matrix, coeffs)
    np.testing.assert_allclose(lens.project(points), expected[:, 0], atol=1e-9)


def test_an_equidistant_fisheye_looks_behind_itself() -> None:
    """Without distortion the image distance is the focal length times the angle, at any angle."""
    angle = np.radians([1, 60, 89.9, 90, 90.1, 120, 179])
    pixels = FISHEYES["equidistant"].project(_directions(angle, np.full(7, 0.3)))
    np.testing.assert_allclose(np.linalg.norm(pixels - 500, axis=1), 300 * angle, atol=1e-10)
    assert FISHEYES["equidistant"].max_angle_rad == np.pi


@every_lens
def test_jacobians_are_finite_differences(lens: Lens, rng: np.random.Generator) -> None:
    points = np.concatenate([_points(rng, lens, 60), [[0, 0, 0.7], [1e-9, 0, 0.7]]])
    pixels, d_parameters, d_points = lens.project_with_jacobians(points)
    np.testing.assert_allclose(pixels, lens.project(points), rtol=1e-13)
    for column, name in enumerate(lens.NAMES):
        # at most quadratic in these steps: their third order is what remains, and rounding
        step = np.zeros(len(lens.NAMES))
        step[column] = 1.0 if name in {"fx", "fy", "cx", "cy"} else 1e-5
        ahead = type(lens).from_parameters(lens.parameters + step).project(points)
        back = type(lens).from_parameters(lens.parameters - step).project(points)
        _same_column(d_parameters[:, :, column], (ahead - back) / (2 * step[column]))
    for column in range(3):
        step = np.zeros(3)
        step[column] = 1e-5  # m, at 0.2 m and more
        slope = (lens.project(points + step) - lens.project(points - step)) / 2e-5
        _same_column(d_points[:, :, column], slope)


def _same_column(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@models
def test_a_block_is_its_views(model: type[Lens], rng: np.random.Generator) -> None:
    """Views of different lenses at once, written into strided parts of one Jacobian."""
    lenses = [_random_lens(model, rng) for _ in range(5)]
    points = np.stack([_points(rng, lens, 40) for lens in lenses])
    n_parameters = len(model.NAMES)
    jacobian = np.full((5, n_parameters + 6, 2, 40), np.nan)
    d_parameters, d_points = jacobian[:, 1 : n_parameters + 1], jacobian[:, n_parameters + 2 : -1]
    pixels = model.project_block(
        np.stack([lens.parameters for lens in lenses]),
        points.mT,
        d_parameters,
        d_points,
    )
    alone = model.project_views(np.stack([lens.parameters for lens in lenses]), points.mT)
    np.testing.assert_allclose(alone, pixels, rtol=1e-13)
    for view, lens in enumerate(lenses):
        for found, expected in zip(
            (
                pixels[view].T,
                d_parameters[view].transpose(2, 1, 0),
                d_points[view].transpose(2, 1, 0),
            ),
            lens.project_with_jacobians(points[view]),
            strict=True,
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-13)
    untouched = jacobian[:, [0, n_parameters + 1, -1]]
    assert np.isnan(untouched).all()


@models
def test_every_seen_point_is_found_again(model: type[Lens], rng: np.random.Generator) -> None:
    for _ in range(60):
        lens = _random_lens(model, rng)
        # the last 1e-5 before a fold is left out: there rounding of the pixel moves the ray by 1e-9
        near_the_end = lens.max_angle_rad * (1 - 10 ** rng.uniform(-5, -2, 50))
        azimuth = rng.uniform(0, 2 * np.pi, 50)
        points = np.concatenate([_points(rng, lens, 200, 1.0), _directions(near_the_end, azimuth)])
        assert lens.sees(points).all()
        rays = lens.unproject(lens.project(points))
        _same_directions(rays, points)
        norm = rays[:, 2] if model is not KannalaBrandt else np.linalg.norm(rays, axis=1)
        np.testing.assert_allclose(norm, 1, rtol=1e-14)


def _same_directions(rays: FloatArray, points: FloatArray) -> None:
    found, expected = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (rays, points))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@models
def test_every_ray_found_is_seen_where_it_came_from(
    model: type[Lens], rng: np.random.Generator
) -> None:
    n_rays, n_pixels = 0, 0
    for _ in range(60):
        lens = _random_lens(model, rng)
        pixels = rng.uniform([-640, -480], [1920, 1440], (200, 2))
        rays = lens.unproject(pixels)
        found = np.asarray(np.isfinite(rays).all(axis=1))
        assert (np.isfinite(rays).any(axis=1) == found).all()
        assert lens.sees(rays[found]).all()
        np.testing.assert_allclose(lens.project(rays[found]), pixels[found], atol=1e-9)
        n_rays, n_pixels = n_rays + int(found.sum()), n_pixels + len(found)
    assert 0.2 * n_pixels < n_rays < n_pixels  # both answers occur


@models
def test_the_picture_unfolds_up_to_the_largest_angle(
    model: type[Lens], rng: np.random.Generator
) -> None:
    """The Jacobian by the angle and the azimuth keeps its sign, and loses it just beyond."""
    folds = 0
    for _ in range(40):
        lens = _random_lens(model, rng)
        angle = lens.max_angle_rad * np.linspace(0.01, 0.999, 60)
        assert (_turning(lens, angle) > 0).all()
        beyond = _turning(lens, np.array([1.02 * lens.max_angle_rad]))
        strongest = max(abs(getattr(lens, name, 0.0)) for name in ("p1", "p2"))
        if lens.max_angle_rad < 0.9 * np.pi / 2 and strongest < 1e-3:
            folds += 1
            assert not (beyond > 0).all()  # nan: a pole or no image at all
    assert folds > 5


def _turning(lens: Lens, angle: FloatArray) -> FloatArray:
    """Determinant of d(pixel) by d(angle) and the arc of the azimuth, at 40 azimuths."""
    angle, azimuth = (grid.ravel() for grid in np.meshgrid(angle, np.linspace(0, 2 * np.pi, 40)))
    _, _, d_points = lens.project_with_jacobians(_directions(angle, azimuth))
    outwards = _directions(angle + np.pi / 2, azimuth)
    around = _directions(np.full_like(azimuth, np.pi / 2), azimuth + np.pi / 2)
    (a, b), (c, d) = (np.einsum("nij,nj->in", d_points, along) for along in (outwards, around))
    return np.asarray(a * d - b * c)


def test_known_folds() -> None:
    """d(r g)/dr of 1 - 0.3 r^2 is 0 at r = 1/sqrt(0.9); a tangential 6 p r takes away the rest."""
    lens = BrownConrady(fx=500, fy=500, cx=0, cy=0, k1=-0.3)
    assert np.tan(lens.max_angle_rad) == pytest.approx(1 / np.sqrt(0.9), rel=1e-12)
    lens = BrownConrady(fx=500, fy=500, cx=0, cy=0, p2=0.1)
    assert np.tan(lens.max_angle_rad) == pytest.approx(1 / 0.6, rel=1e-12)
    lens = BrownConrady(fx=500, fy=500, cx=0, cy=0, k1=0.05, p1=-0.06, p2=0.08)  # from g itself
    assert np.tan(lens.max_angle_rad) == pytest.approx(2, rel=1e-12)
    pole = Rational(fx=500, fy=500, cx=0, cy=0, k4=-0.25)
    assert np.tan(pole.max_angle_rad) == pytest.approx(2, rel=1e-12)
    fisheye = KannalaBrandt(fx=500, fy=500, cx=0, cy=0, k1=-1 / 12)
    assert fisheye.max_angle_rad == pytest.approx(2, rel=1e-12)
    assert BrownConrady(fx=500, fy=500, cx=0, cy=0, k1=0.3).max_angle_rad == np.pi / 2


@pytest.mark.parametrize("name", ["barrel", "fisheye", "equidistant", "fisheye-fold"])
def test_outside_the_picture_there_are_no_rays(name: str) -> None:
    lens, azimuth = EVERY[name], np.linspace(0, 2 * np.pi, 36)
    rim = lens.project(_directions(np.full(36, (1 - 1e-9) * lens.max_angle_rad), azimuth))
    centre = [lens.cx, lens.cy]
    reach = np.linalg.norm(rim - centre, axis=1)
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    assert np.isfinite(lens.unproject(centre + 0.99 * reach.min() * circle)).all()
    assert np.isnan(lens.unproject(centre + 1.01 * reach.max() * circle)).all()


@every_lens
def test_strange_pixels_have_no_ray(lens: Lens) -> None:
    pixels = [[np.nan, 5.0], [np.inf, 5.0], [1e300, -1e300], [lens.cx, lens.cy]]
    rays = lens.unproject(np.array(pixels))
    assert np.isnan(rays[:3]).all()
    np.testing.assert_array_equal(rays[3], [0, 0, 1])


@every_lens
def test_what_has_no_image_is_nowhere(lens: Lens) -> None:
    """The projection centre, straight behind, nan; ahead there is one."""
    points = np.array([[0.0, 0, 0], [0, 0, -1], [np.nan, 0, 1], [0, 0, 2]])
    pixels, _, _ = lens.project_with_jacobians(points)
    for found in (lens.project(points), pixels):
        assert np.isfinite(found).all(axis=1).tolist() == [False, False, False, True]
    assert lens.sees(points).tolist() == [False, False, False, True]


@projective
def test_a_plane_picture_ends_at_90_degrees(lens: Lens) -> None:
    points = np.array([[1.0, 0, 0], [1, 0, -1]])
    assert np.isnan(lens.project(points)).all()
    assert not lens.sees(points).any()


def test_beyond_a_pole_and_beyond_a_falling_curve_there_is_no_image() -> None:
    """1 - 0.25 r^2 is 0 at r = 2; theta - theta^3 / 12 falls from theta = 2."""
    pole = Rational(fx=500, fy=500, cx=0, cy=0, k4=-0.25)
    near, far = np.array([[1.99, 0, 1]]), np.array([[2.01, 0, 1]])
    assert np.isfinite(pole.project(near)).all()
    assert np.isnan(pole.project(far)).all()
    fisheye = KannalaBrandt(fx=500, fy=500, cx=0, cy=0, k1=-1 / 12)
    pixels = fisheye.project(_directions(np.array([1.99, 2.01]), np.zeros(2)))
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False]


def test_newton_may_circle() -> None:
    """From afar full steps towards these images go to and fro without leaving the bracket."""
    k = {"k1": 0.58, "k2": -0.14, "k3": 0.12, "k4": 0.53, "k5": -0.18, "k6": 0.04, "p1": -2e-4}
    lens = Rational(fx=850, fy=1137, cx=640, cy=480, **k)
    x = np.linspace(1.5666, 1.5674, 200)
    points = np.stack([x, 0 * x, 0 * x + 1], axis=1)
    _same_directions(lens.unproject(lens.project(points)), points)


def test_newton_may_jump_over_the_fold() -> None:
    k = {"k1": -0.5638160, "k2": 0.4502584, "p1": -0.0120732, "p2": 0.0873138, "k3": -0.0935792}
    lens = BrownConrady(fx=870, fy=885, cx=640, cy=480, **k)
    angle, azimuth = np.meshgrid(np.linspace(0.5, 0.999, 100), np.linspace(0, 2 * np.pi, 200))
    points = _directions(lens.max_angle_rad * angle.ravel(), azimuth.ravel())
    _same_directions(lens.unproject(lens.project(points)), points)


@projective
def test_without_denominator_a_quotient_is_a_polynomial(
    lens: BrownConrady | Rational, rng: np.random.Generator
) -> None:
    shared = {name: getattr(lens, name) for name in BrownConrady.NAMES}
    plain, quotient = BrownConrady(**shared), Rational(**shared)
    points = _points(rng, plain)
    assert quotient.max_angle_rad == plain.max_angle_rad
    for found, expected in zip(
        quotient.project_with_jacobians(points),
        plain.project_with_jacobians(points),
        strict=True,
    ):
        np.testing.assert_allclose(found[:, :, :9] if found.ndim == 3 else found, expected)


@models
def test_names_and_values(model: type[Lens], rng: np.random.Generator) -> None:
    lens = _random_lens(model, rng)
    assert LENSES[lens.MODEL] is model
    assert model.from_parameters(lens.parameters) == lens == model(**lens.as_dict())
    assert list(lens.as_dict()) == list(model.NAMES)
    groups = [name for group in model.OPTIONAL for name in group]
    assert len(set(groups)) == len(groups)
    assert set(groups) < set(model.NAMES[4:])
    matrix = [[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]]
    np.testing.assert_array_equal(lens.matrix, matrix)


@models
def test_start_has_its_axis_in_the_middle(model: type[Lens]) -> None:
    lens = model.start((1280, 960), 700.0)
    assert lens == model(fx=700, fy=700, cx=639.5, cy=479.5)
    np.testing.assert_array_equal(lens.unproject(np.array([639.5, 479.5])), [0, 0, 1])


@every_lens
def test_the_page_of_conventions_reproduces_a_rig(
    lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "conventions.md").read_text(encoding="utf-8")
    code = page.split("```python")[1].split("```")[0]
    turned = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    place = {"rotation": turned, "translation_m": [0.1, 0.2, 0.3]}
    camera = {"lens": {"model": lens.MODEL, **lens.as_dict()}, "cam_from_ref": place}
    (tmp_path / "rig.json").write_text(json.dumps({"cameras": {"cam0": camera}}))
    monkeypatch.chdir(tmp_path)
    names = {"point_ref": np.array([0.2, -0.3, 0.9])}
    exec(code, names)  # noqa: S102 (our own page)
    expected = lens.project(np.array([0.3 + 0.1, 0.2 + 0.2, 0.9 + 0.3]))
    np.testing.assert_allclose([names["u"], names["v"]], expected, rtol=1e-12)
