"""Description spaces: where the error of a colour is judged, and how it is weighed near a colour.

Each space has a difference and, near any colour, a metric: the quadratic form that the squared
difference becomes for small errors. Least squares with that metric is what a fit "in Lab" is.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from calichrome.colorimetry.adaptation import D65, adapt
from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz
from calichrome.colorimetry.reference import cam16_ucs
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray

__all__ = ["DESCRIPTION_SPACES", "DescriptionSpace", "difference", "metric"]

DescriptionSpace = Literal["xyz", "linear-srgb", "lab76", "lab94", "lab2000", "oklab", "cam16-ucs"]

_STEP = 1e-4  # of Y = 1: a hundredth of what CIEDE2000 tells apart, far above rounding
_LMS_FROM_XYZ = np.array(
    [
        [0.8189330101, 0.3618667424, -0.1288597137],
        [0.0329845436, 0.9293118715, 0.0361456387],
        [0.0482003018, 0.2643662691, 0.6338517070],
    ]
)
_OKLAB_FROM_LMS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def _delta_e_94(lab_a: FloatArray, lab_b: FloatArray) -> FloatArray:
    """CIE94 for graphic arts, chroma as the geometric mean so that the order does not matter.

    References
    ----------
    .. [1] CIE 116-1995, eq. 1 to 9 and the note on the choice of the standard.
    """
    delta = lab_b - lab_a
    chroma_a, chroma_b = (np.hypot(lab[..., 1], lab[..., 2]) for lab in (lab_a, lab_b))
    d_chroma = chroma_b - chroma_a
    d_hue2 = np.maximum(delta[..., 1] ** 2 + delta[..., 2] ** 2 - d_chroma**2, 0)
    mean = np.sqrt(chroma_a * chroma_b)
    return np.asarray(
        np.sqrt(
            delta[..., 0] ** 2
            + (d_chroma / (1 + 0.045 * mean)) ** 2
            + d_hue2 / (1 + 0.015 * mean) ** 2
        )
    )


def _oklab(xyz: FloatArray, white: FloatArray) -> FloatArray:
    """Oklab, times 100 so that it counts like Lab.

    References
    ----------
    .. [1] B. Ottosson, "A perceptual color space for image processing", 2020.
    """
    lms = adapt(xyz, white, D65) @ _LMS_FROM_XYZ.T
    return np.asarray(100 * np.cbrt(lms) @ _OKLAB_FROM_LMS.T)


def _euclidean(
    coordinates: Callable[[FloatArray, FloatArray], FloatArray],
) -> Callable[[FloatArray, FloatArray, FloatArray], FloatArray]:
    return lambda a, b, white: np.asarray(
        np.linalg.norm(coordinates(a, white) - coordinates(b, white), axis=-1)
    )


_DIFFERENCES: Mapping[str, Callable[[FloatArray, FloatArray, FloatArray], FloatArray]] = (
    MappingProxyType(
        {
            "xyz": _euclidean(lambda xyz, white: 100 * xyz / white),
            "linear-srgb": _euclidean(
                lambda xyz, white: 100 * adapt(xyz, white, D65) @ RGB_FROM_XYZ["srgb"].T
            ),
            "lab76": _euclidean(lab_from_xyz),
            "lab94": lambda a, b, white: _delta_e_94(
                lab_from_xyz(a, white), lab_from_xyz(b, white)
            ),
            "lab2000": lambda a, b, white: delta_e_2000(
                lab_from_xyz(a, white), lab_from_xyz(b, white)
            ),
            "oklab": _euclidean(_oklab),
            "cam16-ucs": _euclidean(cam16_ucs),
        }
    )
)
DESCRIPTION_SPACES = tuple(_DIFFERENCES)


def difference(
    xyz_a: FloatArray,
    xyz_b: FloatArray,
    space: DescriptionSpace = "lab2000",
    white: FloatArray = D65,
) -> FloatArray:
    """Return how far colours are apart in a description space.

    Parameters
    ----------
    xyz_a, xyz_b : (..., 3) float
        Y = 1 for the perfect diffuser.
    space
        "xyz" and "linear-srgb" in hundredths of white; "lab76", "lab94", "lab2000": the CIE's
        differences in Lab; "oklab" times 100; "cam16-ucs" under an average surround.
    white : (3,) float

    Returns
    -------
    (...) float
    """
    return _DIFFERENCES[space](xyz_a, xyz_b, white)


def metric(
    xyz: FloatArray, space: DescriptionSpace = "lab2000", white: FloatArray = D65
) -> FloatArray:
    """Return M (N, 3, 3): near each colour, difference^2 = d' M d for a small error d in XYZ.

    Parameters
    ----------
    xyz : (N, 3) float
        Y = 1 for the perfect diffuser.
    space, white
        As in `difference`.
    """

    def squared(step: FloatArray) -> FloatArray:
        return np.asarray(
            (
                difference(xyz, xyz + step, space, white) ** 2
                + difference(xyz, xyz - step, space, white) ** 2
            )
            / 2
        )

    # of the form's entries M_ij = (q(i + j) - q(i) - q(j)) / 2
    steps = _STEP * np.eye(3)
    alone = [squared(step) for step in steps]
    form = np.empty((len(xyz), 3, 3))
    for i in range(3):
        form[:, i, i] = alone[i]
        for j in range(i):
            form[:, i, j] = (squared(steps[i] + steps[j]) - alone[i] - alone[j]) / 2
            form[:, j, i] = form[:, i, j]
    return form / _STEP**2
