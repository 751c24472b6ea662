"""ICC profiles of the output spaces, for pictures that say what their numbers mean."""

import struct
from functools import cache
from types import MappingProxyType

import numpy as np

from calichrome.colorimetry.adaptation import D65, adapt
from calichrome.colorimetry.rgb_spaces import XYZ_FROM_RGB
from calichrome.core.arrays import FloatArray

__all__ = ["icc_profile"]

_NAMES = MappingProxyType({"srgb": "sRGB", "display-p3": "Display P3"})
_PCS_WHITE = np.array([0.9642, 1.0, 0.8249])  # D50 as the profile connection space has it
_SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)  # IEC 61966-2-1
_NO_PATENT = "No copyright, use freely"


@cache
def icc_profile(space: str) -> bytes | None:
    """Return the profile of "srgb" or "display-p3"; None for spaces that pictures need not name.

    A matrix and the sRGB curve (function type 3), version 4.

    References
    ----------
    .. [1] ICC.1:2022, "Image technology colour management", sections 7.2, 8.3, 9.2, 10.
    """
    if space not in _NAMES:
        return None
    red, green, blue = adapt(XYZ_FROM_RGB[space].T, D65, _PCS_WHITE)
    to_pcs = adapt(np.eye(3), D65, _PCS_WHITE).T
    curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0) + _fixed(np.array(_SRGB_CURVE))
    tags = {
        b"desc": _text(_NAMES[space]),
        b"cprt": _text(_NO_PATENT),
        b"wtpt": _xyz(_PCS_WHITE),
        b"chad": b"sf32" + bytes(4) + _fixed(to_pcs),
        b"rXYZ": _xyz(red),
        b"gXYZ": _xyz(green),
        b"bXYZ": _xyz(blue),
        b"rTRC": curve,
        b"gTRC": curve,
        b"bTRC": curve,
    }
    return _assembled(tags)


def _fixed(values: FloatArray) -> bytes:
    """Numbers as s15Fixed16."""
    return np.rint(np.asarray(values) * 65536).astype(">i4").tobytes()


def _xyz(values: FloatArray) -> bytes:
    return b"XYZ " + bytes(4) + _fixed(values)


def _text(text: str) -> bytes:
    """One record of multiLocalizedUnicodeType."""
    encoded = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">IIIHHII", 0, 1, 12, 0x656E, 0x5553, len(encoded), 28) + encoded


def _assembled(tags: dict[bytes, bytes]) -> bytes:
    """Header, table of tags, and what they hold, each from a multiple of four; equal ones once."""
    start = 128 + 4 + 12 * len(tags)
    places: dict[bytes, int] = {}
    body = b""
    for content in tags.values():
        if content not in places:
            places[content] = start + len(body)
            body += content + bytes(-len(content) % 4)
    table = struct.pack(">I", len(tags)) + b"".join(
        name + struct.pack(">II", places[content], len(content)) for name, content in tags.items()
    )
    header = (
        struct.pack(">I4sI", start + len(body), bytes(4), 0x04400000)
        + b"mntrRGB XYZ "
        + struct.pack(">6H", 2026, 1, 1, 0, 0, 0)
        + b"acsp"
        + bytes(28)
        + _fixed(_PCS_WHITE)
        + bytes(48)
    )
    return header + table + body
