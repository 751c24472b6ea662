"""What one picture says of the board."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["BoardView", "DiscSamples", "NotFound"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiscSamples:
    """Colours of the discs of one picture, in linear camera values 0..1 of full scale.

    Parameters
    ----------
    marker_ids : (M,) int
        Which discs; discs that were not seen are absent.
    centres_px : (M, 2) float
    mean_rgb, median_rgb : (M, 3) float
    cov_rgb : (M, 3, 3) float
        Covariance of one pixel about the mean times the pixels that repeat one measurement (as
        demosaicing makes them); divide by `n_px` for the mean's own.
    n_px : (M,) int
        Pixels in the region grown from the seed.
    clipped : (M,) float
        Share of the disc's pixels with a channel at full scale.
    white_rgb, black_rgb : (M, 3) float
        Level of the white and black squares at the disc; nan where they are clipped or hidden.
    """

    marker_ids: IntArray
    centres_px: FloatArray
    mean_rgb: FloatArray
    median_rgb: FloatArray
    cov_rgb: FloatArray
    n_px: IntArray
    clipped: FloatArray
    white_rgb: FloatArray
    black_rgb: FloatArray

    def __len__(self) -> int:
        return len(self.marker_ids)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The board in one picture.

    Parameters
    ----------
    corner_ids : (N,) int
        Row-major indices of inner corners.
    corners_px : (N, 2) float
        Pixel (0, 0) is the centre of the top-left pixel.
    cov_px : (N, 2, 2) float, or None
        Covariance of each corner, px^2; None if it was not estimated.
    cov_scale
        Mean squared misfit of the corners to a smooth board over what white noise explains; above 1
        a floor common to all corners was added to `cov_px`, below 1 it was multiplied by it.
    half_turn_ambiguous
        True if the board looks the same after half a turn, so that the ids may be turned.
    discs
        None if the target has no discs, or the picture no colour.
    """

    corner_ids: IntArray
    corners_px: FloatArray
    cov_px: FloatArray | None = None
    cov_scale: float = 1.0
    half_turn_ambiguous: bool = False
    discs: DiscSamples | None = None

    def __post_init__(self) -> None:
        if self.corners_px.shape != (len(self.corner_ids), 2):
            raise ValueError(
                f"corners_px: expected shape ({len(self.corner_ids)}, 2), got "
                f"{self.corners_px.shape}"
            )
        if not np.isfinite(self.corners_px).all():
            raise ValueError("corners_px: holds a value that is not finite")


@dataclass(frozen=True, slots=True)
class NotFound:
    """No board in this picture, and why: an answer, not an error."""

    reason: str
