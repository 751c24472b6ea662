"""Real recordings against what is published: python -m benchmarks.geometry.real --data FOLDER.

Pictures are searched anew unless --cache names a folder; each figure stands beside its bar.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from benchmarks.geometry.real_rows import Pair, opencv_pair, row_differences_px
from benchmarks.geometry.real_sets import (
    RECORDINGS,
    ZHANG,
    ZHANG_FIXED,
    Recorded,
    zhang_recorded,
)
from benchmarks.geometry.tables import NOT_RUN, Bar, print_bars, print_table

from calichrome.core.arrays import FloatArray
from calichrome.geometry.halves import compare_halves
from calichrome.geometry.held_out import held_out_rms_px
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import Dataset

__all__ = ["main"]

_ROW_BARS = {"opencv_stereo": 0.18, "boofcv_bumblebee2_chess": 0.06}
_STEREO_MM = {"x": (-99.80, 0.14), "y": (1.12, 0.11), "z": (0.05, 0.50)}
"""Published with the recording, with its own uncertainty (J.-Y. Bouguet's stereo example)."""


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cache", type=Path, help="keep detections here")
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    bars: list[Bar] = []
    absent = []
    for name, item in RECORDINGS.items():
        recorded = item.read(options.data, options.cache)
        if recorded is None:
            absent.append((name, NOT_RUN))
        else:
            bars += _recording(name, recorded)
    zhang = zhang_recorded(options.data)
    if zhang is None:
        absent.append(("zhang1998", NOT_RUN))
    else:
        bars += _zhang(zhang)
    print_bars([bar for bar in bars if not _is_open(bar)])
    print_table(
        ("figure without a bar", "measured"), [bar.cells[:2] for bar in bars if _is_open(bar)]
    )
    if absent:
        print_table(("recording", ""), absent)


def _is_open(bar: Bar) -> bool:
    return bar.low == -np.inf and bar.high == np.inf


def _recording(name: str, recorded: Recorded) -> Iterator[Bar]:
    solved = _solve(recorded, recorded.dataset)
    print_table(
        ("recording", "camera", "RMS px", "noise over the stated", "fx px", "fy px", "left out"),
        [
            (
                name, camera, f"{solved.rms_px(camera):.4f}", f"{solved.noise[camera]:.2f}",
                f"{lens.parameters[0]:.2f}", f"{lens.parameters[1]:.2f}",
                str(sum(int((~kept).sum()) for key, kept in solved.inliers.items()
                        if key[0] == camera)),
            )
            for camera, lens in solved.lenses.items()
        ],
    )  # fmt: skip
    held_out = held_out_rms_px(
        solved, recorded.target.corners_board, partial(_solve, recorded, start=solved)
    )
    limit = 0.120 if name == "boofcv_trinocular_odd" else np.inf
    for camera, value in held_out.items():
        error = np.nan if value is None else value
        yield Bar(f"{name}: held-out RMS {camera}, px", error, high=limit)
    if name == "opencv_stereo":
        yield from _published_stereo(solved)
    if name == "boofcv_trinocular_odd":
        yield from _halves(name, recorded, solved)
    if name in _ROW_BARS:
        yield from _rows(name, recorded)


def _solve(recorded: Recorded, dataset: Dataset, start: RigSolution | None = None) -> RigSolution:
    settings = RigSettings(reference=recorded.reference, start=start)
    return solve_rig(dataset, recorded.target, settings)


def _published_stereo(solved: RigSolution) -> Iterator[Bar]:
    left = solved.lenses["left"].as_dict()
    yield Bar("opencv_stereo: left fx, px", left["fx"], 533.09 - 1, 533.09 + 1)
    yield Bar("opencv_stereo: left fy, px", left["fy"], 533.22 - 1, 533.22 + 1)
    found_mm = solved.cams_from_ref["right"].trans_m * 1e3
    for value, (axis, (known, sigma)) in zip(found_mm, _STEREO_MM.items(), strict=True):
        yield Bar(
            f"opencv_stereo: translation {axis}, mm", float(value), known - sigma, known + sigma
        )
    yield Bar("opencv_stereo: left RMS, px", solved.rms_px("left"), high=0.215)


def _halves(name: str, recorded: Recorded, solved: RigSolution) -> Iterator[Bar]:
    """Even against odd frames."""
    halves = compare_halves(recorded.dataset, partial(_solve, recorded, start=solved))
    for camera in recorded.dataset.cameras:
        sigmas = None if halves is None else halves.position_sigmas(camera)
        if sigmas is not None:
            yield Bar(
                f"{name}: halves, largest of x, y, z of {camera}, combined sigma",
                float(np.abs(sigmas).max()),
                high=3,
            )
        ratio = None if halves is None else halves.ratio(camera)
        if ratio is not None:
            yield Bar(f"{name}: halves, lens of {camera} over the predicted", ratio)


def _rows(name: str, recorded: Recorded) -> Iterator[Bar]:
    """Each calibration starts from nothing: what is left out helps in no way."""

    def ours(dataset: Dataset) -> Pair:
        solved = _solve(recorded, dataset)
        return solved.lenses["left"], solved.lenses["right"], solved.cams_from_ref["right"]

    rows = row_differences_px(recorded, "left", "right", ours)
    yield Bar(f"{name}: rows of the frame left out, RMS px", _rms(rows), high=_ROW_BARS[name])
    theirs = partial(opencv_pair, recorded, "left", "right")
    rows = row_differences_px(recorded, "left", "right", theirs)
    yield Bar(f"{name}: the same, cv2.stereoCalibrate, RMS px", _rms(rows))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _zhang(recorded: Recorded) -> Iterator[Bar]:
    """His model: k1, k2 only, a flat board; then what a bow changes."""
    settings = RigSettings(fixed={"camera": ZHANG_FIXED}, warp=False, robust=False)
    flat = solve_rig(recorded.dataset, recorded.target, settings)
    found = flat.lenses["camera"].as_dict()
    widths = {"fx": 0.4, "fy": 0.4, "cx": 0.4, "cy": 0.4, "k1": 2e-3, "k2": 1e-2}
    for name, known in ZHANG.items():
        yield Bar(f"zhang1998: {name}", found[name], known - widths[name], known + widths[name])
    yield Bar("zhang1998: RMS, px", flat.rms_px("camera"), 0.333, 0.337)
    for text, other in (
        ("flat, outliers left out", replace(settings, robust=True)),
        ("bow", replace(settings, warp=True)),
        ("bow, outliers left out", replace(settings, warp=True, robust=True)),
    ):
        solved = solve_rig(recorded.dataset, recorded.target, other)
        yield Bar(f"zhang1998, {text}: fx", solved.lenses["camera"].as_dict()["fx"])
        yield Bar(f"zhang1998, {text}: RMS, px", solved.rms_px("camera"))


if __name__ == "__main__":
    main()
