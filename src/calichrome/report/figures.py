"""Figures: numbers in, a `Figure` out; nothing is shown or saved here."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from calichrome.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["tracks_figure"]


def tracks_figure(
    paths_m: Mapping[int, FloatArray],
    colours_rgb: Mapping[int, FloatArray],
    cameras_m: Mapping[str, FloatArray],
) -> "Figure":
    """Draw tracks in space, seen aslant and along z.

    Parameters
    ----------
    paths_m
        track -> (T, 3) places in world, metres.
    colours_rgb
        track -> (3,) sRGB 0..1 of the object.
    cameras_m
        camera -> (3,) place in world.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.5), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    plan = figure.add_subplot(1, 2, 2)
    for track, path in paths_m.items():
        colour = tuple(np.clip(colours_rgb[track], 0, 1))
        space.plot(*path.T, color=colour, linewidth=1.5)
        space.scatter(*path[-1:].T, color=[colour], s=30, edgecolor="black", linewidth=0.5)
        plan.plot(path[:, 0], path[:, 1], color=colour, linewidth=1.5)
        plan.annotate(str(track), (path[-1, 0], path[-1, 1]), fontsize=8)
        plan.plot(*path[-1, :2], "o", color=colour, markeredgecolor="black", markeredgewidth=0.5)
    if paths_m:
        every = np.concatenate(list(paths_m.values()))
        middle, reach = every.mean(axis=0), float(np.ptp(every, axis=0).max()) / 2 or 1.0
        for axis, centre in zip("xyz", middle, strict=True):
            getattr(space, f"set_{axis}lim")(centre - reach, centre + reach)
    for camera, place in cameras_m.items():
        plan.plot(*place[:2], "k^", markersize=6)
        plan.annotate(camera, (place[0], place[1]), fontsize=8)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("x (m)")
    plan.set_ylabel("y (m)")
    space.set_box_aspect(None, zoom=0.85)  # or the label of z is cut off
    for axis in "xyz":
        getattr(space, f"set_{axis}label")(f"{axis} (m)")
    return figure
