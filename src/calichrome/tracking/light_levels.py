"""How much light each camera's side of the scene has, told by the objects themselves."""

from collections.abc import Mapping, Sequence

import numpy as np

from calichrome.tracking.track import Track

__all__ = ["light_levels"]

_ROUNDS = 20  # of medians; they settle after a few
_ENOUGH = 20  # looks of a camera at objects that others see as well


def light_levels(tracks: Sequence[Track]) -> Mapping[str, float]:
    """Return camera -> factor of the light in which it sees objects, 1 on average.

    Notes
    -----
    The rig's level stands on the light on the board where each camera saw it. Where light is
    uneven, that is not the same for all, and each camera sees another side of objects. With
    ``log Y = a(object, instant) + g(camera)`` the objects tell g, by medians in turn. It is a
    factor: hue and chromaticity stay as they were measured.
    """
    seen = [
        {c: np.log(s.colour.xyz_d65[1]) for c, s in step.sightings.items() if s.used and s.colour}
        for track in tracks
        for step in track.steps
    ]
    looks = [own for own in seen if len(own) > 1]
    cameras = sorted({camera for own in looks for camera in own})
    if not cameras:
        return {}
    values = np.array([[own.get(camera, np.nan) for camera in cameras] for own in looks])
    levels = np.zeros(len(cameras))
    for _ in range(_ROUNDS):
        objects = np.nanmean(values - levels, axis=1, keepdims=True)
        levels = np.nanmedian(values - objects, axis=0)
        levels -= levels.mean()
    known = np.isfinite(values).sum(axis=0) >= _ENOUGH
    return {
        camera: float(np.exp(level)) if enough else 1.0
        for camera, level, enough in zip(cameras, levels, known, strict=True)
    }
