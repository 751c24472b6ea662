"""Findings on the target and on colour: what the numbers say to their user."""

from collections.abc import Iterator, Mapping

import numpy as np

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.checks import exposure_jumps, grey_slope
from calichrome.colour.rig_fit import ColourSolution
from calichrome.colour.samples import ColourSamples
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = [
    "greys_contradict",
    "judge_colour",
    "judge_exposures",
    "judge_target",
]

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


def greys_contradict(disc_rgb: FloatArray, target: Target) -> bool:
    """Tell whether the greys rise with another exponent than 1, (n_markers, 3) linear values."""
    slope = grey_slope(disc_rgb, target.marker_xyz_d65)
    return slope is not None and abs(slope - 1) > _SLOPE_TOLERANCE


def _name(encoding: EncodingName | ToneCurve | None) -> str:
    if isinstance(encoding, ToneCurve):
        return "its estimated curve says"
    return encoding or "linear values"


def judge_colour(
    camera: str,
    solution: ColourSolution,
    encoding: EncodingName | ToneCurve | None,
    target: Target,
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
            f"Camera {camera}: read as {_name(encoding)}, its greys follow the nominal "
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
