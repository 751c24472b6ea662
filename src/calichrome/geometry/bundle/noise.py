"""How noisy each view is, told from its residuals.

Stated covariances are right in shape more often than in size: a print that is not even, blur or
compression adds what no detector sees. So each camera has a variance factor, from its squared
residuals over its redundancy, and where the views of a camera differ by more than chance lets
them, each view has one, drawn towards that of the camera by as much as it is uncertain itself.

References
----------
.. [1] W. Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten", AVN 86,
   1979 (variance factors from residuals and redundancy).
.. [2] R. DerSimonian, N. Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7,
   1986 (how much groups differ beyond chance, here of log variances; shrinkage by it).
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri, digamma, polygamma

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.geometry.bundle.observations import Observations
from calichrome.geometry.bundle.state import Free

__all__ = ["median_noise", "view_noise"]

_MEDIAN = 1.1774
"""Median length of a 2-D residual of unit noise per axis, sqrt(2 ln 2) (Rayleigh distribution)."""

_BY_CHANCE = 1e-3  # how often views of equal noise are taken to differ; a choice


def median_noise(observations: Observations, lengths: Sequence[FloatArray]) -> FloatArray:
    """Noise of each camera from the median length of its residuals, handed to its views, (V,)."""
    by_camera: list[list[FloatArray]] = [[] for _ in range(observations.n_cameras)]
    for chunk, values in zip(observations.chunks, lengths, strict=True):
        camera = observations.camera[chunk.views]
        for present in set(camera.tolist()):
            own = camera == present
            by_camera[present].append(values[own][chunk.filled[own]])
    medians = np.array([np.median(np.concatenate(own)) if own else 0.0 for own in by_camera])
    # where residuals are rounding errors, their median must not be divided by
    noise = np.maximum(medians / _MEDIAN, 1e-6 * medians.max() + 1e-12)
    return np.asarray(noise[observations.camera])


def view_noise(
    observations: Observations,
    lengths: Sequence[FloatArray],
    kept: Sequence[BoolArray],
    free: Free,
    *,
    views_differ: bool,
    shares: FloatArray | None = None,
) -> FloatArray:
    """By what the residuals of each view exceed its stated noise, (V,).

    Parameters
    ----------
    observations
        What was seen.
    lengths
        Whitened 2-D residuals, (V, N) by chunk.
    kept
        Which corners count, (V, N) by chunk.
    free
        What was solved for.
    views_differ
        False: only cameras do.
    shares
        What `BundleEquations.shares` returned, (V,); None: by corners.
    """
    n_views = len(observations.camera)
    squares, counts = np.zeros(n_views), np.zeros(n_views)
    for chunk, values, inside in zip(observations.chunks, lengths, kept, strict=True):
        squares[chunk.views] = (np.where(inside, values, 0.0) ** 2).sum(axis=1)
        counts[chunk.views] = 2.0 * inside.sum(axis=1)
    if shares is None:
        in_frame = np.bincount(observations.frame, counts)[observations.frame]
        shares = counts / np.maximum(in_frame, 1)
    redundancy = np.maximum(counts - _unknowns(observations, counts, free, shares), 0.0)
    overall = squares.sum() / max(redundancy.sum(), 1.0)
    variance = np.empty(n_views)
    for camera in range(observations.n_cameras):
        own = np.flatnonzero(observations.camera == camera)
        if len(own) == 0:
            continue
        total, left = squares[own].sum(), redundancy[own].sum()
        # a camera with hardly more equations than unknowns says nothing of its noise: others do
        variance[own] = total / left if left > counts[own].sum() / 3 else overall
        told = own[(redundancy[own] > counts[own] / 3) & (squares[own] > 0)]
        if views_differ and len(told) > 2:
            variance[told] = _shrunk(squares[told], redundancy[told], variance[told])
    return np.asarray(np.sqrt(np.maximum(variance, 1e-12 * overall + 1e-24)))


def _shrunk(squares: FloatArray, redundancy: FloatArray, common: FloatArray) -> FloatArray:
    """Variance factors of views, drawn towards their camera's."""
    # log chi-square of d degrees of freedom: mean digamma(d/2) + log 2, variance trigamma(d/2); the
    # usual -1/d and 2/d take views of 6 corners to differ in 4 of 10 recordings of 400 equal ones
    logs = np.log(squares / 2) - digamma(redundancy / 2)
    weights = 1 / polygamma(1, redundancy / 2)
    mean = float(weights @ logs / weights.sum())
    spread = float(weights @ (logs - mean) ** 2)
    n_views = len(squares)
    if spread < chdtri(n_views - 1, _BY_CHANCE):
        return common
    beyond = (spread - (n_views - 1)) / (weights.sum() - (weights @ weights) / weights.sum())
    variance = np.exp(mean + beyond / (beyond + 1 / weights) * (logs - mean))
    return np.asarray(variance * (squares / variance).sum() / redundancy.sum())


def _unknowns(
    observations: Observations, counts: FloatArray, free: Free, shares: FloatArray
) -> FloatArray:
    """Share the unknowns out among the views so that their sum is exact, (V,).

    Lens parameters go to the views of their camera by residuals. A board goes to its views by their
    `shares` in what is known of it, the shape likewise. Camera poses go the other way round: with
    residuals p_c + b_f - y_cf of weight w_c (two-way layout), view cf has w_c / W of the trace of
    the hat matrix for b_f, and (1 - w_c / W) / F for p_c.
    """
    camera = observations.camera
    in_camera = np.bincount(camera, counts, observations.n_cameras)[camera]
    lens = free.lenses.sum(axis=1)[camera] * counts / np.maximum(in_camera, 1)
    others = (1 - shares) / np.bincount(camera)[camera]
    poses = 6 * free.cameras.sum() * others / max(float(others.sum()), 1e-9)
    shape = free.shape.sum() * shares / max(float(shares.sum()), 1e-9)
    return np.asarray(lens + 6 * shares + poses + shape)
