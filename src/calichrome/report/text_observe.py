"""What `observe` says."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from calichrome.core.findings import Finding
from calichrome.report.text import finding_lines, table
from calichrome.tracking import ErrorSizes, Trajectory

__all__ = ["observe_summary", "observe_to_json"]

_MOST_TRACKS = 15


def observe_summary(
    trajectories: Sequence[Trajectory],
    errors: ErrorSizes,
    findings: Sequence[Finding],
    *,
    n_born: int,
    n_lost: int,
    cameras: Sequence[str],
    n_frames: int,
    time_unit_s: float,
) -> str:
    """Say what was seen, how well, and what to doubt.

    Parameters
    ----------
    trajectories, errors
        What was found.
    findings
        What to doubt.
    n_born, n_lost
        Tracks that begin after the first frame, or end before the last.
    cameras, n_frames
        That were looked at.
    time_unit_s
        Seconds per unit of the reported times.
    """
    objects = f"{len(trajectories)} object{'' if len(trajectories) == 1 else 's'}"
    lines = [f"{objects} in {n_frames} frames of {len(cameras)} cameras ({', '.join(cameras)})"]
    if n_born or n_lost:
        lines.append(f"{n_born} tracks begin after the first frame, {n_lost} end before the last")
    if trajectories:
        lasting = f"lasting errors {errors.silhouette:.2g} times"
        lines += [f"Centres in pictures: noise {errors.noise:.2g} times the stated, {lasting}", ""]
        lines += _tracks(trajectories, time_unit_s)
    lines += list(finding_lines(findings))
    return "\n".join(lines)


def _tracks(trajectories: Sequence[Trajectory], unit_s: float) -> Iterator[str]:
    unit = "s" if unit_s == 1 else "frame"
    rows = [
        [
            str(item["track"]),
            f"{item['from']:.2f} to {item['to']:.2f}",
            str(item["frames"]),
            f"{item['views']:.1f}",
            f"{item['sigma_m'] * 1e3:.2f}",
            f"{item['speed']:.3g}",
        ]
        for item in (_track_to_json(t, unit_s) for t in trajectories[:_MOST_TRACKS])
    ]
    yield from table(
        ["track", f"alive ({unit})", "frames", "views", "± mm", f"speed m/{unit}"], rows
    )
    if len(trajectories) > _MOST_TRACKS:
        yield f"and {len(trajectories) - _MOST_TRACKS} more"


def observe_to_json(
    trajectories: Sequence[Trajectory],
    errors: ErrorSizes,
    findings: Sequence[Finding],
    *,
    n_born: int,
    n_lost: int,
    time_unit_s: float,
) -> dict[str, Any]:
    """Return the same for programs."""
    return {
        "tracks": [_track_to_json(item, time_unit_s) for item in trajectories],
        "born": n_born,
        "lost": n_lost,
        "errors": {
            "noise": errors.noise,
            "silhouette": errors.silhouette,
            "density_m2_s3": errors.density_m2_s3,
        },
        "findings": [
            {
                "code": item.code,
                "severity": item.severity,
                "text": item.text,
                **dict(item.data),
            }
            for item in findings
        ],
    }


def _track_to_json(item: Trajectory, unit_s: float) -> dict[str, Any]:
    speed = np.linalg.norm(item.velocities_ref, axis=1) * unit_s
    variance = np.trace(item.cov[:, :3, :3], axis1=1, axis2=2)
    return {
        "track": item.track.number,
        "from": float(item.times_s[0]) / unit_s,
        "to": float(item.times_s[-1]) / unit_s,
        "frames": len(item.times_s),
        "views": float(np.mean([len(step.sightings) for step in item.track.steps])),
        "sigma_m": float(np.sqrt(variance.mean())),
        "speed": float(np.sqrt(np.mean(speed**2))),
    }
