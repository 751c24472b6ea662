"""Measured spectra: surfaces, lights, the observer and cameras, all at the same wavelengths.

What colour-science does not bring is read from the folder of test data (``CALICHROME_DATA``, by
default ../shared/data beside the project) and never copied.
"""

import json
import os
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType, ModuleType

import numpy as np

from calichrome.core.arrays import FloatArray, frozen

__all__ = [
    "REFLECTANCES",
    "WAVELENGTHS_NM",
    "colour_science",
    "data_folder",
    "further_cameras",
    "illuminant",
    "known_cameras",
    "observer",
    "reflectances",
]

WAVELENGTHS_NM = frozen(np.arange(400, 701, 5))
"""The range that every camera was measured over; the Sigma ends at 680 nm and keeps its last value,
which is 0.5 % of its peak."""

_N_SYNTHETIC = 1000
_WAVES = 6  # cosines over the range: the finest has a half period of 60 nm
_SWING = 2.2
"""Standard deviation of all waves together before the logistic: a value of 2.2 is a reflectance of
0.9, so that a third of the range is spent beyond what pigments reach. Chosen, not tuned."""


def colour_science() -> ModuleType:
    """Return the module `colour`, which is slow to import and warns of optional packages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour

    return colour  # type: ignore[no-any-return]


def data_folder() -> Path:
    """Return the folder of test data."""
    default = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("CALICHROME_DATA", default))


def _sampled(wavelengths_nm: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate columns (n, k) linearly to (61, k); ends keep their last value."""
    columns = np.asarray(values, dtype=np.float64).reshape(len(wavelengths_nm), -1).T
    return np.stack([np.interp(WAVELENGTHS_NM, wavelengths_nm, column) for column in columns], -1)


@cache
def illuminant(name: str) -> FloatArray:
    """Relative spectral power of a CIE illuminant, (61,)."""
    item = colour_science().SDS_ILLUMINANTS[name]
    return frozen(_sampled(item.wavelengths, item.values)[:, 0])


@cache
def observer() -> FloatArray:
    """CIE 1931 2 degree colour matching functions, (61, 3)."""
    item = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return frozen(_sampled(item.wavelengths, item.values))


def _chart(name: str) -> FloatArray:
    patches = colour_science().SDS_COLOURCHECKERS[name].values()
    return np.stack([_sampled(item.wavelengths, item.values)[:, 0] for item in patches])


def _json_table(path: Path) -> FloatArray:
    """Read a spectral file of rawtoaces: wavelength, then its values."""
    table = json.loads(path.read_text(encoding="utf-8"))["spectral_data"]["data"]["main"]
    return _sampled(np.array([float(key) for key in table]), np.array(list(table.values())))


def _text_table(path: Path) -> FloatArray:
    rows = np.loadtxt(path, delimiter=",", comments="#")
    return _sampled(rows[:, 0], rows[:, 1:])


def _patches_190() -> FloatArray:
    name = "spectral/rawtoaces_other/training/training_spectral.json"
    return _json_table(data_folder() / name).T


def _munsell() -> FloatArray:
    return _text_table(data_folder() / "spectral/reflectance/Munsell1269.dat").T


def _synthetic() -> FloatArray:
    """Smooth reflectances 0..1 from seed 0: the logistic of a sum of cosines that fade."""
    rng = np.random.default_rng(0)
    place = (WAVELENGTHS_NM - WAVELENGTHS_NM[0]) / np.ptp(WAVELENGTHS_NM)
    order = np.arange(_WAVES)
    spread = 1 / (1 + order)
    weights = rng.normal(0, _SWING * spread / np.linalg.norm(spread), (_N_SYNTHETIC, _WAVES))
    return np.asarray(1 / (1 + np.exp(-weights @ np.cos(np.pi * order[:, None] * place))))


REFLECTANCES: Mapping[str, Callable[[], FloatArray]] = MappingProxyType(
    {
        "checker": lambda: _chart("ColorChecker N Ohta"),
        "t190": _patches_190,
        "pmc30": lambda: _chart("PMC"),
        "syn1000": _synthetic,
        "munsell1269": _munsell,
    }
)
"""What is trained on, what is tested on, and the Munsell chips, on which constants are set."""


@cache
def reflectances(name: str) -> FloatArray:
    """Return a set of `REFLECTANCES`, (n, 61), 0..1."""
    return frozen(REFLECTANCES[name]())


def known_cameras() -> dict[str, FloatArray]:
    """Return the three cameras that come with colour-science, (61, 3) each."""
    colour = colour_science()
    cameras = {
        name: _sampled(item.wavelengths, item.values)
        for name, item in colour.MSDS_CAMERA_SENSITIVITIES.items()
    }
    folder = Path(colour.characterisation.aces_it.ROOT_RESOURCES_RAWTOACES)
    rows = np.loadtxt(
        folder / "CANON_EOS_5DMark_II_RGB_Sensitivities.csv", delimiter=",", skiprows=1
    )
    return {**cameras, "Canon 5D Mk II (rawtoaces 1)": _sampled(rows[:, 0], rows[:, 1:])}


def further_cameras() -> dict[str, FloatArray]:
    """Return the cameras of the test data, (61, 3) each; some were measured by two labs."""
    root = data_folder() / "spectral"
    cameras = {}
    for folder, lab, read in (
        ("camera_rawtoaces", "rawtoaces", _json_table),
        ("camera_ssf_camspec", "camspec", _text_table),
        ("camera_ssf_spectroscope", "spectroscope", _text_table),
    ):
        for path in sorted((root / folder).iterdir()):
            model = path.stem.removesuffix("_380_780_5").removesuffix("_ssf").replace("_", " ")
            cameras[f"{model} ({lab})"] = read(path)
    return cameras
