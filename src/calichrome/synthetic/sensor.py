"""From electrons to the numbers of a file: noise, mosaic, converter, demosaicing, encoding."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import FloatArray
from calichrome.synthetic.scene import SceneCamera, SceneSensor

__all__ = ["demosaic", "develop", "expose", "mosaic", "stored"]

# Malvar, He, Cutler 2004, figure 2, in eighths.
_GREEN = np.array(
    [
        [0, 0, -1, 0, 0],
        [0, 0, 2, 0, 0],
        [-1, 2, 4, 2, -1],
        [0, 0, 2, 0, 0],
        [0, 0, -1, 0, 0],
    ]
)
_ALONG_ROW = np.array(
    [
        [0, 0, 0.5, 0, 0],
        [0, -1, 0, -1, 0],
        [-1, 4, 5, 4, -1],
        [0, -1, 0, -1, 0],
        [0, 0, 0.5, 0, 0],
    ]
)
_ALONG_COLUMN = _ALONG_ROW.T
_DIAGONAL = np.array(
    [
        [0, 0, -1.5, 0, 0],
        [0, 2, 0, 2, 0],
        [-1.5, 0, 6, 0, -1.5],
        [0, 2, 0, 2, 0],
        [0, 0, -1.5, 0, 0],
    ]
)
# Share of the converter's range below zero light, so that noise in the dark is not cut off;
# 64 of 4096 is usual.
_BLACK_LEVEL = 64 / 4096


def mosaic(rgb: FloatArray) -> FloatArray:
    """Keep one of three values per pixel, (H, W, 3) to (H, W): rows R G R G, then G B G B."""
    raw = rgb[..., 1].copy()
    raw[::2, ::2] = rgb[::2, ::2, 0]
    raw[1::2, 1::2] = rgb[1::2, 1::2, 2]
    return raw


def demosaic(raw: FloatArray) -> FloatArray:
    """Interpolate the missing colours of an RGGB mosaic linearly, (H, W) to (H, W, 3).

    References
    ----------
    .. [1] H. S. Malvar, L. He, R. Cutler, "High-Quality Linear Interpolation for Demosaicing of
       Bayer-Patterned Color Images", IEEE ICASSP 2004, vol. 3, pp. 485-488.
    """
    # "mirror" reflects about the outermost pixel, which keeps the order of the filters.
    green, along_row, along_column, diagonal = (
        convolve(raw, kernel / 8, mode="mirror")
        for kernel in (_GREEN, _ALONG_ROW, _ALONG_COLUMN, _DIAGONAL)
    )
    rgb = np.repeat(raw[..., None], 3, axis=-1)
    red, blue = (slice(None, None, 2),) * 2, (slice(1, None, 2),) * 2
    red_row = slice(None, None, 2), slice(1, None, 2)
    blue_row = slice(1, None, 2), slice(None, None, 2)
    rgb[..., 1][red], rgb[..., 1][blue] = green[red], green[blue]
    rgb[..., 0][red_row], rgb[..., 2][blue_row] = along_row[red_row], along_row[blue_row]
    rgb[..., 0][blue_row], rgb[..., 2][red_row] = along_column[blue_row], along_column[red_row]
    rgb[..., 0][blue], rgb[..., 2][red] = diagonal[blue], diagonal[red]
    return rgb


def expose(electrons: FloatArray, sensor: SceneSensor, rng: np.random.Generator) -> FloatArray:
    """Read a sensor out.

    Parameters
    ----------
    electrons : (...) float
        Mean number of electrons per photosite.

    Returns
    -------
    (...) float
        Share of the full well, black level removed; at most 1, below 0 where noise says so.
    """
    if sensor.noise:
        noise = rng.normal(0, sensor.read_noise_e, electrons.shape)
        electrons = rng.poisson(np.maximum(electrons, 0)) + noise
    share = electrons / sensor.full_well_e
    if sensor.adc_bits is None:
        return np.minimum(share, 1)
    largest = 2**sensor.adc_bits - 1
    black = round(_BLACK_LEVEL * (largest + 1))
    numbers = np.clip(np.round(black + share * (largest - black)), 0, largest)
    return np.asarray((numbers - black) / (largest - black))


def develop(electrons: FloatArray, camera: SceneCamera, rng: np.random.Generator) -> FloatArray:
    """Return the linear picture of a camera, white-balanced, from mean electrons (H, W, 3).

    Values are shares of full scale, (H, W, 3), not yet cut at 0 and 1.
    """
    if camera.sensor.mosaic:
        rgb = demosaic(expose(mosaic(electrons), camera.sensor, rng))
    else:
        rgb = expose(electrons, camera.sensor, rng)
    return np.asarray(rgb * np.array(camera.white_balance))


def stored(rgb_linear: FloatArray, camera: SceneCamera) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Encode and round a linear picture (H, W, 3) to the numbers of its file."""
    encoded = encode(np.clip(rgb_linear, 0, 1), camera.encoding)
    numbers: FloatArray = np.round(encoded * (2**camera.bits - 1))
    return numbers.astype(np.uint8) if camera.bits == 8 else numbers.astype(np.uint16)
