"""Rows of frames corrected by the C extension."""

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.chebyshev import chebpts1
from numpy.typing import ArrayLike, NDArray

from calichrome.apply.correction import Correction
from calichrome.colorimetry.encoding import (
    EncodingName,
    ToneCurve,
    encode,
    linear_table,
    linearise,
)
from calichrome.colour.models.root_polynomial import LIFT
from calichrome.core.arrays import FloatArray
from calichrome.imaging import Pixels
from calichrome.kernels import native

__all__ = ["NativeRows"]

_N_LINEAR = 255 * 16 + 1
"""Entries of a table from stored to linear values, with straight lines in between: every 8-bit
number has its own, and so has every node of a tone curve of 256."""
_LINEAR, _BY_CURVE, _BY_TABLE = range(3)  # enum linearisation of plan.h
_N_POWERS = 7  # of polynomials in plan.h
_FOOT_ENDS: dict[EncodingName, float] = {"srgb": 0.04045, "rec709": 0.0812428583}
"""Stored values below which encodings are linear: IEC 61966-2-1:1999; ITU-R BT.709-6 as in
`colorimetry.encoding`. A power law without a foot gets a table: near black a polynomial follows it
to 1e-5 of white only, and roots of that show."""


class NativeRows:
    """A correction compiled for the C extension; see `Correction`.

    Parameters
    ----------
    correction
        What is done.
    wide
        Use the vector instructions of the processor where it has them.
    """

    def __init__(self, correction: Correction, *, wide: bool = True) -> None:
        assert native is not None  # noqa: S101 (the caller has looked)
        self._native: ModuleType = native
        self._plan = native.compile_plan(**_plan(correction))
        self._wide = wide

    def run(self, frame: Pixels, out: Pixels, first: int, last: int) -> None:
        """Write rows `first` to `last` - 1 of the output."""
        self._native.run(self._plan, frame, out, first, last, self._wide)


def _plan(correction: Correction) -> dict[str, Any]:
    frames, colour = correction.frames, correction.colour
    nothing = _floats([])
    plan: dict[str, Any] = {
        "in_size_wh": correction.size_wh,
        "out_size_wh": correction.out_size_wh,
        "n_channels": frames.n_channels,
        "in_type": np.dtype(frames.dtype).itemsize,
        "out_type": np.dtype(correction.out_type).itemsize,
        "is_bgr": frames.order == "bgr",
        "has_colour": colour is not None,
        "clips": False,
        "full_scale": frames.top,
        "out_scale": correction.out_scale,
        "map_step": 0 if correction.map is None else correction.map.step,
        "map_nodes": nothing if correction.map is None else correction.map.nodes,
        "gain_step": 0,
        "gain_nodes": nothing,
        "balance": _floats(np.ones(3)),
        "linearisation": _LINEAR,
        "curve": _floats(np.zeros(_N_POWERS)),
        "curve_foot": (0.0, 0.0),
        "linear": nothing,
        "matrix": _floats(np.eye(3)),
        "offset": _floats(np.zeros(3)),
        "lift": LIFT,
        "lifted_grey": (1 + np.sqrt(1 + 4 * LIFT**2)) / 2,
        "lifted_matrix": _floats(np.zeros((3, 3))),
        "factors": np.zeros((0, 3), np.uint8),
        "coefficients": nothing,
        "table_size": 0,
        "table_scale": _floats(np.ones(3)),
        "table": nothing,
        "is_encoded": False,
        "encoding": _floats(np.zeros(_N_POWERS)),
        "encoding_foot": (0.0, 0.0),
    }
    if colour is None:
        return plan
    terms = colour.terms
    plan |= {
        "clips": colour.clips,
        "balance": _floats(terms.balance),
        "matrix": _floats(terms.matrix),
        "offset": _floats(terms.offset),
        "lifted_matrix": _floats(terms.lifted_matrix),
        "factors": np.ascontiguousarray(terms.factors),
        "coefficients": _floats(terms.coefficients),
    }
    if not isinstance(colour.curve, ToneCurve) and colour.curve in _FOOT_ENDS:
        plan["linearisation"] = _BY_CURVE
        plan["curve"], plan["curve_foot"] = _linearising_curve(colour.curve)
    elif colour.curve != "linear":
        plan["linearisation"] = _BY_TABLE
        plan["linear"] = _floats(linear_table(colour.curve, _N_LINEAR - 1).T)
    if colour.gain is not None:
        plan["gain_step"] = colour.gain.step
        plan["gain_nodes"] = _floats(colour.gain.nodes * terms.balance[:, None, None])
    if terms.table is not None:
        plan["table_size"] = terms.table.size
        plan["table_scale"] = _floats(terms.table.scale)
        plan["table"] = terms.table.nodes
    if colour.is_encoded:
        plan["is_encoded"] = True
        plan["encoding"], plan["encoding_foot"] = _srgb_encoding_curve()
    return plan


@cache
def _linearising_curve(encoding: EncodingName) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Coefficients of a polynomial in the stored value, and the foot below it.

    Of degree 6 it is within 1e-5 of the power laws: 0.03 levels of 255 once
    encoded in the darkest tones.
    """
    end = _FOOT_ENDS[encoding]
    slope = float(linearise(np.array(end), encoding)) / end
    return _polynomial(lambda stored: linearise(stored, encoding), end), (end, slope)


@cache
def _srgb_encoding_curve() -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Coefficients of a polynomial in the fourth root of light, and the foot below it.

    The transfer function of sRGB is there the power 5/3, which degree 6 follows within 2e-6; over
    light itself its slope has no bound at 0, and no degree would do.
    """
    end = float(linearise(np.array(_FOOT_ENDS["srgb"]), "srgb"))
    slope = _FOOT_ENDS["srgb"] / end
    return _polynomial(lambda root: encode(root**4, "srgb"), end**0.25), (end, slope)


def _polynomial(curve: Callable[[FloatArray], FloatArray], start: float) -> NDArray[np.float32]:
    """Fit a curve from `start` to 1 at Chebyshev's points; lowest power first."""
    places = start + (1 - start) * (1 + chebpts1(200)) / 2
    fitted = Chebyshev.fit(places, curve(places), _N_POWERS - 1, domain=[start, 1])
    return _floats(fitted.convert(kind=Polynomial).coef)


def _floats(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)
