"""A picture with what was found drawn into it."""

import cv2
import numpy as np

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.target import Target

__all__ = ["draw_overlay"]

_CORNER, _FIRST, _TEXT = (255, 40, 40), (40, 220, 40), (255, 220, 0)
_SUBPIXEL_BITS = 4


def draw_overlay(image: Image, target: Target, found: BoardView | NotFound) -> UInt8Array:
    """Draw corners with ids, discs with the nominal colour, or the reason why there is nothing.

    Returns
    -------
    (H, W, 3) uint8
        sRGB. A disc's ring has its nominal colour; its filled part is what was measured.
    """
    grey_tones = np.rint(np.clip(image.grey(), 0, 255)).astype(np.uint8)
    canvas = np.repeat(grey_tones[..., None], 3, axis=2)
    if image.is_colour:
        everything = (slice(None), slice(None))
        canvas = np.rint(encode(image.linear(everything), "srgb") * 255).astype(np.uint8)
    canvas = np.ascontiguousarray(canvas)
    size = max(canvas.shape[1] / 1280, 0.5)
    if isinstance(found, NotFound):
        for line, text in enumerate(_wrapped(found.reason, 60)):
            place = (round(20 * size), round((40 + 30 * line) * size))
            cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.8 * size, _TEXT, 2)
        return canvas
    if found.discs is not None:
        _draw_discs(canvas, target, found, size)
    for corner, centre in zip(found.corner_ids, found.corners_px, strict=True):
        colour = _FIRST if corner == 0 else _CORNER
        _circle(canvas, centre, 4 * size, colour, 1)
        place = (round(centre[0] + 5 * size), round(centre[1] - 5 * size))
        cv2.putText(
            canvas,
            str(corner),
            place,
            cv2.FONT_HERSHEY_SIMPLEX,
            0.35 * size,
            colour,
            1,
            cv2.LINE_AA,
        )
    return canvas


def _draw_discs(canvas: UInt8Array, target: Target, found: BoardView, size: float) -> None:
    discs = found.discs
    assert discs is not None  # noqa: S101 (the caller looked)
    nominal = np.clip(target.marker_xyz_d65 @ RGB_FROM_XYZ["srgb"].T, 0, 1)
    nominal = np.rint(encode(nominal, "srgb") * 255)
    for index, marker in enumerate(discs.marker_ids):
        radius = float(np.sqrt(discs.n_px[index] / np.pi))
        _circle(canvas, discs.centres_px[index], radius, _TEXT, 1)
        colour = tuple(int(value) for value in nominal[marker])
        _circle(canvas, discs.centres_px[index], radius + 2 * size, colour, max(1, round(2 * size)))


def _circle(
    canvas: UInt8Array, centre: FloatArray, radius: float, colour: tuple[int, ...], width: int
) -> None:
    unit = 1 << _SUBPIXEL_BITS
    place = (round(centre[0] * unit), round(centre[1] * unit))
    cv2.circle(canvas, place, round(radius * unit), colour, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _wrapped(text: str, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines
