"""How well three different sensors that look at one print agree on other colours.

The print's table is wrong by the same errors for all of them. The same models are fitted with disc
colours that the cameras share, and to each camera alone on the table.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from benchmarks.colour.problems import ColourProblem, noisy
from benchmarks.colour.scoring import errors
from benchmarks.geometry.tables import Bar, print_table

from calichrome.colorimetry.difference import (
    delta_e_2000,
    lab_from_xyz,
    xyz_from_lab,
    xyz_per_lab,
)
from calichrome.colour.joint import fit_together
from calichrome.colour.model import ColourModel
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.selection import Selection, select_together
from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["print_joint"]

_PRINT_SD = 3.0  # in L*, a* and b*; also what the fits take any print to be good to
_NOISE = 0.002  # of a channel: a disc's mean over the views of a recording
_TEST = "t190"
_CHOSEN = "auto"
_MODELS = (_CHOSEN, "linear-white", "root-polynomial-2-white")

Rig = Mapping[str, ColourProblem]
"""Cameras under one light, by name."""


def print_joint(problems: Sequence[ColourProblem], draws: int) -> list[Bar]:
    """Print agreement and error with shared disc colours and without.

    Parameters
    ----------
    problems
        Cameras by lights; the cameras under one light are a rig.
    draws
        Of print errors and noise, the same for all rows.
    """
    rigs = [
        {one.camera: one for one in problems if one.light == light}
        for light in dict.fromkeys(one.light for one in problems)
    ]
    rows, bars = [], []
    for print_sd, limit in ((0.0, 1.45), (_PRINT_SD, 1.60)):
        found = _measure(rigs, draws, print_sd)
        for model, table in found.items():
            (between, absolute), (between_alone, absolute_alone) = table[True], table[False]
            nearer, farther = between / between_alone, absolute / absolute_alone
            cells = [f"{value:.3f}" for value in (between, between_alone, nearer)]
            cells += [f"{value:.3f}" for value in (absolute, absolute_alone, farther)]
            rows.append([model, f"{print_sd:g}", *cells])
            if model != _CHOSEN:
                continue
            bars.append(Bar(f"joint, print sd {print_sd:g}, between cameras", between, high=limit))
            if print_sd:
                bars.append(Bar("joint, between cameras, shared over alone", nearer, high=0.96))
                bars.append(Bar("joint, absolute, shared over alone", farther, high=1.02))
    print(
        f"\n{len(rigs[0])} sensors in {len(rigs)} lights, {draws} prints and draws of "
        f"{_NOISE:.1%} noise, {_TEST}"
    )
    head = ["model", "print sd", "between, shared", "alone", "ratio", "absolute, shared", "alone"]
    print_table([*head, "ratio"], rows)
    return bars


def _measure(
    rigs: Sequence[Rig], draws: int, print_sd: float
) -> dict[str, dict[bool, tuple[float, float]]]:
    """Mean difference between cameras and from the truth, by model, with sharing and without."""
    parts: dict[str, dict[bool, list[tuple[float, float]]]] = {
        model: {True: [], False: []} for model in _MODELS
    }
    for draw in range(draws):
        for light, rig in enumerate(rigs):
            rng = np.random.default_rng([draw, light])
            nominal, cov = _table(rig, rng.normal(0, print_sd, (len(_first(rig).train.xyz), 3)))
            pairs = {
                camera: _pairs(noisy(problem, _NOISE, rng), nominal, cov)
                for camera, problem in rig.items()
            }
            rows = dict.fromkeys(pairs, np.arange(len(nominal)))
            for model, by_sharing in parts.items():
                names = _names(model, pairs, rows, nominal, cov)
                for share, collected in by_sharing.items():
                    fitted = fit_together(pairs, rows, names, nominal, cov, share=share)
                    collected.append(_differences(rig, fitted.models))
    return {
        model: {
            share: (float(np.mean([a for a, _ in values])), float(np.mean([b for _, b in values])))
            for share, values in by_sharing.items()
        }
        for model, by_sharing in parts.items()
    }


def _first(rig: Rig) -> ColourProblem:
    return next(iter(rig.values()))


def _table(rig: Rig, error_lab: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what the print is taken for, (n, 3), and the covariance that the fits give it."""
    problem = _first(rig)
    lab = lab_from_xyz(problem.train.xyz, problem.white_xyz) + error_lab
    nominal = np.maximum(xyz_from_lab(lab, problem.white_xyz), 0)
    slopes = xyz_per_lab(nominal, problem.white_xyz)
    return nominal, _PRINT_SD**2 * slopes @ np.swapaxes(slopes, 1, 2)


def _pairs(problem: ColourProblem, nominal_xyz: FloatArray, cov: FloatArray) -> ColourPairs:
    rgb = problem.train.rgb
    return ColourPairs.of(
        rgb,
        nominal_xyz,
        white_rgb=problem.white_rgb,
        white_xyz=problem.white_xyz,
        adopted_white=problem.white_xyz,
        rgb_cov=(_NOISE * rgb)[:, :, None] ** 2 * np.eye(3),
        xyz_cov=cov,
    )


def _names(
    model: str,
    pairs: Mapping[str, ColourPairs],
    rows: Mapping[str, IntArray],
    nominal: FloatArray,
    cov: FloatArray,
) -> dict[str, str]:
    if model != _CHOSEN:
        return dict.fromkeys(pairs, model)
    chosen = select_together(pairs, rows, nominal, cov)
    return {camera: own.best.name for camera, own in chosen.items() if isinstance(own, Selection)}


def _differences(rig: Rig, models: Mapping[str, ColourModel]) -> tuple[float, float]:
    """CIEDE2000 on the test colours between two cameras and from the truth, means."""
    seen = {
        camera: lab_from_xyz(models[camera].apply(problem.tests[_TEST].rgb), problem.white_xyz)
        for camera, problem in rig.items()
    }
    between = [delta_e_2000(a, b).mean() for a, b in combinations(seen.values(), 2)]
    absolute = [
        errors(models[camera].apply, problem.tests[_TEST], problem.white_xyz).mean()
        for camera, problem in rig.items()
    ]
    return float(np.mean(between)), float(np.mean(absolute))
