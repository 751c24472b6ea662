"""Table of the joint solve: calichrome and mrcal on the same problems, from the same start.

`python -m benchmarks.solver.run --mrcal-python PATH`. Runs are interleaved, each in a process of
its own; figures are medians over the runs.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks.solver.exchange import Problem, Solution
from benchmarks.solver.problems import SPECS, Spec, make_problem
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray

__all__ = ["error_ratio", "main"]

_PROJECT = Path(__file__).parents[2]
_SCALING_FRAMES = (75, 150, 300, 600, 1200)
_MRCAL_BYTES = 1000
"""Per residual: 900 are what mrcal 2.5.2 grew by at `huge`."""


@dataclass(frozen=True, slots=True)
class _Bench:
    """Folder of the files of this run, and the interpreters."""

    folder: Path
    mrcal_python: Path | None
    seed: int

    def write(self, name: str, spec: Spec) -> Problem:
        problem = make_problem(spec, self.seed)
        problem.save(self.folder / f"{name}.npz")
        return problem

    def ours(self, name: str, *flags: str) -> Solution | None:
        return self._run(Path(sys.executable), "ours", name, flags)

    def mrcal(self, name: str, *flags: str) -> Solution | None:
        if self.mrcal_python is None:
            return None
        return self._run(self.mrcal_python, "mrcal_peer", name, flags)

    def _run(self, python: Path, module: str, name: str, flags: Sequence[str]) -> Solution | None:
        answer = self.folder / "solution.npz"
        files = [self.folder / f"{name}.npz", self.folder / "warm-up.npz", answer]
        command = [str(python), "-m", f"benchmarks.solver.{module}", *map(str, files), *flags]
        done = subprocess.run(  # noqa: S603 (our own modules)
            command, cwd=_PROJECT, capture_output=True, text=True, check=False
        )
        if done.returncode:
            print(f"{name}, {module}: {done.stderr.strip()[-500:]}", file=sys.stderr)
            return None
        return Solution.load(answer)


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parts = [*SPECS, "scaling", "robust"]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=",".join(parts), help=f"of {', '.join(parts)}")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mrcal-python", type=Path, help="interpreter that can import mrcal")
    parser.add_argument(
        "--covariance", action="store_true", help="mrcal's covariance and iterations at huge, too"
    )
    options = parser.parse_args(argv)
    wanted = options.only.split(",")
    if unknown := set(wanted) - set(parts):
        parser.error(f"--only: {', '.join(sorted(unknown))}: choose from {', '.join(parts)}")
    with tempfile.TemporaryDirectory() as folder:
        bench = _Bench(Path(folder), options.mrcal_python, options.seed)
        bench.write("warm-up", SPECS["small"])
        _print_header(
            "problem | engine | CPU s | ratio | iterations | memory growth MB | "
            "cost relative difference | errors / sigmas | covariance CPU s | "
            "largest relative sigma difference"
        )
        for name in SPECS:
            if name in wanted:
                _print_problem(bench, name, options.runs, with_all=options.covariance)
        if "scaling" in wanted:
            _print_scaling(bench, options.runs)
        if "robust" in wanted:
            _print_robust(bench, [name for name in SPECS if name in wanted], options.runs)


def error_ratio(problem: Problem, solution: Solution) -> float:
    """Root mean square of the errors of all camera parameters over their predicted sigmas."""
    truth = problem.truth
    turn = solution.cam_from_ref_rotation @ truth.cam_from_ref_rotation.transpose(0, 2, 1)
    poses = np.hstack(
        [Rotation.from_matrix(turn).as_rotvec(), solution.cam_from_ref_m - truth.cam_from_ref_m]
    )
    errors = np.concatenate([(solution.lens - truth.lens).ravel(), poses[1:].ravel()])
    ratios = errors / (problem.sigma_px * _sigmas(solution))
    return float(np.sqrt(np.mean(ratios**2)))


def _sigmas(solution: Solution) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(solution.covariance)))


def _print_problem(bench: _Bench, name: str, runs: int, *, with_all: bool) -> None:
    """Run both engines in turn and print a row for each."""
    problem = bench.write(name, SPECS[name])
    details = ("--details",) if name != "huge" or with_all else ()
    fits = _available_bytes() > _MRCAL_BYTES * problem.pixels.size
    if bench.mrcal_python is not None and not fits:
        print(f"{name}: not enough free memory for mrcal", file=sys.stderr)
    solutions: dict[str, list[Solution]] = defaultdict(list)
    for _ in range(runs):
        for engine, solution in (
            ("mrcal", bench.mrcal(name, *details) if fits else None),
            ("calichrome", bench.ours(name, "--details")),
        ):
            if solution is not None:
                solutions[engine].append(solution)
    peer = solutions["mrcal"][0] if solutions["mrcal"] else None
    for engine in ("mrcal", "calichrome"):
        if not solutions[engine]:
            _print_row([name, engine, "not run", *[""] * 7])
            continue
        first = solutions[engine][0]
        cpu_s = _median(solutions[engine], "cpu_s")
        ratio, cost, sigma = np.nan, np.nan, np.nan
        if peer is not None:
            ratio = cpu_s / _median(solutions["mrcal"], "cpu_s")
            cost = first.cost / peer.polished_cost - 1
        if peer is not None and peer.covariance.size:
            sigma = float(np.abs(_sigmas(first) / _sigmas(peer) - 1).max())
        cells = [
            f"{cpu_s:.4f}",
            f"{ratio:.3f}",
            f"{_median(solutions[engine], 'iterations'):.0f}",
            f"{_median(solutions[engine], 'growth_mb'):.0f}",
            f"{cost:.1e}",
            f"{error_ratio(problem, first) if first.covariance.size else np.nan:.3f}",
            f"{_median(solutions[engine], 'covariance_cpu_s'):.4f}",
            f"{sigma:.1e}",
        ]
        _print_row([name, engine, *("" if cell == "nan" else cell for cell in cells)])


def _print_scaling(bench: _Bench, runs: int) -> None:
    """Print CPU time against frames, the rig's cameras being kept, and the fitted exponent."""
    times: dict[int, float] = {}
    for n_frames in _SCALING_FRAMES:
        bench.write("scaling", SPECS["rig"].with_frames(n_frames))
        solutions = [s for s in (bench.ours("scaling") for _ in range(runs)) if s is not None]
        if solutions:
            times[n_frames] = _median(solutions, "cpu_s")
    _print_header("frames of the rig | CPU s")
    for n_frames in _SCALING_FRAMES:
        _print_row([str(n_frames), f"{times[n_frames]:.4f}" if n_frames in times else "not run"])
    if len(times) > 1:
        exponent = np.polyfit(np.log(list(times)), np.log(list(times.values())), 1)[0]
        print(f"\nCPU time grows as frames^{exponent:.2f}")


def _print_robust(bench: _Bench, names: Sequence[str], runs: int) -> None:
    """Print what outliers, bow and a covariance for each corner cost."""
    _print_header(
        "problem | plain CPU s | robust + bow + covariances + final least squares CPU s | ratio | "
        "memory growth MB"
    )
    for name in names or ["rig"]:
        bench.write(name, SPECS[name])
        pairs = [(bench.ours(name), bench.ours(name, "--robust")) for _ in range(runs)]
        plain = [solution for solution, _ in pairs if solution is not None]
        robust = [solution for _, solution in pairs if solution is not None]
        if not plain or not robust:
            _print_row([name, "not run", "", "", ""])
            continue
        before, after = _median(plain, "cpu_s"), _median(robust, "cpu_s")
        growth_mb = _median(robust, "growth_mb")
        _print_row(
            [name, f"{before:.4f}", f"{after:.4f}", f"{after / before:.2f}", f"{growth_mb:.0f}"]
        )


def _median(solutions: Sequence[Solution], field: str) -> float:
    return float(statistics.median(getattr(solution, field) for solution in solutions))


def _available_bytes() -> float:
    """Free memory; unlimited where the system does not tell."""
    info = Path("/proc/meminfo")
    if not info.exists():
        return float("inf")
    line = next(row for row in info.read_text(encoding="ascii").splitlines() if "Available" in row)
    return 1024 * float(line.split()[1])


def _print_header(titles: str) -> None:
    print(f"\n| {titles} |\n|{' --- |' * (titles.count('|') + 1)}")


def _print_row(cells: Sequence[str]) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
