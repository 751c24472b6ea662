"""What a method is given, and its errors: CIEDE2000 in Lab of the problem's own light."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from benchmarks.colour.problems import ColourProblem, ColourSet

from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz
from calichrome.core.arrays import FloatArray

__all__ = [
    "EXPOSURES",
    "Apply",
    "Errors",
    "Method",
    "change_over_exposures",
    "errors",
    "leave_one_out",
    "pooled",
    "score",
]

EXPOSURES: Mapping[str, float] = MappingProxyType(
    {f"x{exposure:g}": exposure for exposure in (0.25, 0.5, 2.0, 4.0)}
)


Apply = Callable[[FloatArray], FloatArray]
"""A fitted method: linear camera RGB (n, 3) to XYZ (n, 3)."""

Method = Callable[[FloatArray, FloatArray, FloatArray], Apply]
"""A way of fitting, called with the training colours and the light: (n, 3) linear RGB with 1 for
the perfect diffuser, (n, 3) XYZ with Y = 1 for it, (3,) XYZ of the light's white."""


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Differences of many colours; `str` is mean / 95 %."""

    values: FloatArray

    @property
    def mean(self) -> float:
        """Mean."""
        return float(self.values.mean())

    @property
    def p95(self) -> float:
        """95 % quantile."""
        return float(np.quantile(self.values, 0.95))

    def __str__(self) -> str:
        return f"{self.mean:.2f} / {self.p95:.2f}"


def errors(
    apply: Apply, colours: ColourSet, white_xyz: FloatArray, exposure: float = 1.0
) -> FloatArray:
    """CIEDE2000 of each colour at another exposure, the result scaled back, (n,)."""
    found = apply(exposure * colours.rgb) / exposure
    lab, true_lab = lab_from_xyz(found, white_xyz), lab_from_xyz(colours.xyz, white_xyz)
    return delta_e_2000(lab, true_lab)


def leave_one_out(method: Method, problem: ColourProblem) -> FloatArray:
    """Error of each training patch when the others are fitted, (n,)."""
    train = problem.train
    found = []
    for index in range(len(train.rgb)):
        kept = np.arange(len(train.rgb)) != index
        apply = method(train.rgb[kept], train.xyz[kept], problem.white_xyz)
        one = ColourSet(train.rgb[[index]], train.xyz[[index]])
        found.append(errors(apply, one, problem.white_xyz))
    return np.concatenate(found)


def score(method: Method, problem: ColourProblem, columns: Sequence[str]) -> dict[str, FloatArray]:
    """Fit once and return the errors of each column.

    Columns are `train`, `loo` (each training patch left out), a test set, `x0.25` to `x4` (t190 at
    that exposure) and `white`.
    """
    train, white_xyz = problem.train, problem.white_xyz
    apply = method(train.rgb, train.xyz, white_xyz)
    found = {}
    for name in columns:
        if name == "loo":
            found[name] = leave_one_out(method, problem)
        elif name in EXPOSURES:
            found[name] = errors(apply, problem.tests["t190"], white_xyz, EXPOSURES[name])
        else:
            white = ColourSet(problem.white_rgb[None], white_xyz[None])
            sets = {**problem.tests, "train": train, "white": white}
            found[name] = errors(apply, sets[name], white_xyz)
    return found


def change_over_exposures(scored: Mapping[str, FloatArray]) -> float:
    """Largest change of the mean error on t190 from the exposure of the fit to another."""
    means = [scored[name].mean() for name in EXPOSURES]
    return float(np.abs(np.array(means) - scored["t190"].mean()).max())


def pooled(scored: Iterable[Mapping[str, FloatArray]]) -> dict[str, Errors]:
    """Join the errors of several problems or draws, set by set."""
    parts: dict[str, list[FloatArray]] = {}
    for one in scored:
        for name, values in one.items():
            parts.setdefault(name, []).append(values)
    return {name: Errors(np.concatenate(values)) for name, values in parts.items()}
