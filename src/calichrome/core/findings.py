"""Doubts and remarks that travel with a result instead of vanishing in a log.

`docs/findings.md` explains every code to the user; a test keeps the two lists equal.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

__all__ = ["SEVERITIES", "Finding", "Severity", "finding", "worst_severity"]

Severity = Literal["note", "warning", "critical"]
JsonScalar = str | float | int | bool | None
JsonValue = JsonScalar | list[str] | list[float] | dict[str, float]

SEVERITIES: Mapping[str, Severity] = MappingProxyType(
    {
        "few_views": "warning",
        "too_few_views": "critical",
        "repeated_views": "critical",
        "poor_coverage": "critical",
        "camera_moved": "critical",
        "mirrored_views": "critical",
        "lens_misfit": "critical",
        "not_converged": "critical",
        "bent_board": "critical",
        "turned_views": "warning",
        "halves_disagree": "warning",
        "camera_drift": "critical",
        "lens_drift": "critical",
        "outliers_left_out": "note",
        "terms_held": "note",
        "board_taken_as_flat": "note",
        "bowed_board": "note",
        "small_board": "note",
        "scale_unverified": "note",
        "nominal_unmeasured": "note",
        "paper_white_unknown": "note",
        "encoding_doubtful": "warning",
        "encoding_estimated": "note",
        "exposure_changes": "warning",
        "illuminant_changes": "warning",
        "colour_drift": "warning",
        "light_changed": "note",
        "uneven_light": "note",
        "unsynchronised": "critical",
        "weak_geometry": "critical",
        "poor_fit": "critical",
        "target_contradicted": "critical",
        "views_disagree": "critical",
        "unreadable_frame": "warning",
        "no_board_frame": "note",
        "rotation_tag_ignored": "note",
        "correlated_noise": "note",
        "colour_not_calibrated": "note",
        "clipped_discs": "warning",
        "coarse_table": "warning",
        "setting_not_locked": "warning",
        "slow_camera": "warning",
        "frozen_camera": "critical",
        "camera_lost": "critical",
        "time_unknown": "note",
        "frames_apart": "warning",
        "calibration_taken_as_exact": "note",
    }
)
"""Every finding there is, with its severity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One remark.

    Parameters
    ----------
    code
        A key of `SEVERITIES`.
    severity
        "critical" means: do not trust the result (exit code 3).
    text
        One or two sentences: what, where with numbers, what to do.
    data
        The same in machine-readable form.
    """

    code: str
    severity: Severity
    text: str
    data: Mapping[str, JsonValue] = field(default_factory=dict)


def finding(code: str, text: str, **data: JsonValue) -> Finding:
    """Make a finding with the severity that belongs to its code.

    Examples
    --------
    >>> finding("few_views", "camera left: 5 views", camera="left").severity
    'warning'
    """
    return Finding(code=code, severity=SEVERITIES[code], text=text, data=data)


def worst_severity(findings: Iterable[Finding]) -> Severity | None:
    """Return the gravest severity, or None when there is no finding."""
    present = {item.severity for item in findings}
    order: tuple[Severity, ...] = ("critical", "warning", "note")
    return next((severity for severity in order if severity in present), None)
