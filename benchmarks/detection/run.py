"""The table of detectors: python -m benchmarks.detection.run --scenes 100.

All detectors run in turn on every scene, one thread, CPU time of the process. See `scoring` for
what counts as found.
"""

import argparse
import hashlib
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache as remembered
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from benchmarks.detection.bound import corner_cells, cramer_rao, oracle
from benchmarks.detection.peers import DETECTORS
from benchmarks.detection.scenes import BoardKind, Scene, noisy, random_scene, render
from benchmarks.detection.scoring import Score, compare, ratios, summary
from benchmarks.detection.surfaces import board_target

from calichrome.core.arrays import FloatArray, UInt8Array

__all__ = ["Material", "main", "material"]

_ORACLE = "one-step oracle (knows the truth)"


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A scene with its pictures.

    Parameters
    ----------
    pictures
        With noise, 8 bit, by kind of board.
    bound_px2 : (N, 2, 2) float
    oracle_px : (N, 2) float
        On the plain board.
    """

    scene: Scene
    pictures: dict[BoardKind, UInt8Array]
    bound_px2: FloatArray
    oracle_px: FloatArray


def material(seed: int, cache: Path | None) -> Material:
    """Render a scene, or read what an earlier run left in the folder `cache`."""
    scene = random_scene(seed)
    kinds: tuple[BoardKind, ...] = get_args(BoardKind)
    path = None if cache is None else cache / f"scene{seed:05d}.npz"
    if path is not None and path.exists():
        with np.load(path) as stored:
            if str(stored["sources"]) == _sources():
                pictures = {kind: stored[kind] for kind in kinds}
                return Material(scene, pictures, stored["bound_px2"], stored["oracle_px"])
    clean = {kind: render(scene, kind) for kind in kinds}
    pictures = {kind: noisy(clean[kind], scene, scene.rng(10 + i)) for i, kind in enumerate(kinds)}
    cells = corner_cells(scene)
    bound_px2 = cramer_rao(scene, cells)
    oracle_px = oracle(scene, cells, clean["plain"], pictures["plain"])
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, sources=_sources(), bound_px2=bound_px2, oracle_px=oracle_px, **pictures)
    return Material(scene, pictures, bound_px2, oracle_px)


@remembered
def _sources() -> str:
    """Digest of the modules that make a scene: another digest, another picture."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for name in ("renderer", "surfaces", "backgrounds", "scenes", "bound"):
        digest.update((here / f"{name}.py").read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class _Outcome:
    score: Score
    ratios: FloatArray
    cpu_ms_per_mp: float


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--cache", type=Path, help="folder for rendered scenes")
    parser.add_argument("--only", help="run only detectors whose name contains this")
    parser.add_argument("--verbose", action="store_true", help="name the scenes that went wrong")
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    names = [name for name in DETECTORS if options.only is None or options.only in name]
    outcomes: dict[tuple[BoardKind, str], list[_Outcome]] = defaultdict(list)
    for seed in range(options.first, options.first + options.scenes):
        item = material(seed, options.cache)
        for kind in ("disc", "plain"):
            for name in names:
                outcome = _run(name, kind, item)
                if outcome is None:
                    continue
                outcomes[kind, name].append(outcome)
                if options.verbose:
                    _complain(name, kind, item, outcome)
        outcomes["plain", _ORACLE].append(_oracle_outcome(item))
    titles: dict[BoardKind, str] = {"disc": "Board with 24 discs", "plain": "Plain board"}
    for kind, title in titles.items():
        print(f"\n{title}, {options.scenes} scenes")
        _print_table([*names, *([_ORACLE] if kind == "plain" else [])], kind, outcomes)


def _run(name: str, kind: BoardKind, item: Material) -> _Outcome | None:
    """Run one detector on one picture; None if it has no business there."""
    detector = DETECTORS[name]
    scene = item.scene
    if detector.find is None or (detector.own_board and kind == "plain"):
        return None
    picture = item.pictures["charuco" if detector.own_board else kind]
    target = scene.target if kind == "disc" else scene.plain_target
    start = time.process_time()
    detection = detector.find(picture, target)
    cpu_s = time.process_time() - start
    score = compare(detector, detection, scene.corners_px, scene.spacing_px)
    return _Outcome(score, ratios(score, item.bound_px2), 1e3 * cpu_s / scene.megapixels)


def _oracle_outcome(item: Material) -> _Outcome:
    errors = item.oracle_px - item.scene.corners_px
    score = Score(np.arange(len(errors)), errors, None, 0, 0, is_whole=True)
    return _Outcome(score, ratios(score, item.bound_px2), float("nan"))


def _complain(name: str, kind: BoardKind, item: Material, outcome: _Outcome) -> None:
    score, scene = outcome.score, item.scene
    worst = float(outcome.ratios.max(initial=0))
    if name == "calichrome" and (not score.is_whole or score.n_wrong or worst > 5):
        print(
            f"seed {scene.seed} {kind}: {len(score.ids)} found, {score.n_wrong} wrong, worst ratio "
            f"{worst:.1f}; {scene.size_wh}, spacing {scene.spacing_px.min():.0f} px, tilt "
            f"{np.degrees(scene.tilt_rad):.0f} deg, psf {scene.psf_sigma_px:.1f} px, noise "
            f"{scene.noise_dn:.1f} DN"
        )


def _print_table(
    names: Sequence[str],
    kind: BoardKind,
    outcomes: dict[tuple[BoardKind, str], list[_Outcome]],
) -> None:
    print(
        "| detector | whole board | corners found | median px | p95 px | ratio median | "
        "ratio RMS | ratio p95 | wrong labels | false points | CPU ms per MP |"
    )
    print("|" + " --- |" * 11)
    for name in names:
        of_name = outcomes.get((kind, name))
        if of_name:
            print(f"| {name} | {' | '.join(_row(of_name))} |")
        elif name in DETECTORS and (kind == "disc" or not DETECTORS[name].own_board):
            print(f"| {name} | not run |" + " |" * 9)


def _row(outcomes: Sequence[_Outcome]) -> list[str]:
    errors = np.concatenate([np.linalg.norm(o.score.errors_px, axis=1) for o in outcomes])
    whole = np.mean([outcome.score.is_whole for outcome in outcomes])
    found = len(errors) / (board_target().n_corners * len(outcomes))
    times = np.median([outcome.cpu_ms_per_mp for outcome in outcomes])
    counts = [
        f"{sum(outcome.score.n_wrong for outcome in outcomes)}",
        f"{np.mean([outcome.score.n_false for outcome in outcomes]):.1f}",
        "" if np.isnan(times) else f"{times:.1f}",
    ]
    if not len(errors):
        return [f"{whole:.2f}", f"{found:.3f}", *[""] * 5, *counts]
    return [
        f"{whole:.2f}",
        f"{found:.3f}",
        f"{np.median(errors):.4f}",
        f"{np.quantile(errors, 0.95):.4f}",
        *summary([outcome.ratios for outcome in outcomes]),
        *counts,
    ]


if __name__ == "__main__":
    main()
