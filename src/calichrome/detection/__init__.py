"""Pixels to observations."""

from calichrome.detection.board import detect_board
from calichrome.detection.discs import BoardToPixels, measure_discs
from calichrome.detection.overlay import draw_overlay

__all__ = [
    "BoardToPixels",
    "detect_board",
    "draw_overlay",
    "measure_discs",
]
