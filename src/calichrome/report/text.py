"""The summary of a calibration: at most some 25 lines that a person understands."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calichrome._version import __version__
from calichrome.core.findings import Finding
from calichrome.rig import Camera, Rig

__all__ = ["finding_lines", "summary", "table"]

_MOST_FINDINGS = 9


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Align columns; the first to the left, the others to the right.

    Examples
    --------
    >>> table(["camera", "px"], [["left", "0.2"]])
    ['camera   px', 'left    0.2']
    """
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if index == 0 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in [header, *rows]
    ]


def summary(rig: Rig) -> str:
    """Say what was calibrated, how well, and what to doubt."""
    return "\n".join(_lines(rig))


def _lines(rig: Rig) -> Iterator[str]:
    nx, ny = rig.target.corners_xy
    yield (
        f"calichrome {__version__}: {_count(len(rig.cameras), 'camera')}, "
        f"{_count(len(rig.frames), 'frame')}, board of {nx}x{ny} corners, squares of "
        f"{rig.target.square_m[0] * 1e3:g} mm"
    )
    between = rig.inter_camera_delta_e_2000
    if between is not None:
        yield (
            f"Between cameras: {between['mean']:.2f} dE2000 on average, 95 % below "
            f"{between['p95']:.2f}{_left_out(between)}"
        )
    yield ""
    yield from table(
        [
            "camera",
            "size",
            "views",
            "held-out px",
            "RMS px",
            "fx px",
            "fy px",
            "dE2000",
            "from ref mm",
        ],
        [_camera_row(name, camera, rig) for name, camera in rig.cameras.items()],
    )
    models = [
        f"{name} {camera.colour.model.MODEL}"
        for name, camera in rig.cameras.items()
        if camera.colour is not None
    ]
    if models:
        yield "(dE2000: leave-one-disc-out error against the target / error of the fit)"
        yield f"Colour models: {', '.join(models)}"
    if rig.pairs:
        yield ""
        pairs = sorted(rig.pairs, key=lambda pair: pair.rms_px)
        shown = [f"{'-'.join(p.cameras)} {p.rms_px:.3f} px ({p.shared_views})" for p in pairs[:6]]
        more = f", {len(pairs) - 6} more" if len(pairs) > 6 else ""
        yield f"Pairs, RMS (shared views): {', '.join(shown)}{more}"
    yield ""
    yield from finding_lines(rig.findings)
    yield (
        "Trustworthy: yes."
        if rig.trustworthy
        else "Trustworthy: NO. A critical finding says that these numbers may be wrong."
    )


def finding_lines(findings: Sequence[Finding]) -> Iterator[str]:
    """Yield the first finding of each code, gravest first, and how many more there are."""
    order = {"critical": 0, "warning": 1, "note": 2}
    by_code: dict[str, list[Finding]] = {}
    for item in sorted(findings, key=lambda item: order[item.severity]):
        by_code.setdefault(item.code, []).append(item)
    for same in list(by_code.values())[:_MOST_FINDINGS]:
        more = f" (and {len(same) - 1} more like this)" if len(same) > 1 else ""
        yield f"{same[0].severity:8} {same[0].code}: {same[0].text}{more}"
    if len(by_code) > _MOST_FINDINGS:
        yield f"         and {len(by_code) - _MOST_FINDINGS} more kinds of findings in the rig file"


def _left_out(between: Mapping[str, float | None]) -> str:
    value = between.get("held_out_mean")
    return "" if value is None else f"; {value:.2f} on discs left out of the fit"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _camera_row(name: str, camera: Camera, rig: Rig) -> list[str]:
    colour = camera.colour
    delta_e = "-"
    if colour is not None:
        errors = colour.delta_e_2000
        delta_e = f"{errors['held_out_mean']:.2f} / {errors['fit_mean']:.2f}"
    return [
        name,
        f"{camera.size_wh[0]}x{camera.size_wh[1]}",
        str(camera.n_views),
        "-" if camera.held_out_rms_px is None else f"{camera.held_out_rms_px:.3f}",
        f"{camera.rms_px:.3f}",
        with_sigma(camera.lens.fx, camera.lens_sigma["fx"]),
        with_sigma(camera.lens.fy, camera.lens_sigma["fy"]),
        delta_e,
        "reference" if name == rig.reference_camera else distance_text(camera),
    ]


def distance_text(camera: Camera) -> str:
    """Distance of a camera from the reference camera in mm, with its sigma along that line."""
    trans_m = camera.cam_from_ref.trans_m
    distance = float(np.linalg.norm(trans_m))
    sigma = None
    if camera.cov_m is not None and distance > 0:
        direction = trans_m / distance
        sigma = float(np.sqrt(direction @ camera.cov_m @ direction)) * 1e3
    return with_sigma(distance * 1e3, sigma)


def with_sigma(value: float, sigma: float | None) -> str:
    """Write a value to the digit that its sigma allows.

    Examples
    --------
    >>> with_sigma(1104.408, 0.53), with_sigma(3.14159, None)
    ('1104.41 ± 0.53', '3.14')
    """
    if sigma is None or sigma <= 0 or not np.isfinite(sigma):
        return f"{value:.2f}"
    digits = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"
