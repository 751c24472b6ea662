"""What is doubtful about a board, whoever made it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz
from calichrome.core.arrays import FloatArray
from calichrome.target.board import Target
from calichrome.target.design import (
    LARGEST_DISC_RATIO,
    SMALLEST_DISC_RATIO,
    SMALLEST_SQUARE_PX,
    smallest_square_px,
)
from calichrome.target.layout import DISCS_IN_WINDOW, WINDOW, layout_quality
from calichrome.target.page import smallest_white_margin_m
from calichrome.target.palette import DARK_BELOW_L

__all__ = ["TargetProblem", "check_target"]

_ENOUGH_COLOURS = 24
"""A 3x3 matrix needs 3, a root-polynomial of degree 2 needs 6; models are chosen by leaving colours
out, which a ColorChecker's worth carries."""

_ENOUGH_GREYS = 3
_GREY_BELOW_CHROMA = 5.0
_ALMOST_EQUAL_DELTA_E = 5.0
_MOST_COMPARED = 500
"""Colours of a foreign file that are compared in pairs."""

_BRIGHTEST_Y = 1.2
"""Optical brighteners lift paper to Y = 1.1; more is a wrong scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetProblem:
    """One sentence about a board.

    Parameters
    ----------
    severity
        "error": the file contradicts itself, results would be wrong. "remark": the board can be
        used, and this is what it costs.
    code
        Stable name of the rule.
    text
        What, where, and what to do.
    """

    severity: Literal["error", "remark"]
    code: str
    text: str


def check_target(target: Target) -> list[TargetProblem]:
    """Return what is wrong or doubtful with a board; errors first.

    The rules for boards that we print are remarks here: others print boards too.
    """
    problems = [*_orientation(target), *_margin(target)]
    if target.markers:
        problems += [*_values(target), *_discs(target), *_palette(target), *_layout(target)]
    return sorted(problems, key=lambda problem: problem.severity)


def _error(code: str, text: str) -> TargetProblem:
    return TargetProblem(severity="error", code=code, text=text)


def _remark(code: str, text: str) -> TargetProblem:
    return TargetProblem(severity="remark", code=code, text=text)


def _orientation(target: Target) -> Iterator[TargetProblem]:
    if not target.has_unique_orientation:
        nx, ny = target.corners_xy
        rescue = (
            "only its discs tell which way up it is"
            if target.markers
            else "one camera cannot tell which way up it is; several decide it together"
        )
        yield _remark(
            "equal_parity",
            f"{nx}x{ny} inner corners are both {'odd' if nx % 2 else 'even'}: the squares look the "
            f"same after half a turn, {rescue}. Print {nx + 2}x{ny + 1} squares instead.",
        )


def _margin(target: Target) -> Iterator[TargetProblem]:
    wanted = smallest_white_margin_m(target.square_m)
    if target.white_margin_m is not None and target.white_margin_m < wanted - 1e-9:
        yield _remark(
            "narrow_margin",
            f"a white margin of {target.white_margin_m * 1e3:.1f} mm lets the surroundings touch "
            f"the outer squares; leave {wanted * 1e3:.1f} mm or more.",
        )


def _values(target: Target) -> Iterator[TargetProblem]:
    xyz = target.marker_xyz_d65
    y_max = float(xyz[:, 1].max())
    if y_max <= 0.015:
        yield _error(
            "wrong_scale",
            f"the brightest disc has Y = {y_max * 100:.2f}: XYZ_D65 is written with Y = 100 for "
            f"the perfect diffuser, not with Y = 1. Multiply by 100.",
        )
    for marker in target.markers:
        if min(marker.xyz_d65) < 0 or marker.xyz_d65[1] > _BRIGHTEST_Y:
            values = ", ".join(f"{value * 100:.1f}" for value in marker.xyz_d65)
            yield _error(
                "impossible_colour",
                f"disc {marker.name} in square {marker.square}: XYZ_D65 = {values} is not the "
                f"colour of a printed surface. Correct the file.",
            )
    if not target.colours_measured:  # measured discs of one name may differ a little
        first: dict[str, tuple[float, float, float]] = {}
        for marker in target.markers:
            if first.setdefault(marker.name, marker.xyz_d65) != marker.xyz_d65:
                yield _error(
                    "one_name_two_colours",
                    f"disc {marker.name} in square {marker.square} has another XYZ_D65 than the "
                    f"first disc of that name. Give it another name or the same values.",
                )
    white, black = target.paper.white_xyz_d65, target.paper.black_xyz_d65
    if white and black and white[1] <= black[1]:
        yield _error(
            "paper_inverted",
            f"the paper's white (Y = {white[1] * 100:.1f}) is not brighter than its black "
            f"(Y = {black[1] * 100:.1f}). Exchange the two.",
        )


def _discs(target: Target) -> Iterator[TargetProblem]:
    ratios = np.array([m.diameter_m for m in target.markers]) / min(target.square_m)
    largest, smallest = float(ratios.max()), float(ratios.min())
    if largest > LARGEST_DISC_RATIO + 1e-9:
        limit = smallest_square_px(largest)
        where = f"where squares show less than {limit:.0f} px" if np.isfinite(limit) else "always"
        yield _remark(
            "large_discs",
            f"discs of {largest:.2f} of a square reach into the windows in which corners are "
            f"measured, {where}. Use {LARGEST_DISC_RATIO} or less.",
        )
    if smallest < SMALLEST_DISC_RATIO - 1e-9:
        needed = SMALLEST_SQUARE_PX * SMALLEST_DISC_RATIO / smallest
        yield _remark(
            "small_discs",
            f"discs of {smallest:.2f} of a square hold too few pixels unless squares show "
            f"{needed:.0f} px. Use {SMALLEST_DISC_RATIO} or more.",
        )
    lightness = lab_from_xyz(np.maximum(target.marker_xyz_d65, 0))[:, 0]
    on_black = np.array([marker.background == "black" for marker in target.markers])
    for wrong, what in (
        ((lightness < DARK_BELOW_L) & on_black, "dark on black"),
        ((lightness >= DARK_BELOW_L) & ~on_black, "bright on white"),
    ):
        names = sorted({target.markers[index].name for index in np.flatnonzero(wrong)})
        if names:
            yield _remark(
                what.replace(" ", "_"),
                f"{_listed(names)}: {what}, hard to tell from the square. Put colours with L* "
                f"below {DARK_BELOW_L:g} on white squares and the others on black ones.",
            )


def _palette(target: Target) -> Iterator[TargetProblem]:
    colours = {marker.name: marker.xyz_d65 for marker in target.markers}
    names = list(colours)
    lab = lab_from_xyz(np.maximum(np.array(list(colours.values())), 0))
    if len(names) < _ENOUGH_COLOURS:
        yield _remark(
            "few_colours",
            f"{len(names)} colours: fewer than {_ENOUGH_COLOURS} leave little to choose a colour "
            f"model by. Print more colours.",
        )
    n_grey = int((np.hypot(lab[:, 1], lab[:, 2]) < _GREY_BELOW_CHROMA).sum())
    if n_grey < _ENOUGH_GREYS:
        yield _remark(
            "few_greys",
            f"{n_grey} grey colours: the test of a picture's encoding needs {_ENOUGH_GREYS}. Print "
            f"more neutral colours.",
        )
    twins = [
        f"{names[a]} and {names[b]} (ΔE2000 {delta:.1f})" for a, b, delta in _almost_equal(lab)
    ]
    if twins:
        yield _remark(
            "almost_equal_colours",
            f"{_listed(twins)} are almost equal: they neither tell squares apart nor teach a "
            f"colour model much. Replace one of each pair.",
        )


def _almost_equal(lab: FloatArray) -> Iterator[tuple[int, int, float]]:
    lab = lab[:_MOST_COMPARED]
    for index in range(len(lab) - 1):
        deltas = delta_e_2000(lab[index], lab[index + 1 :])
        for offset in np.flatnonzero(deltas < _ALMOST_EQUAL_DELTA_E):
            yield index, index + 1 + int(offset), float(deltas[offset])


def _layout(target: Target) -> Iterator[TargetProblem]:
    quality = layout_quality(target)
    if quality is None:
        return
    long, short = WINDOW
    if quality.least_differing == 0:
        yield _remark(
            "parts_look_alike",
            f"two parts of {long}x{short} squares show the same discs: a partly visible board may "
            f"not be told from another part. Show more of the board, or print one made here.",
        )
    if quality.share_with_enough_discs < 0.9:
        yield _remark(
            "sparse_discs",
            f"only {quality.share_with_enough_discs:.0%} of the parts of {long}x{short} squares "
            f"show {DISCS_IN_WINDOW} discs: elsewhere a partly visible board may go unrecognised. "
            f"Show more of the board, or print one with more discs.",
        )


def _listed(items: list[str], most: int = 4) -> str:
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(items[:most]) + more
