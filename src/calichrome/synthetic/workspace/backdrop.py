"""The empty workspace as one camera sees it: traced once, with what each lamp adds to it.

Every panel and box is met by the pixel's ray, nearest first. Pixels at whose neighbours another
surface is met are traced again by 4 x 4 rays; the point spread follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.synthetic.coverage import SAMPLES, filter_radius_px
from calichrome.synthetic.render import grain
from calichrome.synthetic.scene import (
    Panel,
    SceneCamera,
    SceneError,
    cosine_vignetting,
    image_rng,
    irradiance,
)
from calichrome.synthetic.spectra import camera_response
from calichrome.synthetic.workspace.scene import Workspace
from calichrome.synthetic.workspace.shadows import seen_past_boxes

__all__ = ["Backdrop"]

_OFFSETS = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """What of a camera's view of a workspace stays the same in all frames.

    Parameters
    ----------
    padding
        Pixels by which `rays_cam` reaches beyond the picture.
    rays_cam : (H + 2 padding, W + 2 padding, 3) float
        With z = 1.
    vignetting : (H, W) float
        Share of light that reaches the picture.
    points_world : (H, W, 3) float, metres
        Of the surface at each pixel's centre.
    radiance : (H, W, 3) float
        Camera radiance without vignetting, all sources.
    of_lamps : (n_lights, H, W, 3) float
        What each lamp adds to it.
    box_cover : (H, W) float, 0..1
        Share of each pixel in which a box is seen.
    box_depth_m : (H, W) float
        z of the nearest box near the pixel; inf where there is none.
    """

    camera: SceneCamera
    padding: int
    rays_cam: FloatArray
    vignetting: FloatArray
    points_world: NDArray[np.float32]
    radiance: NDArray[np.float32]
    of_lamps: NDArray[np.float32]
    box_cover: FloatArray
    box_depth_m: FloatArray

    @classmethod
    def trace(cls, workspace: Workspace, camera: SceneCamera) -> "Backdrop":
        """Look at the empty workspace.

        Raises
        ------
        SceneError
            If the lens folds inside the picture, or a ray leaves the room.
        """
        padding = filter_radius_px(camera.psf_sigma_px) + 1  # one more for the interpolation
        rays_cam = _padded_rays(camera, padding)
        inner = rays_cam[padding:-padding, padding:-padding]
        height, width = inner.shape[:2]
        tracer = _Tracer(workspace, camera)
        panel, depth_m = tracer.meet(inner.reshape(-1, 3))
        light = tracer.light(inner.reshape(-1, 3), panel, depth_m)
        box = tracer.is_box[panel]
        cover = box.astype(np.float32)

        panel = panel.reshape(height, width)
        edge = maximum_filter(panel, 3) != minimum_filter(panel, 3)
        samples = _rays_inside(rays_cam, edge, padding)
        n_edge, n_samples = samples.shape[:2]
        met, met_m = tracer.meet(samples.reshape(-1, 3))
        fine = tracer.light(samples.reshape(-1, 3), met, met_m)
        light[:, edge.ravel()] = fine.reshape(-1, n_edge, n_samples, 3).mean(axis=2)
        cover[edge.ravel()] = tracer.is_box[met].reshape(n_edge, n_samples).mean(axis=1)

        blur = camera.psf_sigma_px
        light = gaussian_filter(light.reshape(-1, height, width, 3), (0, blur, blur, 0))
        box_depth_m = np.where(box, depth_m, np.inf).reshape(height, width)
        return cls(
            camera=camera,
            padding=padding,
            rays_cam=rays_cam,
            vignetting=cosine_vignetting(camera, inner),
            points_world=tracer.points_world(inner, depth_m.reshape(height, width)).astype(
                np.float32
            ),
            radiance=light.sum(axis=0),
            of_lamps=light[:-1],
            box_cover=gaussian_filter(cover.reshape(height, width), blur),
            box_depth_m=minimum_filter(box_depth_m, 2 * padding + 1),
        )


def _padded_rays(camera: SceneCamera, padding: int) -> FloatArray:
    width, height = camera.size_wh
    x, y = np.meshgrid(np.arange(-padding, width + padding), np.arange(-padding, height + padding))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)
    rays_cam = camera.lens.unproject(pixels).reshape(*x.shape, 3)
    if not np.isfinite(rays_cam).all():
        raise SceneError(
            f"camera {camera.camera_id}: its distortion folds inside the picture; reduce k1, k2, "
            f"k3 or the field of view"
        )
    return rays_cam / rays_cam[..., 2:]


def _rays_inside(rays_cam: FloatArray, chosen: BoolArray, padding: int) -> FloatArray:
    """4 x 4 rays through each chosen pixel, (n, 16, 3), from padded rays and their slopes."""
    place = np.pad(chosen, padding)
    down, across = (np.gradient(rays_cam, axis=axis)[place] for axis in (0, 1))
    y, x = (axis.ravel()[:, None] for axis in np.meshgrid(_OFFSETS, _OFFSETS, indexing="ij"))
    return np.asarray(rays_cam[place][:, None] + y * down[:, None] + x * across[:, None])


class _Tracer:
    """Meets rays of one camera, (n, 3) with z = 1, with everything that stands still."""

    def __init__(self, workspace: Workspace, camera: SceneCamera) -> None:
        self.scene, self.boxes = workspace.scene, workspace.boxes
        self.camera = camera
        self.world_from_cam = camera.cam_from_world.inverse()
        faces = [panel for box in workspace.boxes for panel in box.panels]
        self.panels: Sequence[Panel] = [*self.scene.panels, *faces]
        self.is_box = np.arange(len(self.panels)) >= len(self.scene.panels)
        reflectances = np.stack([panel.reflectance for panel in self.panels])
        self.responses = camera_response(self.scene, camera.sensor.sensitivity, reflectances)

    def points_world(self, rays_cam: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Points (..., 3) on rays at depths (...), metres."""
        return self.world_from_cam.apply(rays_cam * depth_m[..., None])

    def meet(self, rays_cam: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return which panel each ray meets first, and its depth along z, metres."""
        nearest = np.full(len(rays_cam), np.inf)
        first = np.full(len(rays_cam), -1)
        for index, panel in enumerate(self.panels):
            cam_from_panel = self.camera.cam_from_world @ panel.world_from_panel
            u_axis, v_axis, normal = cam_from_panel.rotation.T
            towards = rays_cam @ normal  # a panel is seen only against its z axis
            with np.errstate(divide="ignore"):
                depth_m = np.where(towards > 0, normal @ cam_from_panel.trans_m / towards, np.inf)
            closer = np.flatnonzero((depth_m > 0) & (depth_m < nearest))
            apart = rays_cam[closer] * depth_m[closer, None] - cam_from_panel.trans_m
            inside = np.abs(apart @ u_axis) <= panel.half_size_m[0]
            inside &= np.abs(apart @ v_axis) <= panel.half_size_m[1]
            nearest[closer[inside]] = depth_m[closer[inside]]
            first[closer[inside]] = index
        if (first < 0).any():
            raise SceneError(
                f"camera {self.camera.camera_id} looks out of the room; make the panels larger"
            )
        return first, nearest

    def light(
        self, rays_cam: FloatArray, panel_ids: IntArray, depth_m: FloatArray
    ) -> NDArray[np.float32]:
        """Camera radiance by lamp, then of all ambient light together, (n_lights + 1, n, 3)."""
        n_lights = len(self.scene.lights)
        result = np.zeros((n_lights + 1, len(rays_cam), 3), dtype=np.float32)
        for index in np.unique(panel_ids):
            panel, response = self.panels[index], self.responses[index]
            mine = np.flatnonzero(panel_ids == index)
            points_world = self.points_world(rays_cam[mine], depth_m[mine])
            u, v, _ = panel.world_from_panel.inverse().apply(points_world).T
            rng = image_rng(self.scene.seed, "texture", str(index))
            texture = 1 + panel.texture_contrast * grain(rng, np.stack([v, u]) / panel.texture_m)
            gain = np.maximum(texture, 0)[:, None]
            light = irradiance(self.scene, points_world, -panel.world_from_panel.rotation[:, 2])
            for lamp, source in enumerate(self.scene.lights):
                share = seen_past_boxes(source, points_world, self.boxes)
                result[lamp, mine] = gain * (share * light[:, lamp])[:, None] * response[lamp]
            result[-1, mine] = gain * (light[:, n_lights:] @ response[n_lights:])
        return result
