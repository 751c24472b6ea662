"""The pictures of docs/colour.md: python -m benchmarks.colour.pictures [NAME...].

Everything in them is rendered or computed here, from measured spectra and our own scenes.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from benchmarks.colour.pictures_rendered import falloff, light
from benchmarks.colour.problems import ColourProblem, noisy, problems
from benchmarks.colour.scoring import errors
from benchmarks.colour.views import save
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.description import metric
from calichrome.colorimetry.difference import (
    delta_e_2000,
    lab_from_xyz,
    xyz_from_lab,
    xyz_per_lab,
)
from calichrome.colorimetry.encoding import encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.colour.families import fit_model, leave_one_out
from calichrome.colour.model import TermModel
from calichrome.colour.models import MODELS
from calichrome.colour.models.root_polynomial import RootPolynomial2, RootPolynomial2White
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.uncertainty import bound_95, model_covariance
from calichrome.core.arrays import FloatArray

__all__ = ["FIGURES", "main"]

_FOLDER = Path(__file__).resolve().parents[2] / "docs" / "figures"
_NOISE, _PRINT_SD, _N_REPEATED = 0.01, 0.5, 200


def _shown(xyz: FloatArray) -> FloatArray:
    """XYZ under D65 as a screen stores it, 0..1."""
    return encode(np.clip(xyz @ RGB_FROM_XYZ["srgb"].T, 0, 1), "srgb")


def differences() -> Figure:
    """Draw pairs of colours, further and further apart."""
    sizes = (0.5, 1.0, 2.0, 4.0, 8.0)
    colours = {  # Lab, well inside what screens show
        "grey": (50.0, 0.0, 0.0),
        "skin": (66.0, 18.0, 18.0),
        "leaf": (43.0, -13.0, 22.0),
        "blue": (45.0, 5.0, -35.0),
    }
    rng = np.random.default_rng(0)
    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes = figure.subplots()
    for row, lab in enumerate(np.array(list(colours.values()))):
        for column, size in enumerate(sizes):
            other = lab + _step_of(lab, rng.normal(size=3), size)
            for side, half in enumerate((lab, other)):
                colour = tuple(_shown(xyz_from_lab(half)))
                left = 1.15 * column + 0.5 * side
                # the right half lies on the left colour: a seam would show what is no difference
                axes.add_patch(_box(left, -1.1 * row, 1.0 - 0.5 * side, 1.0, colour))
    axes.set_xlim(0, 1.15 * len(sizes))
    axes.set_ylim(-1.1 * (len(colours) - 1), 1.0)
    axes.set_xticks(
        [1.15 * column + 0.5 for column in range(len(sizes))], [f"{s:g}" for s in sizes]
    )
    axes.set_yticks([0.5 - 1.1 * row for row in range(len(colours))], list(colours))
    axes.set_xlabel("ΔE2000 between the left and the right half")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return figure


def _box(x: float, y: float, width: float, height: float, colour: tuple[float, ...]) -> Rectangle:
    return Rectangle((x, y), width, height, facecolor=colour, linewidth=0)


def _step_of(lab: FloatArray, direction: FloatArray, size: float) -> FloatArray:
    """Step along a direction to a difference, by bisection."""
    low, high = 0.0, 100.0
    unit = direction / np.linalg.norm(direction)
    for _ in range(50):
        middle = (low + high) / 2
        if delta_e_2000(lab, lab + middle * unit) < size:
            low = middle
        else:
            high = middle
    return np.asarray(low * unit)


def _pairs(problem: ColourProblem) -> ColourPairs:
    return ColourPairs.of(
        problem.train.rgb, problem.train.xyz, white_rgb=np.ones(3),
        adopted_white=problem.white_xyz,
    )  # fmt: skip


def models() -> Figure:
    """Draw each model's errors: what it was fitted to, each colour left out, other surfaces."""
    rng = np.random.default_rng(0)
    names = [name for name in MODELS if name != "white-balance"]
    rows: dict[str, list[list[float]]] = {name: [] for name in names}
    for exact in problems(every=False):
        problem = noisy(exact, 0.01, rng)
        pairs = _pairs(problem)
        for name in names:
            model = fit_model(name, pairs)
            rows[name].append(
                [
                    float(pairs.difference(model.apply(pairs.rgb)).mean()),
                    float(pairs.difference(leave_one_out(name, pairs)).mean()),
                    float(
                        errors(model.apply, problem.tests["munsell1269"], problem.white_xyz).mean()
                    ),
                ]
            )
    means = {name: np.mean(values, axis=0) for name, values in rows.items()}
    order = sorted(names, key=lambda name: -means[name][0])
    figure = Figure(figsize=(8, 5.2), layout="constrained")
    axes = figure.subplots()
    print("\nmodels, 1 % noise, one draw, 9 pairs: fitted, left out, Munsell")
    for row, name in enumerate(order):
        fitted, left_out, other = means[name]
        print(f"{name:24} {fitted:6.2f} {left_out:6.2f} {other:6.2f}")
        axes.plot([max(fitted, 0.1), max(left_out, other)], [row, row], color="0.85", zorder=0)
        for value, marker, colour, label in (
            (fitted, "o", "tab:orange", "the 24 colours it was fitted to"),
            (left_out, "D", "tab:blue", "each of the 24 left out of the fit"),
            (other, "s", "black", "1269 other surfaces"),
        ):
            axes.plot(
                max(value, 0.1), row, marker, color=colour, markersize=5,
                label=label if row == 0 else None,
            )  # fmt: skip
    axes.set_yticks(range(len(order)), order, fontsize=8)
    axes.set_xscale("log")
    axes.set_xticks([0.1, 0.5, 1, 2, 5, 10, 20], ["0", "0.5", "1", "2", "5", "10", "20"])
    axes.minorticks_off()
    axes.set_xlabel("mean ΔE2000")
    axes.grid(visible=True, axis="x", color="0.93")
    axes.legend(fontsize=8, loc="lower right")
    return figure


def stability() -> Figure:
    """Draw the card corrected at five exposures and scaled back, by three models that fit well."""
    problem = next(iter(problems(every=False)))
    pairs = _pairs(problem)
    exposures = (0.25, 0.5, 1.0, 2.0, 4.0)
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    names = ("cheung-20", "thin-plate-exact", "root-polynomial-2-white")
    print("\nstability: mean dE2000 at x0.25, 0.5, 1, 2, 4")
    for axes, name in zip(figure.subplots(3, 1), names, strict=True):
        model = fit_model(name, pairs)
        labels = []
        for row, exposure in enumerate(exposures):
            xyz = model.apply(exposure * pairs.rgb) / exposure
            shown = _shown(xyz / problem.white_xyz * D65)
            for column, colour in enumerate(shown):
                axes.add_patch(_box(column, -row, 1, 0.92, tuple(colour)))
            labels.append(f"x{exposure:g}:  {pairs.difference(xyz).mean():.1f}")
        print(name, labels)
        axes.set_xlim(0, len(pairs))
        axes.set_ylim(1 - len(exposures), 1)
        axes.set_yticks([0.5 - row for row in range(len(exposures))], labels, fontsize=8)
        axes.set_xticks([])
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_title(name, fontsize=10, loc="left")
    return figure


def tone() -> Figure:
    """Draw what light at many levels tells of a tone curve, and what only known greys tell."""
    stored = np.linspace(0.002, 1, 400)
    true = linearise(stored, "srgb")
    bent = linearise(stored, "srgb") * (1 + 0.5 * np.sin(2.2 * np.pi * stored) * (1 - stored))
    curves = {
        "true": (true, "black"),
        "its power 1.25": (true**1.25, "tab:orange"),
        "its power 0.8": (true**0.8, "tab:green"),
        "another shape": (bent / bent[-1], "tab:red"),
    }
    shares = np.array([0.59, 0.36, 0.19, 0.09])  # greys of the ColorChecker over white
    levels = np.geomspace(0.25, 0.9, 7)
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for name, (curve, colour) in curves.items():
        left.plot(stored, curve, color=colour, label=name)

        def read(linear: FloatArray, curve: FloatArray = curve) -> FloatArray:
            return np.interp(encode(linear, "srgb"), stored, curve)

        ratios = read(levels[:, None] * shares) / read(levels)[:, None]
        middle.plot(levels, ratios, color=colour, marker=".")
        right.loglog(shares, ratios[-2], color=colour, marker=".")
    left.set_xlabel("stored")
    left.set_ylabel("light")
    left.legend(fontsize=8)
    middle.set_xlabel("level of the light")
    middle.set_ylabel("grey disc over the white beside it")
    middle.set_yscale("log")
    for axis in (middle.yaxis, right.xaxis, right.yaxis):
        axis.set_major_locator(FixedLocator([0.05, 0.1, 0.2, 0.5]))
        axis.set_major_formatter("{x:g}")
    right.set_xlabel("what is printed")
    right.set_ylabel("grey disc over white")
    for axes, title in (
        (left, "four curves"),
        (middle, "shape: level must not matter"),
        (right, "power: greys must come out right"),
    ):
        axes.set_title(title, fontsize=10)
        axes.minorticks_off()
        axes.grid(visible=True, color="0.93")
    return figure


def uncertainty() -> Figure:
    """Draw what is stated against what repeating the calibration shows, colour by colour."""
    problem = next(iter(problems(every=False)))
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    print("\nuncertainty: share of the repetitions within the bound that each states itself")
    for axes, model in zip(
        figure.subplots(1, 2), (RootPolynomial2, RootPolynomial2White), strict=True
    ):
        seen, stated, inside, shown = _repeated(problem, model)
        print(f"{model.MODEL}: {100 * inside:.1f} %")
        axes.scatter(seen, stated, c=shown, s=18, edgecolors="0.6", linewidths=0.3)
        top = 1.05 * float(max(seen.max(), stated.max()))
        axes.plot([0, top], [0, top], color="0.6", linewidth=1)
        axes.set_title(f"{model.MODEL}: {100 * inside:.0f} % within", fontsize=10)
        axes.set_xlabel(f"ΔE2000 that 95 % of {_N_REPEATED} repetitions stay below")
        axes.grid(visible=True, color="0.93")
    figure.axes[0].set_ylabel("as stated, median")
    return figure


def _repeated(
    problem: ColourProblem, model: type[TermModel]
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Calibrate with fresh noise and fresh prints.

    Returns
    -------
    seen, stated : (n,) float
        95 % of the differences from the exact result, and the median of what is stated.
    inside
        Share of all differences that are within the bound stated by the same repetition.
    shown : (n, 3) float
        The colours, as a screen stores them.
    """
    train, white = problem.train, problem.white_xyz
    rgb_cov = (_NOISE * train.rgb)[:, :, None] ** 2 * np.eye(3)
    xyz_cov = np.asarray(np.linalg.inv(metric(train.xyz, "lab2000", white)) * _PRINT_SD**2)
    some = problem.tests["munsell1269"].rgb[::10]

    def fitted(rgb: FloatArray, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        pairs = ColourPairs.of(
            rgb, xyz, white_rgb=np.ones(3), adopted_white=white, rgb_cov=rgb_cov, xyz_cov=xyz_cov
        )
        corrected = fit_model(model.MODEL, pairs).apply(some)
        return corrected, bound_95(corrected, model_covariance(model.MODEL, pairs, some), white)

    exact, _ = fitted(train.rgb, train.xyz)
    roots = np.linalg.cholesky(xyz_cov)
    rng = np.random.default_rng(0)
    away, bounds = [], []
    for _ in range(_N_REPEATED):
        rgb = train.rgb * (1 + rng.normal(0, _NOISE, train.rgb.shape))
        xyz = train.xyz + np.einsum("nij,nj->ni", roots, rng.normal(size=train.xyz.shape))
        corrected, bound = fitted(rgb, xyz)
        away.append(delta_e_2000(lab_from_xyz(corrected, white), lab_from_xyz(exact, white)))
        bounds.append(bound)
    inside = float(np.mean(np.array(away) <= np.array(bounds)))
    seen, stated = np.quantile(away, 0.95, axis=0), np.median(bounds, axis=0)
    return seen, stated, inside, _shown(exact / white * D65)


def weights() -> Figure:
    """Draw errors that count alike: ellipses in a, b of Lab."""
    problem = next(iter(problems(every=False)))
    xyz, white = problem.train.xyz, problem.white_xyz
    lab = lab_from_xyz(xyz, white)
    slopes = np.linalg.inv(xyz_per_lab(xyz, white))
    metric_cov = np.linalg.inv(metric(xyz, "lab2000", white))
    figure = Figure(figsize=(5, 4.6), layout="constrained")
    axes = figure.subplots()
    for colour, cov, slope, at in zip(
        _shown(xyz / white * D65), metric_cov, slopes, lab, strict=True
    ):
        plane = (slope @ cov @ slope.T)[1:, 1:]
        values, vectors = np.linalg.eigh(plane)
        turn = np.linspace(0, 2 * np.pi, 60)
        circle = np.stack([np.cos(turn), np.sin(turn)])
        ring = at[1:, None] + 3 * vectors * np.sqrt(values) @ circle
        axes.fill(*ring, color=tuple(colour), edgecolor="0.5", linewidth=0.4)
    axes.set_aspect("equal")
    axes.set_xlabel("a* (green to red)")
    axes.set_ylabel("b* (blue to yellow)")
    axes.grid(visible=True, color="0.93")
    return figure


FIGURES: Mapping[str, Callable[[], Figure]] = MappingProxyType(
    {
        "differences": differences,
        "light": light,
        "falloff": falloff,
        "tone": tone,
        "weights": weights,
        "models": models,
        "stability": stability,
        "uncertainty": uncertainty,
    }
)
_PICTURES = ("light",)  # hold photographs: PNG; the others are SVG


def main(argv: Sequence[str] | None = None) -> None:
    """Draw the figures that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(FIGURES))
    options = parser.parse_args(argv)
    for name in options.names or FIGURES:
        suffix = "png" if name in _PICTURES else "svg"
        path = _FOLDER / f"colour_{name}.{suffix}"
        save(FIGURES[name](), path)
        print(f"wrote {path.name}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
