"""Pictures of the watched workspace: balls drawn over each camera's backdrop, far ones first.

A ball is met by the pixels' rays, so perspective and distortion are exact. Its edge is
anti-aliased and blurred as those of the board (`calichrome.synthetic.coverage`); its shading is
Lambert's under each lamp, with the shadows of boxes and of other balls, and is taken at the
pixel's centre. Balls darken what stands still where they hide a lamp from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.synthetic.coverage import filtered, pixels_per_unit, sampled, soft_step
from calichrome.synthetic.scene import Light, image_rng, irradiance
from calichrome.synthetic.sensor import develop, stored
from calichrome.synthetic.spectra import camera_response
from calichrome.synthetic.workspace.backdrop import Backdrop
from calichrome.synthetic.workspace.scene import Ball, Workspace
from calichrome.synthetic.workspace.shadows import blocked_by_ball, seen_past_boxes

__all__ = ["WorkspaceRenderer"]

_CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_FAINT_SHADOW = 0.02  # of a lamp: shadows that hide less of it everywhere are left out
_Part = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """A ball in a picture: the pixels it may touch, and which share of each is seen of it."""

    ball_id: int
    part: _Part
    seen: FloatArray


class WorkspaceRenderer:
    """Renders the frames of one workspace and keeps each camera's backdrop.

    Parameters
    ----------
    workspace
        What to render.
    """

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.positions_world = np.stack(
            [ball.path.positions_world(workspace.times_s) for ball in workspace.balls], axis=1
        )
        """Of each ball in each frame, (n_frames, n_balls, 3), metres."""
        # A ball is small beside a box's shadow: its middle tells for all of it.
        self._past_boxes = np.ones((*self.positions_world.shape[:2], len(workspace.scene.lights)))
        for index, lamp in enumerate(workspace.scene.lights):
            centres_world = self.positions_world.reshape(-1, 3)
            past = seen_past_boxes(lamp, centres_world, workspace.boxes)
            self._past_boxes[..., index] = past.reshape(self.positions_world.shape[:2])
        self._backdrops: dict[str, Backdrop] = {}
        self._responses: dict[str, FloatArray] = {}

    def picture(
        self, camera_id: str, frame_id: str, index: int | None
    ) -> tuple[NDArray[np.uint8] | NDArray[np.uint16], FloatArray]:
        """Return what a camera stores of a frame, (H, W, 3), and the share of each ball it sees.

        Parameters
        ----------
        frame_id
            Seeds the noise.
        index
            Number of the frame, from 0; None for the empty workspace.
        """
        electrons, seen = self.electrons(camera_id, index)
        camera = self.workspace.scene.camera(camera_id)
        rng = image_rng(self.workspace.scene.seed, "noise", camera_id, frame_id)
        return stored(develop(electrons, camera, rng), camera), seen

    def electrons(self, camera_id: str, index: int | None) -> tuple[FloatArray, FloatArray]:
        """Mean electrons per pixel behind R, G and B filters, and the share seen of each ball.

        Returns
        -------
        electrons : (H, W, 3) float
        seen : (n_balls,) float, 0..1
            Of the ball's whole outline, in the picture or not; 0 for the empty workspace.
        """
        backdrop = self._backdrop(camera_id)
        camera = backdrop.camera
        radiance, seen = backdrop.radiance.astype(np.float64), np.zeros(len(self.workspace.balls))
        if index is not None:
            self._cast_shadows(backdrop, self.positions_world[index], radiance)
            seen = self._draw_balls(backdrop, index, radiance)
        radiance *= backdrop.vignetting[..., None]
        radiance += camera.flare * radiance.mean(axis=(0, 1))
        radiance *= camera.exposure_e
        return radiance, seen

    def _backdrop(self, camera_id: str) -> Backdrop:
        if camera_id not in self._backdrops:
            scene = self.workspace.scene
            camera = scene.camera(camera_id)
            surfaces = np.stack([ball.reflectance for ball in self.workspace.balls])
            self._backdrops[camera_id] = Backdrop.trace(self.workspace, camera)
            self._responses[camera_id] = camera_response(scene, camera.sensor.sensitivity, surfaces)
        return self._backdrops[camera_id]

    def _cast_shadows(
        self, backdrop: Backdrop, balls_world: FloatArray, radiance: FloatArray
    ) -> None:
        """Take away the light that balls keep from what stands still."""
        for lamp, of_lamp in zip(self.workspace.scene.lights, backdrop.of_lamps, strict=True):
            hidden = np.zeros(radiance.shape[:2], dtype=np.float32)
            for ball, centre_world in zip(self.workspace.balls, balls_world, strict=True):
                part = self._shadow_part(backdrop, lamp, centre_world, ball.radius_m)
                if part is not None:
                    points_world = backdrop.points_world[part]
                    hidden[part] += blocked_by_ball(lamp, points_world, centre_world, ball.radius_m)
            radiance -= np.minimum(hidden, 1)[..., None] * of_lamp

    def _shadow_part(
        self, backdrop: Backdrop, lamp: Light, centre_world: FloatArray, radius_m: float
    ) -> _Part | None:
        """Return the pixels that a ball's shadow on the floor may reach."""
        floor = self.workspace.floor_m
        lamp_world = np.array(lamp.centre_world)
        step = centre_world - lamp_world
        if step[1] <= 0:
            return None
        stretch = (floor - lamp_world[1]) / step[1]  # 1 at the ball
        if (
            stretch <= 1
            or (radius_m * stretch / lamp.radius_m / (stretch - 1)) ** 2 < _FAINT_SHADOW
        ):
            return None
        reach = radius_m * stretch + lamp.radius_m * (stretch - 1)
        # A slanted cone is cut by the floor in an ellipse.
        reach *= np.linalg.norm(step) / step[1]
        around = lamp_world + stretch * step + reach * _CUBE * (1, 0, 1)
        return _part_of(backdrop, around)

    def _draw_balls(self, backdrop: Backdrop, frame: int, radiance: FloatArray) -> FloatArray:
        """Draw all balls, far ones first; return the share seen of each."""
        balls_world = self.positions_world[frame]
        balls_cam = backdrop.camera.cam_from_world.apply(balls_world)
        drawn: list[_Drawn] = []
        whole = np.ones(len(balls_world))
        for ball_id in np.argsort(-np.linalg.norm(balls_cam, axis=1)):
            ball = self.workspace.balls[ball_id]
            around = balls_world[ball_id] + ball.radius_m * _CUBE
            part = None if balls_cam[ball_id, 2] <= ball.radius_m else _part_of(backdrop, around)
            if part is None:
                continue
            cover, points_world, depth_m = _outline(backdrop, part, balls_cam[ball_id], ball)
            whole[ball_id] = max(_outline_area_px(backdrop, balls_cam[ball_id], ball), 1e-9)
            in_front = backdrop.box_depth_m[part] < depth_m
            cover *= 1 - np.where(in_front, backdrop.box_cover[part], 0.0)
            for other in drawn:
                _hide(other, part, cover)
            drawn.append(_Drawn(int(ball_id), part, cover.copy()))
            colour = (
                self._lit(frame, int(ball_id), points_world)
                @ self._responses[backdrop.camera.camera_id][ball_id]
            )
            radiance[part] += cover[..., None] * (colour - radiance[part])
        seen = np.zeros(len(balls_world))
        for item in drawn:
            seen[item.ball_id] = min(item.seen.sum() / whole[item.ball_id], 1.0)
        return seen

    def _lit(self, frame: int, ball_id: int, points_world: FloatArray) -> FloatArray:
        """Light on points of a ball, (h, w, n_sources)."""
        workspace, balls_world = self.workspace, self.positions_world[frame]
        centre_world = balls_world[ball_id]
        normals = (points_world - centre_world) / workspace.balls[ball_id].radius_m
        light = irradiance(workspace.scene, points_world, normals)
        for index, lamp in enumerate(workspace.scene.lights):
            light[..., index] *= self._past_boxes[frame, ball_id, index]
            for other, ball in enumerate(workspace.balls):
                reach = ball.radius_m + workspace.balls[ball_id].radius_m
                if other != ball_id and _may_shade(lamp, centre_world, balls_world[other], reach):
                    light[..., index] *= 1 - blocked_by_ball(
                        lamp, points_world, balls_world[other], ball.radius_m
                    )
        return light


def _may_shade(
    lamp: Light, centre_world: FloatArray, other_world: FloatArray, reach_m: float
) -> bool:
    """Whether a ball comes near the cone from a lamp to another ball."""
    to_lamp = np.array(lamp.centre_world) - centre_world
    to_other = other_world - centre_world
    along = float(to_other @ to_lamp / (to_lamp @ to_lamp))
    aside = float(np.linalg.norm(to_other - along * to_lamp))
    return 0 < along < 1 and aside < reach_m + lamp.radius_m * along


def _part_of(backdrop: Backdrop, points_world: FloatArray) -> _Part | None:
    """Return the pixels around points in space, padding included; None outside the picture."""
    camera = backdrop.camera
    points_cam = camera.cam_from_world.apply(points_world)
    if not camera.lens.sees(points_cam).all():
        return None
    pixels = camera.lens.project(points_cam)
    width, height = camera.size_wh
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - backdrop.padding, 0)
    x1, y1 = np.ceil(pixels.max(axis=0)).astype(int) + backdrop.padding + 1
    x1, y1 = min(x1, width), min(y1, height)
    return (slice(y0, y1), slice(x0, x1)) if x0 < x1 and y0 < y1 else None


def _outline(
    backdrop: Backdrop, part: _Part, centre_cam: FloatArray, ball: Ball
) -> tuple[FloatArray, FloatArray, float]:
    """Return the share of each pixel that a ball covers, its points (h, w, 3), and its depth."""
    rows, columns = part
    padding = backdrop.padding
    grown = (
        slice(rows.start, rows.stop + 2 * padding),
        slice(columns.start, columns.stop + 2 * padding),
    )
    rays = backdrop.rays_cam[grown]
    direction = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    along = direction @ centre_cam
    squared = float(centre_cam @ centre_cam)
    aside = np.sqrt(np.maximum(squared - along**2, 0))
    # How far a ray lies inside the cone that touches the ball, radians.
    inside = np.arcsin(ball.radius_m / np.sqrt(squared)) - np.arctan2(aside, along)
    edge = soft_step(sampled(inside) * pixels_per_unit(inside))
    cover = filtered(np.float32(0.5) * (1 + edge), backdrop.camera.psf_sigma_px)

    inner = slice(padding, -padding), slice(padding, -padding)
    halfway = np.sqrt(np.maximum(ball.radius_m**2 - aside[inner] ** 2, 0))
    apart = direction[inner] * (along[inner] - halfway)[..., None] - centre_cam
    # Rays that pass the ball by see its edge, which the blur carries to them.
    apart *= ball.radius_m / np.linalg.norm(apart, axis=-1, keepdims=True)
    points_world = backdrop.camera.cam_from_world.inverse().apply(centre_cam + apart)
    return np.asarray(cover, dtype=np.float64), points_world, float(centre_cam[2])


def _outline_area_px(backdrop: Backdrop, centre_cam: FloatArray, ball: Ball) -> float:
    """Area of a ball's whole outline in pixels, within the picture or not."""
    lens, step = backdrop.camera.lens, 1e-4
    around = centre_cam + step * centre_cam[2] * np.eye(3)[:2]
    pixels = lens.project(np.concatenate([centre_cam[None], around]))
    scale = abs(float(np.linalg.det(pixels[1:] - pixels[0]))) / step**2
    # A cone of half angle a about a direction at the angle b to the axis meets the plane z = 1 in
    # an ellipse with the half axes sin a cos a / (cos^2 b - sin^2 a) and the root of
    # sin^2 a / (cos^2 b - sin^2 a).
    squared = float(centre_cam @ centre_cam)
    sin2, cos2 = ball.radius_m**2 / squared, centre_cam[2] ** 2 / squared
    return float(scale * np.pi * sin2 * np.sqrt(1 - sin2) / (cos2 - sin2) ** 1.5)


def _hide(farther: _Drawn, part: _Part, cover: FloatArray) -> None:
    """Take from a ball that is farther away what a nearer one covers."""
    common = [
        (max(a.start, b.start), min(a.stop, b.stop))
        for a, b in zip(farther.part, part, strict=True)
    ]
    if any(first >= last for first, last in common):
        return
    theirs, ours = (
        tuple(
            slice(first - own.start, last - own.start)
            for (first, last), own in zip(common, item, strict=True)
        )
        for item in (farther.part, part)
    )
    farther.seen[theirs] *= 1 - cover[ours]
