"""Reflectances of what is printed, and what lights and sensors make of them."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import lsq_linear

from calichrome.colorimetry.difference import lab_from_xyz, xyz_from_lab
from calichrome.colorimetry.reference import (
    WAVELENGTHS_NM,
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
    observer,
    reflectance_to_xyz_d65,
)
from calichrome.core.arrays import FloatArray, frozen
from calichrome.synthetic.scene import Scene, SceneError, image_rng
from calichrome.target import Target

__all__ = [
    "Palette",
    "black_ink",
    "camera_response",
    "light_spectrum",
    "paper_white",
    "printed_palette",
    "random_reflectance",
    "reflectance_from_xyz",
]

_SAME_XYZ = 5e-4  # a named colour whose XYZ differs by less is the ColorChecker's own spectrum
_XYZ_WEIGHT = 1e4  # of the colour against the smoothness: leaves errors of about 1e-6
_PRIOR_WEIGHT = 1e-3  # of staying near a reflectance against being smooth
_REFLECTANCE_RANGE = (0.005, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Palette:
    """Reflectances that are printed, 0..1.

    Parameters
    ----------
    white, black : (81,) float
        Paper and ink.
    discs : (n_markers, 81) float
        By marker id.
    """

    white: FloatArray
    black: FloatArray
    discs: FloatArray

    @property
    def surfaces(self) -> FloatArray:
        """White, black, then the discs, (2 + n_markers, 81)."""
        return np.concatenate([self.white[None], self.black[None], self.discs])


def paper_white() -> FloatArray:
    """Office paper without brightener: 0.85, falling below 430 nm, shape (81,)."""
    fall = 1 / (1 + np.exp(-(WAVELENGTHS_NM - 402) / 10))
    return np.asarray(
        (0.38 + 0.47 * fall) * (1 - 0.006 * np.exp(-(((WAVELENGTHS_NM - 450) / 30) ** 2)))
    )


def black_ink() -> FloatArray:
    """Pigment black: 0.045, rising in the far red, shape (81,)."""
    return np.asarray(0.042 + 0.0075 * (WAVELENGTHS_NM - 380) / 400 + 0.01 * (WAVELENGTHS_NM > 710))


def reflectance_from_xyz(xyz_d65: FloatArray, like: FloatArray | None = None) -> FloatArray:
    """Return the smoothest reflectance of a given colour.

    Parameters
    ----------
    xyz_d65 : (3,) float
        Tristimulus values under D65, Y = 1 for the perfect diffuser.
    like : (81,) float, optional
        The difference from this reflectance is kept smooth and small instead.

    Raises
    ------
    SceneError
        If no reflectance between 0 and 1 has this colour.

    References
    ----------
    .. [1] C. J. Li, M. R. Luo, "The estimation of spectral reflectances using the smoothness
       constraint condition", 9th Color Imaging Conference, 2001, pp. 62-67.
    """
    n_bands = len(WAVELENGTHS_NM)
    second_difference = np.diff(np.eye(n_bands), n=2, axis=0)
    weights = observer() * illuminant("D65")[:, None]
    weights /= weights[:, 1].sum()
    prior = np.full(n_bands, float(xyz_d65[1])) if like is None else like
    stiffness = np.concatenate([second_difference, _PRIOR_WEIGHT * np.eye(n_bands)])
    rows = np.concatenate([_XYZ_WEIGHT * weights.T, stiffness])
    wanted = np.concatenate([_XYZ_WEIGHT * np.asarray(xyz_d65), stiffness @ prior])
    reflectance = lsq_linear(rows, wanted, bounds=_REFLECTANCE_RANGE, method="bvls").x
    error = np.abs(reflectance_to_xyz_d65(reflectance) - xyz_d65).max()
    if error > 1e-4:
        raise SceneError(
            f"no printable surface has the colour XYZ = {np.round(100 * np.asarray(xyz_d65), 1)} "
            f"under D65 (nearest: {100 * error:.2f} off); correct this colour in the target"
        )
    return np.asarray(reflectance)


def printed_palette(target: Target, palette_error_lab_sd: float = 0.0, seed: int = 0) -> Palette:
    """Return the reflectances of a print of `target`.

    Parameters
    ----------
    palette_error_lab_sd
        Standard deviation of the print about the target, for each colour name and Lab axis.
    seed
        Of these errors.

    Notes
    -----
    A disc with the name and the XYZ of a ColorChecker patch has that patch's spectrum; any other
    colour gets a smooth reflectance, bent from the patch of that name where there is one.
    """
    checker = colour_checker_spectra()
    printed: dict[tuple[str, tuple[float, float, float]], FloatArray] = {}
    for marker in target.markers:
        key = (marker.name, marker.xyz_d65)
        if key in printed:
            continue
        nominal = np.array(marker.xyz_d65)
        like = checker.get(marker.name)
        known = like is not None and (
            np.abs(reflectance_to_xyz_d65(like) - nominal).max() < _SAME_XYZ
        )
        if like is not None and known and palette_error_lab_sd == 0:
            printed[key] = like
            continue
        step = image_rng(seed, "palette", marker.name).normal(0, palette_error_lab_sd, 3)
        printed[key] = _print_near(nominal, step, like)
    discs = [printed[marker.name, marker.xyz_d65] for marker in target.markers]
    white, black = target.paper.white_xyz_d65, target.paper.black_xyz_d65
    return Palette(
        white=paper_white() if white is None else _like(np.array(white), paper_white()),
        black=black_ink() if black is None else _like(np.array(black), black_ink()),
        discs=np.array(discs).reshape(-1, len(WAVELENGTHS_NM)),
    )


def _like(xyz_d65: FloatArray, like: FloatArray) -> FloatArray:
    near = np.abs(reflectance_to_xyz_d65(like) - xyz_d65).max() < _SAME_XYZ
    return like if near else reflectance_from_xyz(xyz_d65, like)


def _print_near(nominal: FloatArray, step_lab: FloatArray, like: FloatArray | None) -> FloatArray:
    """Print a colour a step away; steps that leave the printable solid are shortened."""
    lab = lab_from_xyz(nominal)
    for share in (1.0, 0.5, 0.25):
        try:
            return reflectance_from_xyz(xyz_from_lab(lab + share * step_lab), like)
        except SceneError:
            continue
    return reflectance_from_xyz(nominal, like)


def random_reflectance(rng: np.random.Generator) -> FloatArray:
    """Return a smooth reflectance between 0.05 and 0.6 for things of the surroundings, (81,)."""
    phase = np.pi * (WAVELENGTHS_NM - 380) / 400
    waves = np.cos(phase[:, None] * np.arange(4)) @ rng.normal(0, [1.0, 1.2, 0.8, 0.5])
    return np.asarray(0.05 + 0.55 / (1 + np.exp(-waves)))


@cache
def light_spectrum(name: str) -> FloatArray:
    """Spectral power of an illuminant with unit luminous integral, shape (81,), read-only."""
    power = illuminant(name)
    return frozen(power / (power @ observer()[:, 1]))


@cache
def _sensitivity(name: str) -> FloatArray:
    """Sensitivities (81, 3), scaled so that a white under D65 gives G = 1."""
    known = camera_sensitivities()
    if name not in known:
        raise SceneError(f"no sensitivities of a camera {name!r}; known are {', '.join(known)}")
    return frozen(known[name] / (known[name][:, 1] @ light_spectrum("D65")))


def camera_response(scene: Scene, sensitivity: str, reflectances: FloatArray) -> FloatArray:
    """Return what a sensor makes of each surface under each source at unit irradiance.

    Parameters
    ----------
    sensitivity
        Name of the sensor.
    reflectances : (n, 81) float

    Returns
    -------
    (n, n_sources, 3) float
        Linear camera R, G, B; G = 1 for the perfect diffuser under D65.
    """
    lights = np.array([light_spectrum(name) for name in scene.spectra])
    return np.asarray(np.einsum("nw,lw,wc->nlc", reflectances, lights, _sensitivity(sensitivity)))
