"""``calichrome target make | check``."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from calichrome.cli.palette import judged_palette, palette_lines, palette_to_json
from calichrome.cli.terminal import Command, Flag, Output, square_size
from calichrome.core.files import check_output, writing_file
from calichrome.core.units import parse_length
from calichrome.errors import TargetError
from calichrome.pipeline.scene_palette import scene_palette
from calichrome.target import (
    PaletteColour,
    SquareColour,
    check_target,
    colour_checker_palette,
    design_target,
    layout_quality,
    load_target,
    read_palette,
    target_to_json,
    write_pdf,
)

__all__ = ["TargetCheck", "TargetMake"]


def _length(option: str, text: str) -> float:
    try:
        return parse_length(text)
    except ValueError as error:
        raise TargetError(f"{option} {error}") from error


def _squares(text: str) -> tuple[int, int]:
    columns, cross, rows = text.partition("x")
    if not (cross and columns.isdigit() and rows.isdigit()):
        raise TargetError(f"--squares {text}: write columns x rows of squares, like 10x9")
    return int(columns), int(rows)


@dataclass(frozen=True, kw_only=True)
class TargetMake(Command):
    """Design a board and draw it for the printer."""

    squares: str = "10x9"
    """Columns x rows of squares."""
    square: str = "30mm"
    """Side of a square, with its unit."""
    paper: str = "A3"
    """A4 to A0, letter, tabloid, or WIDTHxHEIGHTmm."""
    palette: Path | None = None
    """Colours with names: CSV or CGATS (.txt, .ti3) of X,Y,Z, L,a,b or reflectances; default: the
    24 of the ColorChecker."""
    for_scene: Path | None = None
    """Picture or folder of white-balanced pictures: choose printable colours that cover theirs."""
    plain: Flag = False
    """A chessboard without colours."""
    disc_ratio: float = 0.5
    """Diameter of a disc by the side of a square."""
    top_left: SquareColour = "black"
    """Colour of the top-left square."""
    printable_margin: str = "5mm"
    """Edge of the paper that the printer cannot reach."""
    illuminant: str | None = None
    """Of the palette, where its file does not say it."""
    observer: str | None = None
    """Of the palette, where its file does not say it."""
    seed: int = 0
    """Another seed arranges the colours in another way."""
    output: Annotated[Path, Output] = Path("target.json")
    """target.json; the PDF is written beside it under the same name."""
    force: Flag = False
    """Replace existing outputs."""

    def run(self) -> int:
        """Design, draw and write both files."""
        if self.seed < 0:
            raise TargetError(f"--seed {self.seed}: give 0 or more")
        page_path = self.output.with_suffix(".pdf")
        for path in (self.output, page_path):
            check_output(path, force=self.force)
        target = design_target(
            squares=_squares(self.squares),
            square_m=square_size(self.square),
            palette=self._palette(),
            disc_ratio=self.disc_ratio,
            top_left=self.top_left,
            seed=self.seed,
        )
        page = write_pdf(
            target,
            page_path,
            paper=self.paper,
            printable_margin_m=_length("--printable-margin", self.printable_margin),
        )
        target = replace(target, white_margin_m=page.white_margin_m)
        with writing_file(self.output, force=self.force) as temporary:
            temporary.write_text(json.dumps(target_to_json(target), indent=1) + "\n")
        nx, ny = target.corners_xy
        lines = [
            (
                f"Wrote {self.output} and {page_path}: {nx}x{ny} inner corners, "
                f"{len(target.markers)} discs, white margin {page.white_margin_m * 1e3:.1f} mm"
            ),
            (
                "Print at 100 % on matte paper, glue it to something flat, measure the ruler, and "
                "give the true size with --square."
            ),
        ]
        quality = layout_quality(target)
        if quality is not None:
            lines.append(
                f"Any two 4x3 parts of the board differ in {quality.least_differing} squares or "
                f"more."
            )
        if page.clipped_colours:
            lines.append(
                f"Outside the sRGB gamut, so printed paler: {', '.join(page.clipped_colours)}"
            )
        judged = judged_palette(target)
        if judged is not None:
            lines += palette_lines(judged, every=False)
        self.show(
            "\n".join(lines),
            {
                "target": str(self.output),
                "pdf": str(page_path),
                "corners_xy": [nx, ny],
                "palette": palette_to_json(judged),
            },
        )
        return 0

    def _palette(self) -> tuple[PaletteColour, ...]:
        ways = ("--plain", self.plain), ("--palette", self.palette), ("--for-scene", self.for_scene)
        given = [name for name, value in ways if value]
        if len(given) > 1:
            raise TargetError(f"{' and '.join(given)} name different colours; give one of them")
        if self.plain:
            return ()
        if self.for_scene is not None:
            return scene_palette(self.for_scene)
        if self.palette is not None:
            return read_palette(self.palette, illuminant=self.illuminant, observer=self.observer)
        return colour_checker_palette()


@dataclass(frozen=True, kw_only=True)
class TargetCheck(Command):
    """Say what is wrong with a target.json, and what its colours are good for."""

    target: Positional[Path]
    """target.json."""

    def run(self) -> int:
        """Check; exit code 1 if there is an error, 0 with remarks only."""
        target = load_target(self.target)
        problems = check_target(target)
        judged = judged_palette(target)
        lines = [f"{item.severity:7} {item.text}" for item in problems]
        lines = lines or [f"{self.target}: nothing to remark"]
        if judged is not None:
            lines += palette_lines(judged, every=True)
        data = [{"severity": item.severity, "text": item.text} for item in problems]
        self.show("\n".join(lines), {"problems": data, "palette": palette_to_json(judged)})
        return 1 if any(item.severity == "error" for item in problems) else 0
