"""A small target and scenes of it."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.reference import colour_checker_spectra, reflectance_to_xyz_d65
from calichrome.synthetic import Renderer, Scene, demo_scene, random_scene
from calichrome.target import Marker, Target

_SIDE_M = 0.03


def checker_target(n_discs: int = 24) -> Target:
    """ColorChecker colours row by row, dark ones on white squares."""
    target = Target(squares=(9, 6), square_m=(_SIDE_M, _SIDE_M), white_margin_m=_SIDE_M / 2)
    free = {
        colour: [
            (ix, iy) for iy in range(6) for ix in range(9) if target.square_colour(ix, iy) == colour
        ]
        for colour in ("black", "white")
    }
    markers = []
    for name, reflectance in list(colour_checker_spectra().items())[:n_discs]:
        x, y, z = (float(value) for value in reflectance_to_xyz_d65(reflectance))
        background = "white" if y < 0.19 else "black"
        markers.append(
            Marker(
                square=free[background].pop(0),
                name=name,
                diameter_m=_SIDE_M / 2,
                background="white" if background == "white" else "black",
                xyz_d65=(x, y, z),
            )
        )
    return replace(target, markers=tuple(markers))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260)


@pytest.fixture(scope="session")
def target() -> Target:
    return checker_target()


@pytest.fixture(scope="session")
def demo(target: Target) -> Scene:
    return demo_scene(target, seed=4)


@pytest.fixture(scope="session")
def pair(target: Target) -> Scene:
    """Two cameras, four frames, with noise and mosaic."""
    return random_scene(target, 2, 4, (480, 360), 11)


@pytest.fixture(scope="session")
def clean_pair(target: Target) -> Scene:
    """The same without noise, mosaic and quantisation, seen without falloff and stray light."""
    scene = random_scene(target, 2, 4, (480, 360), 11, noise=0, mosaic=False)
    cameras = tuple(
        replace(
            camera,
            sensor=replace(camera.sensor, adc_bits=None),
            vignetting_power=0.0,
            flare=0.0,
        )
        for camera in scene.cameras
    )
    return replace(scene, cameras=cameras)


@pytest.fixture(scope="session")
def clean_renderer(clean_pair: Scene) -> Renderer:
    """Shared, because it inverts the lenses once."""
    return Renderer(clean_pair)
