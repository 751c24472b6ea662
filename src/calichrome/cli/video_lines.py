"""What became of videos, in words and as JSON."""

from collections.abc import Mapping
from typing import Any

from calichrome.pipeline.correct_video import VideoOutcome

__all__ = ["video_json", "video_lines"]


def video_lines(videos: Mapping[str, VideoOutcome]) -> list[str]:
    """Return for each video its frames, its speed and who used the CPU."""
    lines = []
    for item in videos.values():
        total_s = sum(item.cpu_s.values()) or 1.0
        shares = ", ".join(f"{what} {spent / total_s:.0%}" for what, spent in item.cpu_s.items())
        per_frame_ms = item.cpu_s["correct"] / item.n_frames * 1e3
        lines.append(
            f"  {item.name}: {item.n_frames} frames, {item.n_frames / item.wall_s:.1f} per second; "
            f"CPU time: {shares} (correct {per_frame_ms:.1f} ms per frame)"
        )
        if item.n_stand_ins:
            lines.append(
                f"    {item.n_stand_ins} damaged frames are shown as far as they could be decoded, "
                f"or as the next one"
            )
        if item.n_frames < item.n_expected:
            lines.append(
                f"    {item.n_expected - item.n_frames} frames at the end could not be decoded; "
                f"copy the video again"
            )
    return lines


def video_json(videos: Mapping[str, VideoOutcome]) -> dict[str, Any]:
    """Return the same as data."""
    return {
        name: {
            "file": item.name,
            "frames": item.n_frames,
            "frames_expected": item.n_expected,
            "frames_damaged": item.n_stand_ins,
            "wall_s": round(item.wall_s, 3),
            "cpu_s": {what: round(spent, 3) for what, spent in item.cpu_s.items()},
        }
        for name, item in videos.items()
    }
