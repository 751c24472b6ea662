"""A colour model and an output space in the form that loops over pixels evaluate."""

from dataclasses import dataclass, field
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from calichrome.colour.model import ColourModel, TermModel
from calichrome.colour.models.hue_plane import HuePlane
from calichrome.colour.models.linear import Affine, Linear, LinearWhite
from calichrome.colour.models.polynomial import Polynomial
from calichrome.colour.models.root_polynomial import RootPolynomial
from calichrome.colour.models.white_balance import WhiteBalance
from calichrome.core.arrays import FloatArray
from calichrome.kernels.table import ColourTable

__all__ = ["ColourTerms", "colour_terms"]

_TABLE_SIZE = 33
"""Of what models add to their tangent at white. On colours drawn from the camera's cube, splines,
subspaces and local regression are then met within 0.04 levels of 255 in 99 %, 0.25 at most; the
edges of tetrahedra within 1.3 in 99 % (with 65 nodes 0.5)."""

# numbers of the factors in correct.h
_ONE, _BALANCED, _ROOT, _CUBE_ROOT, _RADIUS, _WAVES = 0, 1, 4, 7, 10, 11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourTerms:
    """``offset + matrix @ b + lifted_matrix @ lifted(b) + coefficients.T @ terms + table(b)``.

    Parameters
    ----------
    balance : (3,) float
        b = balance * linear camera RGB.
    matrix, lifted_matrix : (3, 3) float
        The second acts on the lifted channels of `root_polynomial.lifted`.
    offset : (3,) float
    factors : (P, 3) uint8
        Each term is a product of three of the factors that correct.h numbers.
    coefficients : (P, 3) float
    table
        What a model without closed form adds.
    """

    matrix: FloatArray
    balance: FloatArray = field(default_factory=lambda: np.ones(3))
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    lifted_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    factors: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    coefficients: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    table: ColourTable | None = None


def colour_terms(
    model: ColourModel, out_from_xyz: FloatArray, white_rgb: FloatArray, most: FloatArray
) -> ColourTerms:
    """Compile a model.

    Parameters
    ----------
    model
        Linear camera RGB to XYZ.
    out_from_xyz : (3, 3) float
        To the linear channels of the output.
    white_rgb : (3,) float
        Where tables follow the model exactly in value and slope.
    most : (3,) float
        The most light that a pixel can hold; a table ends there.
    """
    terms = _closed_form(model, out_from_xyz)
    if terms is not None:
        return terms
    # the tangent at white is exact, so a table holds the little that bends away from it
    matrix = out_from_xyz @ model.jacobian(white_rgb)
    table = ColourTable.of(
        lambda light: model.apply(light) @ out_from_xyz.T - light @ matrix.T, most, _TABLE_SIZE
    )
    return ColourTerms(matrix=matrix, table=table)


@singledispatch
def _closed_form(model: ColourModel, out_from_xyz: FloatArray) -> ColourTerms | None:  # noqa: ARG001
    return None


@_closed_form.register(WhiteBalance)
@_closed_form.register(LinearWhite)
@_closed_form.register(Linear)
@_closed_form.register(Affine)
def _(model: TermModel, out_from_xyz: FloatArray) -> ColourTerms:
    black = np.zeros(3)
    return ColourTerms(
        matrix=out_from_xyz @ model.jacobian(black), offset=out_from_xyz @ model.apply(black)
    )


@_closed_form.register
def _(model: Polynomial, out_from_xyz: FloatArray) -> ColourTerms:
    exponents = np.array(model.EXPONENTS)
    coefficients = (model.coefficients * model.white_xyz) @ out_from_xyz.T
    degree = exponents.sum(axis=1)
    first = degree == 1
    factors = [
        np.pad(np.repeat(_BALANCED + np.arange(3), powers), (0, 3 - sum(powers)))
        for powers in exponents[degree > 1]
    ]
    return ColourTerms(
        balance=1 / model.white_rgb,
        matrix=(exponents[first].T @ coefficients[first]).T,
        offset=coefficients[degree == 0].sum(axis=0),
        factors=np.array(factors, dtype=np.uint8),
        coefficients=coefficients[degree > 1],
    )


@_closed_form.register
def _(model: RootPolynomial, out_from_xyz: FloatArray) -> ColourTerms:
    matrix, coefficients = _matrix_first(model, out_from_xyz)
    factors = []
    for exponents in model.EXPONENTS:
        order, first = (2, _ROOT) if (exponents % 0.5 == 0).all() else (3, _CUBE_ROOT)
        powers = np.rint(exponents * order).astype(int)
        factors.append(np.pad(np.repeat(first + np.arange(3), powers), (0, 3 - order)))
    return ColourTerms(
        balance=1 / model.white_rgb,
        matrix=matrix,
        # geometric less arithmetic mean
        lifted_matrix=-coefficients.T @ model.EXPONENTS,
        factors=np.array(factors, dtype=np.uint8),
        coefficients=coefficients,
    )


@_closed_form.register
def _(model: HuePlane, out_from_xyz: FloatArray) -> ColourTerms:
    matrix, coefficients = _matrix_first(model, out_from_xyz)
    waves = [_WAVES + 2 * (order - 2) + part for order in model.ORDERS for part in range(2)]
    factors = [[_RADIUS, wave, _ONE] for wave in (_ONE, *waves)]
    return ColourTerms(
        balance=1 / model.white_rgb,
        matrix=matrix,
        factors=np.array(factors, dtype=np.uint8),
        coefficients=coefficients,
    )


def _matrix_first(model: TermModel, out_from_xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the matrix of a model's first terms on balanced colours, and the other coefficients.

    They are R - G, B - G beside the base G where white is kept, else R, G, B.
    """
    kind, count = (LinearWhite, 2) if model.WHITE_EXACT else (Linear, 3)
    linear = kind(np.ones(3), model.white_xyz, model.coefficients[:count])
    others = (model.coefficients[count:] * model.white_xyz) @ out_from_xyz.T
    return out_from_xyz @ linear.jacobian(np.zeros(3)), others
