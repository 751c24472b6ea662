"""White levels beside discs, in the form that the fall-off of lenses is fitted to."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.colour.light import Neighbourhoods
from calichrome.colour.shading import shading_terms
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.observations import Dataset, DiscSamples
from calichrome.target import Target

__all__ = ["FEWEST_DISCS", "WhiteReadings", "collect_white_readings", "picture_frame"]

FEWEST_DISCS = 12  # of a view, for a quadratic through its readings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhiteReadings:
    """White levels beside discs of all cameras, one row each.

    Parameters
    ----------
    camera, frame, marker : (N,) int
        Positions in the dataset, and which disc.
    logs : (N, 3) float
        Of the levels, as averages of logs over the squares that were read.
    terms : (N, 5) float
        Of the shading, averaged over the same squares.
    places : (N, 2) float
        Of the discs, half diagonals from the centre.
    weights : (N,) float
        Of the squares of errors: the more squares were read and the brighter they are, the less
        noise a log has.
    """

    camera: IntArray
    frame: IntArray
    marker: IntArray
    logs: FloatArray
    terms: FloatArray
    places: FloatArray
    weights: FloatArray

    def where(self, kept: BoolArray) -> "WhiteReadings":
        """Keep some rows."""
        return WhiteReadings(
            camera=self.camera[kept],
            frame=self.frame[kept],
            marker=self.marker[kept],
            logs=self.logs[kept],
            terms=self.terms[kept],
            places=self.places[kept],
            weights=self.weights[kept],
        )

    @property
    def place(self) -> IntArray:
        """Number of the frame and disc of each row, (N,): rows of one number share their light."""
        return _numbered(self.frame, self.marker)

    @property
    def view(self) -> IntArray:
        """Number of the camera and frame of each row, (N,)."""
        return _numbered(self.camera, self.frame)


def _numbered(a: IntArray, b: IntArray) -> IntArray:
    """Give every pair that occurs a number."""
    return np.asarray(np.unique(a * (int(b.max(initial=0)) + 1) + b, return_inverse=True)[1])


def picture_frame(
    size_wh: tuple[int, int], centre_px: FloatArray | None
) -> tuple[FloatArray, float]:
    """Return the centre of a picture, its middle unless another is known, and half its diagonal."""
    middle = (np.array(size_wh, dtype=np.float64) - 1) / 2
    centre = middle if centre_px is None else np.asarray(centre_px, dtype=np.float64)
    return centre, float(np.hypot(*size_wh)) / 2


def collect_white_readings(
    dataset: Dataset, target: Target, centres_px: Mapping[str, FloatArray]
) -> WhiteReadings:
    """Gather what all views say of the light beside their discs."""
    around = Neighbourhoods.around_discs(target)
    frame_index = {frame: index for index, frame in enumerate(dataset.frames)}
    columns: list[tuple[FloatArray | IntArray, ...]] = []
    for index, (camera, views) in enumerate(dataset.views.items()):
        centre, unit = picture_frame(dataset.sizes_wh[camera], centres_px.get(camera))
        for frame, view in views.items():
            discs = view.discs
            if discs is None:
                continue
            weights = around.weights[discs.marker_ids]
            kept = (discs.white_rgb > 0).all(axis=1) & (weights != 0).any(axis=1)
            squares = around.squares_px(discs.marker_ids, discs.centres_px)
            if squares is None or kept.sum() < FEWEST_DISCS:
                continue
            seen = shading_terms((squares - centre) / unit)
            columns.append(
                (
                    np.full(kept.sum(), index),
                    np.full(kept.sum(), frame_index[frame]),
                    discs.marker_ids[kept],
                    np.log(discs.white_rgb[kept]) - _bend(around, discs, kept),
                    np.einsum("mq,mqt->mt", weights, seen)[kept],
                    (discs.centres_px[kept] - centre) / unit,
                    discs.white_rgb[kept].mean(axis=1) / (weights[kept] ** 2).sum(axis=1),
                )
            )
    if not columns:
        none = np.empty(0, dtype=np.int64)
        shapes = [(0, 3), (0, 5), (0, 2), (0,)]
        columns = [(none, none, none, *(np.empty(shape) for shape in shapes))]
    joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
    return WhiteReadings(
        camera=joined[0].astype(np.int64),
        frame=joined[1].astype(np.int64),
        marker=joined[2].astype(np.int64),
        logs=joined[3].astype(np.float64),
        terms=joined[4].astype(np.float64),
        places=joined[5].astype(np.float64),
        weights=joined[6].astype(np.float64),
    )


def _bend(around: Neighbourhoods, discs: DiscSamples, kept: BoolArray) -> FloatArray:
    """How far the log of each averaged level is above the average of the logs, (K, 3).

    Half the variance of the logs over the squares of a level: 0.2 to 0.5 % near the corner of a
    picture that falls off by 40 %.
    """
    weights = around.weights[discs.marker_ids[kept]]
    x, y = (around.squares_board / np.ptp(around.squares_board, axis=0).max()).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    surface, *_ = np.linalg.lstsq(weights @ terms, np.log(discs.white_rgb[kept]), rcond=None)
    levels = terms @ surface
    return np.asarray(np.log(weights @ np.exp(levels)) - weights @ levels)
