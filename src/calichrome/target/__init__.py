"""What is printed, and how it is described to others."""

from calichrome.target.board import Marker, Paper, SquareColour, Target, chessboard
from calichrome.target.check import TargetProblem, check_target
from calichrome.target.colour_table import PaletteColour, read_colour_table
from calichrome.target.design import design_target
from calichrome.target.drawing import PrintedPage, write_pdf
from calichrome.target.fiducial import AprilGridTarget, CharucoTarget, CodedTarget
from calichrome.target.file import (
    load_target,
    parse_target,
    target_from_json,
    target_to_json,
    with_square_size,
)
from calichrome.target.layout import LayoutQuality, arrange_colours, layout_quality
from calichrome.target.measure import measured_target
from calichrome.target.page import PAPERS_M, parse_paper
from calichrome.target.palette import colour_checker_palette, read_palette

__all__ = [
    "PAPERS_M",
    "AprilGridTarget",
    "CharucoTarget",
    "CodedTarget",
    "LayoutQuality",
    "Marker",
    "PaletteColour",
    "Paper",
    "PrintedPage",
    "SquareColour",
    "Target",
    "TargetProblem",
    "arrange_colours",
    "check_target",
    "chessboard",
    "colour_checker_palette",
    "design_target",
    "layout_quality",
    "load_target",
    "measured_target",
    "parse_paper",
    "parse_target",
    "read_colour_table",
    "read_palette",
    "target_from_json",
    "target_to_json",
    "with_square_size",
    "write_pdf",
]
