"""How much of a lamp is seen from a point: the shadows of balls and of boxes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.synthetic.scene import Light
from calichrome.synthetic.workspace.scene import Box

__all__ = ["blocked_by_ball", "seen_past_boxes"]

_LAMP_POINTS = 24  # on a lamp, for the shadows of boxes
_GOLDEN_RAD = np.pi * (3 - np.sqrt(5))


def seen_past_boxes(light: Light, points_world: FloatArray, boxes: Sequence[Box]) -> FloatArray:
    """Share of a round lamp that no box hides from points (n, 3), 0..1."""
    if not boxes:
        return np.ones(len(points_world))
    centre = np.array(light.centre_world)
    to_lamp = centre - points_world
    near = np.zeros(len(points_world), dtype=bool)
    for box in boxes:  # whose sphere the line to the lamp comes close to
        to_box = box.world_from_box.trans_m - points_world
        along = (to_box * to_lamp).sum(axis=1) / (to_lamp**2).sum(axis=1)
        aside = np.linalg.norm(to_box - np.clip(along, 0, 1)[:, None] * to_lamp, axis=1)
        near |= aside < box.reach_m + light.radius_m
    share = np.ones(len(points_world))
    starts = points_world[near]
    visible = np.zeros(len(starts))
    for point in centre + _points_on(light):
        visible += ~np.logical_or.reduce([box.blocks(starts, point) for box in boxes])
    share[near] = visible / _LAMP_POINTS
    return share


def _points_on(light: Light) -> FloatArray:
    """Points evenly over the face of a lamp, (n, 3), about its centre, metres."""
    axis = np.array(light.axis_world) / np.linalg.norm(light.axis_world)
    x = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    x /= np.linalg.norm(x)
    index = np.arange(_LAMP_POINTS)
    radius = light.radius_m * np.sqrt((index + 0.5) / _LAMP_POINTS)
    angle = index * _GOLDEN_RAD
    across = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(axis, x)
    return np.asarray(radius[:, None] * across)


def blocked_by_ball(
    light: Light, points_world: NDArray[np.floating], centre_world: FloatArray, radius_m: float
) -> FloatArray:
    """Share of a round lamp that a ball hides from points (..., 3), 0..1.

    Both are taken as discs across the line of sight: the area that two circles share, over that of
    the lamp's.
    """
    to_lamp = np.array(light.centre_world, dtype=points_world.dtype) - points_world
    to_ball = centre_world.astype(points_world.dtype) - points_world
    squared = _dot(to_lamp, to_lamp)
    # Where on the way to the lamp the ball is, 0..1; the lamp's disc shrinks with it.
    along = _dot(to_ball, to_lamp) / squared
    aside2 = _dot(to_ball, to_ball) - along**2 * squared
    reach = max(light.radius_m, 1e-6) * along + radius_m
    near = (along > 0) & (along < 1) & (aside2 < reach**2)
    share = np.zeros(near.shape)
    lamp = reach[near].astype(np.float64) - radius_m
    area = _shared_area(lamp, radius_m, np.sqrt(np.maximum(aside2[near], 0)))
    share[near] = area / (np.pi * lamp**2)
    return share


def _dot(a: NDArray[np.floating], b: NDArray[np.floating]) -> FloatArray:
    return np.asarray(np.einsum("...i,...i", a, b))


def _shared_area(a: FloatArray, b: float, apart: FloatArray) -> FloatArray:
    """Area that circles of radius a and b share, their centres `apart` < a + b."""
    d = np.maximum(apart, np.abs(a - b) + 1e-9)  # nearer, the smaller circle lies in the larger
    angle_a = np.arccos(np.clip((d**2 + a**2 - b**2) / (2 * d * a), -1, 1))
    angle_b = np.arccos(np.clip((d**2 + b**2 - a**2) / (2 * d * b), -1, 1))
    lens = a**2 * (angle_a - np.sin(2 * angle_a) / 2) + b**2 * (angle_b - np.sin(2 * angle_b) / 2)
    return np.asarray(np.where(apart <= np.abs(a - b), np.pi * np.minimum(a, b) ** 2, lens))
