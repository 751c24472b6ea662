"""One row per disc and view of a camera, with the light taken out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.colour.flare import Additive
from calichrome.colour.light import Neighbourhoods, fit_light
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.observations import BoardView, DiscSamples
from calichrome.target import Target

__all__ = [
    "FEWEST_PX",
    "ColourSamples",
    "DiscMeans",
    "collect_samples",
    "combine_views",
    "cov_of_mean",
    "disc_means",
]

_OUTLIER = 4.0  # robust sigmas from the disc's median over views: a highlight, a hand, a shadow
_FLOOR = 0.01  # of the white level: a spread below is not measured by a handful of views
_ALIKE = 0.5
"""Share of a deviation that may differ between channels for it to be white light or its lack."""
FEWEST_PX = 20
"""Pixels behind a disc, below which demosaicing and JPEG smear chroma over its edge by more than
what else is wrong: frames with 12 to 17 px a disc, Bayer or JPEG, lost up to 0.12 of what colours
deviate from grey. Two cameras of a simulated rig (that of `demo`) had 0.78 and 0.75 dE2000 without
such discs in place of 1.20 and 0.88; without those below 30 px 1.10 and 0.80, as few were left."""
_ENOUGH = 4  # larger views of a disc, for the small ones to be left out
_HIDDEN = 0.5  # share of the pixels that a disc usually has, below which something lies on it


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
        Linear camera values, 0..1 of full scale; a supported additive part is taken off.
    light_rgb : (M, 3) float
        Level a white square would have at the disc.
    reference_light_rgb : (3,) float
        Median light over all rows, as the lens' centre would show it if the fall-off of the lens is
        known: the level at which Y = 1 means the perfect diffuser.
    n_px : (M,) int
        Pixels behind each value.
    clipped : (M,) float
        Share of clipped pixels.
    cov_rgb : (M, 3, 3) float, optional
        Covariance of `rgb` by the noise of pixels.
    light_variance : (M, 3) float, optional
        Of `light_rgb`; nan where the light was not fitted.
    white_rgb, black_rgb : (M, 3) float, optional
        Level of the squares as read beside the disc.
    centres_px : (M, 2) float, optional
        Where the disc is in the picture.
    tilt_rad, distance_m : (M,) float, optional
        Angle between the board's normal and the line of sight; from the camera to the disc.
    """

    frame_ids: tuple[str, ...]
    view: IntArray
    marker_ids: IntArray
    rgb: FloatArray
    light_rgb: FloatArray
    reference_light_rgb: FloatArray
    n_px: IntArray
    clipped: FloatArray
    cov_rgb: FloatArray | None = None
    light_variance: FloatArray | None = None
    white_rgb: FloatArray | None = None
    black_rgb: FloatArray | None = None
    centres_px: FloatArray | None = None
    tilt_rad: FloatArray | None = None
    distance_m: FloatArray | None = None

    @property
    def even_rgb(self) -> FloatArray:
        """What each disc would read in the reference light, (M, 3)."""
        return self.rgb / self.light_rgb * self.reference_light_rgb

    @property
    def even_cov(self) -> FloatArray:
        """Covariance of `even_rgb` by pixel noise and light, (M, 3, 3); zero where not known."""
        scale = self.reference_light_rgb / self.light_rgb
        cov = np.zeros((len(self.rgb), 3, 3))
        if self.cov_rgb is not None:
            cov += self.cov_rgb * scale[:, :, None] * scale[:, None, :]
        if self.light_variance is not None:
            relative = np.nan_to_num(self.light_variance) / self.light_rgb**2
            cov += (self.even_rgb**2 * relative)[:, :, None] * np.eye(3)
        return cov

    @property
    def usable(self) -> BoolArray:
        """Rows without clipped pixels and with known light, (M,)."""
        lit = np.isfinite(self.light_rgb).all(axis=1) & (self.light_rgb > 0).all(axis=1)
        return np.asarray(lit & (self.clipped == 0) & np.isfinite(self.rgb).all(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiscMeans:
    """Each disc over its views.

    Parameters
    ----------
    mean_rgb : (n_markers, 3) float
        In the reference light; nan for a disc without a usable view.
    cov_rgb : (n_markers, 3, 3) float
        Of the mean: pixel noise, light, and the scatter between views that neither explains.
    n_views : (n_markers,) int
        Views in each mean.
    reasons : (M,) str
        Why a row of the samples was left out: "clipped", "unlit" (no white squares), "highlight"
        (gloss: white light added), "shadow" (all channels down alike), "hidden" (few pixels left),
        "misread" (another colour), "small" (`FEWEST_PX`, where enough larger views are there); ""
        for rows in a mean.
    """

    mean_rgb: FloatArray
    cov_rgb: FloatArray
    n_views: IntArray
    reasons: tuple[str, ...]


def collect_samples(
    views: Mapping[str, BoardView],
    target: Target | None = None,
    *,
    vignetting: Vignetting | None = None,
    additive: Additive | None = None,
    cam_from_board: Mapping[str, Pose] | None = None,
) -> ColourSamples | None:
    """Gather the discs of one camera's views; None if no view has any.

    Parameters
    ----------
    views
        By frame.
    target
        Tells which squares the light beside each disc was read from; without it the light is taken
        as read at the disc.
    vignetting
        Of the camera: the light is then smoothed without it.
    additive
        Of the camera: its supported part is subtracted from discs and squares.
    cam_from_board
        Poses by frame, for `tilt_rad` and `distance_m`; with `target`.
    """
    frames = [
        frame for frame, view in views.items() if view.discs is not None and len(view.discs) > 0
    ]
    if not frames:
        return None
    discs = [item for frame in frames if (item := views[frame].discs) is not None]
    offsets = [_offset(item, additive) for item in discs]
    around = None if target is None else Neighbourhoods.around_discs(target)
    lights, variances = zip(
        *(
            _light(item, item.white_rgb - offset, around, vignetting)
            for item, offset in zip(discs, offsets, strict=True)
        ),
        strict=True,
    )
    light_rgb = np.concatenate(lights)
    if not np.isfinite(light_rgb).any():
        return None  # the white squares are clipped everywhere: there is no light to divide by
    centres_px = np.concatenate([item.centres_px for item in discs])
    through = light_rgb if vignetting is None else light_rgb / vignetting.gain(centres_px)
    tilt_rad = distance_m = None
    if target is not None and cam_from_board is not None:
        tilt_rad, distance_m = _seen_from(target, frames, discs, cam_from_board)
    return ColourSamples(
        frame_ids=tuple(frames),
        view=np.repeat(np.arange(len(discs)), [len(item) for item in discs]),
        marker_ids=np.concatenate([item.marker_ids for item in discs]),
        rgb=np.concatenate(
            [item.mean_rgb - offset for item, offset in zip(discs, offsets, strict=True)]
        ),
        light_rgb=light_rgb,
        reference_light_rgb=np.nanmedian(through, axis=0),
        n_px=np.concatenate([item.n_px for item in discs]),
        clipped=np.concatenate([item.clipped for item in discs]),
        cov_rgb=np.concatenate(
            [item.cov_rgb / np.maximum(item.n_px, 1)[:, None, None] for item in discs]
        ),
        light_variance=np.concatenate(variances),
        white_rgb=np.concatenate([item.white_rgb for item in discs]),
        black_rgb=np.concatenate([item.black_rgb for item in discs]),
        centres_px=centres_px,
        tilt_rad=tilt_rad,
        distance_m=distance_m,
    )


def _offset(discs: DiscSamples, additive: Additive | None) -> FloatArray:
    known = np.isfinite(discs.white_rgb).all(axis=1)
    if additive is None or not known.any():
        return np.zeros(3)
    return additive.offset(discs.white_rgb[known].mean(axis=0))


def _light(
    discs: DiscSamples,
    white_rgb: FloatArray,
    around: Neighbourhoods | None,
    vignetting: Vignetting | None,
) -> tuple[FloatArray, FloatArray]:
    """Level of a white square at each disc (M, 3), and its variance."""
    if around is None:
        return fit_light(discs.centres_px, white_rgb)
    gain = square_gain = None
    squares_px = around.squares_px(discs.marker_ids, discs.centres_px)
    if vignetting is not None and squares_px is not None:
        gain, square_gain = vignetting.gain(discs.centres_px), vignetting.gain(squares_px)
    return fit_light(
        around.discs_board[discs.marker_ids],
        white_rgb,
        squares=around.squares_board,
        weights=around.weights[discs.marker_ids],
        gain=gain,
        square_gain=square_gain,
    )


def _seen_from(
    target: Target, frames: list[str], discs: list[DiscSamples], poses: Mapping[str, Pose]
) -> tuple[FloatArray, FloatArray]:
    """Angle to the board's normal and distance of each disc, (M,) each; nan without a pose."""
    tilts, distances = [], []
    for frame, item in zip(frames, discs, strict=True):
        pose = poses.get(frame)
        if pose is None:
            tilts.append(np.full(len(item), np.nan))
            distances.append(np.full(len(item), np.nan))
            continue
        points_cam = pose.apply(target.marker_centres_board[item.marker_ids])
        distance = np.linalg.norm(points_cam, axis=1)
        tilts.append(np.arccos(np.clip(np.abs(points_cam @ pose.rotation[:, 2]) / distance, 0, 1)))
        distances.append(distance)
    return np.concatenate(tilts), np.concatenate(distances)


def combine_views(samples: ColourSamples, n_markers: int) -> DiscMeans:
    """Average each disc over its views, outliers left out with a reason."""
    even, cov, usable = samples.even_rgb, samples.even_cov, samples.usable
    reasons = np.where(usable, "", np.where(samples.clipped > 0, "clipped", "unlit")).astype(object)
    mean_rgb = np.full((n_markers, 3), np.nan)
    cov_rgb = np.full((n_markers, 3, 3), np.nan)
    n_views = np.zeros(n_markers, dtype=np.int64)
    usual_px = _usual_pixels(samples, n_markers)
    for marker in range(n_markers):
        of_disc = np.flatnonzero(usable & (samples.marker_ids == marker))
        if not len(of_disc):
            continue
        large = samples.n_px[of_disc] >= FEWEST_PX
        if large.sum() >= _ENOUGH:
            reasons[of_disc[~large]] = "small"
            of_disc = of_disc[large]
        rows, n_px = even[of_disc], samples.n_px[of_disc]
        off = rows - np.median(rows, axis=0)
        sigma = 1.4826 * np.median(np.abs(off), axis=0)
        floor = _FLOOR * samples.reference_light_rgb
        kept = (np.abs(off) <= _OUTLIER * np.maximum(sigma, floor)).all(axis=1)
        for row in np.flatnonzero(~kept):
            few = samples.n_px[of_disc[row]] < _HIDDEN * usual_px[of_disc[row]]
            reasons[of_disc[row]] = _reason(
                off[row], rows[row], samples.reference_light_rgb, few=bool(few)
            )
        if not kept.any():
            continue
        # photons count alike: noise falls with their number, in large discs and in bright views;
        # small discs are nearer to their blurred edge, too
        photons = (n_px * samples.light_rgb[of_disc].mean(axis=1))[kept]
        weights = photons / photons.sum()
        mean_rgb[marker] = weights @ rows[kept]
        left = rows[kept] - mean_rgb[marker]
        n_views[marker] = kept.sum()
        cov_rgb[marker] = cov_of_mean(left, weights, cov[of_disc[kept]])
    return DiscMeans(
        mean_rgb=mean_rgb, cov_rgb=cov_rgb, n_views=n_views, reasons=tuple(map(str, reasons))
    )


def cov_of_mean(left: FloatArray, weights: FloatArray, cov: FloatArray) -> FloatArray:
    """Covariance of a weighted mean: what is expected, or what is seen where that is more."""
    expected = np.asarray(np.einsum("n,nij->ij", weights**2, cov))
    if len(left) < 3:
        return expected
    share = float((weights**2).sum())
    seen = share / (1 - share) * np.einsum("n,ni,nj->ij", weights, left, left)
    excess, axes = np.linalg.eigh(seen - expected)
    return np.asarray(expected + axes * np.maximum(excess, 0) @ axes.T)


def _usual_pixels(samples: ColourSamples, n_markers: int) -> FloatArray:
    """Pixels that each row should have: its view's scale times its disc's, (M,)."""
    logs = np.log(np.maximum(samples.n_px, 1))
    scale = np.zeros(len(samples.frame_ids))
    for view in range(len(scale)):
        mine = samples.view == view
        scale[view] = np.median(logs[mine]) if mine.any() else 0.0
    own = np.zeros(n_markers)
    for marker in range(n_markers):
        mine = samples.marker_ids == marker
        own[marker] = np.median(logs[mine] - scale[samples.view[mine]]) if mine.any() else 0.0
    return np.asarray(np.exp(scale[samples.view] + own[samples.marker_ids]))


def _reason(off: FloatArray, row: FloatArray, white: FloatArray, *, few: bool) -> str:
    """Say what a row that differs by `off` from its disc's usual colour shows."""
    if few:
        return "hidden"
    added = off / white  # gloss adds the colour of the lamp, which white paper shows
    if (added > 0).all() and np.ptp(added) <= _ALIKE * added.max():
        return "highlight"
    lost = off / np.maximum(row - off, 1e-9)  # a shadow takes the same share of every channel
    if (lost < 0).all() and np.ptp(lost) <= _ALIKE * np.abs(lost).max():
        return "shadow"
    return "misread"


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
    means = combine_views(samples, n_markers)
    unusable = {"", "clipped", "unlit", "small"}
    n_rejected = sum(reason not in unusable for reason in means.reasons)
    return means.mean_rgb, means.n_views, n_rejected
