"""Tables of colour methods on measured spectra: python -m benchmarks.colour.run.

Trained on the 24 colours of the ColorChecker, tested on others; mean / 95 % of CIEDE2000 in Lab of
the light, over all colours, cameras and lights of a row.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np
from benchmarks.colour import ours
from benchmarks.colour.fuzz import print_fuzz
from benchmarks.colour.joint import print_joint
from benchmarks.colour.peers import LEAST_SQUARES, PEERS, NotRunError
from benchmarks.colour.problems import ColourProblem, lit_chart, noisy, problems
from benchmarks.colour.scoring import (
    EXPOSURES,
    Errors,
    Method,
    change_over_exposures,
    errors,
    pooled,
    score,
)
from benchmarks.colour.spectra import data_folder
from benchmarks.colour.tone import print_tone
from benchmarks.geometry.tables import NOT_RUN, Bar, print_bars, print_table

from calichrome.core.arrays import FloatArray

__all__ = ["AUTO", "main"]

AUTO = "auto"
"""Of our methods, the one that has to meet the bars."""

_NOISE = 0.01  # of the noisy table: pessimistic, a disc's mean over views is far better
_LIGHT_NOISE = 0.003  # of the table of uneven light
_FALL_OFF = 0.4  # what real lamps and lenses do to a board at worst
_ALLOWED = 0.05  # dE2000 by which a method may be worse than 3x3 least squares on any pair
_NOISE_FREE = ("train", "loo", "t190", "syn1000", "pmc30", *EXPOSURES, "white")
_NOISY = ("train", "t190", "syn1000", "white")

Table = dict[str, FloatArray]


@dataclass(frozen=True)
class _Bench:
    """What a run measures."""

    methods: Mapping[str, Method]
    draws: int
    every_camera: bool
    looks: int
    points: int
    chromacal_python: Path | None

    @cached_property
    def three_cameras(self) -> list[ColourProblem]:
        """Nine pairs of camera and light."""
        return list(problems(every=False))


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=",".join(_PARTS), help=f"of {', '.join(_PARTS)}")
    parser.add_argument("--draws", type=int, default=20, help="of the noise, same for all methods")
    parser.add_argument(
        "--looks", type=int, default=5, help="random curves and webcams of part tone"
    )
    parser.add_argument("--points", type=int, default=1_000_000, help="of part fuzz, each pair")
    parser.add_argument("--cameras", choices=("3", "all"), default="all", help="of part pairs")
    parser.add_argument("--methods", help="those whose names hold one of these words, and 3x3")
    parser.add_argument(
        "--chromacal-python", type=Path, help="interpreter that can import chromacal"
    )
    options = parser.parse_args(argv)
    wanted = options.only.split(",")
    if unknown := set(wanted) - set(_PARTS):
        parser.error(f"--only: {', '.join(sorted(unknown))}: choose from {', '.join(_PARTS)}")
    if not data_folder().is_dir():
        parser.error(f"{data_folder()} holds no test data: set CALICHROME_DATA")
    methods = {**PEERS, **ours.METHODS}
    if options.methods:
        words = options.methods.split(",")
        methods = {
            name: method
            for name, method in methods.items()
            if name == LEAST_SQUARES or any(word in name for word in words)
        }
    every = options.cameras == "all"
    bench = _Bench(
        methods=methods,
        draws=options.draws,
        every_camera=every,
        looks=options.looks,
        points=options.points,
        chromacal_python=options.chromacal_python,
    )
    bars = [bar for name in wanted for bar in _PARTS[name](bench)]
    if bars:
        print_bars(bars)


def _print_noise_free(bench: _Bench) -> list[Bar]:
    """Nine pairs, exact training colours."""
    rows, bars = [], []
    for name, method in bench.methods.items():
        try:
            scored = [score(method, problem, _NOISE_FREE) for problem in bench.three_cameras]
        except NotRunError:
            rows.append(_not_run(name, len(_NOISE_FREE) + 1))
            continue
        table = pooled(scored)
        change = max(change_over_exposures(one) for one in scored)
        rows.append([name, *(str(table[column]) for column in _NOISE_FREE), f"{change:.2f}"])
        if name == AUTO:
            bars += [
                Bar("auto, noise-free, t190", table["t190"].mean, high=1.07),
                Bar("auto, error of white, worst pair", table["white"].values.max(), high=0.3),
                Bar("auto, change over exposures, worst pair", change, high=0.05),
            ]
    _print("noise-free", bench, ["method", *_NOISE_FREE, "largest change"], rows)
    return bars


def _print_noisy(bench: _Bench) -> list[Bar]:
    """Nine pairs; the standard error is that of the mean over pairs, from draw to draw."""
    rows, bars = [], []
    reference = np.empty(0)
    for name, method in bench.methods.items():
        try:
            draws = [
                pooled(
                    score(
                        method, noisy(problem, _NOISE, np.random.default_rng([draw, pair])), _NOISY
                    )
                    for pair, problem in enumerate(bench.three_cameras)
                )
                for draw in range(bench.draws)
            ]
        except NotRunError:
            rows.append(_not_run(name, len(_NOISY) + 2))
            continue
        table = pooled({key: one.values for key, one in draw.items()} for draw in draws)
        means = np.array([draw["t190"].mean for draw in draws])
        if name == LEAST_SQUARES:
            reference = means
        ratio = means.mean() / reference.mean()
        sigma = _standard_error(means)
        cells = [*(str(table[column]) for column in _NOISY), f"{sigma:.3f}", f"{ratio:.3f}"]
        rows.append([name, *cells])
        if name == AUTO:
            bars += [
                Bar("auto, 1 % noise, t190", float(means.mean()), high=1.50, sigma=sigma),
                Bar("auto, 1 % noise, over 3x3 on the same draws", float(ratio), high=0.80),
            ]
    head = ["method", *_NOISY, "standard error of t190", "t190 over 3x3"]
    _print(f"{_NOISE:.0%} noise, {bench.draws} draws", bench, head, rows)
    return bars


def _print_light(bench: _Bench) -> list[Bar]:
    """Nine pairs; t190 in even light after a fit to an unevenly lit chart."""
    rows, bars = [], []
    for name, method in bench.methods.items():
        try:
            even, even_white = _lit_errors(bench, method, 0.0)
            naive, local_white = _lit_errors(bench, method, _FALL_OFF)
        except NotRunError:
            rows.append(_not_run(name, 5))
            continue
        cost = local_white.mean - even.mean
        found = [str(one) for one in (even, even_white, naive, local_white)]
        rows.append([name, *found, f"{cost:+.3f}"])
        if name == AUTO:
            bars.append(Bar("auto, cost of 40 % fall-off after local white", cost, high=0.05))
    head = ["method", "even", "even, local white", "40 %", "40 %, local white", "cost"]
    title = f"light that falls off by {_FALL_OFF:.0%}, {_LIGHT_NOISE:.1%} noise"
    _print(f"{title}, {_light_draws(bench)} draws", bench, head, rows)
    return bars


def _light_draws(bench: _Bench) -> int:
    """Return a quarter of the draws: of four fits each, whose differences settle soon."""
    return max(1, bench.draws // 4)


def _lit_errors(bench: _Bench, method: Method, fall_off: float) -> tuple[Errors, Errors]:
    """Errors on t190 of the fit to the patches as read, and divided by the white beside them."""
    parts: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for draw in range(_light_draws(bench)):
        for pair, problem in enumerate(bench.three_cameras):
            rng = np.random.default_rng([draw, pair])
            chart = lit_chart(problem, fall_off, _LIGHT_NOISE, rng)
            for part, rgb in zip(parts, (chart.rgb, chart.even_rgb), strict=True):
                apply = method(rgb, problem.train.xyz, problem.white_xyz)
                part.append(errors(apply, problem.tests["t190"], problem.white_xyz))
    as_read, divided = (Errors(np.concatenate(part)) for part in parts)
    return as_read, divided


def _print_pairs(bench: _Bench) -> list[Bar]:
    """Print each method against 3x3 least squares, pair by pair, noise-free."""
    chosen = list(problems(every=bench.every_camera))
    names = [f"{problem.camera}, {problem.light}" for problem in chosen]
    rows, bars, above = [], [], []
    reference = np.empty(0)
    for name, method in bench.methods.items():
        try:
            means = np.array([score(method, one, ("t190",))["t190"].mean() for one in chosen])
        except NotRunError:
            rows.append(_not_run(name, 5))
            continue
        if name == LEAST_SQUARES:
            reference = means
        excess = means - reference
        worst = int(excess.argmax())
        rows.append(
            [
                name,
                f"{means.mean():.3f}",
                f"{excess.mean():+.3f}",
                f"{excess[worst]:+.3f}",
                names[worst] if excess[worst] > 0 else "",
                f"{(excess > _ALLOWED).sum()}",
            ]
        )
        if name == AUTO:
            bars.append(Bar("auto - 3x3, worst pair", float(excess[worst]), high=_ALLOWED))
            above = [
                [
                    names[index],
                    f"{reference[index]:.3f}",
                    f"{means[index]:.3f}",
                    f"{excess[index]:+.3f}",
                ]
                for index in np.argsort(-excess)
                if excess[index] > _ALLOWED
            ]
    head = ["method", "t190", "minus 3x3", "worst", "worst pair", f"pairs above {_ALLOWED:g}"]
    print(f"\n{len({one.camera for one in chosen})} cameras, {len(chosen)} pairs, noise-free")
    print_table(head, rows)
    if above:
        print_table(["pair", "3x3", AUTO, "difference"], above)
    return bars


def _print_tone(bench: _Bench) -> list[Bar]:
    return print_tone(ours.TONE_METHODS, bench.chromacal_python, bench.looks)


def _print_fuzz(bench: _Bench) -> list[Bar]:
    return print_fuzz(bench.three_cameras, bench.points)


def _print_joint(bench: _Bench) -> list[Bar]:
    return print_joint(bench.three_cameras, bench.draws)


_PARTS: Mapping[str, Callable[[_Bench], list[Bar]]] = MappingProxyType(
    {
        "noise-free": _print_noise_free,
        "noise": _print_noisy,
        "light": _print_light,
        "pairs": _print_pairs,
        "fuzz": _print_fuzz,
        "tone": _print_tone,
        "joint": _print_joint,
    }
)


def _print(title: str, bench: _Bench, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(f"\n{len(bench.three_cameras)} pairs of camera and light, {title}")
    print_table(head, rows)


def _not_run(name: str, n_cells: int) -> list[str]:
    return [name, NOT_RUN, *[""] * (n_cells - 1)]


def _standard_error(means: FloatArray) -> float:
    return float(means.std(ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")


if __name__ == "__main__":
    main()
