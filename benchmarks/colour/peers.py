"""Other people's methods behind one face; what cannot run is None, and the tables say "not run".

colour-science and OpenCV are dependencies of the package. chromacal reads pictures only: see
`benchmarks.colour.tone`.
"""

import atexit
import json
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from benchmarks.colour.scoring import Apply, Method
from benchmarks.colour.spectra import colour_science
from scipy.interpolate import RBFInterpolator

from calichrome.colorimetry.adaptation import D65, adapt
from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.colorimetry.encoding import encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB
from calichrome.core.arrays import FloatArray

__all__ = ["LEAST_SQUARES", "PEERS", "NotRunError", "affine_of_coded", "root_polynomial_2"]

LEAST_SQUARES = "3x3 least squares"


class NotRunError(Exception):
    """A method cannot run here."""


def least_squares(train_rgb: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    """Fit a plain 3x3, unweighted, in XYZ."""
    del white_xyz
    matrix, *_ = np.linalg.lstsq(train_rgb, train_xyz, rcond=None)
    return lambda rgb: rgb @ matrix


def _colour_science(method: str, **options: object) -> Method:
    """`colour.matrix_colour_correction` and the function that applies its matrix."""

    def fit(train_rgb: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray) -> Apply:
        del white_xyz
        characterisation = colour_science().characterisation
        matrix = characterisation.matrix_colour_correction(
            train_rgb, train_xyz, method=method, **options
        )

        def apply(rgb: FloatArray) -> FloatArray:
            found = characterisation.apply_matrix_colour_correction(
                rgb, matrix, method=method, **options
            )
            return np.asarray(found, dtype=np.float64)

        return apply

    return fit


root_polynomial_2 = _colour_science("Finlayson 2015", degree=2, root_polynomial_expansion=True)


def interpolating_spline(
    train_rgb: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray
) -> Apply:
    """Interpolate by the thin-plate spline of three dimensions: kernel r, with a plane.

    r^2 log r, which is often used here, belongs to two dimensions.
    """
    del white_xyz
    spline = RBFInterpolator(train_rgb, train_xyz, kernel="linear", degree=1)
    return lambda rgb: np.asarray(spline(rgb))


def affine_of_coded(coded: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    """Fit 3x4 from stored values to sRGB-coded ones, as PlantCV's `affine_color_correction` does.

    PlantCV's own reading of the card and its rounding to 8 bits are left out. References are sRGB
    values 0..1, here those of the colours after adaptation to D65; results are cut at 0 and 1, as
    its pictures are.
    """
    linear = adapt(train_xyz, white_xyz, D65) @ RGB_FROM_XYZ["srgb"].T
    wanted = encode(np.clip(linear, 0, 1), "srgb")
    matrix, *_ = np.linalg.lstsq(_with_one(coded), wanted, rcond=None)

    def apply(rgb: FloatArray) -> FloatArray:
        found = linearise(np.clip(_with_one(rgb) @ matrix, 0, 1), "srgb")
        return adapt(found @ XYZ_FROM_RGB["srgb"].T, D65, white_xyz)

    return apply


def affine_in_coded_srgb(
    train_rgb: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray
) -> Apply:
    """`affine_of_coded` for a camera that stores sRGB-coded values."""
    apply = affine_of_coded(encode(train_rgb, "srgb"), train_xyz, white_xyz)
    return lambda rgb: apply(encode(rgb, "srgb"))


def _with_one(rgb: FloatArray) -> FloatArray:
    return np.concatenate([rgb, np.ones((len(rgb), 1))], axis=1)


def _opencv(ccm_type: str) -> Method:
    """`cv2.ccm` with CIEDE2000 on linear values; the fitted matrix is applied here.

    The reference goes in as Lab, which OpenCV takes for that of D65: so its differences are those
    in Lab of the problem's light. The way back to XYZ is read from its own linear reference.
    """

    def fit(train_rgb: FloatArray, train_xyz: FloatArray, white_xyz: FloatArray) -> Apply:
        lab = lab_from_xyz(train_xyz, white_xyz)
        request = {"type": ccm_type, "rgb": train_rgb.tolist(), "lab": lab.tolist()}
        answer = json.loads(_opencv_answer(json.dumps(request)))
        matrix = np.array(answer["matrix"])
        linear = np.array(answer["reference_linear"])
        to_ratio, *_ = np.linalg.lstsq(linear, train_xyz / white_xyz, rcond=None)
        padded = _with_one if len(matrix) == 4 else np.asarray
        return lambda rgb: padded(rgb) @ matrix @ to_ratio * white_xyz

    return fit


def _opencv_answer(request: str) -> str:
    """Ask the worker, which forks one process for each fit."""
    worker = _opencv_worker()
    if worker.stdin is None or worker.stdout is None:
        raise NotRunError
    try:
        worker.stdin.write(request + "\n")
        worker.stdin.flush()
        answer = worker.stdout.readline()
    except BrokenPipeError as error:
        raise NotRunError from error
    if not answer:
        raise NotRunError
    return answer


@cache
def _opencv_worker() -> "subprocess.Popen[str]":
    script = Path(__file__).with_name("opencv_worker.py")
    worker = subprocess.Popen(  # noqa: S603 (our own script)
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    atexit.register(worker.communicate)  # closes its input and waits
    return worker


PEERS: Mapping[str, Method] = MappingProxyType(
    {
        LEAST_SQUARES: least_squares,
        **{
            f"colour-science Cheung {terms}": _colour_science("Cheung 2004", terms=terms)
            for terms in (7, 11, 20)
        },
        **{
            f"colour-science root-polynomial {degree}": _colour_science(
                "Finlayson 2015", degree=degree, root_polynomial_expansion=True
            )
            for degree in (2, 3)
        },
        "colour-science Vandermonde 3": _colour_science("Vandermonde", degree=3),
        "interpolating TPS-3D (scipy, kernel r)": interpolating_spline,
        "OpenCV ccm 3x3, CIEDE2000": _opencv("linear"),
        "PlantCV's way: affine in coded sRGB": affine_in_coded_srgb,
    }
)
