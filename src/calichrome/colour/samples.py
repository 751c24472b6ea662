"""One row per disc and view of a camera, with the light taken out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.colour.light import light_at
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.observations import BoardView

__all__ = ["ColourSamples", "collect_samples", "disc_means"]

_OUTLIER = 4.0  # robust sigmas from the disc's median over views: a highlight, a hand, a shadow
_FLOOR = 0.01  # of the white level: a spread below is not measured by a handful of views


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourSamples:
    """Disc colours of one camera.

    Parameters
    ----------
    frame_ids : (K,) str
        Views that gave samples.
    view : (M,) int
        Position in `frame_ids`.
    marker_ids : (M,) int
    rgb : (M, 3) float
        Linear camera values as measured, 0..1 of full scale.
    light_rgb : (M, 3) float
        Level a white square would have at the disc.
    reference_light_rgb : (3,) float
        Median light over all rows: the level at which Y = 1 means the perfect diffuser.
    n_px : (M,) int
        Pixels behind each value.
    clipped : (M,) float
        Share of clipped pixels.
    """

    frame_ids: tuple[str, ...]
    view: IntArray
    marker_ids: IntArray
    rgb: FloatArray
    light_rgb: FloatArray
    reference_light_rgb: FloatArray
    n_px: IntArray
    clipped: FloatArray

    @property
    def even_rgb(self) -> FloatArray:
        """What each disc would read in the reference light, (M, 3)."""
        return self.rgb / self.light_rgb * self.reference_light_rgb

    @property
    def usable(self) -> BoolArray:
        """Rows without clipped pixels and with known light, (M,)."""
        lit = np.isfinite(self.light_rgb).all(axis=1) & (self.light_rgb > 0).all(axis=1)
        return np.asarray(lit & (self.clipped == 0) & np.isfinite(self.rgb).all(axis=1))


def collect_samples(views: Mapping[str, BoardView]) -> ColourSamples | None:
    """Gather the discs of one camera's views; None if no view has any."""
    frames = [
        frame for frame, view in views.items() if view.discs is not None and len(view.discs) > 0
    ]
    if not frames:
        return None
    discs = [item for frame in frames if (item := views[frame].discs) is not None]
    light_rgb = np.concatenate([light_at(item.centres_px, item.white_rgb) for item in discs])
    if not np.isfinite(light_rgb).any():
        return None  # the white squares are clipped everywhere: there is no light to divide by
    return ColourSamples(
        frame_ids=tuple(frames),
        view=np.repeat(np.arange(len(discs)), [len(item) for item in discs]),
        marker_ids=np.concatenate([item.marker_ids for item in discs]),
        rgb=np.concatenate([item.mean_rgb for item in discs]),
        light_rgb=light_rgb,
        reference_light_rgb=np.nanmedian(light_rgb, axis=0),
        n_px=np.concatenate([item.n_px for item in discs]),
        clipped=np.concatenate([item.clipped for item in discs]),
    )


def disc_means(samples: ColourSamples, n_markers: int) -> tuple[FloatArray, IntArray, int]:
    """Average each disc over its views, outliers left out.

    Returns
    -------
    mean_rgb : (n_markers, 3) float
        In the reference light; nan for a disc without a usable view.
    n_views : (n_markers,) int
        Views in each mean.
    n_rejected : int
        Rows that disagree with the other views of their disc.
    """
    even, usable = samples.even_rgb, samples.usable
    mean_rgb = np.full((n_markers, 3), np.nan)
    n_views = np.zeros(n_markers, dtype=np.int64)
    n_rejected = 0
    for marker in range(n_markers):
        of_disc = usable & (samples.marker_ids == marker)
        if not of_disc.any():
            continue
        rows, n_px = even[of_disc], samples.n_px[of_disc]
        off = np.abs(rows - np.median(rows, axis=0))
        sigma = 1.4826 * np.median(off, axis=0)
        floor = _FLOOR * samples.reference_light_rgb
        kept = (off <= _OUTLIER * np.maximum(sigma, floor)).all(axis=1)
        n_rejected += int((~kept).sum())
        if kept.any():
            # pixels count alike: noise falls with their number, and small discs are nearer to
            # their blurred edge
            mean_rgb[marker] = np.average(rows[kept], axis=0, weights=n_px[kept])
            n_views[marker] = kept.sum()
    return mean_rgb, n_views, n_rejected
