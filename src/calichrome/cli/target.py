"""``calichrome target make | check | measure``."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from calichrome.cli.palette import judged_palette, palette_lines, palette_to_json
from calichrome.cli.terminal import Command, Flag, Output
from calichrome.core.files import check_output, writing_file
from calichrome.core.units import parse_length, parse_lengths
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
    measured_target,
    read_colour_table,
    read_palette,
    target_to_json,
    with_square_size,
    write_pdf,
)

__all__ = ["TargetCheck", "TargetMake", "TargetMeasure"]


def _length(option: str, text: str) -> float:
    try:
        return parse_length(text)
    except ValueError as error:
        raise TargetError(f"{option} {error}") from error


def _square(text: str) -> tuple[float, float]:
    try:
        return parse_lengths(text)
    except ValueError as error:
        raise TargetError(f"--square {error}") from error


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
    """CSV of colours (name and X,Y,Z or L,a,b); default: the 24 of the ColorChecker."""
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
    """Of the palette, where the CSV does not say it."""
    observer: str | None = None
    """Of the palette, where the CSV does not say it."""
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
            square_m=_square(self.square),
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


@dataclass(frozen=True, kw_only=True)
class TargetMeasure(Command):
    """Replace nominal colours and sizes by measured ones."""

    target: Positional[Path]
    """target.json as printed."""
    values: Path | None = None
    """CSV of name and X,Y,Z or L,a,b; rows paper_white and paper_black measure the paper."""
    illuminant: Literal["D50", "D65"] | None = None
    """Of the values, where the CSV has no column illuminant."""
    observer: str | None = None
    """Of the values, where the CSV has no column observer; 2 (degrees)."""
    square: str | None = None
    """Measured size of a square, like 39.7mm or 39.7x39.9mm."""
    output: Annotated[Path, Output]
    """Where to write the measured target.json."""
    force: Flag = False
    """Replace an existing output."""

    def run(self) -> int:
        """Read, replace and write."""
        check_output(self.output, force=self.force)
        if self.values is None and self.square is None:
            raise TargetError(
                "nothing was measured; give --values FILE.csv, --square SIZE, or both"
            )
        target = load_target(self.target)
        said = []
        if self.values is not None:
            values = read_colour_table(
                self.values, illuminant=self.illuminant, observer=self.observer
            )
            target = measured_target(target, values)
            said.append(f"{len(values)} colours")
        if self.square is not None:
            target = with_square_size(target, _square(self.square))
            said.append(f"squares of {self.square}")
        with writing_file(self.output, force=self.force) as temporary:
            temporary.write_text(json.dumps(target_to_json(target), indent=1) + "\n")
        self.show(
            f"Wrote {self.output} with measured {' and '.join(said)}", {"target": str(self.output)}
        )
        return 0
