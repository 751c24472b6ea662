"""Cameras of known sensitivities looking at known reflectances."""

from collections.abc import Callable

import numpy as np
import pytest

from calichrome.colorimetry.reference import (
    WAVELENGTHS_NM,
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
    reflectance_to_xyz_d65,
)
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray

_WHITE_RGB = np.array([0.55, 0.8, 0.7])  # what the perfect diffuser reads: no channel like another
_WHITE_XYZ = reflectance_to_xyz_d65(np.ones(len(WAVELENGTHS_NM)))
# three bells, far from any observer: no matrix of theirs is exact
_BELLS = np.exp(
    -0.5 * ((WAVELENGTHS_NM[:, None] - [605.0, 535.0, 455.0]) / [35.0, 38.0, 28.0]) ** 2
)


@pytest.fixture(scope="session")
def sensors() -> dict[str, FloatArray]:
    """Two measured cameras and one made up, (81, 3) each."""
    return camera_sensitivities() | {"bells": _BELLS}


@pytest.fixture(scope="session")
def see(sensors: dict[str, FloatArray]) -> Callable[[str, FloatArray], FloatArray]:
    """Linear RGB (n, 3) that a camera makes of reflectances (n, 81) under D65."""

    def seen(camera: str, reflectances: FloatArray) -> FloatArray:
        response = sensors[camera] * illuminant("D65")[:, None]
        return np.asarray(reflectances @ (response / response.sum(axis=0)) * _WHITE_RGB)

    return seen


@pytest.fixture(scope="session")
def checker_pairs(see: Callable[[str, FloatArray], FloatArray]) -> Callable[..., ColourPairs]:
    """The 24 patches of a ColorChecker by a camera, each channel off by a share of noise."""
    spectra = np.array(list(colour_checker_spectra().values()))

    def pairs(camera: str, noise: float = 0.0, seed: int = 0) -> ColourPairs:
        rgb = see(camera, spectra)
        rgb = rgb * np.random.default_rng(seed).normal(1, noise, rgb.shape)
        return ColourPairs.of(
            rgb,
            reflectance_to_xyz_d65(spectra),
            white_rgb=_WHITE_RGB,
            white_xyz=_WHITE_XYZ,
            adopted_white=_WHITE_XYZ,
        )

    return pairs
