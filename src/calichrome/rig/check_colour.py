"""A rig against new views of its discs: what changed in colour."""

from collections.abc import Iterator

import numpy as np

from calichrome.colour.drift import (
    ColourDrift,
    ColourDrifts,
    ExpectedDiscs,
    KnownColour,
    find_colour_drift,
)
from calichrome.colour.samples import collect_samples
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.observations import Dataset
from calichrome.rig.model import Rig
from calichrome.target import Target

__all__ = ["check_colour", "judge_colour_drift"]

_LIGHT = 2.0
"""Factor by which light may differ from that of the calibration, and over the board, before a word
is said. In 6 simulated recordings it reached 1.75 and 1.79 as boards were turned and moved."""
_LIGHT_TINT = 0.08
"""Length of the change of log R, G, B of the light, likewise; it reached 0.057 there."""


def check_colour(rig: Rig, dataset: Dataset, target: Target) -> ColourDrifts | None:
    """Compare the colours of a rig with new observations; None where there are none to compare.

    Parameters
    ----------
    rig
        The calibration.
    dataset
        Of cameras of the rig, discs read with the encodings of the rig.
    target
        The board.
    """
    if not target.markers:
        return None
    known = {
        camera: KnownColour(
            model=item.colour.model,
            white_rgb=item.colour.white_rgb,
            vignetting=item.vignetting,
            missed=item.colour.delta_e_2000["fit_mean"] or 0.0,
        )
        for camera, item in rig.cameras.items()
        if item.colour is not None
    }
    samples = {
        camera: item
        for camera, views in dataset.views.items()
        if camera in known
        and (item := collect_samples(views, target, vignetting=known[camera].vignetting))
    }
    names = [marker.name for marker in target.markers]
    expected = ExpectedDiscs(
        xyz=target.marker_xyz_d65,
        cov=np.zeros((len(names), 3, 3)),
        colour=np.unique(names, return_inverse=True)[1],
    )
    return find_colour_drift(samples, known, expected)


def judge_colour_drift(drifts: ColourDrifts | None) -> Iterator[Finding]:
    """Yield what changed, and what only the light changed."""
    if drifts is None:
        return
    by_light = len(drifts.cameras) > 1 and all(
        item.change == "matrix" for item in drifts.cameras.values()
    )
    for camera, item in drifts.cameras.items():
        if item.change != "nothing":
            yield finding(
                "colour_drift",
                f"Camera {camera}: {_what(item, len(drifts.cameras), by_light=by_light)}",
                camera=camera, change=item.change, exposure=item.exposure,
                balance=[float(value) for value in item.balance], delta_e_2000=item.delta_e,
                chance=_chance(item), by_light=by_light,
            )  # fmt: skip
    said = list(_light(drifts))
    if said:
        light = drifts.light
        yield finding(
            "light_changed",
            f"The light on the board is {', and '.join(said)}. No camera changed by that.",
            level=light.level, balance=[float(value) for value in light.balance],
            unevenness=light.unevenness,
        )  # fmt: skip


def _chance(item: ColourDrift) -> float | None:
    return {
        "nothing": None,
        "exposure": item.exposure_chance,
        "white balance": item.balance_chance,
        "matrix": item.matrix_chance,
    }[item.change]


def _what(item: ColourDrift, n_cameras: int, *, by_light: bool) -> str:
    either = " Of two cameras either may be the one." if n_cameras == 2 else ""
    if item.change == "exposure":
        return (
            f"against the others its values are {item.exposure:.2f} times what they were: exposure "
            f"or gain changed.{either} Set it back, or calibrate again."
        )
    if item.change == "white balance":
        cause, more = (
            ("or the light has another colour", "")
            if item.alone
            else ("against the others", either)
        )
        return (
            f"its white balance changed {cause}, R, G, B by {_factors(item.balance)}.{more} Set it "
            f"back, or calibrate again."
        )
    cause = (
        "so do all cameras: the light has another spectrum"
        if by_light
        else "its colour processing changed, or the light's spectrum"
    )
    return (
        f"its discs changed by {item.delta_e:.1f} dE2000 beyond exposure and white balance; "
        f"{cause}. Calibrate again."
    )


def _light(drifts: ColourDrifts) -> Iterator[str]:
    light, cameras = drifts.light, drifts.cameras.values()
    if all(item.change == "nothing" for item in cameras):  # what all see is not one camera's
        if abs(np.log(light.level)) > np.log(_LIGHT):
            exposure = " (or the exposure is)" if any(item.alone for item in cameras) else ""
            yield f"{light.level:.2f} times that of the calibration{exposure}"
        if np.linalg.norm(np.log(light.balance)) > _LIGHT_TINT:
            yield f"of another colour (R, G, B by {_factors(light.balance)})"
    if light.unevenness > _LIGHT - 1:
        ratio = 1 + light.unevenness
        yield f"uneven: the brightest place of the board has {ratio:.1f} times that of the darkest"


def _factors(balance: FloatArray) -> str:
    return ", ".join(f"{value:.2f}" for value in balance)
