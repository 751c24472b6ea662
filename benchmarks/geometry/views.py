"""What more views bring, and where that ends: python -m benchmarks.geometry.views.

Nothing is drawn but scenes: the normal equations of the solver, at the truth, say how noise and
errors of the print pass into a stereo rig. `docs/uncertainty.md` shows the figure.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from benchmarks.geometry.scenes import SIGMA_PX, Scene, stereo
from benchmarks.geometry.tables import print_table

from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import inverse_of_scaled
from calichrome.geometry.bundle import (
    BoardShape,
    BundleEquations,
    BundleState,
    Free,
    Observations,
    ObservedView,
)
from calichrome.geometry.bundle.blocks import view_blocks
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.support import supported
from calichrome.geometry.uncertainty import picture_grid, projection_covariances

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Budget",
    "Response",
    "budget",
    "first_views",
    "halves",
    "main",
    "respond",
    "sigmas_of",
    "with_print",
]

COUNTS = (3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60)
PRINT_SIGMA_M = 0.05e-3
"""Of each printed corner, per axis of the board's plane: 0.2 % of the square, the largest of what
`benchmarks.geometry.printed` tells from three real recordings."""
SCALE_SIGMA = 0.005  # relative; what `pipeline.assemble` adds where the square was not measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """How noise and print errors reach the cameras and the bow of a scene.

    Parameters
    ----------
    covariance : (A, A) float
        For the noise of the scene: of all lenses and poses but the reference's pose, then of the
        bow. Poses as left perturbations.
    by_print : (A, 2 n) float, per metre
        Change of the same by a displacement of each printed corner along x and y of the board.
    print_chi_square : float, per metre squared
        By what the sum of squared residuals over their variance grows with the variance of a
        displacement.
    redundancy : int
        Equations less unknowns.
    """

    covariance: FloatArray
    by_print: FloatArray
    print_chi_square: float
    redundancy: int

    def noise_factor(self, print_sigma_m: float) -> float:
        """Mean variance factor of residuals that hold print errors, too."""
        return 1 + print_sigma_m**2 * self.print_chi_square / self.redundancy

    def printed(self, print_sigma_m: float) -> FloatArray:
        """Covariance (A, A) by print errors alone, independent from corner to corner."""
        return np.asarray(print_sigma_m**2 * self.by_print @ self.by_print.T)


def first_views(scene: Scene, frames: Sequence[str]) -> Scene:
    """Return the scene with some of its frames."""
    return replace(
        scene,
        ref_from_boards={frame: scene.ref_from_boards[frame] for frame in frames},
        seen={
            camera: tuple(frame for frame in frames if frame in own)
            for camera, own in scene.seen.items()
        },
    )


def respond(scene: Scene, sigma_px: float = SIGMA_PX) -> Response:
    """Linearise at the truth.

    Every printed corner enters the normal equations as if it were unknown, in a row behind the bow.
    With a for all that is solved and p for the print, which is displaced by dp but taken as even,
    residuals change by -J_p dp, so that at the minimum over a

        S_aa da = S_ap dp

    and the squared residuals that a cannot take up are dp' (S_pp - S_pa S_aa^-1 S_ap) dp.
    """
    bow = BoardShape.bowed(scene.target.corners_board, len(BOW_TERMS))
    observations, state = _packed(scene, with_print(bow, scene.target.n_corners), sigma_px)
    free = Free.everything(state)
    equations = BundleEquations(observations, state, free, view_blocks(observations, state))
    reduced = equations.reduced_hessian()
    if reduced is None:
        raise ValueError("a frame fixes no pose")
    n_print = 2 * scene.target.n_corners
    solved, printed = slice(0, -n_print), slice(-n_print, None)
    covariance = inverse_of_scaled(reduced[solved, solved])
    if covariance is None:
        raise ValueError("the views leave a direction open")
    by_print = covariance @ reduced[solved, printed]
    left = np.trace(reduced[printed, printed]) - np.vdot(reduced[solved, printed], by_print)
    n_unknowns = len(covariance) + 6 * len(scene.ref_from_boards)
    return Response(
        covariance=covariance,
        by_print=by_print,
        print_chi_square=float(left),
        redundancy=2 * observations.n_corners - n_unknowns,
    )


def with_print(bow: BoardShape, n_corners: int) -> BoardShape:
    """Append displacements of every corner along x, then along y of the board, metres."""
    basis = np.zeros((2 * n_corners, 3, n_corners))
    for axis in (0, 1):
        basis[axis * n_corners + np.arange(n_corners), axis, np.arange(n_corners)] = 1
    names = tuple(f"print {axis} {corner}" for axis in "xy" for corner in range(n_corners))
    return BoardShape((*bow.names, *names), np.concatenate([bow.basis, basis]))


def _packed(scene: Scene, shape: BoardShape, sigma_px: float) -> tuple[Observations, BundleState]:
    cameras, frames = list(scene.lenses), list(scene.ref_from_boards)
    ids, whitening = np.arange(scene.target.n_corners), np.eye(2)[None] / sigma_px
    views = [
        ObservedView(row, frames.index(frame), ids, scene.exact_px(camera, frame), whitening)
        for row, camera in enumerate(cameras)
        for frame in scene.seen[camera]
    ]
    state = BundleState.build(
        [scene.lenses[camera] for camera in cameras],
        [scene.cams_from_ref[camera] for camera in cameras],
        list(scene.ref_from_boards.values()),
        shape,
    )
    points = scene.target.corners_board
    return Observations.pack(views, points, state.models, len(frames)), state


def sigmas_of(scene: Scene, covariance: FloatArray) -> dict[str, float]:
    """Return sigma of the left fx (px), baseline (mm) and projection (px, rms over the picture)."""
    lens, pose = scene.lenses["left"], scene.cams_from_ref["right"]
    n_lens = len(lens.NAMES)
    own = covariance[:n_lens, :n_lens]
    # |t|, of a camera whose partner is ref; a left perturbation's omega x t is across it
    along = pose.trans_m / np.linalg.norm(pose.trans_m)
    place = slice(2 * n_lens + 3, 2 * n_lens + 6)
    moved = projection_covariances(lens, own, picture_grid(scene.size_wh))
    return {
        "focal": float(np.sqrt(own[0, 0])),
        "baseline": 1e3 * float(np.sqrt(along @ covariance[place, place] @ along)),
        "projection": float(np.sqrt(np.trace(moved, axis1=1, axis2=2).mean())),
    }


def _frees_everything(scene: Scene, sigma_px: float) -> bool:
    """Whether the solver would free all of it from so few views."""
    bow = BoardShape.bowed(scene.target.corners_board, len(BOW_TERMS))
    observations, state = _packed(scene, bow, sigma_px)
    sizes_wh = (scene.size_wh,) * len(scene.lenses)
    noise_px = np.full(len(scene.lenses), sigma_px)
    support = supported(observations, state, Free.everything(state), sizes_wh, noise_px)
    return not support.held and not support.shape_held


Curves = dict[str, FloatArray]
"""Quantity -> values by number of views."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Budget:
    """Root mean square sigmas over scenes.

    Parameters
    ----------
    noise, printed
        Of noise alone, of print errors alone.
    stated
        By a solver that takes print errors for noise.
    share : (len(COUNTS),) float
        Of the squared residuals that print errors make.
    n_freed : (len(COUNTS),) int
        In how many scenes the solver would free everything.
    """

    noise: Curves
    printed: Curves
    stated: Curves
    share: FloatArray
    n_freed: FloatArray

    def both(self, name: str) -> FloatArray:
        """Return what the error is when print and noise meet."""
        return np.hypot(self.noise[name], self.printed[name])


def budget(scenes: Sequence[Scene], sigma_px: float, print_sigma_m: float) -> Budget:
    """Propagate noise and print errors through the first views of each scene."""
    squares: list[Curves] = [{}, {}, {}]
    share, n_freed = np.zeros(len(COUNTS)), np.zeros(len(COUNTS))
    for scene in scenes:
        frames = list(scene.ref_from_boards)
        for place, n_views in enumerate(COUNTS):
            some = first_views(scene, frames[:n_views])
            response = respond(some, sigma_px)
            factor = response.noise_factor(print_sigma_m)
            share[place] += (1 - 1 / factor) / len(scenes)
            n_freed[place] += _frees_everything(some, sigma_px)
            cov = response.covariance
            for own, case in zip(
                squares, (cov, response.printed(print_sigma_m), factor * cov), strict=True
            ):
                for name, sigma in sigmas_of(some, case).items():
                    own.setdefault(name, np.zeros(len(COUNTS)))[place] += sigma**2 / len(scenes)
    noise, printed, stated = (
        {name: np.sqrt(values) for name, values in own.items()} for own in squares
    )
    return Budget(noise=noise, printed=printed, stated=stated, share=share, n_freed=n_freed)


def halves(
    scenes: Sequence[Scene], sigma_px: float, print_sigma_m: float
) -> dict[str, tuple[float, float]]:
    """Return how far halves differ, and how far the whole errs, over what is stated, by quantity.

    Every other frame is a half, solved apart. The print is the same in both: what it does alike to
    both, their difference does not show.
    """
    sums: dict[str, FloatArray] = {}
    for scene in scenes:
        frames = list(scene.ref_from_boards)
        whole = respond(scene, sigma_px)
        first, second = (
            respond(first_views(scene, frames[start::2]), sigma_px) for start in (0, 1)
        )
        apart = print_sigma_m * (first.by_print - second.by_print)
        cases = (
            first.covariance + second.covariance + apart @ apart.T,
            first.noise_factor(print_sigma_m) * first.covariance
            + second.noise_factor(print_sigma_m) * second.covariance,
            whole.covariance + whole.printed(print_sigma_m),
            whole.noise_factor(print_sigma_m) * whole.covariance,
        )
        for column, covariance in enumerate(cases):
            for name, sigma in sigmas_of(scene, covariance).items():
                sums.setdefault(name, np.zeros(4))[column] += sigma**2
    return {
        name: (float(np.sqrt(s[0] / s[1])), float(np.sqrt(s[2] / s[3]))) for name, s in sums.items()
    }


def draw_budget(found: Budget, baseline_mm: float) -> "Figure":
    """Draw sigmas against the number of views."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    titles = {
        "focal": "focal length, px",
        "baseline": f"baseline of {baseline_mm:.0f} mm, mm",
        "projection": "projection, px (rms over the picture)",
    }
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    counts = np.array(COUNTS)
    for axes, (name, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
        noise, both = found.noise[name], found.both(name)
        guide = noise[-1] * np.sqrt(counts[-1] / counts)
        axes.loglog(counts, guide, color="0.8", linewidth=4, label="1/√n")
        axes.loglog(counts, noise, color="tab:blue", label="corner noise")
        axes.loglog(counts, found.printed[name], color="tab:orange", label="print errors")
        axes.loglog(counts, both, color="black", label="both: the error")
        axes.loglog(counts, found.stated[name], "k:", label="as stated")
        if name == "baseline":
            floor = SCALE_SIGMA * baseline_mm
            axes.axhline(floor, color="tab:red", label="board's scale, 0.5 %, unmeasured")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("views of each camera")
        axes.set_xticks([3, 5, 10, 20, 40, 60], labels=["3", "5", "10", "20", "40", "60"])
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.grid(visible=True, color="0.9")
    handles, labels = figure.axes[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8)
    return figure


def main(argv: Sequence[str] | None = None) -> None:
    """Run, print, and draw if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--noise", type=float, nargs="+", default=[SIGMA_PX, 0.1, 0.07])
    parser.add_argument("--print-mm", type=float, default=1e3 * PRINT_SIGMA_M)
    parser.add_argument("--figure", type=Path, help="SVG of the first noise")
    options = parser.parse_args(argv)
    scenes = [stereo(seed, COUNTS[-1]) for seed in range(options.scenes)]
    print_sigma_m = 1e-3 * options.print_mm
    for index, sigma_px in enumerate(options.noise):
        found = budget(scenes, sigma_px, print_sigma_m)
        print(f"\n## noise {sigma_px:g} px, print {options.print_mm:g} mm, {len(scenes)} scenes")
        print_table(_HEAD, list(_rows(found)))
        for name, (apart, truth) in halves(scenes, sigma_px, print_sigma_m).items():
            print(f"{name}: halves / stated {apart:.2f}, error / stated {truth:.2f}")
        if index == 0 and options.figure is not None:
            baseline_m = float(np.linalg.norm(scenes[0].cams_from_ref["right"].trans_m))
            _save(draw_budget(found, 1e3 * baseline_m), options.figure)


_HEAD = (
    "views", "all freed", "share of print",
    *(f"{name} {kind}" for name in ("focal", "baseline", "projection")
      for kind in ("noise", "print", "error / stated")),
)  # fmt: skip


def _rows(found: Budget) -> Iterator[tuple[str, ...]]:
    for place, n_views in enumerate(COUNTS):
        cells = [f"{n_views}", f"{found.n_freed[place]:.0f}", f"{found.share[place]:.2f}"]
        for name in found.noise:
            ratio = found.both(name)[place] / found.stated[name][place]
            cells += [
                f"{found.noise[name][place]:.3g}",
                f"{found.printed[name][place]:.3g}",
                f"{ratio:.2f}",
            ]
        yield tuple(cells)


def _save(figure: "Figure", path: Path) -> None:
    """Write the same bytes for the same numbers."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "calichrome", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main()
