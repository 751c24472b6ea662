"""Pixels to observations."""

from calichrome.detection.board import detect_board
from calichrome.detection.corners import seen_corner_counts
from calichrome.detection.discs import BoardToPixels, measure_discs
from calichrome.detection.lattice import no_order_fits
from calichrome.detection.overlay import draw_overlay

__all__ = [
    "BoardToPixels",
    "detect_board",
    "draw_overlay",
    "measure_discs",
    "no_order_fits",
    "seen_corner_counts",
]
