"""Reference data of colour-science: spectra, observers, cameras (imported late, it is slow)."""

import warnings
from types import ModuleType

import numpy as np

from calichrome.core.arrays import FloatArray, frozen

__all__ = [
    "WAVELENGTHS_NM",
    "camera_sensitivities",
    "colour_checker_spectra",
    "illuminant",
    "observer",
    "reflectance_to_xyz_d65",
]

WAVELENGTHS_NM = frozen(np.arange(380, 781, 5))
"""Wavelengths of all spectra here; data sets that end earlier keep their last value."""


def _colour() -> ModuleType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of optional packages that we do not use
        import colour

    return colour  # type: ignore[no-any-return]


def _sampled(wavelengths_nm: FloatArray, values: FloatArray) -> FloatArray:
    columns = np.atleast_2d(np.asarray(values, dtype=np.float64).T)
    return np.stack([np.interp(WAVELENGTHS_NM, wavelengths_nm, column) for column in columns], -1)


def colour_checker_spectra() -> dict[str, FloatArray]:
    """Reflectances of the 24 ColorChecker patches, shape (81,) each, 0..1.

    BabelColor Average of 30 charts, as distributed by colour-science.
    """
    spectra = _colour().SDS_COLOURCHECKERS["BabelColor Average"]
    return {
        # the density in brackets goes: white 9.5 (.05 D) becomes white_95
        name.partition(" (")[0].replace(" ", "_").replace(".", ""): _sampled(
            item.wavelengths, item.values
        )[:, 0]
        for name, item in spectra.items()
    }


def camera_sensitivities() -> dict[str, FloatArray]:
    """Measured spectral sensitivities of real cameras, shape (81, 3) each."""
    return {
        name: _sampled(item.wavelengths, item.values)
        for name, item in _colour().MSDS_CAMERA_SENSITIVITIES.items()
    }


def illuminant(name: str) -> FloatArray:
    """Relative spectral power of a CIE illuminant, shape (81,), mean 1."""
    item = _colour().SDS_ILLUMINANTS[name]
    power = _sampled(item.wavelengths, item.values)[:, 0]
    return np.asarray(power / power.mean())


def observer() -> FloatArray:
    """CIE 1931 2 degree colour matching functions, shape (81, 3)."""
    item = _colour().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return _sampled(item.wavelengths, item.values)


def reflectance_to_xyz_d65(reflectance: FloatArray) -> FloatArray:
    """Integrate reflectances (..., 81) to XYZ under D65, Y = 1 for the perfect diffuser."""
    weights = observer() * illuminant("D65")[:, None]
    return np.asarray(reflectance @ weights / weights[:, 1].sum())
