"""Reference data of colour-science: spectra, observers, cameras (imported late, it is slow)."""

import warnings
from types import ModuleType

import numpy as np
from scipy.interpolate import CubicSpline

from calichrome.core.arrays import FloatArray, frozen

__all__ = [
    "WAVELENGTHS_NM",
    "cam16_ucs",
    "camera_sensitivities",
    "colour_checker_spectra",
    "colour_fidelity_spectra",
    "illuminant",
    "observer",
    "reflectance_to_xyz_d65",
    "resampled_reflectance",
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


def colour_fidelity_spectra() -> FloatArray:
    """Reflectances of 99 real things (textiles, skin, plants, paints, prints), (99, 81), 0..1.

    Colour evaluation samples CES 1 to 99 of CIE 224:2017, as distributed by colour-science.
    """
    _colour()
    from colour.quality.cfi2017 import load_TCS_CIE2017

    first, last, step = WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1], WAVELENGTHS_NM[1] - WAVELENGTHS_NM[0]
    samples = load_TCS_CIE2017(_colour().SpectralShape(first, last, step))
    return np.asarray(samples.values, dtype=np.float64).T


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


def resampled_reflectance(wavelengths_nm: FloatArray, reflectance: FloatArray) -> FloatArray:
    """Bring measured reflectances (..., n) to `WAVELENGTHS_NM`, (..., 81), 0 or more.

    Parameters
    ----------
    wavelengths_nm : (n,) float, nm
        Rising; a cubic spline goes through the values, the first and last hold beyond them.

    References
    ----------
    .. [1] CIE 15:2018, section 7.2 (interpolation by third-order polynomials, extrapolation by the
       last measured value).
    """
    inside = np.clip(WAVELENGTHS_NM, wavelengths_nm[0], wavelengths_nm[-1])
    return np.asarray(np.maximum(CubicSpline(wavelengths_nm, reflectance, axis=-1)(inside), 0.0))


def cam16_ucs(xyz: FloatArray, white: FloatArray) -> FloatArray:
    """CAM16-UCS coordinates J', a', b' of (..., 3), Y = 1 for the perfect diffuser.

    Average surround, adapting luminance 64 cd/m^2 over pi, background of 20 % (the conditions of
    sRGB's viewing, IEC 61966-2-1).

    References
    ----------
    .. [1] C. Li et al., "Comprehensive color solutions: CAM16, CAT16, and CAM16-UCS", Color Res.
       Appl. 42 (6), 2017.
    """
    colour = _colour()
    with np.errstate(invalid="ignore"):  # of colours without light, and imaginary ones near them
        seen = colour.XYZ_to_CAM16(
            100 * np.maximum(xyz, 0), 100 * white, 64 / np.pi * 0.2, 20.0,
            surround=colour.VIEWING_CONDITIONS_CAM16["Average"],
        )  # fmt: skip
    is_lit = seen.J > 0
    appearance = [np.where(is_lit, item, 0.0) for item in (seen.J, seen.M, seen.h)]
    return np.asarray(colour.JMh_CAM16_to_CAM16UCS(np.stack(appearance, axis=-1)))
