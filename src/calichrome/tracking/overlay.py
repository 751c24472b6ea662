"""Objects drawn into the pictures that show them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calichrome.core.arrays import FloatArray, UInt8Array

__all__ = ["Mark", "draw_marks", "track_colour"]

_GOLDEN = 0.61803398875  # steps of this share of the hue circle never come close to each other
_SHIFT = 3  # OpenCV draws to 1/8 px


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mark:
    """What is drawn of one object in one picture.

    Parameters
    ----------
    track
        Its number, which chooses its colour.
    caption
        Beside the box.
    box
        Left, top, right, bottom in pixels, right and bottom outside; None: this camera does not see
        it now.
    tail_px : (N, 2) float
        Where its centre was, oldest first; nan where the camera does not see that place.
    used
        Its centre counts for the place; else the box is drawn thin.
    """

    track: int
    caption: str
    box: tuple[int, int, int, int] | None
    tail_px: FloatArray
    used: bool


def track_colour(track: int) -> tuple[int, int, int]:
    """Return a bright RGB of its own for a track."""
    hue = np.uint8(round(179 * (track * _GOLDEN % 1)))
    rgb = cv2.cvtColor(np.array([[[hue, 200, 255]]], dtype=np.uint8), cv2.COLOR_HSV2RGB)[0, 0]
    return int(rgb[0]), int(rgb[1]), int(rgb[2])


def draw_marks(picture: UInt8Array, marks: Sequence[Mark]) -> UInt8Array:
    """Return a copy of a picture (H, W, 3), RGB, with the objects marked."""
    drawn = np.ascontiguousarray(picture).copy()
    size = max(0.4, picture.shape[1] / 2000)
    for mark in marks:
        colour = track_colour(mark.track)
        tail = mark.tail_px[np.isfinite(mark.tail_px).all(axis=1)]
        tail = tail[(np.abs(tail) < 2 * max(picture.shape)).all(axis=1)]
        if len(tail) > 1:
            points = np.rint(tail * 2**_SHIFT).astype(np.int32)
            cv2.polylines(drawn, [points], False, colour, 1, cv2.LINE_AA, _SHIFT)  # noqa: FBT003
        if mark.box is None:
            continue
        left, top, right, bottom = mark.box
        cv2.rectangle(drawn, (left - 1, top - 1), (right, bottom), colour, 2 if mark.used else 1)
        place = (left, top - 5 if top > 20 else bottom + 14)
        for ink, width in (((0, 0, 0), 3), (colour, 1)):  # readable on every ground
            cv2.putText(
                drawn, mark.caption, place, cv2.FONT_HERSHEY_SIMPLEX, size, ink, width, cv2.LINE_AA
            )
    return drawn
