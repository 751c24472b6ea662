"""The light on a board and on a card beside it: what the card's light makes of the paper.

The white squares tell the light over the board but for a factor, what the paper reflects; a card of
known colours tells the light over itself. Light is smooth across both, which fixes the factor.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["PaperInCardLight", "paper_in_card_light"]

_CURVED = 0.01
"""Relative sigma of a white level about a quadratic of the places, at least. Lamps fall off in
another way: over 3000 pairs of lamps at 0.5 to 1.6 m before a board of 0.3 m and a card beside it,
with vignetting (those of the tests), the paper comes out right to 1.3 % rms, and to 2.5 % if levels
count as right to 0.3 %."""
_PATCH = 0.01  # the same for the level of a patch, whose camera is no matrix: usually 0.02 to 0.04
_TERMS = (3, 6, 10)  # of a plane, a quadratic and a cubic in two variables
_FEWEST = 12  # levels for a quadratic, as for the light on a board


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PaperInCardLight:
    """What the camera makes of the paper in the light that the card was in.

    Parameters
    ----------
    rgb : (3,) float
        Linear camera value.
    level_sigma
        Relative sigma of what is common to the channels: of the paper's level alone.
    tint_cov : (3, 3) float
        Relative covariance of what differs between the channels.
    """

    rgb: FloatArray
    level_sigma: float
    tint_cov: FloatArray


def paper_in_card_light(
    board_px: FloatArray,
    white_rgb: FloatArray,
    card_px: FloatArray,
    card_light: FloatArray,
    card_weights: FloatArray,
) -> PaperInCardLight | str:
    """Carry the level of the paper from the board to the card.

    Parameters
    ----------
    board_px : (M, 2) float
        Where white levels were read.
    white_rgb : (M, 3) float
        Linear camera values of the paper there, all positive.
    card_px : (N, 2) float
        Where the patches are.
    card_light : (N,) float
        Light on each patch over that in which the card's camera model holds.
    card_weights : (N,) float
        Of the patches, 0 to 1.

    Returns
    -------
    PaperInCardLight or str
        The sentence says what is missing.

    Notes
    -----
    With y the mean log of the channels and T the terms of a polynomial in the places x,

        y(x) = log paper + T(x) q   on the board,        log light(x) = T(x) q   on the card,

    so that the paper is what the two differ by. A quadratic is taken. What the next order would
    change, together with the noise that the solution carries, is the sigma. The tint, log w - y, is
    carried by a plane through the board's levels alone, since patches tell it badly; its next order
    is the quadratic.
    """
    if len(board_px) < _FEWEST:
        return f"only {len(board_px)} white levels are readable, {_FEWEST} are needed"
    if len(card_px) < _TERMS[0]:
        return f"only {len(card_px)} patches of the card are usable"
    origin = np.average(card_px, axis=0, weights=card_weights)
    scale = float(np.linalg.norm(board_px.mean(axis=0) - origin))
    board, card = (board_px - origin) / scale, (card_px - origin) / scale
    log_white = np.log(white_rgb)
    level = log_white.mean(axis=1)

    on_board = np.concatenate([np.ones(len(board)), np.zeros(len(card))])
    places, values = np.concatenate([board, card]), np.concatenate([level, np.log(card_light)])
    sigma = np.concatenate(
        [
            np.full(len(board), max(_scatter(board, level, _TERMS[1]), _CURVED)),
            max(_scatter(card, np.log(card_light), _TERMS[0]), _PATCH)
            / np.sqrt(np.maximum(card_weights, 1e-6)),
        ]
    )
    paper, paper_sigma = _solve(on_board, _terms(places, _TERMS[1]), values, sigma)
    cubic, _ = _solve(on_board, _terms(places, _TERMS[2]), values, sigma)

    tint = log_white - level[:, None]
    plane, noise = _extrapolate(board, tint, _TERMS[0])
    quadratic, _ = _extrapolate(board, tint, _TERMS[1])
    # channels of a tint sum to 0, and so do their errors
    off = quadratic - plane
    return PaperInCardLight(
        rgb=np.exp(paper + plane),
        level_sigma=float(np.hypot(paper_sigma, cubic - paper)),
        tint_cov=np.outer(off, off) + noise,
    )


def _terms(places: FloatArray, count: int) -> FloatArray:
    x, y = places.T
    one = np.ones_like(x)
    columns = [one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
    return np.stack(columns[:count], axis=1)


def _scatter(places: FloatArray, values: FloatArray, n_terms: int) -> float:
    """Root mean square of values about their own polynomial."""
    design = _terms(places, n_terms)
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(np.sqrt((left**2).sum() / max(len(values) - n_terms, 1)))


def _solve(
    on_board: FloatArray, terms: FloatArray, values: FloatArray, sigma: FloatArray
) -> tuple[float, float]:
    """Return the step from card to board, and its sigma."""
    design = np.concatenate([on_board[:, None], terms], axis=1) / sigma[:, None]
    inverse = np.linalg.pinv(design)
    return float(inverse[0] @ (values / sigma)), float(np.linalg.norm(inverse[0]))


def _extrapolate(
    places: FloatArray, values: FloatArray, n_terms: int
) -> tuple[FloatArray, FloatArray]:
    """Value at the origin of polynomials through (M, 3), (3,), and its covariance by noise."""
    design = _terms(places, n_terms)
    inverse = np.linalg.pinv(design)
    solution = inverse @ values
    left = values - design @ solution
    cov = left.T @ left / max(len(values) - n_terms, 1) * (inverse[0] @ inverse[0])
    return solution[0], cov
