"""Regions of a drawn ball: unbiased through a distorted lens, sized, and sure as they say."""

from collections.abc import Iterator

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.tracking import Background, Picture, PixelRays, Region, View, find_regions
from calichrome.tracking.likelihood import object_radius

_SIZE_WH = (400, 300)
_LENS = BrownConrady(fx=300, fy=302, cx=201, cy=148, k1=-0.2, k2=0.05, p1=1e-3, p2=-5e-4)
_VIEW = View(camera="a", lens=_LENS, cam_from_ref=Pose.identity(), size_wh=_SIZE_WH)
_RAYS = PixelRays.through(_LENS, _SIZE_WH)
_SUB = 4  # rays per pixel and axis
_SIGMA = 0.004


def _backdrop() -> FloatArray:
    x, y = np.meshgrid(np.arange(_SIZE_WH[0]), np.arange(_SIZE_WH[1]))
    grey = 0.25 + 0.1 * np.sin(x / 9) * np.cos(y / 13)
    return np.asarray(grey[..., None] * [0.9, 1.0, 1.1])


def _noisy(picture: FloatArray, rng: np.random.Generator) -> Picture:
    return np.asarray(picture + rng.normal(0, _SIGMA, picture.shape), dtype=np.float32)


def _with_ball(
    picture: FloatArray, centre: FloatArray, radius_m: float, xyz: FloatArray
) -> FloatArray:
    """Cast rays; the ball is shaded by a lamp above."""
    offset = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    x, y = (np.arange(n)[:, None] + offset for n in _SIZE_WH)
    grid = np.stack(np.meshgrid(x.ravel(), y.ravel()), axis=-1)
    rays = _LENS.unproject(grid)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ centre
    depth = along**2 - centre @ centre + radius_m**2
    hit = depth > 0
    normal = (rays * (along - np.sqrt(np.where(hit, depth, 0)))[..., None] - centre) / radius_m
    light = 0.4 + 0.6 * np.clip(normal @ np.array([0.0, -0.8, -0.6]), 0, 1)
    ball = np.where(hit, light, 0)[..., None] * xyz
    shape = (_SIZE_WH[1], _SUB, _SIZE_WH[0], _SUB)
    share = hit.reshape(shape).mean(axis=(1, 3))[..., None]
    return np.asarray(picture * (1 - share) + ball.reshape(*shape, 3).mean(axis=(1, 3)))


def _background(rng: np.random.Generator) -> Background:
    def frames() -> Iterator[Picture]:
        for _ in range(8):
            yield _noisy(_backdrop(), rng)

    return Background.learn(frames())


def _found(picture: Picture, background: Background, **options: float) -> tuple[Region, ...]:
    return find_regions(
        picture,
        background,
        _VIEW,
        _RAYS,
        min_area_px=int(options.get("min_area_px", 30)),
        darkest_shadow=options.get("darkest_shadow", 0.4),
        in_colour=True,
    )


def test_an_empty_scene_has_no_regions(rng: np.random.Generator) -> None:
    background = _background(rng)
    for _ in range(5):
        assert _found(_noisy(_backdrop(), rng), background) == ()


@pytest.mark.parametrize("centre", [(0.02, -0.01, 1.0), (0.42, 0.3, 1.0), (-0.35, 0.2, 0.6)])
def test_centre_and_size_of_a_ball(rng: np.random.Generator, centre: tuple[float, ...]) -> None:
    place, radius_m = np.array(centre), 0.05
    picture = _with_ball(_backdrop(), place, radius_m, np.array([0.6, 0.35, 0.1]))
    background = _background(rng)
    (region,) = _found(_noisy(picture, rng), background)
    truth = _LENS.project(place[None])[0]
    # the bias of shaded silhouettes, of which the tracks of simulated workspaces tell 0.13 px
    np.testing.assert_allclose(region.centre_px, truth, atol=0.15)
    looked = object_radius(np.linalg.norm(place), np.array(region.half_angle_rad))
    assert looked == pytest.approx(radius_m, rel=0.02)
    assert region.whole
    # its colour is that of the lit side
    assert region.colour is not None
    np.testing.assert_allclose(region.colour.xyz_d65, [0.6, 0.35, 0.1], rtol=0.08)


def test_the_centroid_of_pixels_would_be_off() -> None:
    """Why the mean of directions: near a corner the silhouette's middle is not the centre."""
    place, radius_m = np.array([0.42, 0.3, 1.0]), 0.12
    distance = np.linalg.norm(place)
    share = _RAYS.directions @ (place / distance) > np.sqrt(1 - (radius_m / distance) ** 2)
    truth = _LENS.project(place[None])[0]
    x, y = np.meshgrid(np.arange(_SIZE_WH[0]), np.arange(_SIZE_WH[1]))
    centroid = np.array([(share * x).sum(), (share * y).sum()]) / share.sum()
    weight = share * _RAYS.solid_angle_sr
    mean = _LENS.project(np.einsum("yx,yxi->i", weight, _RAYS.directions)[None])[0]
    assert np.linalg.norm(centroid - truth) > 5 * np.linalg.norm(mean - truth)
    assert np.linalg.norm(mean - truth) < 0.05


def test_noise_moves_the_centre_as_little_as_stated(rng: np.random.Generator) -> None:
    place = np.array([0.1, 0.05, 1.0])
    picture = _with_ball(_backdrop(), place, 0.05, np.array([0.6, 0.35, 0.1]))
    background = _background(rng)
    regions = [_found(_noisy(picture, rng), background)[0] for _ in range(20)]
    centres = np.array([region.centre_px for region in regions])
    stated = np.sqrt(np.trace(regions[0].cov_px2) / 2)
    # stated for the shares of edge pixels as pictures have them, which noise alone is part of
    assert centres.std(axis=0).max() < stated < 0.1


def test_a_shadow_is_no_object(rng: np.random.Generator) -> None:
    shadow = _backdrop()
    shadow[100:140, 150:200] *= 0.6
    background = _background(rng)
    assert _found(_noisy(shadow, rng), background) == ()
    assert len(_found(_noisy(shadow, rng), background, darkest_shadow=1.0)) == 1


def test_a_region_at_the_border_is_not_whole(rng: np.random.Generator) -> None:
    edge = _LENS.unproject(np.array([[0.0, 150.0]]))[0]
    picture = _with_ball(_backdrop(), edge, 0.08, np.array([0.6, 0.35, 0.1]))
    (region,) = _found(_noisy(picture, rng), _background(rng))
    assert not region.whole


def test_solid_angles_sum_to_that_of_the_picture() -> None:
    """A pinhole's rectangle has the solid angle 4 asin(sin a sin b) of half angles a, b."""
    lens = BrownConrady(fx=300, fy=300, cx=199.5, cy=149.5)
    rays = PixelRays.through(lens, _SIZE_WH)
    half = [np.arctan(200 / 300), np.arctan(150 / 300)]
    expected = 4 * np.arcsin(np.sin(half[0]) * np.sin(half[1]))
    assert rays.solid_angle_sr.sum() == pytest.approx(expected, rel=1e-4)


def test_too_few_empty_frames_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="two frames"):
        Background.learn([_noisy(_backdrop(), rng)])
