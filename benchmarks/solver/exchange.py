"""What the engines get and give, as files, and the meters they share. Needs numpy alone."""

import argparse
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "WARM_UPS",
    "Geometry",
    "Meter",
    "Problem",
    "Solution",
    "Task",
    "engine_arguments",
    "measured",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_T = TypeVar("_T")

WARM_UPS = 5
"""How often an engine solves the small problem before its solve is timed: a call of some
milliseconds still gets shorter from the second time to the fifth."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """All unknowns of a problem.

    Parameters
    ----------
    lens : (C, 9) float
        fx fy cx cy k1 k2 p1 p2 k3 of each camera.
    cam_from_ref_rotation, cam_from_ref_m : (C, 3, 3) and (C, 3) float
        Camera 0 is the reference: identity.
    ref_from_board_rotation, ref_from_board_m : (F, 3, 3) and (F, 3) float
    """

    lens: FloatArray
    cam_from_ref_rotation: FloatArray
    cam_from_ref_m: FloatArray
    ref_from_board_rotation: FloatArray
    ref_from_board_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Whole boards seen by cameras, views in the order of frames, then cameras.

    Parameters
    ----------
    corners_xy : (2,) int
    board_m : (N, 3) float
        Row by row, first corner at the origin.
    camera_index, frame_index : (V,) int
    pixels : (V, N, 2) float
    sigma_px : () float
        Standard deviation of the noise per axis.
    size_wh : (2,) int
    truth, start
        What made the pixels, and where the solve begins.
    """

    corners_xy: IntArray
    board_m: FloatArray
    camera_index: IntArray
    frame_index: IntArray
    pixels: FloatArray
    sigma_px: FloatArray
    size_wh: IntArray
    truth: Geometry
    start: Geometry

    def save(self, path: Path) -> None:
        """Write to an .npz file."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in ("truth", "start"):
            geometry = arrays.pop(name)
            arrays |= {f"{name}.{f.name}": getattr(geometry, f.name) for f in fields(Geometry)}
        np.savez(path, **arrays)

    @classmethod
    def load(cls, path: Path) -> "Problem":
        """Read what `save` wrote."""
        with np.load(path) as stored:
            values: dict[str, Any] = dict(stored)
        for name in ("truth", "start"):
            own = {field.name: values.pop(f"{name}.{field.name}") for field in fields(Geometry)}
            values[name] = Geometry(**own)
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """What an engine found and what it cost; a number that was not measured is nan.

    Parameters
    ----------
    cost, polished_cost : px^2
        Half the sum of squares of the residuals where the timed solve stopped, and after solving
        once more from there.
    iterations
        Accepted steps of the timed solve.
    cpu_s, growth_mb
        Of the timed solve: CPU time, and growth of the peak of the resident memory.
    covariance_cpu_s
        CPU time of `covariance`.
    covariance : (P, P) float, or empty
        Of all camera parameters for noise of 1 px: the lenses (9 numbers each), then the poses
        cam_from_ref of all but camera 0 as (omega, tau): x -> exp(omega) R x + t + tau.
    lens, cam_from_ref_rotation, cam_from_ref_m
        As in `Geometry`, after polishing.
    """

    cost: float
    polished_cost: float
    iterations: float
    cpu_s: float
    growth_mb: float
    covariance_cpu_s: float
    covariance: FloatArray
    lens: FloatArray
    cam_from_ref_rotation: FloatArray
    cam_from_ref_m: FloatArray

    def save(self, path: Path) -> None:
        """Write to an .npz file."""
        np.savez(path, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> "Solution":
        """Read what `save` wrote."""
        with np.load(path) as stored:
            values: dict[str, Any] = {k: v if v.ndim else float(v) for k, v in stored.items()}
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """What an engine is asked for.

    Parameters
    ----------
    problem
        To be timed.
    warm_up
        To be solved before it, so that first calls cost nothing.
    solution_path
        Where the solution goes.
    with_details
        Whether covariance and number of iterations are wanted; at mrcal both may take long.
    robust
        Whether corners are given covariances and outliers, and the board may be bent (ours only).
    """

    problem: Problem
    warm_up: Problem
    solution_path: Path
    with_details: bool
    robust: bool


def engine_arguments() -> Task:
    """Read the command line of an engine."""
    parser = argparse.ArgumentParser()
    parser.add_argument("problem", type=Path)
    parser.add_argument("warm_up", type=Path)
    parser.add_argument("solution", type=Path)
    parser.add_argument("--details", action="store_true")
    parser.add_argument("--robust", action="store_true")
    options = parser.parse_args()
    return Task(
        problem=Problem.load(options.problem),
        warm_up=Problem.load(options.warm_up),
        solution_path=options.solution,
        with_details=options.details,
        robust=options.robust,
    )


@dataclass(frozen=True, slots=True)
class Meter:
    """What a call took: CPU seconds of the process, and growth of its peak of memory in MB."""

    cpu_s: float
    growth_mb: float


def measured(work: Callable[[], _T]) -> tuple[_T, Meter]:
    """Call and measure."""
    peak_mb = _peak_mb()
    start = time.process_time()
    result = work()
    cpu_s = time.process_time() - start
    return result, Meter(cpu_s, _peak_mb() - peak_mb)


def _peak_mb() -> float:
    """Peak of the resident memory of this process, 10^6 bytes; nan where there is no /proc.

    getrusage would start from the peak of the parent that spawned the process, which hides growth.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    match = re.search(r"VmHWM:\s+(\d+) kB", status.read_text(encoding="ascii"))
    return int(match[1]) * 1024 / 1e6 if match else float("nan")
