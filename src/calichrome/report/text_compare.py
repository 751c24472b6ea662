"""What `compare` and `check` found, for a person and for a program."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from calichrome.colour.drift import ColourDrift, ColourDrifts
from calichrome.core.arrays import FloatArray
from calichrome.geometry.comparison import LensDifference
from calichrome.geometry.displacement import Displacement
from calichrome.geometry.drift import CameraDrift, LensChange
from calichrome.report.text import table, with_sigma
from calichrome.rig.check import Check
from calichrome.rig.compare import CameraComparison, Comparison

__all__ = ["check_summary", "check_to_json", "comparison_summary", "comparison_to_json"]


def comparison_summary(found: Comparison) -> str:
    """Say by how much two rigs differ, and whether chance explains it."""
    return "\n".join(_comparison_lines(found))


def _comparison_lines(found: Comparison) -> Iterator[str]:
    yield "Projections, first to second rig, RMS / max px (expected RMS)"
    rows = []
    for camera, item in found.cameras.items():
        far = "-" if item.near is None else _metres(item.distances_m)
        rows.append(
            [camera, _projection(item.far), _verdict(item.far.chance, found.limit), far]
            + (
                ["-", "-"]
                if item.near is None
                else [_projection(item.near), _verdict(item.near.chance, found.limit)]
            )
        )
    yield from table(["camera", "far", "", "at m", "near", ""], rows)
    if len(found.cameras) > 1:
        yield ""
        yield f"Places against {found.reference}, first to second rig"
        yield from table(
            ["camera", "moved mm", "turned mdeg", ""],
            [
                [camera, *_motion(item.place), _verdict(item.place.chance, found.limit)]
                for camera, item in found.cameras.items()
                if item.place is not None
            ],
        )
    yield ""
    for names, which in ((found.only_first, "first"), (found.only_second, "second")):
        if names:
            yield f"Only in the {which} rig: {', '.join(names)}"
    if found.same_pictures:
        yield (
            f"{found.same_pictures} pictures are in both: their errors are shared, and the "
            f"expected differences are too large."
        )
    if not found.with_covariance:
        yield "No verdict: rig.npz with the covariances is not beside both rigs."
    elif found.differing:
        yield f"Different beyond 3 sigma: {', '.join(found.differing)}."
    else:
        yield "Compatible: no difference beyond 3 sigma."


def _metres(distances_m: tuple[float, ...]) -> str:
    return f"{distances_m[0]:.2f}" + (f"-{distances_m[-1]:.2f}" if len(distances_m) > 1 else "")


def _projection(item: LensDifference) -> str:
    expected = "" if item.sigma_px is None else f" ({item.sigma_px:.3f})"
    return f"{item.rms_px:.3f} / {item.max_px:.3f}{expected}"


def _verdict(chance: float | None, limit: float) -> str:
    """Say where a difference lies among those that chance makes."""
    if chance is None:
        return ""
    if chance < limit:
        return "beyond 3 sigma"
    if chance < 0.0027:
        return "beyond 99.7 %"
    return "beyond 95 %" if chance < 0.05 else "within 95 %"


def _motion(place: Displacement) -> list[str]:
    moved = with_sigma(place.distance_m * 1e3, _times(place.sigma_m, 1e3))
    turned = with_sigma(
        np.degrees(place.angle_rad) * 1e3, _times(place.sigma_rad, 1e3 * 180 / np.pi)
    )
    return [moved, turned]


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def comparison_to_json(found: Comparison) -> dict[str, Any]:
    """Return all numbers of a comparison."""
    return {
        "reference_camera": found.reference,
        "only_first": list(found.only_first),
        "only_second": list(found.only_second),
        "same_pictures": found.same_pictures,
        "significant_below": found.limit,
        "compatible": not found.differing if found.with_covariance else None,
        "differing": list(found.differing),
        "cameras": {camera: _camera_json(item) for camera, item in found.cameras.items()},
    }


def _camera_json(item: CameraComparison) -> dict[str, Any]:
    return {
        "far": _projection_json(item.far),
        "near": None if item.near is None else _projection_json(item.near),
        "distances_m": list(item.distances_m),
        "place": None if item.place is None else _motion_json(item.place, item.place.chance),
    }


def _projection_json(item: LensDifference) -> dict[str, Any]:
    return {
        "rms_px": item.rms_px,
        "max_px": item.max_px,
        "expected_rms_px": item.sigma_px,
        "ratio": item.ratio,
        "chance": item.chance,
        "rotation_rad": item.b_from_a.rotvec_rad.tolist(),
        "translation_m": item.b_from_a.trans_m.tolist(),
    }


def _motion_json(place: Displacement, chance: float | None) -> dict[str, Any]:
    return {
        "moved_m": place.distance_m,
        "moved_sigma_m": place.sigma_m,
        "turned_rad": place.angle_rad,
        "turned_sigma_rad": place.sigma_rad,
        "motion": place.motion.tolist(),
        "chance": chance,
    }


def check_summary(found: Check) -> str:
    """Say of every camera whether it moved, and whether its lens or its colour changed."""
    return "\n".join(_check_lines(found))


def _check_lines(found: Check) -> Iterator[str]:
    yield from table(
        ["camera", "moved mm", "turned mdeg", "chance", "focal %", "chance", "misfit", "verdict"],
        [_check_row(camera, item) for camera, item in found.drift.cameras.items()],
    )
    yield (
        "(chance: how often an unchanged camera shows as much; misfit: what remains whatever "
        "moved, over that of the calibration)"
    )
    if found.colour is not None:
        yield ""
        yield from table(
            [
                "camera", "exposure", "chance", "balance R, G, B", "chance", "matrix dE", "chance",
                "verdict",
            ],
            [_colour_row(camera, item) for camera, item in found.colour.cameras.items()],
        )  # fmt: skip
        light = found.colour.light
        yield (
            f"Light: {light.level:.2f} times that of the calibration, R G B by "
            f"{_rgb(light.balance)}; it varies by {light.unevenness:.0%} over the board."
        )
    if found.absent:
        yield f"Not checked, no view of the board: {', '.join(found.absent)}"
    if found.unknown:
        yield f"Not in the rig: {', '.join(found.unknown)}"
    if not found.with_covariance:
        yield "The ± hold the noise of these pictures only: rig.npz is not beside the rig."
    yield ""
    for item in found.findings:
        yield f"{item.severity:8} {item.code}: {item.text}"
    if found.unchanged:
        colour = "" if found.colour is None else " and sees the colours it saw"
        yield f"Unchanged: every camera is where it was, with the lens it had{colour}."


def _check_row(camera: str, item: CameraDrift) -> list[str]:
    moved = ["-", "-"] if item.moved is None else _motion(item.moved)
    return [
        camera, *moved, _chance(item.moved_chance), _focal(item.lens), _chance(item.lens_chance),
        f"{item.misfit:.2f}", _state(item),
    ]  # fmt: skip


def _colour_row(camera: str, item: ColourDrift) -> list[str]:
    return [
        camera,
        "-" if item.alone else f"{item.exposure:.3f}",
        _chance(item.exposure_chance),
        _rgb(item.balance),
        _chance(item.balance_chance),
        "-" if item.matrix_chance is None else f"{item.delta_e:.1f}",
        _chance(item.matrix_chance),
        "as it was" if item.change == "nothing" else f"{item.change} changed",
    ]


def _rgb(factors: FloatArray) -> str:
    return " ".join(f"{value:.3f}" for value in factors)


def _state(item: CameraDrift) -> str:
    if not item.fits:
        return "does not fit"
    said = [
        words
        for words, is_so in (("moved", item.has_moved), ("lens changed", item.has_lens_changed))
        if is_so
    ]
    unsure = "?" if item.moved_or or item.lens_or else ""
    return f"{' or '.join(said)}{unsure}" if said else "as it was"


def _chance(value: float | None) -> str:
    if value is None:
        return "-"
    return "< 1e-9" if value < 1e-9 else f"{value:.2g}"


def _focal(lens: LensChange | None) -> str:
    return "-" if lens is None else with_sigma(lens.values[0] * 100, lens.sigma[0] * 100)


def check_to_json(found: Check) -> dict[str, Any]:
    """Return all numbers of a check."""
    return {
        "unchanged": found.unchanged,
        "frames": found.frames,
        "absent": list(found.absent),
        "unknown": list(found.unknown),
        "with_covariance": found.with_covariance,
        "cameras": {
            camera: {
                "n_views": item.n_views,
                "place": None
                if item.moved is None
                else _motion_json(item.moved, item.moved_chance),
                "lens": None
                if item.lens is None
                else {
                    "focal_share": float(item.lens.values[0]),
                    "cx_px": float(item.lens.values[1]),
                    "cy_px": float(item.lens.values[2]),
                    "sigma": item.lens.sigma.tolist(),
                    "chance": item.lens_chance,
                },
                "misfit": item.misfit,
                "moved": item.has_moved,
                "lens_changed": item.has_lens_changed,
                "fits": item.fits,
            }
            for camera, item in found.drift.cameras.items()
        },
        "colour": None if found.colour is None else _colour_json(found.colour),
        "findings": [
            {**item.data, "code": item.code, "severity": item.severity, "text": item.text}
            for item in found.findings
        ],
    }


def _colour_json(found: ColourDrifts) -> dict[str, Any]:
    return {
        "cameras": {
            camera: {
                "change": item.change,
                "exposure": None if item.alone else item.exposure,
                "exposure_chance": item.exposure_chance,
                "balance": item.balance.tolist(),
                "balance_chance": item.balance_chance,
                "matrix": item.matrix.tolist(),
                "matrix_delta_e_2000": item.delta_e,
                "matrix_chance": item.matrix_chance,
            }
            for camera, item in found.cameras.items()
        },
        "light": {
            "level": found.light.level,
            "balance": found.light.balance.tolist(),
            "unevenness": found.light.unevenness,
        },
    }
