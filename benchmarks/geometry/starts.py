"""Blind starts of random problems: python -m benchmarks.geometry.starts --problems 500.

Focal length 0.4-2.5 of the naive guess, 3-30 views, one to four cameras, 2 % gross corners, and
from 8 frames on at least one view whose corners are counted from the wrong end or side, or two
frames that exchanged their names in one camera.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from benchmarks.geometry import ours
from benchmarks.geometry.bound import State, View, cost_of, minimise
from benchmarks.geometry.problems import COUNTS, Problem, counted, random_problem
from benchmarks.geometry.tables import Bar, print_bars, print_table

from calichrome.core.pose import Pose
from calichrome.errors import SolveError

__all__ = ["Verdict", "judge", "main", "reference_start"]

_SAME_COST = 1e-6
_SHORT = 0.1
"""Of chi-square: a state within it is a third of a sigma from its minimum or less. Not 0, since a
solver may follow the noise that it estimates and so its weights to a few percent only."""
_KEPT_SHARE = 0.9  # of the good corners of views that nothing befell: fewer is no solution of them

Kind = Literal["right", "lower", "higher", "short", "contradicts", "few", "gave up"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a blind solve ended.

    Parameters
    ----------
    kind
        "right": the minimum to which it belongs has the cost of the minimum reached from the
        truth, with the same corners, weights and free parameters; "lower" than that; "higher";
        "short": right, but not reached; "contradicts": views of different boards, or
        of one and of its mirror image, were believed to be one; "few": less than 90 % of the good
        corners were believed; "gave up": the solver said that it cannot.
    excess
        Cost of its minimum over that of the reference, less 1.
    is_trusted
        Whether the solver stands by it.
    """

    kind: Kind
    excess: float
    is_trusted: bool

    @property
    def is_right(self) -> bool:
        """Whether the minimum is the right one, or a better one."""
        return self.kind in {"right", "lower"}


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="seed of the first problem")
    options = parser.parse_args(argv)
    kinds: dict[str, Counter[str]] = {}
    n_right = n_silent = 0
    cpu_s = []
    for seed in range(options.first, options.first + options.problems):
        problem = random_problem(seed)
        began = time.process_time()
        verdict = judge(problem)
        cpu_s.append(time.process_time() - began)
        n_right += verdict.is_right
        n_silent += not verdict.is_right and verdict.is_trusted
        kinds.setdefault(_class(problem), Counter())[_label(verdict)] += 1
        if not verdict.is_right:
            print(
                f"{describe(problem)}: {_label(verdict)}, excess {verdict.excess:.3g}", flush=True
            )
        if (seed + 1 - options.first) % 50 == 0:
            print(f"{seed + 1 - options.first} problems, median {np.median(cpu_s):.2f} CPU s")
    labels = sorted({label for counter in kinds.values() for label in counter})
    rows = [
        (name, str(sum(counter.values())), *(str(counter[label]) for label in labels))
        for name, counter in sorted(kinds.items())
    ]
    print_table(("problems", "number", *labels), rows)
    print_bars(
        [
            Bar("share that reaches the right minimum", n_right / options.problems, low=0.995),
            Bar("wrong and trusted", n_silent, high=0),
        ]
    )


def judge(problem: Problem) -> Verdict:
    """Solve blind, and compare with the solve that starts at the truth."""
    target = problem.scene.target
    try:
        solved = ours.solve(problem.recording.dataset, target)
    except SolveError as error:
        print(error)
        return Verdict("gave up", float("nan"), is_trusted=False)
    is_trusted = ours.is_trusted(solved, target)
    start = reference_start(problem, solved)
    if start is None:
        return Verdict("contradicts", float("nan"), is_trusted)
    cost = minimise(solved.problem, solved.state)[1]
    excess = cost / minimise(solved.problem, start)[1] - 1
    kind: Kind = "right" if excess <= _SAME_COST else "higher"
    if excess < -_SAME_COST:
        kind = "lower"
    if cost_of(solved.problem, solved.state) - cost > _SHORT:
        kind = "short"
    if _kept(problem, solved) < _KEPT_SHARE:
        kind = "few"
    return Verdict(kind, excess, is_trusted)


def reference_start(problem: Problem, solved: ours.Solved) -> State | None:
    """Return the truth as a start for what the solver believed; None where this has no truth.

    Held parameters keep the solver's value. A place of the board is the true one of the frame in
    which its pictures were taken, turned if the corners are counted from another end or side: a
    flat board counted in mirror image is the board seen from behind.
    """
    boards: dict[str, Pose] = {}
    lenses, cams = {}, {}
    shown: dict[str, set[tuple[str, str]]] = {}
    for (camera, place), view in solved.problem.views.items():
        origin = problem.origin[camera, place.split("@")[0]]
        shown.setdefault(place, set()).add((origin, _counted(problem, camera, origin, view)))
    for place, candidates in shown.items():
        if len(candidates) > 1:
            return None
        ((origin, count),) = candidates
        boards[place] = problem.scene.ref_from_boards[origin] @ _turn(problem, count)
    free = solved.problem.free[: 15 * len(solved.lenses)].reshape(-1, 15)
    for (camera, lens), own in zip(problem.scene.lenses.items(), free, strict=True):
        kept = solved.lenses[camera].parameters
        lenses[camera] = type(lens).from_parameters(np.where(own[:9], lens.parameters, kept))
        cams[camera] = problem.scene.cams_from_ref[camera]
    return replace(
        solved.state,
        lenses=lenses,
        cams_from_ref=cams,
        ref_from_boards=boards,
        bow=np.zeros(len(solved.state.bow)),
    )


def _counted(problem: Problem, camera: str, origin: str, view: View) -> str:
    """Return from which end and side the corners of a view are counted, a key of `COUNTS`."""
    exact = problem.scene.exact_px(camera, origin)

    def median_px(count: str) -> float:
        ids = counted(problem.scene.target.corners_xy, count)[view.corner_ids]
        return float(np.median(np.linalg.norm(view.pixels - exact[ids], axis=1)))

    return min(COUNTS, key=median_px)


def _turn(problem: Problem, count: str) -> Pose:
    """Return the motion of a flat board that takes each corner to the one counted for it."""
    along_x, along_y = COUNTS[count]
    corners = problem.scene.target.corners_board
    middle = corners.mean(axis=0)
    rotation = np.diag([along_x, along_y, along_x * along_y]).astype(np.float64)
    return Pose(rotation, middle - rotation @ middle)


def _kept(problem: Problem, solved: ours.Solved) -> float:
    """Share of the good corners of untouched views that the solver believed."""
    touched = {(item.camera, frame) for item in problem.mishaps for frame in item.frames}
    n_good = n_kept = 0
    for key, gross in problem.recording.gross.items():
        if key not in touched:
            n_good += int((~gross).sum())
            n_kept += int((~gross & solved.solution.inliers[key]).sum())
    return n_kept / n_good


def _class(problem: Problem) -> str:
    n_cameras = len(problem.scene.lenses)
    name = {1: "one camera", 2: "two cameras"}.get(n_cameras, "three or four cameras")
    if not problem.mishaps:
        return f"{name}, fewer than 8 frames"
    return f"{name}, {problem.mishaps[0].kind}"


def _label(verdict: Verdict) -> str:
    return f"{verdict.kind}, {'trusted' if verdict.is_trusted else 'not trusted'}"


def describe(problem: Problem) -> str:
    """Say in a line what a problem is."""
    scene = problem.scene
    factors = "/".join(f"{lens.fx / scene.size_wh[0]:.2f}" for lens in scene.lenses.values())
    views = "/".join(str(len(frames)) for frames in scene.seen.values())
    mishaps = "; ".join(f"{m.kind} {m.camera} {' '.join(m.frames)}" for m in problem.mishaps)
    return (
        f"seed {problem.seed}: {len(scene.lenses)} cameras, focal {factors}, views {views}, board "
        f"{scene.target.corners_xy}, {mishaps or 'no mishap'}"
    )


if __name__ == "__main__":
    main()
