"""Light that is not the scene's: a black level, and stray light that veils the whole picture."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.observations import BoardView
from calichrome.target import Target

__all__ = ["Additive", "measure_additive"]

_SUPPORTED = 3.0  # sigmas from which an additive part is taken for real
_FEWEST_FRAMES = 4  # whose scatter tells a sigma
_INK_TOLERANCE = 0.1
"""Relative sigma of black over white in a camera's channels about its ratio in Y: black inks are
neutral to some per cent (carbon black and process black 3 to 10 %); not set on any data set."""
_VEIL = 0.1  # sigma of stray light as a share of white, before any data: lenses have 0.2 to 5 %
_ROUNDS = 5
_HUBER = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Additive:
    """What is added to every picture of a camera.

    ``black square = ink * white square + level + veil * mean white of the view``, where the white
    square is without what is added, too.

    Parameters
    ----------
    level, sigma_level : (3,) float
        The same in all pictures: a black level that was not removed. Share of full scale.
    veil, sigma_veil : (3,) float
        Stray light, as a share of the view's mean white.
    ink, sigma_ink : (3,) float
        Black over white as printed.
    ink_known
        Whether the target's paper said what black ink reflects; otherwise `ink` follows from how
        black and white change together with the light.

    Notes
    -----
    A part counts as supported if it is beyond three sigmas in all three channels: taken off one
    channel alone it would tint the dark colours. `level` and `ink` are those without a veil where
    the veil is not supported; `veil` is reported all the same.
    """

    level: FloatArray
    sigma_level: FloatArray
    veil: FloatArray
    sigma_veil: FloatArray
    ink: FloatArray
    sigma_ink: FloatArray
    ink_known: bool

    def offset(self, mean_white: FloatArray) -> FloatArray:
        """Return what to subtract from a view of `mean_white` (3,): only what is supported."""
        offset = np.zeros(3)
        if (np.abs(self.level) > _SUPPORTED * self.sigma_level).all():
            offset = offset + self.level
        if _is_veiled(self.veil, self.sigma_veil):
            offset = offset + self.veil * mean_white
        return offset


def _is_veiled(veil: FloatArray, sigma: FloatArray) -> bool:
    return bool((veil > _SUPPORTED * sigma).all())  # stray light is never negative


def measure_additive(views: Mapping[str, BoardView], target: Target) -> Additive | None:
    """Estimate the additive part of one camera from black and white squares.

    None with fewer than four views that show both.
    """
    columns, black, frames = [], [], []
    for index, view in enumerate(views.values()):
        discs = view.discs
        if discs is None:
            continue
        read = np.isfinite(discs.white_rgb).all(axis=1) & np.isfinite(discs.black_rgb).all(axis=1)
        if not read.any():
            continue
        white = discs.white_rgb[read]
        mean = np.broadcast_to(white.mean(axis=0), white.shape)
        columns.append(np.stack([white, np.ones_like(white), mean], axis=-1))
        black.append(discs.black_rgb[read])
        frames.append(np.full(len(white), index))
    if len(frames) < _FEWEST_FRAMES:
        return None
    paper = target.paper
    ink = None
    if paper.white_xyz_d65 is not None and paper.black_xyz_d65 is not None:
        ink = float(paper.black_xyz_d65[1] / paper.white_xyz_d65[1])
    design, blacks, frame = np.concatenate(columns), np.concatenate(black), np.concatenate(frames)
    value, sigma = _regress_channels(design, blacks, frame, ink)
    veil, sigma_veil = value[:, 2], sigma[:, 2]
    if not _is_veiled(veil, sigma_veil):
        value, sigma = _regress_channels(design[..., :2], blacks, frame, ink)
    return Additive(
        ink=value[:, 0],
        sigma_ink=sigma[:, 0],
        level=value[:, 1],
        sigma_level=sigma[:, 1],
        veil=veil,
        sigma_veil=sigma_veil,
        ink_known=ink is not None,
    )


def _regress_channels(
    design: FloatArray, black: FloatArray, frame: IntArray, ink: float | None
) -> tuple[FloatArray, FloatArray]:
    """Regress each channel of (N, 3, P) and (N, 3): values and sigmas, (3, P)."""
    solved = [_regress(design[:, k], black[:, k], frame, ink) for k in range(3)]
    value = np.array([item[0] for item in solved])
    sigma = np.array([item[1] for item in solved])
    # the white that was read holds the additive part as well, of which ink takes its share off
    scale = np.ones_like(value)
    scale[:, 1:] = 1 - value[:, :1]
    return value / scale, sigma / scale


def _regress(
    design: FloatArray, black: FloatArray, frame: IntArray, ink: float | None
) -> tuple[FloatArray, FloatArray]:
    """Robust regression (P,) with sigmas (P,) from leaving out one frame at a time."""
    trust = np.ones(len(black))
    noise = float(np.var(black)) + 1e-12
    # wide but finite: in even light veil and ink cannot be told apart, and sigmas must say so
    aim = np.array([0.0 if ink is None else ink, 0, 0])[: design.shape[1]]
    doubts = np.array([1.0 if ink is None else _INK_TOLERANCE * ink, 1.0, _VEIL])
    prior = 1 / doubts[: design.shape[1]] ** 2

    def solve(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = design * (rows * trust)[:, None]
        inverse = np.asarray(np.linalg.inv(weighted.T @ design / noise + np.diag(prior)))
        return inverse @ (weighted.T @ black / noise + prior * aim), inverse

    every = np.ones(len(black))
    for _ in range(_ROUNDS):
        value, inverse = solve(every)
        off = np.abs(black - design @ value)
        # never below the rounding of 16 bits: made-up readings without noise have none
        sigma = 1.4826 * float(np.median(off)) + 1e-6
        trust, noise = np.minimum(1, _HUBER * sigma / np.maximum(off, 1e-12)), sigma**2
    left_out = np.array([solve(frame != index)[0] for index in np.unique(frame)])
    n_frames = len(left_out)
    scatter = (n_frames - 1) / n_frames * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    from_prior = (inverse**2 * prior).sum(axis=1)  # all frames share it
    return value, np.asarray(np.sqrt(scatter + from_prior))
