"""What `target` says of the colours of a board."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from calichrome.pipeline.palette import LARGEST_ORDER, PaletteJudgement, judge_palette
from calichrome.report.text import table
from calichrome.synthetic.scene import SceneError
from calichrome.synthetic.spectra import printed_palette, random_reflectance
from calichrome.target import Target

__all__ = ["judged_palette", "palette_lines", "palette_to_json"]

_SURFACES = 300  # unseen ones, smooth; more take longer than anyone waits for a hint
_MOST_COLOURS = 200  # whose spectra are looked for, some hundredths of a second each


def judged_palette(target: Target) -> PaletteJudgement | None:
    """Judge the different colours of a board; None without discs."""
    if not target.markers:
        return None
    names = [marker.name for marker in target.markers]
    first = [index for index, name in enumerate(names) if names.index(name) == index]
    xyz_d65 = target.marker_xyz_d65[first]
    if len(first) > _MOST_COLOURS:
        return judge_palette(xyz_d65)
    one_each = replace(target, markers=tuple(target.markers[index] for index in first))
    try:
        reflectances = printed_palette(one_each).discs
    except SceneError:  # no surface looks like that: target check says so
        return judge_palette(xyz_d65)
    rng = np.random.default_rng(0)
    surfaces = np.array([random_reflectance(rng) for _ in range(_SURFACES)])
    return judge_palette(xyz_d65, reflectances, surfaces)


def palette_lines(found: PaletteJudgement, *, every: bool) -> Iterator[str]:
    """Say what a palette is good for; `every` lists all colour models, not the best alone."""
    if found.gap is None or found.gap_lab is None:
        yield f"{found.n_colours} colours, all in a plane of Lab."
    else:
        place = ", ".join(f"{value:.0f}" for value in found.gap_lab)
        yield (
            f"{found.n_colours} colours span {found.hull_volume / 1e3:.0f} thousand cubic units of "
            f"Lab; the largest gap is {found.gap:.0f} about L, a, b = {place}."
        )
    best = found.best
    if found.order is None or best is None:
        yield (
            "Colour models were not simulated: no printed surface has some of these colours, or "
            "there are too many."
        )
        return
    yield (
        f"It carries colour models up to order {found.order} of {LARGEST_ORDER} (1 a matrix, 2 "
        f"and 3 root-polynomials); expected dE2000 of unseen surfaces {best.mean:.2f} by "
        f"{best.name}, simulated."
    )
    if every:
        rows = [
            [item.name, str(item.needed), "-", "-"]
            if item.mean is None or item.p95 is None
            else [item.name, str(item.needed), f"{item.mean:.2f}", f"{item.p95:.2f}"]
            for item in found.models
        ]
        yield from table(["model", "needs colours", "mean dE", "95 %"], rows)


def palette_to_json(found: PaletteJudgement | None) -> dict[str, Any] | None:
    """Return all numbers; None without discs."""
    if found is None:
        return None
    return {
        "n_colours": found.n_colours,
        "hull_volume_lab": found.hull_volume,
        "largest_gap_lab": found.gap,
        "largest_gap_at_lab": None if found.gap_lab is None else list(found.gap_lab),
        "order": found.order,
        "models": [
            {
                "model": item.name,
                "needs_colours": item.needed,
                "delta_e_2000_mean": item.mean,
                "delta_e_2000_p95": item.p95,
            }
            for item in found.models
        ],
    }
