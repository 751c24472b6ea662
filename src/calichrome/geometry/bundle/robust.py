"""Corners that do not belong are found, left out, and the rest solved by plain least squares.

A robust cost (Huber) finds the neighbourhood of the truth although some corners lie; the median of
its residuals tells each camera's noise, a gate takes out what noise cannot explain, and the least
squares on the rest has a covariance that means what it says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.geometry.bundle.blocks import chunk_residuals, whiten
from calichrome.geometry.bundle.board_shape import BoardShape
from calichrome.geometry.bundle.noise import median_noise, view_noise
from calichrome.geometry.bundle.observations import Observations
from calichrome.geometry.bundle.solve import BundleResult, solve_bundle, step_bundle
from calichrome.geometry.bundle.state import BundleState, Free, Priors

__all__ = ["RobustResult", "solve_robust"]

_HUBER = 1.345
"""In sigmas: 95 % efficient for Gaussian noise in one dimension (P. J. Huber, E. Ronchetti, "Robust
Statistics", 2nd ed., 2009). Only the way to the gate depends on it, not the result."""

_LOST = 1e-3
"""Good corners that the gate is expected to take, per recording: with N corners of unit noise it
stands at sqrt(2 ln(N / _LOST)), 5.5 for 3520. A choice: efficient, and no outlier below it can
move a parameter by more than about its leverage times 5.5 sigma."""

_ROUNDS = 5  # of Huber, each with the noise of the one before; of the gate as well
_LOOSE = 1e-2  # relative decrease at which a Huber pass has found the neighbourhood
_STEADY = 0.4  # share of the noise before at which a Huber pass had the right threshold
_NEAR = 1e-8  # damping of a solve that starts near its minimum; grows by itself where it must
_ON_THE_LINE = 1e-4  # share of corners that may still cross the gate: of 10,000 none or one
_SETTLED = 0.02  # mean change of the views' noise that shifts the minimum by little of a sigma
_MANY, _ENOUGH = 20_000, 20
"""Corners from which the Huber passes look at about 20 of each view only; choices, for speed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustResult:
    """A bundle solved without the corners that do not belong.

    Parameters
    ----------
    result
        Least squares on the inliers, whitened to unit variance by `noise`.
    inliers : (V,) list of (N,) bool
        By view, in the order packed.
    noise : (C,) float
        By what each camera's residuals exceed their stated noise (pixels, where none was stated),
        in its median view.
    squares
        Sum of squares of all corners' residuals as stated, none left out but none counted beyond
        the gate: what two models of the same corners can be compared by.
    n_unknowns
        That were free.
    """

    result: BundleResult
    inliers: list[BoolArray]
    noise: FloatArray
    squares: float
    n_unknowns: int


def solve_robust(
    observations: Observations,
    start: BundleState,
    free: Free,
    *,
    priors: Priors | None = None,
    gate: bool = True,
) -> RobustResult:
    """Solve with Huber's cost, gate, and solve the rest in least squares.

    Parameters
    ----------
    observations, start, free, priors
        As in `solve_bundle`.
    gate
        False: every corner counts, as it does in plain least squares.
    """
    base = _whitenings(observations)
    if gate:
        state, residuals = _near(observations, start, free, priors)
    else:
        state, residuals = start, chunk_residuals(observations, start)
    lengths = _lengths(base, residuals)
    inside = kept = [chunk.filled for chunk in observations.chunks]
    if gate:
        inside = _inside(observations, lengths, median_noise(observations, lengths))
    noise = view_noise(observations, lengths, inside, free, views_differ=gate)
    if gate:  # the first gate stood on a rough state: one step on, it is drawn again
        step = step_bundle(
            observations.weighted(_scaled(observations, base, noise, inside)), state, free,
            priors=priors, damping=_NEAR,
        )  # fmt: skip
        state, lengths = step.state, _lengths(base, step.residuals)
        noise = view_noise(
            observations, lengths, inside, free, views_differ=True, shares=step.equations.shares()
        )
        inside = _whole(observations, _inside(observations, lengths, noise))
    for _ in range(_ROUNDS):
        kept, used = inside, noise
        result = solve_bundle(
            observations.weighted(_scaled(observations, base, noise, kept)), state, free,
            priors=priors, damping=_NEAR if gate else 1e-4,
        )  # fmt: skip
        state = result.state
        lengths = _lengths(base, chunk_residuals(observations, state))
        noise = view_noise(
            observations, lengths, kept, free, views_differ=gate, shares=result.equations.shares()
        )
        inside = _whole(observations, _inside(observations, lengths, noise)) if gate else kept
        moved = sum(int((a != b).sum()) for a, b in zip(inside, kept, strict=True))
        changed = float(np.sqrt(np.mean((noise / used - 1) ** 2)))
        if moved <= _ON_THE_LINE * observations.n_corners and changed < _SETTLED:
            break
    inliers = observations.by_view([item[:, None].astype(np.float64) for item in kept])
    return RobustResult(
        result=replace(result, equations=result.equations.reweighted(used / noise)),
        inliers=[item[:, 0] > 0 for item in inliers],
        noise=_by_camera(observations, noise),
        squares=_bounded_squares(observations, lengths, noise),
        n_unknowns=int(free.mask.sum()) + 6 * len(np.unique(observations.frame)),
    )


def _bounded_squares(
    observations: Observations, lengths: Sequence[FloatArray], noise: FloatArray
) -> float:
    limit = _limit(observations)
    return float(
        sum(
            (np.minimum(values, limit * noise[chunk.views][:, None]) ** 2)[chunk.filled].sum()
            for chunk, values in zip(observations.chunks, lengths, strict=True)
        )
    )


def _limit(observations: Observations) -> float:
    return float(np.sqrt(2 * np.log(max(observations.n_corners, 1) / _LOST)))


def _by_camera(observations: Observations, noise: FloatArray) -> FloatArray:
    """Median view of each camera, (C,); 1 for a camera without views."""
    own = [noise[observations.camera == camera] for camera in range(observations.n_cameras)]
    return np.array([float(np.median(part)) if len(part) else 1.0 for part in own])


def _near(
    observations: Observations, start: BundleState, free: Free, priors: Priors | None
) -> tuple[BundleState, list[FloatArray]]:
    """Come near the truth by Huber's cost, whose threshold follows the noise that is seen.

    Only a neighbourhood is sought, so all corners of a camera weigh alike and the board keeps its
    shape; what a bow leaves over counts as noise until the gate is drawn again.

    Returns
    -------
    state, residuals
        And what `chunk_residuals` returns there.
    """
    is_thinned = observations.n_corners > _MANY
    few = observations.thinned(_ENOUGH) if is_thinned else observations
    shaped = start.shape.displaced(few.points_board, start.shape_parameters)
    few = replace(few.unwhitened(np.ones(few.n_cameras)), points_board=shaped)
    base = _whitenings(few)
    state = replace(start, shape=BoardShape.flat(shaped), shape_parameters=np.zeros(0))
    free = replace(free, shape=np.zeros(0, dtype=bool))
    if priors is not None:
        priors = replace(priors, shape_mean=np.zeros(0), shape_sigma=np.zeros(0))
    residuals = chunk_residuals(few, state)
    noise: FloatArray | None = None
    for _ in range(_ROUNDS):
        before, noise = noise, median_noise(few, _lengths(base, residuals))
        if before is not None and (noise > _STEADY * before).all():
            break
        weighted = few.weighted(_scaled(few, base, noise))
        if before is not None:  # by now one step is enough, as a rule
            step = step_bundle(weighted, state, free, priors=priors, huber=_HUBER, damping=_NEAR)
            state, residuals = step.state, step.residuals
            if step.is_better:
                continue
        state = solve_bundle(
            weighted, state, free, priors=priors, huber=_HUBER, max_iterations=20,
            relative_decrease=_LOOSE, foreseen=1.0, damping=1e-4,
        ).state  # fmt: skip
        residuals = chunk_residuals(few, state)
    if is_thinned:
        residuals = chunk_residuals(replace(observations, points_board=shaped), state)
    return replace(state, shape=start.shape, shape_parameters=start.shape_parameters), residuals


def _whitenings(observations: Observations) -> list[FloatArray]:
    """Stated whitenings, (V, 2, 2, N); the identity, 0 where a chunk is filled up."""
    return [
        chunk.whitening
        if chunk.whitening is not None
        else np.eye(2)[None, :, :, None] * chunk.filled[:, None, None, :]
        for chunk in observations.chunks
    ]


def _scaled(
    observations: Observations,
    whitenings: Sequence[FloatArray],
    noise: FloatArray,
    kept: Sequence[BoolArray] | None = None,
) -> list[FloatArray]:
    scaled = [
        item / noise[chunk.views][:, None, None, None]
        for chunk, item in zip(observations.chunks, whitenings, strict=True)
    ]
    if kept is None:
        return scaled
    return [item * inside[:, None, None] for item, inside in zip(scaled, kept, strict=True)]


def _lengths(whitenings: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> list[FloatArray]:
    """Whitened 2-D residuals, (V, N) by chunk."""
    whitened = (whiten(own, rows) for own, rows in zip(whitenings, residuals, strict=True))
    return [np.hypot(rows[:, 0], rows[:, 1]) for rows in whitened]


def _inside(
    observations: Observations, lengths: Sequence[FloatArray], noise: FloatArray
) -> list[BoolArray]:
    limit = _limit(observations)
    return [
        chunk.filled & (values <= limit * noise[chunk.views][:, None])
        for chunk, values in zip(observations.chunks, lengths, strict=True)
    ]


def _whole(observations: Observations, inside: Sequence[BoolArray]) -> list[BoolArray]:
    """Leave out all of a view that mostly does not belong: its other corners agree by chance."""
    return [
        part & (2 * part.sum(axis=1) > chunk.lengths)[:, None]
        for chunk, part in zip(observations.chunks, inside, strict=True)
    ]
