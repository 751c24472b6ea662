"""How the pixels of frames are stored."""

from dataclasses import dataclass
from typing import Literal, Self, get_args

import numpy as np

from calichrome.colorimetry.encoding import EncodingName
from calichrome.imaging import Image

__all__ = ["ChannelOrder", "FrameFormat", "PixelType"]

PixelType = Literal["uint8", "uint16", "float32"]
ChannelOrder = Literal["rgb", "bgr", "grey"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFormat:
    """How the pixels of a frame are stored.

    Parameters
    ----------
    dtype
        Of the numbers.
    order
        Of the channels; grey frames are (H, W), the others (H, W, 3).
    encoding
        How light became numbers; None: as the camera was calibrated, else by depth (8 bit sRGB,
        others linear).
    full_scale
        The largest number that is stored; None: 255, 65535 or 1 by `dtype`.

    Raises
    ------
    ValueError
        If `full_scale` is not positive.
    """

    dtype: PixelType = "uint8"
    order: ChannelOrder = "rgb"
    encoding: EncodingName | None = None
    full_scale: float | None = None

    def __post_init__(self) -> None:
        if self.full_scale is not None and not 0 < self.full_scale < np.inf:
            raise ValueError(f"full_scale={self.full_scale}: expected a positive number")

    @classmethod
    def of(cls, image: Image) -> Self:
        """Return how a picture is stored; its encoding is left to the camera."""
        names: tuple[PixelType, ...] = get_args(PixelType)
        return cls(
            dtype=next(name for name in names if image.pixels.dtype == name),
            order="rgb" if image.is_colour else "grey",
            full_scale=image.full_scale,
        )

    @property
    def n_channels(self) -> int:
        """1 or 3."""
        return 1 if self.order == "grey" else 3

    @property
    def top(self) -> float:
        """The number that means full scale."""
        return top_of(self.dtype) if self.full_scale is None else self.full_scale


def top_of(dtype: str) -> float:
    """Return the number that means full scale unless something else is said."""
    return 1.0 if dtype == "float32" else float(np.iinfo(dtype).max)
