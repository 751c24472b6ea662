"""Comparing detections with the truth.

A corner is *found* if the point with its id (without ids: the nearest point) is within
`FOUND_PX` of the truth. A label is *wrong* if the point with an id is further than
`WRONG_SPACINGS` of the corner's spacing from the true place of that id. A whole board has all
corners found. Errors, and their ratio to the bound, are those of found corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from benchmarks.detection.peers import Detection, Detector
from scipy.spatial import cKDTree

from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["FOUND_PX", "WRONG_SPACINGS", "Score", "compare", "ratios", "summary"]

FOUND_PX = 2.0
WRONG_SPACINGS = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """One detection against the truth.

    Parameters
    ----------
    ids : (M,) int
        Corners that were found.
    errors_px : (M, 2) float
        Their errors.
    cov_px : (M, 2, 2) float, or None
        Their covariances as the detector states them.
    n_wrong
        Points with an id that lie elsewhere.
    n_false
        Points without ids near no corner.
    is_whole
        Whether every corner of the board was found.
    """

    ids: IntArray
    errors_px: FloatArray
    cov_px: FloatArray | None
    n_wrong: int
    n_false: int
    is_whole: bool


_NOTHING = Score(np.empty(0, dtype=np.int64), np.empty((0, 2)), None, 0, 0, is_whole=False)


def compare(
    detector: Detector, detection: Detection | None, truth_px: FloatArray, spacing_px: FloatArray
) -> Score:
    """Match a detection with the true corners (N, 2) of spacing (N,).

    Ids that are right only up to a half turn are turned if that fits better.
    """
    if detection is None:
        return _NOTHING
    if detection.corner_ids is None:
        return _nearest(detection, truth_px)
    ids, points = detection.corner_ids, detection.points_px
    if detector.ids == "whole":
        turned = len(truth_px) - 1 - ids
        errors = [np.linalg.norm(points - truth_px[order], axis=1) for order in (ids, turned)]
        ids = ids if np.median(errors[0]) <= np.median(errors[1]) else turned
    offsets = points - truth_px[ids]
    distance = np.linalg.norm(offsets, axis=1)
    found = distance < FOUND_PX
    cov = None if detection.cov_px is None else detection.cov_px[found]
    return Score(
        ids[found],
        offsets[found],
        cov,
        int((distance > WRONG_SPACINGS * spacing_px[ids]).sum()),
        0,
        is_whole=len(np.unique(ids[found])) == len(truth_px),
    )


def ratios(score: Score, bound_px2: FloatArray) -> FloatArray:
    """Return sqrt(e' C^-1 e / 2) of the found corners, (M,), C the bound (N, 2, 2) by id."""
    inverse = np.linalg.inv(bound_px2[score.ids])
    squared = np.einsum("ni,nij,nj->n", score.errors_px, inverse, score.errors_px)
    return np.asarray(np.sqrt(squared / 2))


def summary(parts: Sequence[FloatArray]) -> list[str]:
    """Return median, root mean square and 95 % point of ratios, 1 for an efficient estimator.

    e' C^-1 e / 2 is then exponential with mean 1: its median is log 2, its 95 % point log 20.
    """
    ratio = np.concatenate(parts)
    values = (
        np.median(ratio) / np.sqrt(np.log(2)),
        np.sqrt(np.mean(ratio**2)),
        np.quantile(ratio, 0.95) / np.sqrt(np.log(20)),
    )
    return [f"{value:.2f}" for value in values]


def _nearest(detection: Detection, truth_px: FloatArray) -> Score:
    distance, index = cKDTree(detection.points_px).query(truth_px)
    found = distance < FOUND_PX
    return Score(
        np.flatnonzero(found),
        detection.points_px[index[found]] - truth_px[found],
        None,
        0,
        len(detection.points_px) - len(np.unique(index[found])),
        is_whole=bool(found.all()),
    )
