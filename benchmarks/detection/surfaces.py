"""What the surfaces of the board look like to a camera: levels per channel, 0..1."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from calichrome.colorimetry.reference import camera_sensitivities, illuminant
from calichrome.core.arrays import FloatArray
from calichrome.synthetic.spectra import printed_palette
from calichrome.target import Target, chessboard
from calichrome.target.board import Marker
from calichrome.target.palette import background_of, colour_checker_palette

__all__ = [
    "BLACK",
    "WHITE",
    "Look",
    "board_target",
    "colour_look",
    "grey_look",
    "random_cast",
]

WHITE, BLACK = 0.9, 0.04
"""Reflectance of coated paper and of pigment black."""

SQUARES = (9, 8)
SQUARE_M = 0.03
DISC_RATIO = 0.5

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """Levels of the surfaces in each channel of a camera, perfect diffuser = 1.

    Parameters
    ----------
    white, black, skin : (C,) float
        Paper, ink, and a hand before the board.
    discs : (M, C) float
        By marker id.
    mix : (3, C) float
        What an sRGB colour of the surroundings becomes.
    """

    white: FloatArray
    black: FloatArray
    skin: FloatArray
    discs: FloatArray
    mix: FloatArray


@cache
def board_target() -> Target:
    """Return the board of all scenes: 9x8 squares, each ColorChecker colour once.

    Bright colours lie on black squares, dark ones on white, as on the boards that we print, on
    squares drawn at random.
    """
    return _arranged(_LAYOUT_SEED)


_LAYOUT_SEED = 47
"""Of seeds 0..199 the one whose windows of 4x3 squares differ most by `layout_quality`: in 3 or
more squares (other seeds: 0 to 3), 23 % of them show 6 discs or more."""


def _arranged(seed: int) -> Target:
    board = chessboard((SQUARES[0] - 1, SQUARES[1] - 1), (SQUARE_M, SQUARE_M))
    rng = np.random.default_rng(seed)
    black = board.black_squares
    free = {
        "black": rng.permutation(np.argwhere(black)).tolist(),
        "white": rng.permutation(np.argwhere(~black)).tolist(),
    }
    markers = []
    for colour in colour_checker_palette():
        background = background_of(colour)
        iy, ix = free[background].pop()
        markers.append(
            Marker(
                square=(ix, iy),
                name=colour.name,
                diameter_m=DISC_RATIO * SQUARE_M,
                background=background,
                xyz_d65=colour.xyz_d65,
            )
        )
    return replace(board, markers=tuple(markers), white_margin_m=SQUARE_M)


def grey_look(target: Target) -> Look:
    """Return the luminances of the board under D65."""
    luminance = np.array([marker.xyz_d65[1] for marker in target.markers]).reshape(-1, 1)
    return Look(
        white=np.array([WHITE]),
        black=np.array([BLACK]),
        skin=np.array([0.33]),
        discs=luminance,
        mix=_LUMINANCE[:, None],
    )


def _responses(target: Target, light: str) -> FloatArray:
    """Camera values of white, black and discs, (2 + M, 3); white balanced on the diffuser."""
    sensitivities = camera_sensitivities()
    weights = sensitivities[min(sensitivities)] * illuminant(light)[:, None]
    values = printed_palette(target).surfaces @ weights / weights.sum(axis=0)
    return np.asarray(values * (WHITE / values[0].mean()))  # paper as bright as on grey pictures


def random_cast(rng: np.random.Generator) -> FloatArray:
    """Return the colour response of an unknown camera, (3, 3), applied as rgb @ matrix.

    White balance off by gains of 0.55 to 1 and channels that mix as a colour matrix mixes them.
    """
    gains = rng.uniform(0.55, 1.0, 3)
    mixing = np.eye(3) + rng.uniform(-0.15, 0.25, (3, 3)) * (1 - np.eye(3))
    return np.asarray(mixing / mixing.sum(axis=0) * (gains / gains.max()))


def colour_look(target: Target, light: str = "D65") -> Look:
    """Return what a white-balanced camera sees of the board.

    Spectra of the ColorChecker and measured sensitivities of a camera; the surroundings keep
    their sRGB colours.

    Parameters
    ----------
    light
        CIE illuminant: "D65", "A" and so on.
    """
    seen = _responses(target, light)
    skin = np.array([0.47, 0.29, 0.21])  # linear sRGB of light skin, ColorChecker patch 2
    return Look(white=seen[0], black=seen[1], skin=skin, discs=seen[2:], mix=np.eye(3))
