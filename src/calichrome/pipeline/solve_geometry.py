"""Which way, which lens: the geometry of a recording solved as its user asked."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from calichrome.errors import SolveError
from calichrome.geometry.bow_check import BowCheck, bow_left_out
from calichrome.geometry.halves import Halves, compare_halves
from calichrome.geometry.held_out import held_out_rms_px
from calichrome.geometry.lenses import LENSES, BrownConrady
from calichrome.geometry.rig_pairwise import solve_rig_pairwise
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import FixedParameters, RigSettings, solve_rig
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["GeometrySettings", "LensName", "SolvedGeometry", "solve_geometry"]

LensName = Literal["brown-conrady", "rational", "kannala-brandt", "auto"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometrySettings:
    """How to solve the geometry.

    Parameters
    ----------
    method
        "joint": everything in one adjustment. "pairwise": each camera, then pairs, then the chain
        to the reference camera, as in Kapusi et al., 2010.
    lens
        Model of all lenses whose recording.toml names none; "auto": the one with the smallest
        held-out error.
    warp
        Estimate how the board is bowed, and where the residuals show it, by how much its squares
        are wider than high, and lean.
    robust
        Leave out corners that lie and frames that contradict themselves, and weigh each view by its
        own noise; otherwise plain least squares on all corners.
    reference_camera
        Default: the camera with the least total path error.
    world_frame
        The board in this frame is the floor: origin at its first corner, x along its columns, z up
        from the board.
    world_points
        CSV file with columns frame,corner,x,y,z: world coordinates, in metres, of board corners.
    """

    method: Literal["joint", "pairwise"] = "joint"
    lens: LensName = "brown-conrady"
    warp: bool = True
    robust: bool = True
    reference_camera: str | None = None
    world_frame: str | None = None
    world_points: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedGeometry:
    """The solution, and its error on frames that it has not seen.

    Parameters
    ----------
    solution
        Of all frames.
    held_out
        Error by camera, pixels; None where too few frames are left.
    rig_settings
        How it was solved; None for the pairwise way.
    bow
        What it costs that the board was taken as flat; None where it was not.
    halves
        Even and odd frames solved apart; None where too few frames are left.
    """

    solution: RigSolution
    held_out: Mapping[str, float | None]
    rig_settings: RigSettings | None
    bow: BowCheck | None = None
    halves: Halves | None = None


def solve_geometry(
    dataset: Dataset,
    target: Target,
    settings: GeometrySettings,
    *,
    fixed: FixedParameters,
    lenses: Mapping[str, str],
) -> SolvedGeometry:
    """Solve, and cross-validate.

    Parameters
    ----------
    dataset, target
        What was seen, of which board.
    settings
        See there.
    fixed
        camera -> lens parameters that keep their value.
    lenses
        camera -> lens model, where one is named.

    Raises
    ------
    SolveError
        And its kinds: see `solve_rig`.
    """
    points = target.corners_board
    if settings.method == "pairwise":
        if settings.lens != "brown-conrady" or set(lenses.values()) - {"brown-conrady"}:
            raise SolveError(
                "the pairwise way knows the lens brown-conrady only; use --method joint"
            )
        solution = solve_rig_pairwise(
            dataset, target, reference=settings.reference_camera, fixed=fixed
        )
        again = partial(
            solve_rig_pairwise,
            target=target,
            reference=solution.reference,
            fixed=fixed,
            start={
                camera: lens
                for camera, lens in solution.lenses.items()
                if isinstance(lens, BrownConrady)
            },
        )
        return SolvedGeometry(
            solution=solution,
            held_out=held_out_rms_px(solution, points, again),
            rig_settings=None,
            halves=compare_halves(solution.dataset, again),
        )
    names = list(LENSES) if settings.lens == "auto" else [settings.lens]
    solved: list[SolvedGeometry] = []
    errors: list[SolveError] = []
    for name in names:
        rig_settings = RigSettings(
            reference=settings.reference_camera,
            lens=name,
            lenses=lenses,
            fixed=fixed,
            warp=settings.warp,
            robust=settings.robust,
        )
        try:
            solution = solve_rig(dataset, target, rig_settings)
        except SolveError as error:
            errors.append(error)
            continue
        again_settings = replace(rig_settings, start=solution, reference=solution.reference)
        held_out = held_out_rms_px(
            solution, points, partial(solve_rig, target=target, settings=again_settings)
        )
        solved.append(
            SolvedGeometry(solution=solution, held_out=held_out, rig_settings=again_settings)
        )
    if not solved:
        raise errors[0]
    best = min(solved, key=_total)
    best_settings = best.rig_settings
    assert best_settings is not None  # noqa: S101 (none of these was solved pairwise)
    best = replace(
        best,
        halves=compare_halves(
            best.solution.dataset,
            partial(solve_rig, target=target, settings=best_settings),
        ),
    )
    if not settings.warp:
        best = replace(best, bow=bow_left_out(best.solution, target, best_settings))
    return best


def _total(solved: SolvedGeometry) -> float:
    """Mean square held-out error of all cameras; inf where one could not be judged."""
    values = list(solved.held_out.values())
    if any(value is None for value in values):
        return np.inf
    return float(np.mean([value**2 for value in values if value is not None]))
