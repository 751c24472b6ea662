"""Findings: what the numbers of a calibration say to its user."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calichrome.colorimetry.encoding import EncodingName
from calichrome.colour.checks import exposure_jumps, grey_slope
from calichrome.colour.fit import ColourSolution
from calichrome.colour.samples import ColourSamples
from calichrome.core.findings import Finding, finding
from calichrome.geometry.adjustment import rms_px
from calichrome.geometry.intrinsics import CameraSolution
from calichrome.geometry.rig_solve import RigSolution
from calichrome.imaging import Recording
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = [
    "focal_sigma",
    "judge_colour",
    "judge_exposures",
    "judge_geometry",
    "judge_target",
    "judge_unknown_encodings",
]

_FEW_VIEWS = 10  # Kapusi et al., 2010: at least ten views
_SMALL_BOARD = 56  # ... of 7x8 corners
_UNSYNCHRONISED = 2.0
"""Pair error over the larger of the two cameras' own. Real synchronous recordings stay below 1.3;
a board that moves by one pixel between the shutters passes 2 wherever corners are good to 0.3."""
_WEAK_FOCAL = 0.02
"""Relative sigma of a focal length from which lengths are uncertain by 4 % (95 %): no rig can use
that, while ten tilted views give 0.1 %."""
_POOR_FIT = 1e-3
"""RMS over picture width from which a lens does not explain its views: at common focal lengths a
ray is then off by 1 mrad, 1 mm at 1 m. The real recordings of the tests are at 1e-4 to 3e-4."""
_OUTLYING = 4.0
"""RMS of a view over the median view of its camera, where it also exceeds `_POOR_FIT`. The worst
views of the real recordings of the tests are at 1.6."""
_SLOPE_TOLERANCE = 0.12
"""Of the grey slope about 1, on the greys of the ColorChecker. sRGB read as Rec.709 gives 0.84, the
reverse 1.21, sRGB read as linear 0.48, linear as sRGB 1.68. Prints with errors of sd 3 in L, a, b
scatter by 0.07 (1000 draws), mostly through the darkest disc, so one such print in fourteen is
called doubtful wrongly; measured colours are not. sRGB and gamma 2.2 differ by 0.05: not told."""
_CONTRADICTED = 15.0
"""Mean dE2000 of the fit from which discs and target do not belong together: permuted or mirrored
discs give 30 to 50, the wrong encoding 8, good prints 0.6 to 3 (rendered recordings)."""
_EXIF_CHANGE = 0.05  # relative; EXIF rounds exposure times by less


def judge_target(target: Target) -> Iterator[Finding]:
    """Yield what is not known of the print."""
    if not target.square_size_measured:
        yield finding(
            "scale_unverified",
            f"The square size of {target.square_m[0] * 1e3:g} mm is nominal: 0.5 % was added to "
            f"the ± of every length. Measure the printed ruler and give --square.",
        )
    if target.markers and not target.colours_measured:
        yield finding(
            "nominal_unmeasured",
            "The disc colours are nominal, not measured on the print: trust how well cameras agree "
            "more than the error against the target. Measure them with `target measure`.",
        )
    if target.markers and target.paper.white_xyz_d65 is None:
        yield finding(
            "paper_white_unknown",
            "The paper's white is not in target.json: the overall level comes from the discs "
            "alone. Measure it with `target measure` (row paper_white).",
        )


def judge_geometry(rig: RigSolution, target: Target) -> Iterator[Finding]:
    """Yield doubts about lenses and poses."""
    for camera, solution in rig.cameras.items():
        n_views = len(solution.cams_from_board)
        sigma = focal_sigma(solution)
        costs = "unknown" if sigma is None else f"{sigma:.2g} px"
        if n_views < _FEW_VIEWS:
            expected = (
                ""
                if sigma is None
                else (f" (about {sigma * math.sqrt(n_views / 15):.2g} px with 15 views)")
            )
            yield finding(
                "few_views",
                f"Camera {camera}: {n_views} views of the board; its focal length is known to "
                f"± {costs}{expected}. Record 15 to 25.",
                camera=camera, n_views=n_views, sigma_fx_px=sigma,
            )  # fmt: skip
        if target.n_corners < _SMALL_BOARD:
            expected = (
                ""
                if sigma is None
                else (f" (about {sigma * math.sqrt(target.n_corners / 88):.2g} px with 11x8)")
            )
            yield finding(
                "small_board",
                f"Camera {camera}: the board has {target.n_corners} inner corners; the focal "
                f"length is known to ± {costs}{expected}.",
                camera=camera, n_corners=target.n_corners, sigma_fx_px=sigma,
            )  # fmt: skip
        if sigma is None or sigma > _WEAK_FOCAL * solution.lens.fx:
            yield finding(
                "weak_geometry",
                f"Camera {camera}: the views do not determine the lens (focal length ± {costs}). "
                f"Tilt the board by 30 to 45 degrees both ways and vary its distance.",
                camera=camera, sigma_fx_px=sigma,
            )  # fmt: skip
        yield from _judge_residuals(camera, solution, list(rig.dataset.views[camera]), rig)
    for (a, b), pair in rig.pairs.items():
        own = max(rig.cameras[a].rms_px, rig.cameras[b].rms_px)
        if pair.n_shared > 1 and pair.rms_px > _UNSYNCHRONISED * own:
            yield finding(
                "unsynchronised",
                f"Cameras {a} and {b}: {pair.rms_px:.2f} px together, {own:.2f} px alone; the "
                f"board moved between their pictures, or frames are mixed up. Hold it still for "
                f"each shot.",
                cameras=[a, b], rms_px=pair.rms_px, own_rms_px=own,
            )  # fmt: skip


def _judge_residuals(
    camera: str, solution: CameraSolution, frames: Sequence[str], rig: RigSolution
) -> Iterator[Finding]:
    limit_px = _POOR_FIT * rig.dataset.sizes_wh[camera][0]
    by_view = np.array([rms_px(part) for part in solution.residuals_px])
    off = by_view > max(limit_px, _OUTLYING * float(np.median(by_view)))
    names = [frame for frame, is_off in zip(frames, off, strict=True) if is_off]
    if names:
        yield finding(
            "views_disagree",
            f"Camera {camera}: frames {', '.join(names[:5])} miss by {by_view[off].max():.1f} px, "
            f"the others by {np.median(by_view):.2f} px. The board moved, bent or was numbered "
            f"wrongly there; look at them with `detect --overlay` and leave them out.",
            camera=camera, frames=names,
        )  # fmt: skip
    elif solution.rms_px > limit_px:
        yield finding(
            "poor_fit",
            f"Camera {camera}: the views are explained only to {solution.rms_px:.2f} px. The board "
            f"may be bent, the target described wrongly, or the lens beyond {solution.lens.MODEL}.",
            camera=camera, rms_px=solution.rms_px,
        )  # fmt: skip


def focal_sigma(solution: CameraSolution) -> float | None:
    """Return the standard deviation of fx, pixels; None if the views leave it open."""
    return None if solution.lens_cov is None else float(np.sqrt(solution.lens_cov[0, 0]))


def judge_exposures(
    dataset: Dataset, samples: Mapping[str, ColourSamples | None]
) -> Iterator[Finding]:
    """Yield frames in which a camera changed its exposure, gain or white balance."""
    for camera, views in dataset.views.items():
        own = [dataset.exposures.get((camera, frame), {}) for frame in views]
        for quantity in sorted({name for item in own for name in item}):
            values = [item[quantity] for item in own if quantity in item]
            low, high = min(values), max(values)
            if high - low > _EXIF_CHANGE * abs(high):
                yield finding(
                    "exposure_changes",
                    f"Camera {camera}: EXIF says that {quantity} changed between {low:g} and "
                    f"{high:g}. Lock exposure, gain and white balance, then record again.",
                    camera=camera,
                )
    levels = {
        camera: {
            frame: float(np.nanmedian(item.light_rgb[item.view == index, 1]))
            for index, frame in enumerate(item.frame_ids)
            if np.isfinite(item.light_rgb[item.view == index, 1]).any()
        }
        for camera, item in samples.items()
        if item is not None
    }
    for camera, frame, ratio in exposure_jumps(levels):
        yield finding(
            "exposure_changes",
            f"Camera {camera}, frame {frame}: white is {ratio:.2f} times what the other cameras "
            f"lead one to expect. Lock exposure, gain and white balance, then record again.",
            camera=camera, frame=frame, ratio=ratio,
        )  # fmt: skip


def judge_unknown_encodings(
    recording: Recording, encodings: Mapping[str, EncodingName | None]
) -> Iterator[Finding]:
    """Yield cameras whose encoding is said to be unknown: this release does not estimate it."""
    for camera, encoding in encodings.items():
        if recording.entry(camera).encoding == "unknown":
            yield finding(
                "encoding_doubtful",
                f"Camera {camera}: its encoding is stated as unknown and was taken as {encoding}. "
                f"State it in recording.toml if you can find out.",
                camera=camera,
            )


def judge_colour(
    camera: str, solution: ColourSolution, encoding: EncodingName | None, target: Target
) -> Iterator[Finding]:
    """Yield doubts about one camera's colour."""
    slope = grey_slope(solution.disc_rgb, target.marker_xyz_d65)
    error = float(np.nanmean(solution.fit_delta_e))
    if error > _CONTRADICTED or (slope is not None and slope <= 0):
        yield finding(
            "target_contradicted",
            f"Camera {camera}: its discs differ from the target's by {error:.0f} dE2000. The "
            f"pictures may be mirrored, or show another print; then the geometry is wrong as well. "
            f"Check --target.",
            camera=camera, delta_e_2000=error,
        )  # fmt: skip
    elif slope is not None and abs(slope - 1) > _SLOPE_TOLERANCE:
        yield finding(
            "encoding_doubtful",
            f"Camera {camera}: read as {encoding or 'linear values'}, its greys follow the nominal "
            f"ones with exponent {slope:.2f} instead of 1. State the true encoding in "
            f"recording.toml, or turn off contrast and gamma settings of the camera.",
            camera=camera, slope=slope,
        )  # fmt: skip
    if solution.n_clipped:
        yield finding(
            "clipped_discs",
            f"Camera {camera}: {solution.n_clipped} disc readings hold clipped pixels and were "
            f"left out. Shorten the exposure until no disc is clipped.",
            camera=camera, n_clipped=solution.n_clipped,
        )  # fmt: skip
