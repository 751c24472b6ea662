"""Tables of `observe` on simulated workspaces: `python -m benchmarks.observe.run --seeds 0,1,2`.

Each workspace is rendered, its rig calibrated from pictures of a board, its recording observed with
and without colour correction, and the tracks held against the truth.
"""

import argparse
import resource
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from benchmarks.geometry.tables import Bar, print_bars, print_table
from benchmarks.observe.scenes import Case, make_case, run_command
from benchmarks.observe.scoring import Scores, associations, centre_sigmas_px, score
from benchmarks.observe.tables import (
    Distances,
    Sightings,
    Tracks,
    read_distances,
    read_sightings,
    read_tracks,
)

from calichrome.core.arrays import FloatArray

__all__ = ["main"]

_RAW = "--no-colour-correction"


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0", help="like 0,1,2")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument(
        "--cache",
        type=Path,
        default=Path(tempfile.gettempdir()) / "calichrome-observe",
        help="folder for what is rendered and calibrated",
    )
    options = parser.parse_args(argv)
    scored = [
        _report(make_case(int(text), options.frames, options.cache))
        for text in options.seeds.split(",")
    ]
    if len(scored) > 1:
        _print_pooled(scored)


def _print_pooled(scored: Sequence[Scores]) -> None:
    """Print means over workspaces: one workspace holds few draws of the errors that last."""
    print(f"\n## {len(scored)} workspaces, means and their standard errors")
    coverage = 100 * np.array([one.coverage for one in scored])
    colour = np.array([one.colour_de for one in scored])
    print_bars(
        [
            Bar(
                "distances above their 95 % bound, %",
                float(coverage.mean()), 93.0, 97.0, sigma=_standard_error(coverage),
            ),
            Bar(
                "colour between cameras, mean dE2000",
                float(colour.mean()), high=2.0, sigma=_standard_error(colour),
            ),
        ]
    )  # fmt: skip


def _standard_error(values: FloatArray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def _report(case: Case) -> Scores:
    corrected, corrected_s = _observe(case)
    raw, raw_s = _observe(case, _RAW)
    scores, matching = score(*corrected, case.truth)
    without, matching_without = score(*raw, case.truth)
    sigma_px = centre_sigmas_px(corrected[1], case.truth)
    ours = associations(*corrected[:2], matching, case.truth, sigma_px)
    theirs = associations(*raw[:2], matching_without, case.truth, sigma_px)
    sigmas = ", ".join(f"{camera} {value:.2f}" for camera, value in sigma_px.items())
    print(
        f"\n## Seed {case.seed}: {len(case.truth.cameras)} cameras, {len(case.truth.balls)} balls, "
        f"{len(case.truth.frame_ids)} frames\n\n"
        f"sigma of centres in pictures, px per coordinate: {sigmas}"
    )
    print_bars(
        [
            Bar("position, RMS over predicted sigma", scores.position_ratio, high=2.0),
            Bar("position, RMS in % of the distance", 100 * scores.position_share, high=0.3),
            Bar("speed, RMS error in % of RMS speed", 100 * scores.speed_share, high=5.0),
            Bar("swaps", scores.n_swaps, high=0),
            Bar("colour between cameras, mean dE2000", scores.colour_de, high=2.0),
            Bar("frames with exchangeable balls", ours.n_frames, low=30),
            Bar("wrong associations in those", ours.n_wrong, high=0),
            Bar("distances above their 95 % bound, %", 100 * scores.coverage, 93.0, 97.0),
        ]
    )
    rows = [
        *_rows(scores, without),
        ["exchangeable: frame, cameras, balls", str(ours.n_cases), str(theirs.n_cases)],
        ["sightings in those", str(ours.n_sightings), str(theirs.n_sightings)],
        ["wrong associations in those", str(ours.n_wrong), str(theirs.n_wrong)],
        ["wrong associations in all", str(ours.n_wrong_anywhere), str(theirs.n_wrong_anywhere)],
        ["CPU time of observe, s", f"{corrected_s:.0f}", f"{raw_s:.0f}"],
    ]
    print_table(("for information", "colours corrected", "camera values"), rows)
    return scores


def _rows(*runs: Scores) -> list[list[str]]:
    return [
        ["position, RMS, mm", *(f"{1e3 * run.position_m:.2f}" for run in runs)],
        ["after the best rigid motion, mm", *(f"{1e3 * run.aligned_m:.2f}" for run in runs)],
        ["velocity, RMS error in %", *(f"{100 * run.velocity_share:.2f}" for run in runs)],
        ["tracks", *(str(run.n_tracks) for run in runs)],
        ["swaps", *(str(run.n_swaps) for run in runs)],
        ["fragments", *(str(run.n_fragments) for run in runs)],
        ["lost while visible", *(str(run.n_lost) for run in runs)],
        ["visible balls without a track, %", *(f"{100 * run.missed:.2f}" for run in runs)],
        ["rows near no ball", *(str(run.n_false) for run in runs)],
        ["colour between cameras, frame by frame", *(f"{run.colour_frame_de:.2f}" for run in runs)],
    ]


def _observe(case: Case, *flags: str) -> tuple[tuple[Tracks, Sightings, Distances], float]:
    """Run the command; return its tables and its CPU time, seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as name:
        tracks, sightings, distances = (
            Path(name) / f"{table}.csv" for table in ("tracks", "sightings", "distances")
        )
        run_command(
            "observe", str(case.rig), str(case.recording), "-o", str(tracks),
            "--sightings", str(sightings), "--distances", str(distances), *flags,
        )  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        frame_ids = case.truth.frame_ids
        tables = (
            read_tracks(tracks, frame_ids),
            read_sightings(sightings, frame_ids),
            read_distances(distances, frame_ids),
        )
    used = (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)
    return tables, used


if __name__ == "__main__":
    main()
