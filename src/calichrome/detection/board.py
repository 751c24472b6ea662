"""The one entry: a picture in, the board or the reason why not out."""

import numpy as np

from calichrome.detection.corners import corner_spacing, find_corner_grid, refine_corners
from calichrome.detection.discs import local_homographies, measure_discs
from calichrome.detection.fiducials import detect_coded_board
from calichrome.detection.lattice import goes_on, is_regular, orient_grid
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.target import CodedTarget, Target

__all__ = ["detect_board"]

_MIN_SPACING_PX = 6.0
"""Below this the refinement window of +-2 px covers two thirds of the way to the neighbouring
corners, which then pull on the corner."""


def detect_board(image: Image, target: Target) -> BoardView | NotFound:
    """Find the whole board in one picture.

    Parameters
    ----------
    image
        Grey or colour, encoded or linear.
    target
        The board to look for.

    Returns
    -------
    BoardView
        All inner corners with ids; discs where the target has them and the picture is in colour.
    NotFound
        With a reason that a person at the camera can act on.
    """
    if isinstance(target, CodedTarget):
        return detect_coded_board(image, target)
    grey = image.grey()
    grey8 = np.rint(np.clip(grey, 0, 255)).astype(np.uint8)
    grid = find_corner_grid(grey8, target.corners_xy)
    nx, ny = target.corners_xy
    if grid is None:
        return NotFound(_why_not(image, grey8, f"no whole board of {nx}x{ny} inner corners"))
    if corner_spacing(grid).min() < _MIN_SPACING_PX:
        return NotFound(
            f"squares of {corner_spacing(grid).min():.0f} px are too small to measure; bring the "
            f"board nearer"
        )
    grid = refine_corners(grey, grid)
    if not is_regular(grid):
        return NotFound(f"what looks like {nx}x{ny} corners is no even grid; is it another board?")
    if goes_on(grid, grey):
        return NotFound(
            f"the board goes on beyond {nx}x{ny} inner corners; count them again and correct "
            f"--target"
        )
    oriented = orient_grid(grid, grey, target)
    if isinstance(oriented, str):
        return NotFound(oriented)
    discs = None
    if target.markers and image.is_colour:
        to_pixels = local_homographies(oriented.corners_px, target.square_m)
        discs = measure_discs(image, target, to_pixels)
    return BoardView(
        corner_ids=np.arange(target.n_corners),
        corners_px=oriented.corners_px.reshape(-1, 2),
        half_turn_ambiguous=oriented.half_turn_ambiguous,
        discs=discs,
    )


def _why_not(image: Image, grey8: np.typing.NDArray[np.uint8], what: str) -> str:
    """Add what a person can do to the fact that nothing was found."""
    everything = (slice(None), slice(None))
    clipped = float(image.is_clipped(everything).mean())
    if clipped > 0.2:
        return f"{what}: {clipped:.0%} of the picture is overexposed; close the aperture"
    contrast = float(np.quantile(grey8, 0.99)) - float(np.quantile(grey8, 0.01))
    if contrast < 40:
        return f"{what}: the picture has only {contrast:.0f} of 255 levels; add light"
    return f"{what}; show it whole, with its white margin, sharp and without shadows"
