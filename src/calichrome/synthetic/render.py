"""From a scene to the electrons that each pixel collects, before any noise.

Each pixel's ray is found once per camera by inverting the lens; board and surroundings are met by
these rays, so distortion and perspective are exact. Edges are anti-aliased and blurred in
`coverage`; light and vignetting, which are smooth, are taken at the pixel's centre.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.synthetic.coverage import filter_radius_px
from calichrome.synthetic.planes import Bounds, PlanePatch
from calichrome.synthetic.scene import (
    Panel,
    Scene,
    SceneCamera,
    SceneError,
    cosine_vignetting,
    faces,
    image_rng,
    irradiance,
    white_margin_m,
)
from calichrome.synthetic.spectra import Palette, camera_response, printed_palette
from calichrome.target import Target

__all__ = ["Renderer", "grain", "render_frame", "sheet_bounds"]

_TILE_CELLS = 64  # side of the noise tile that textures repeat
_OCTAVES = (1.0, 0.5, 0.25)  # size and strength of coarse, middle and fine grain


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What of a camera stays the same in all frames.

    `rays_cam` (H + 2 padding, W + 2 padding, 3) reaches beyond the picture; `surroundings`
    (H, W, 3) is camera radiance without vignetting; `responses` (2 + n_markers, n_sources, 3).
    """

    camera: SceneCamera
    padding: int
    rays_cam: FloatArray
    vignetting: FloatArray
    responses: FloatArray
    surroundings: FloatArray


class Renderer:
    """Renders the frames of one scene and keeps what frames share.

    Parameters
    ----------
    scene
        What to render.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.palette: Palette = printed_palette(
            scene.target, scene.palette_error_lab_sd, scene.seed
        )
        self._views: dict[str, _View] = {}

    def electrons(self, camera_id: str, frame_id: str) -> FloatArray:
        """Mean number of electrons per pixel behind R, G and B filters, (H, W, 3)."""
        if camera_id not in self._views:
            self._views[camera_id] = self._new_view(self.scene.camera(camera_id))
        view = self._views[camera_id]
        radiance = view.surroundings.copy()
        self._draw_board(view, self.scene.world_from_board[frame_id], radiance)
        radiance *= view.vignetting[..., None]
        radiance += view.camera.flare * radiance.mean(axis=(0, 1))
        return view.camera.exposure_e * radiance

    def _new_view(self, camera: SceneCamera) -> _View:
        padding = filter_radius_px(camera.psf_sigma_px) + 1  # one more for the interpolation
        width, height = camera.size_wh
        x, y = np.meshgrid(
            np.arange(-padding, width + padding), np.arange(-padding, height + padding)
        )
        pixels = np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)
        rays_cam = camera.lens.unproject(pixels).reshape(*x.shape, 3)
        if not np.isfinite(rays_cam).all():
            raise SceneError(
                f"camera {camera.camera_id}: its distortion folds inside the picture; reduce k1, "
                f"k2, k3 or the field of view"
            )
        sensitivity = camera.sensor.sensitivity
        view = _View(
            camera=camera,
            padding=padding,
            rays_cam=rays_cam,
            vignetting=cosine_vignetting(camera, rays_cam[padding:-padding, padding:-padding]),
            responses=camera_response(self.scene, sensitivity, self.palette.surfaces),
            surroundings=np.zeros((height, width, 3)),
        )
        for index, panel in enumerate(self.scene.panels):
            self._draw_panel(view, panel, image_rng(self.scene.seed, "texture", str(index)))
        return view

    def _draw_panel(self, view: _View, panel: Panel, rng: np.random.Generator) -> None:
        half_u, half_v = panel.half_size_m
        bounds = (-half_u, half_u, -half_v, half_v)
        patch = self._patch(view, panel.world_from_panel, bounds)
        if patch is None:
            return
        response = camera_response(
            self.scene, view.camera.sensor.sensitivity, panel.reflectance[None]
        )[0]
        texture = grain(rng, np.stack([patch.v, patch.u]) / panel.texture_m)
        gain = np.maximum(1 + panel.texture_contrast * texture, 0)
        colour = gain[..., None] * (self._light(panel.world_from_panel, patch) @ response)
        picture = view.surroundings[patch.slices]
        picture += patch.rectangle(bounds)[..., None] * (colour - picture)

    def _draw_board(self, view: _View, world_from_board: Pose, radiance: FloatArray) -> None:
        target = self.scene.target
        sheet = sheet_bounds(target)
        patch = self._patch(view, world_from_board, sheet)
        if patch is None:
            return
        from_behind = not faces(view.camera, world_from_board)
        light = self._light(world_from_board, patch, from_behind=from_behind)
        white, black = light @ view.responses[0], light @ view.responses[1]
        picture = radiance[patch.slices]
        picture += patch.rectangle(sheet)[..., None] * (white - picture)
        if from_behind:  # the back of the paper is plain
            return
        black_squares = patch.checkerboard(
            target.squares, target.square_m, black_first=target.top_left == "black"
        )
        picture += black_squares[..., None] * (black - white)
        for index, marker in enumerate(target.markers):
            u, v, _ = target.marker_centres_board[index]
            radius = marker.diameter_m / 2
            part = patch.around((u - radius, u + radius, v - radius, v + radius))
            if part is None:
                continue
            ground = view.responses[1 if marker.background == "black" else 0]
            change = self._light(world_from_board, part) @ (view.responses[2 + index] - ground)
            radiance[part.slices] += part.disc((u, v), radius)[..., None] * change

    def _patch(self, view: _View, world_from_plane: Pose, bounds: Bounds) -> PlanePatch | None:
        cam_from_plane = view.camera.cam_from_world @ world_from_plane
        return PlanePatch.whole_picture(
            view.rays_cam, cam_from_plane, view.padding, view.camera.psf_sigma_px
        ).around(bounds)

    def _light(
        self, world_from_plane: Pose, patch: PlanePatch, *, from_behind: bool = False
    ) -> FloatArray:
        points = np.stack([patch.u, patch.v, np.zeros_like(patch.u)], axis=-1)
        # The face of boards and panels looks against their z axis, the back of a board along it.
        normal_world = world_from_plane.rotation[:, 2] * (1 if from_behind else -1)
        return irradiance(self.scene, world_from_plane.apply(points), normal_world)


def render_frame(scene: Scene, camera_id: str, frame_id: str) -> FloatArray:
    """Mean number of electrons per pixel behind R, G and B filters, (H, W, 3).

    For several frames keep a `Renderer`: it inverts each camera's lens only once.
    """
    return Renderer(scene).electrons(camera_id, frame_id)


def sheet_bounds(target: Target) -> Bounds:
    """Return the edges of the paper on the board: all squares and the white around them."""
    margin = white_margin_m(target)
    width, height = target.square_m
    return (
        -width - margin,
        (target.squares[0] - 1) * width + margin,
        -height - margin,
        (target.squares[1] - 1) * height + margin,
    )


def grain(rng: np.random.Generator, position_vu: FloatArray) -> FloatArray:
    """Smooth noise of about unit variance at positions (2, h, w), in grains."""
    tile = rng.normal(0, 1, (_TILE_CELLS, _TILE_CELLS))
    layers = [
        size * map_coordinates(tile, position_vu / size, order=1, mode="grid-wrap")
        for size in _OCTAVES
    ]
    return np.asarray(np.sum(layers, axis=0))
