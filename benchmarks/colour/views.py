"""What more views bring to colour, and where that ends: python -m benchmarks.colour.views.

Two cameras of different sensors see a board whose print is off its table, as prints are. Pictures
are rendered and stored in 8 bits; the discs are read where true lenses and poses say they are, so
that only colour is judged. `docs/colour.md` shows the figure.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from benchmarks.geometry.tables import print_table

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.flare import measure_additive
from calichrome.colour.rig_fit import (
    ColourSettings,
    ColourSolution,
    between_cameras,
    fit_rig_colour,
)
from calichrome.colour.samples import collect_samples
from calichrome.colour.shading import Vignetting
from calichrome.colour.shading_fit import VignettingFit, fit_vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.detection import BoardToPixels, measure_discs
from calichrome.imaging import Image
from calichrome.observations import BoardView, Dataset
from calichrome.synthetic import (
    Renderer,
    Scene,
    SceneCamera,
    SceneError,
    picture,
    random_scene,
    truth_of,
)
from calichrome.target import Target, colour_checker_palette, design_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COUNTS", "Recorded", "judge", "main", "record", "save", "solve"]

COUNTS = (1, 2, 3, 5, 8, 12, 20, 30)
_PRINT_SD = 3.0  # of L, a and b of each printed colour: an office printer nobody profiled


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """Discs of a rendered recording, and what is true.

    Parameters
    ----------
    nominal, measured
        The board as designed, and with its print measured without error.
    """

    scene: Scene
    dataset: Dataset
    nominal: Target
    measured: Target

    def views(self, frames: Sequence[str]) -> Dataset:
        """Return some of the frames."""
        return self.dataset.with_views(
            {
                camera: {frame: views[frame] for frame in frames}
                for camera, views in self.dataset.views.items()
            }
        )


def record(seed: int, n_frames: int, print_sd: float = _PRINT_SD) -> Recorded:
    """Render two cameras and read their discs."""
    palette = colour_checker_palette()
    target = design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=palette)
    scene = random_scene(target, 2, n_frames, (640, 480), seed, palette_error_lab_sd=print_sd)
    renderer = Renderer(scene)
    views = {
        camera.camera_id: {
            frame: _view(renderer, camera, frame, target) for frame in scene.world_from_board
        }
        for camera in scene.cameras
    }
    return Recorded(
        scene=scene,
        dataset=Dataset(
            sizes_wh={camera.camera_id: camera.size_wh for camera in scene.cameras}, views=views
        ),
        nominal=target,
        measured=_measured(scene),
    )


def _view(renderer: Renderer, camera: SceneCamera, frame: str, target: Target) -> BoardView:
    cam_from_board = camera.cam_from_world @ renderer.scene.world_from_board[frame]
    to_pixels = _projection(camera, cam_from_board)
    image = Image(
        pixels=picture(renderer, camera.camera_id, frame), encoding="srgb", bits=camera.bits
    )
    return BoardView(
        corner_ids=np.arange(target.n_corners),
        corners_px=to_pixels(target.corners_board),
        discs=measure_discs(image, target, to_pixels),
    )


def _projection(camera: SceneCamera, cam_from_board: Pose) -> BoardToPixels:
    return lambda points_board: camera.lens.project(cam_from_board.apply(points_board))


def _measured(scene: Scene) -> Target:
    """Return the target as an instrument without error would read it."""
    truth = truth_of(scene)
    x, y, z = map(float, truth.white_xyz_d65)
    return replace(
        scene.target,
        markers=tuple(
            replace(marker, xyz_d65=(float(xyz[0]), float(xyz[1]), float(xyz[2])))
            for marker, xyz in zip(scene.target.markers, truth.marker_xyz_d65, strict=True)
        ),
        paper=replace(scene.target.paper, white_xyz_d65=(x, y, z)),
        colours_measured=True,
    )


def solve(
    recorded: Recorded, target: Target, frames: Sequence[str], model: str
) -> tuple[dict[str, ColourSolution], Mapping[str, Vignetting]]:
    """Take light and fall-off away and fit, as `calibrate` does."""
    dataset = recorded.views(frames)
    lenses = {camera.camera_id: camera.lens for camera in recorded.scene.cameras}
    centres = {camera: np.array([lens.cx, lens.cy]) for camera, lens in lenses.items()}
    vignettings = {
        camera: found.vignetting
        for camera, found in fit_vignetting(dataset, target, centres).items()
        if isinstance(found, VignettingFit)
    }
    samples = {
        camera: collect_samples(
            views,
            target,
            vignetting=vignettings.get(camera),
            additive=measure_additive(views, target),
        )
        for camera, views in dataset.views.items()
    }
    fitted = fit_rig_colour(
        {camera: item for camera, item in samples.items() if item is not None},
        target,
        ColourSettings(model=model),
    )
    solutions = {}
    for camera, found in fitted.items():
        if isinstance(found, str):
            raise SceneError(f"camera {camera}: {found}")
        solutions[camera] = found
    return solutions, vignettings


def judge(recorded: Recorded, target: Target, frames: Sequence[str], model: str) -> FloatArray:
    """Return mean CIEDE2000 against the table, against the print, between cameras, and a share.

    All colours are those of fits that never saw them. The share is that of the cameras whose
    fall-off was told.
    """
    solutions, vignettings = solve(recorded, target, frames, model)
    printed = recorded.measured.marker_xyz_d65
    return np.array(
        [
            np.mean([np.nanmean(item.held_out_delta_e) for item in solutions.values()]),
            np.mean(
                [
                    np.nanmean(delta_e_2000_xyz(item.held_out_xyz, printed))
                    for item in solutions.values()
                ]
            ),
            between_cameras(solutions, held_out=True).mean(),
            len(vignettings) / len(solutions),
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Of each draw and number of views, what `judge` returns: (n_draws, len(COUNTS), 4)."""

    values: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Over draws, (len(COUNTS), 4)."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def range(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest of the draws."""
        return self.values.min(axis=0), self.values.max(axis=0)


def curves(recordings: Sequence[Recorded], *, measured: bool, model: str, n_draws: int) -> Curves:
    """Judge random frames of each recording, more and more of them."""
    rows = []
    for seed, recorded in enumerate(recordings):
        target = recorded.measured if measured else recorded.nominal
        frames = list(recorded.scene.world_from_board)
        for draw in range(n_draws):
            order = np.random.default_rng([seed, draw]).permutation(len(frames))
            rows.append(
                [
                    judge(recorded, target, [frames[index] for index in order[:count]], model)
                    for count in COUNTS
                ]
            )
    return Curves(np.array(rows))


def draw_curves(nominal: Curves, measured: Curves) -> "Figure":
    """Draw errors against the number of views, with the range of the draws."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.8), layout="constrained")
    panels = (
        ("print not measured, off by sd 3 in L, a, b", nominal),
        ("print measured", measured),
    )
    for axes, (title, found) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
        low, high = found.range
        lines = [
            ("against the table", 0, "tab:orange"),
            ("against what is printed", 1, "tab:green"),
            ("between the cameras", 2, "tab:blue"),
        ]
        for label, column, colour in lines:
            if found is measured and column == 1:
                continue  # the table says what is printed
            axes.fill_between(
                COUNTS, low[:, column], high[:, column], color=colour, alpha=0.15, linewidth=0
            )
            axes.plot(COUNTS, found.mean[:, column], color=colour, marker=".", label=label)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("views of each camera")
        axes.set_xscale("log")
        axes.set_xticks([1, 2, 3, 5, 10, 20, 30], labels=["1", "2", "3", "5", "10", "20", "30"])
        axes.minorticks_off()
        axes.set_ylim(0, None)
        axes.grid(visible=True, color="0.9")
    figure.axes[0].set_ylabel("mean ΔE2000, each disc left out")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8)
    return figure


def main(argv: Sequence[str] | None = None) -> None:
    """Run, print, and draw if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=2)
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--model", default="root-polynomial-2-white")
    parser.add_argument("--figure", type=Path, help="SVG")
    options = parser.parse_args(argv)
    recordings = [record(seed, COUNTS[-1]) for seed in range(options.recordings)]
    found = {}
    for measured in (False, True):
        found[measured] = curves(
            recordings, measured=measured, model=options.model, n_draws=options.draws
        )
        print(
            f"\n## print {'measured' if measured else 'not measured'}: {options.recordings} "
            f"recordings, {options.draws} draws of frames of each, {options.model}"
        )
        print_table(_HEAD, list(_rows(found[measured])))
    if options.figure is not None:
        save(draw_curves(found[False], found[True]), options.figure)


_HEAD = ("views", "against the table", "against the print", "between cameras", "fall-off told")


def _rows(found: Curves) -> Iterator[tuple[str, ...]]:
    for count, row in zip(COUNTS, found.mean, strict=True):
        yield (f"{count}", *(f"{value:.2f}" for value in row[:3]), f"{100 * row[3]:.0f} %")


def save(figure: "Figure", path: Path) -> None:
    """Write the same bytes for the same numbers."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "calichrome", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main()
