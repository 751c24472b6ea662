"""Speed and accuracy of corrected frames beside other ways to do it."""

import argparse
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np
from benchmarks.apply.calibrations import colour_of, picture, random_camera
from benchmarks.apply.peers import OPENCOLORIO, TWO_PASSES, Peer, Setup, peers
from benchmarks.apply.truth import corrected_in_floats
from benchmarks.geometry.tables import NOT_RUN, Bar, print_bars, print_table

from calichrome.apply import Corrector, FrameFormat, PixelType, undistorting_map
from calichrome.colorimetry.encoding import EncodingName
from calichrome.colour.models.linear import Linear
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import Pixels
from calichrome.rig import Camera

__all__ = ["main"]

_SIZES = {"1080p": (1920, 1080), "4K": (3840, 2160)}
_OURS, _OURS_MATRIX = "calichrome: root-polynomial, fall-off, map", "calichrome: matrix, map"
_MEMCPY = "copy of the frame"


def main() -> None:
    """Print a table for each size and depth, and whether the bars are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--sizes", nargs="*", choices=_SIZES, default=list(_SIZES))
    parser.add_argument("--seconds", type=float, default=0.6, help="slower ones run twice only")
    settings = parser.parse_args()
    cv2.setNumThreads(1)
    bars: list[Bar] = []
    for name in settings.sizes:
        for dtype in ("uint8", "uint16"):
            bars += _measure(name, dtype, settings.rounds, settings.seconds)
    bars += _accuracy()
    print_bars(bars)
    print(f"\nload of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _measure(name: str, dtype: PixelType, rounds: int, slow_s: float) -> list[Bar]:
    setup = _setup(_SIZES[name], dtype)
    runs: dict[str, Callable[[], object] | None] = {
        _MEMCPY: _copying(setup.frame),
        _OURS: _ours(setup.camera, setup, 1),
        _OURS_MATRIX: _ours(setup.matrix_camera, setup, 1),
        **{peer.name: peer.run for peer in peers(setup)},
    }
    cpu_s = _interleaved({key: run for key, run in runs.items() if run is not None}, rounds, slow_s)
    base = cpu_s[TWO_PASSES]
    rows = [
        [key, *((f"{cpu_s[key] * 1e3:.1f}", f"{cpu_s[key] / base:.2f}") if key in cpu_s else
                (NOT_RUN, NOT_RUN))]
        for key in runs
    ]  # fmt: skip
    print(f"\n{name}, {dtype}")
    print_table(["what", "CPU ms per frame, 10th percentile", "over two passes"], rows)
    wall_s = _walls(setup, rounds)
    print(f"\nwall ms per frame, 10th percentile: {wall_s[1] * 1e3:.1f} with one thread, "
          f"{wall_s[2] * 1e3:.1f} with two; load {os.getloadavg()[0]:.1f}")  # fmt: skip
    where = f"{name} {dtype}"
    bars = [
        Bar(f"{where}: root-polynomial over two passes", cpu_s[_OURS] / base, high=0.9),
        Bar(f"{where}: wall of two threads over one", wall_s[2] / wall_s[1], high=0.62),
    ]
    if OPENCOLORIO in cpu_s:
        faster = cpu_s[OPENCOLORIO] / cpu_s[_OURS]
        bars.append(Bar(f"{where}: OpenColorIO over root-polynomial", faster, low=1.7))
    return bars


def _setup(size_wh: tuple[int, int], dtype: PixelType) -> Setup:
    """Take a lens like that of a wide machine-vision camera, and a picture with noise."""
    rng = np.random.default_rng(0)
    width, height = size_wh
    drawn = random_camera(rng, size_wh, "root-polynomial-2-white")
    while drawn.vignetting is None:
        drawn = random_camera(rng, size_wh, "root-polynomial-2-white")
    lens = BrownConrady(fx=0.8 * width, fy=0.8 * width, cx=width / 2, cy=height / 2,
                        k1=-0.28, k2=0.08, p1=1e-3, p2=-5e-4)  # fmt: skip
    encoding: EncodingName = "srgb" if dtype == "uint8" else "linear"
    colour = replace(colour_of(drawn), encoding=encoding)
    camera = replace(drawn, lens=lens, colour=colour)
    matrix = Linear.from_matrix(colour.model.jacobian(colour.white_rgb))
    matrix_camera = replace(camera, vignetting=None, colour=replace(colour, model=matrix))
    top = np.iinfo(dtype).max
    frame = np.rint(picture(rng, size_wh) * top).astype(dtype)
    return Setup(
        camera=camera,
        matrix_camera=matrix_camera,
        source_map=undistorting_map(lens, size_wh),
        frame=frame,
        dtype=dtype,
    )


def _ours(camera: Camera, setup: Setup, n_threads: int) -> Callable[[], object]:
    corrector = Corrector(
        camera, "srgb", setup.source_map, frames=FrameFormat(dtype=setup.dtype),
        n_threads=n_threads,
    )  # fmt: skip
    out = np.empty(corrector.output_shape, corrector.output_dtype)
    return lambda: corrector.apply(setup.frame, out)


def _copying(frame: Pixels) -> Callable[[], object]:
    out = np.empty_like(frame)
    return lambda: np.copyto(out, frame)


def _interleaved(
    runs: Mapping[str, Callable[[], object]], rounds: int, slow_s: float
) -> dict[str, float]:
    """10th percentile of the CPU seconds of each; in every round all run, in another order."""
    rng = np.random.default_rng(1)
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    names = list(runs)
    for _ in range(rounds):
        for index in rng.permutation(len(names)):
            own = seconds[names[index]]
            if len(own) >= 2 and min(own) > slow_s:
                continue
            start = time.process_time()
            runs[names[index]]()
            own.append(time.process_time() - start)
    return {name: float(np.percentile(own, 10)) for name, own in seconds.items()}


def _walls(setup: Setup, rounds: int) -> dict[int, float]:
    runs = {count: _ours(setup.camera, setup, count) for count in (1, 2)}
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(2 * rounds):
        for count, run in runs.items():
            start = time.perf_counter()
            run()
            seconds[count].append(time.perf_counter() - start)
    return {count: float(np.percentile(own, 10)) for count, own in seconds.items()}


def _accuracy() -> list[Bar]:
    """Compare 8-bit results with double precision, rounded to 8 bits at the end."""
    setup = _setup((960, 540), "uint8")
    rows, bars = [], []
    two_pass = next(peer for peer in peers(setup) if peer.name == TWO_PASSES)
    for name, run, camera in (
        (_OURS, _ours(setup.camera, setup, 1), setup.camera),
        (_OURS_MATRIX, _ours(setup.matrix_camera, setup, 1), setup.matrix_camera),
        (TWO_PASSES, _required(two_pass), setup.matrix_camera),
    ):
        wanted, inside = corrected_in_floats(camera, setup.source_map, setup.frame)
        off = np.abs(np.asarray(run(), dtype=np.float64) - np.rint(255 * wanted))[inside]
        mean, high = float(off.mean()), float(np.percentile(off, 99.9))
        rows.append([name, f"{mean:.3f}", f"{high:.1f}", f"{off.max():.0f}"])
        if name != TWO_PASSES:
            bars.append(Bar(f"{name}: mean error", mean, high=0.25))
            bars.append(Bar(f"{name}: 99.9 % of errors", high, high=2.5))
    print("\nlevels of 255 off what double precision gives, 8-bit frames, inside the picture")
    print_table(["what", "mean", "99.9 %", "largest"], rows)
    return bars


def _required(peer: Peer) -> Callable[[], object]:
    if peer.run is None:
        raise ValueError(f"{peer.name}: is not installed")
    return peer.run


if __name__ == "__main__":
    main()
