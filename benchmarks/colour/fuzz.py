"""What the chosen models do to any camera colour, possible or not."""

from collections.abc import Iterable

import numpy as np
from benchmarks.colour.ours import auto_model
from benchmarks.colour.problems import ColourProblem
from benchmarks.geometry.tables import Bar, print_table

from calichrome.colour.model import ColourModel
from calichrome.core.arrays import FloatArray

__all__ = ["print_fuzz"]

_BATCH = 20_000
_CUBE = (-0.5, 4.0)  # of white: beyond what any camera stores, noise below black included
_NEAR_BLACK = 1e-6  # of white: the scale of the points that look for an infinite slope
_GREYS = 4096


def print_fuzz(problems: Iterable[ColourProblem], n_points: int) -> list[Bar]:
    """Print faults of the models chosen for some pairs of camera and light, `n_points` each."""
    rows, worst = [], np.zeros(5)
    for problem in problems:
        train = problem.train
        model = auto_model(train.rgb, train.xyz, problem.white_xyz)
        faults = _faults(model, train.rgb, n_points)
        worst = np.maximum(worst, faults)
        rows.append(
            [f"{problem.camera} / {problem.light}", model.MODEL, *(f"{item:g}" for item in faults)]
        )
    head = ["not finite", "largest slope", "the same near black", "hues reversed", "greys fall"]
    print(f"\n{n_points} camera colours for each pair, from {_CUBE[0]:g} to {_CUBE[1]:g} of white")
    print_table(["pair", "model", *head], rows)
    limits = [0.0, 100.0, 100.0, 0.0, 0.0]
    return [
        Bar(f"auto, any colour: {name}", float(value), high=limit)
        for name, value, limit in zip(head, worst, limits, strict=True)
    ]


def _faults(model: ColourModel, train_rgb: FloatArray, n_points: int) -> FloatArray:
    """Values and slopes that are not finite, largest slopes, reversed hues, falling greys."""
    rng = np.random.default_rng(0)
    hull = np.concatenate([train_rgb, np.ones((1, 3)), np.zeros((1, 3))])
    not_finite = reversed_hues = 0
    largest = near_black = 0.0
    for start in range(0, n_points, _BATCH):
        count = min(_BATCH, n_points - start)
        anywhere = rng.uniform(*_CUBE, (count, 3))
        anywhere[: count // 10, rng.integers(3)] = 0.0  # on the faces of the cube
        dark = _NEAR_BLACK * rng.uniform(size=(count // 10, 3))
        slopes, dark_slopes = model.jacobian(anywhere), model.jacobian(dark)
        values = np.concatenate([model.apply(anywhere), model.apply(dark)])
        not_finite += int((~np.isfinite(values)).sum() + (~np.isfinite(slopes)).sum())
        not_finite += int((~np.isfinite(dark_slopes)).sum())
        largest = max(largest, float(np.abs(slopes).max()))
        near_black = max(near_black, float(np.abs(dark_slopes).max()))
        inside = rng.dirichlet(np.full(len(hull), 0.1), count) @ hull
        reversed_hues += int((~(np.linalg.det(model.jacobian(inside)) > 0)).sum())
    ramp = model.apply(np.linspace(0, 4, _GREYS)[:, None] * np.ones(3))
    falling = int((np.diff(ramp, axis=0) <= 0).sum())
    return np.array([not_finite, largest, near_black, reversed_hues, falling], dtype=np.float64)
