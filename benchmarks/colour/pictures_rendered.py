"""Pictures of docs/colour.md that need a rendered recording: the light, and the lens."""

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from benchmarks.colour.views import Recorded, record, solve
from matplotlib.figure import Figure

from calichrome.colorimetry.encoding import encode, linearise
from calichrome.colour.light import light_at
from calichrome.colour.samples import collect_samples
from calichrome.core.arrays import FloatArray
from calichrome.observations import DiscSamples
from calichrome.synthetic import Renderer, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["falloff", "light"]

_N_FRAMES = 12


@cache
def _recorded() -> Recorded:
    return record(0, _N_FRAMES, print_sd=0.0)


def light() -> Figure:
    """Draw a picture, the light in it as the white squares tell, and the picture without it."""
    recorded = _recorded()
    camera = recorded.scene.cameras[1]
    views = recorded.dataset.views[camera.camera_id]
    # near enough to be looked at, and unevenly lit
    frame, discs = max(
        ((frame, view.discs) for frame, view in views.items() if view.discs is not None),
        key=lambda item: float(np.ptp(item[1].white_rgb[:, 1]) * item[1].n_px.mean()),
    )
    stored = picture(Renderer(recorded.scene), camera.camera_id, frame)
    linear = linearise(stored / 255, "srgb")
    margin = 45  # pixels around the discs
    low = np.maximum(discs.centres_px.min(axis=0) - margin, 0)
    high = np.minimum(discs.centres_px.max(axis=0) + margin, camera.size_wh)
    (x0, y0), (x1, y1) = (int(v) for v in low), (int(v) for v in high)
    x, y = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
    levels = _light_everywhere(discs, np.stack([x, y], axis=-1).astype(np.float64))
    crop = linear[y0:y1, x0:x1]
    shown = 0.75 / levels[..., 1].max()  # of full scale: bright enough to be looked at
    figure = Figure(figsize=(10, 6.2), layout="constrained", dpi=78)
    top = figure.add_gridspec(2, 3, height_ratios=(1.5, 1))
    panels = (
        ("as recorded (brightened)", encode(np.clip(shown * crop, 0, 1), "srgb")),
        ("divided by that light", encode(np.clip(0.75 * crop / levels, 0, 1), "srgb")),
    )
    for place, (title, picture_shown) in zip((0, 2), panels, strict=True):
        axes = figure.add_subplot(top[0, place])
        axes.imshow(picture_shown)
        _bare(axes, title)
    axes = figure.add_subplot(top[0, 1])
    relative = 100 * levels[..., 1] / levels[..., 1].max()
    drawn = axes.imshow(relative, cmap="cividis")
    lines = axes.contour(relative, levels=np.arange(10, 100, 5), colors="w", linewidths=0.6)
    axes.clabel(lines, fmt="%d", fontsize=8)
    figure.colorbar(drawn, ax=axes, orientation="horizontal", shrink=0.8)
    _bare(axes, "light, % (green), from the white squares")
    axes = figure.add_subplot(top[1, :])
    _scatter_of_discs(axes, recorded, camera.camera_id)
    return figure


def _light_everywhere(discs: DiscSamples, pixels: FloatArray) -> FloatArray:
    """Extend the light at the discs, a quadratic surface, to pixels (..., 2)."""
    middle = discs.centres_px.mean(axis=0)

    def terms(places: FloatArray) -> FloatArray:
        u, v = np.moveaxis((places - middle) / 100, -1, 0)
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)

    levels = light_at(discs.centres_px, discs.white_rgb)
    surface, *_ = np.linalg.lstsq(terms(discs.centres_px), levels, rcond=None)
    return np.asarray(terms(pixels) @ surface)


def _bare(axes: "Axes", title: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])


def _scatter_of_discs(axes: "Axes", recorded: Recorded, camera: str) -> None:
    """Draw what discs read in all views, before and after."""
    samples = collect_samples(recorded.dataset.views[camera], recorded.nominal)
    assert samples is not None  # noqa: S101 (every view has discs)
    markers = recorded.nominal.markers
    names = ("white_95", "neutral_5", "orange", "foliage", "blue")
    for row, name in enumerate(names):
        mine = np.array([markers[index].name == name for index in samples.marker_ids])
        for shift, values, colour, label in (
            (0.15, samples.rgb, "tab:orange", "as read"),
            (-0.15, samples.even_rgb, "tab:blue", "divided by the light"),
        ):
            green = values[mine, 1]
            axes.plot(
                100 * (green / np.median(green) - 1), np.full(len(green), row + shift), "|",
                color=colour, markersize=9, label=label if row == 0 else None,
            )  # fmt: skip
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(f"green of a disc in {_N_FRAMES} views, % from its median")
    axes.legend(fontsize=8)


def falloff() -> Figure:
    """Draw the fall-off of two lenses: found from ratios, and true."""
    recorded = _recorded()
    frames = list(recorded.scene.world_from_board)
    _, found = solve(recorded, recorded.nominal, frames, "linear-white")
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for axes, camera in zip(
        figure.subplots(1, 2, sharey=True), recorded.scene.cameras, strict=True
    ):
        vignetting = found[camera.camera_id]
        way = np.array(camera.size_wh) - 1 - vignetting.centre_px
        steps = np.linspace(0, 1, 60)[:, None]
        pixels = vignetting.centre_px + steps * way
        radius = np.linalg.norm(steps * way, axis=1) / vignetting.half_diagonal_px
        gain, sigma = vignetting.gain(pixels)[:, 1], vignetting.sigma(pixels)[:, 1]
        rays = camera.lens.unproject(np.concatenate([pixels, vignetting.centre_px[None]]))
        cosine = (1 + (rays[:, :2] ** 2).sum(axis=1)) ** (-camera.vignetting_power / 2)
        axes.fill_between(
            radius, gain * (1 - 2 * sigma), gain * (1 + 2 * sigma), color="tab:blue", alpha=0.2,
            linewidth=0, label="± 2 sigma",
        )  # fmt: skip
        axes.plot(radius, gain, color="tab:blue", label="found")
        axes.plot(radius, cosine[:-1] / cosine[-1], "k--", linewidth=1, label="true")
        axes.axvline(vignetting.covered_radius, color="0.7", label="board seen up to here")
        axes.set_title(f"{camera.camera_id} ({camera.sensor.sensitivity})", fontsize=10)
        axes.set_xlabel("from the optical axis, in half diagonals of the picture")
        axes.grid(visible=True, color="0.93")
    figure.axes[0].set_ylabel("light, green")
    figure.axes[0].legend(fontsize=8)
    return figure
