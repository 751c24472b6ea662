"""The page for the printer: exact scale, vectors, tagged sRGB.

Everything on the page is placed in metres from its lower-left corner, y up, as PDF has it.
"""

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.units import parse_lengths
from calichrome.errors import OutputError, TargetError
from calichrome.target.board import Marker, Target

if TYPE_CHECKING:
    from reportlab.pdfgen.canvas import Canvas

__all__ = ["PAPERS_M", "PrintedPage", "parse_paper", "smallest_white_margin_m", "write_pdf"]

PAPERS_M = {
    "A4": (0.210, 0.297),
    "letter": (0.2159, 0.2794),
    "tabloid": (0.2794, 0.4318),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
"""Papers by name, metres (ISO 216, ANSI/ASME Y14.1)."""

_POINT_M = 0.0254 / 72
_LARGEST_PAGE_M = 14_400 * _POINT_M  # ISO 32000-1, annex C.2
_RULERS_M = (0.200, 0.150, 0.100, 0.050)
_STRIP_M = 0.017
"""Width of the strip beside the board: ruler 8 mm, two lines of text."""

_SMALLEST_MARGIN_M = 0.006
_MARGIN_SQUARES = 1 / 3
_GAMUT_TOLERANCE = 5e-4  # of linear RGB; below one step of 8 bits

Side = Literal["below", "right"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedPage:
    """What came out on the page.

    Parameters
    ----------
    paper_wh_m
        Width and height of the page as written, metres.
    white_margin_m
        White between the squares and the nearest ink or edge of the paper; belongs into
        target.json.
    ruler_m
        Length of the printed ruler.
    clipped_colours
        Names of the colours outside sRGB, printed as the nearest value of each channel.
    """

    paper_wh_m: tuple[float, float]
    white_margin_m: float
    ruler_m: float
    clipped_colours: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placing:
    """Where things are on the page, metres; x right, y up."""

    page_wh: tuple[float, float]
    board_xy: tuple[float, float]
    side: Side
    strip_length: float
    white_margin: float


def parse_paper(text: str) -> tuple[float, float]:
    """Return width and height in metres of "A3" or "600x900mm".

    Raises
    ------
    TargetError
        If it is neither the name of a paper nor a size that a page can have.
    """
    for name, size in PAPERS_M.items():
        if text.strip().casefold() == name.casefold():
            return size
    try:
        width, height = parse_lengths(text)
    except ValueError as error:
        raise TargetError(
            f"paper {text!r}: write {', '.join(PAPERS_M)} or a size like 600x900mm"
        ) from error
    return width, height


def smallest_white_margin_m(square_m: tuple[float, float]) -> float:
    """Return the white that must stay around the squares.

    The outer black squares are found by their outline against white. At the smallest squares that
    a picture should show, 20 px, a third of a square is 6.7 px: the blur of both edges (2 sigma_psf
    each) and the pixels between which a threshold is taken. 6 mm is what a clip or a fingertip at
    the edge of the sheet covers.
    """
    return max(_MARGIN_SQUARES * max(square_m), _SMALLEST_MARGIN_M)


def write_pdf(
    target: Target,
    path: Path,
    *,
    paper: str | tuple[float, float] = "A3",
    printable_margin_m: float = 0.005,
    title: str = "calichrome target",
) -> PrintedPage:
    """Write the board as a page at exact scale.

    Parameters
    ----------
    target
        What to print.
    path
        The PDF; replaced if it exists. Equal arguments give equal bytes.
    paper
        A name of `PAPERS_M`, "WIDTHxHEIGHTmm", or width and height in metres. The page is turned
        so that the board fits best.
    printable_margin_m
        Edge of the paper that the printer cannot reach. Nothing is drawn there; it is white all
        the same and counts as white margin of the board.
    title
        Title of the document.

    Raises
    ------
    TargetError
        If the board does not fit (naming the squares and the paper that would).
    OutputError
        If the file cannot be written.
    """
    paper_wh = parse_paper(paper) if isinstance(paper, str) else paper
    if not (min(paper_wh) > 0 and max(paper_wh) <= _LARGEST_PAGE_M):
        raise TargetError(
            f"paper of {paper_wh[0]:g} x {paper_wh[1]:g} m: a PDF page may be up to "
            f"{_LARGEST_PAGE_M:.2f} m long; use a smaller one"
        )
    if not 0 <= printable_margin_m < min(paper_wh) / 2:
        raise TargetError(
            f"a printable margin of {printable_margin_m * 1e3:g} mm leaves nothing of the paper; "
            f"give the edge that the printer cannot reach, usually 5 mm"
        )
    placing = _place(target, paper_wh, printable_margin_m)
    if placing is None:
        raise TargetError(_does_not_fit(target, paper_wh, printable_margin_m))
    ruler_m = next(
        (length for length in _RULERS_M if length + 0.012 <= placing.strip_length), _RULERS_M[-1]
    )
    pdf, clipped = _drawn(target, placing, ruler_m, printable_margin_m, title)
    _replace_file(path, _tagged_srgb(pdf))
    return PrintedPage(
        paper_wh_m=placing.page_wh,
        white_margin_m=round(placing.white_margin, 6),
        ruler_m=ruler_m,
        clipped_colours=clipped,
    )


def _board_wh(target: Target) -> tuple[float, float]:
    return target.squares[0] * target.square_m[0], target.squares[1] * target.square_m[1]


def _place(target: Target, paper_wh: tuple[float, float], edge: float) -> _Placing | None:
    """Find the turn of the paper and the side of the ruler that leave the board most white."""
    width, height = _board_wh(target)
    needed = smallest_white_margin_m(target.square_m)
    best: _Placing | None = None
    sides: tuple[Side, ...] = ("below", "right")
    for page_wh, side in product(dict.fromkeys([paper_wh, paper_wh[::-1]]), sides):
        strip = edge + _STRIP_M
        free_w, free_h = page_wh[0] - width, page_wh[1] - height
        if side == "below":
            x, y = free_w / 2, max(free_h / 2, (free_h + strip) / 2)
            left, top, to_strip = x, free_h - y, y - strip
            margin, ink = min(left, top, to_strip), min(left, top)
        else:
            x, y = (free_w - strip) / 2, free_h / 2
            left, top, to_strip = x, y, free_w - x - strip
            margin, ink = min(left, top, to_strip), min(left, top)
        along = page_wh[0] if side == "below" else page_wh[1]
        length = along - 2 * edge
        if margin < needed - 1e-9 or ink < edge - 1e-9 or length < _RULERS_M[-1] + 0.012:
            continue
        if best is None or margin > best.white_margin + 1e-9:
            best = _Placing(
                page_wh=page_wh,
                board_xy=(x, y),
                side=side,
                strip_length=length,
                white_margin=margin,
            )
    return best


def _scaled(target: Target, factor: float) -> Target:
    square_m = target.square_m[0] * factor, target.square_m[1] * factor
    return replace(target, square_m=square_m, markers=())


def _does_not_fit(target: Target, paper_wh: tuple[float, float], edge: float) -> str:
    width, height = _board_wh(target)
    remedies = []
    largest = _largest_square_mm(target, paper_wh, edge)
    if largest:
        remedies.append(f"squares of {largest} fit")
    by_area = sorted(PAPERS_M, key=lambda name: PAPERS_M[name][0] * PAPERS_M[name][1])
    name = next((name for name in by_area if _place(target, PAPERS_M[name], edge)), None)
    remedies.append(f"paper {name} holds this board" if name else "no listed paper is large enough")
    return (
        f"{target.squares[0]}x{target.squares[1]} squares of {_size_mm(target)} mm are "
        f"{width * 1e3:.0f} x {height * 1e3:.0f} mm and do not fit on paper of "
        f"{paper_wh[0] * 1e3:.0f} x {paper_wh[1] * 1e3:.0f} mm with "
        f"{smallest_white_margin_m(target.square_m) * 1e3:.1f} mm of white around them, a ruler "
        f"beside them, and {edge * 1e3:g} mm that the printer cannot reach; {', '.join(remedies)}"
    )


def _largest_square_mm(target: Target, paper_wh: tuple[float, float], edge: float) -> str | None:
    """Return the largest squares that fit, in tenths of a millimetre; None if none does."""
    low, high = 0.0, 1.0  # shares of the asked size; the whole does not fit
    for _ in range(40):
        middle = (low + high) / 2
        fits = _place(_scaled(target, middle), paper_wh, edge) is not None
        low, high = (middle, high) if fits else (low, middle)
    sides = [np.floor(side * low * 1e4 + 1e-6) / 10 for side in target.square_m]
    if min(sides) < 1:
        return None
    return f"{sides[0]:g}mm" if sides[0] == sides[1] else f"{sides[0]:g}x{sides[1]:g}mm"


def _size_mm(target: Target) -> str:
    width, height = (f"{side * 1e3:.6g}" for side in target.square_m)
    return width if width == height else f"{width} x {height}"


def _drawn(
    target: Target, placing: _Placing, ruler_m: float, edge: float, title: str
) -> tuple[bytes, tuple[str, ...]]:
    from reportlab.pdfgen.canvas import Canvas

    page_pt = placing.page_wh[0] / _POINT_M, placing.page_wh[1] / _POINT_M
    buffer = io.BytesIO()
    canvas = Canvas(buffer, pagesize=page_pt, invariant=1, pageCompression=1)
    canvas.setTitle(title)
    canvas.setSubject(" ".join(_sentences(target, ruler_m)))
    canvas.setCreator("calichrome")
    canvas.setViewerPreference("PrintScaling", "None")
    # Ink is counted from the top-left square, the page from its lower-left corner.
    canvas.saveState()
    x, y = placing.board_xy
    canvas.translate(x / _POINT_M, (y + _board_wh(target)[1]) / _POINT_M)
    _draw_squares(canvas, target)
    clipped = _draw_discs(canvas, target)
    canvas.restoreState()
    canvas.saveState()
    if placing.side == "below":
        canvas.translate(edge / _POINT_M, edge / _POINT_M)
    else:  # read from the right: the strip's upper side is towards the board
        canvas.translate((placing.page_wh[0] - edge) / _POINT_M, edge / _POINT_M)
        canvas.rotate(90)
    _draw_strip(canvas, target, placing, ruler_m)
    canvas.restoreState()
    canvas.showPage()
    canvas.save()
    return buffer.getvalue(), clipped


def _draw_squares(canvas: "Canvas", target: Target) -> None:
    width, height = (side / _POINT_M for side in target.square_m)
    canvas.setFillColorRGB(0, 0, 0)
    for iy, ix in np.argwhere(target.black_squares).tolist():
        canvas.rect(ix * width, -(iy + 1) * height, width, height, stroke=0, fill=1)


def _draw_discs(canvas: "Canvas", target: Target) -> tuple[str, ...]:
    clipped: dict[str, None] = {}
    for marker in target.markers:
        rgb, outside = _srgb(marker)
        if outside:
            clipped[marker.name] = None
        canvas.setFillColorRGB(*rgb)
        centre = [
            (index + 0.5) * side / _POINT_M
            for index, side in zip(marker.square, target.square_m, strict=True)
        ]
        radius = marker.diameter_m / 2 / _POINT_M
        canvas.circle(centre[0], -centre[1], radius, stroke=0, fill=1)
    return tuple(clipped)


def _srgb(marker: Marker) -> tuple[list[float], bool]:
    linear = RGB_FROM_XYZ["srgb"] @ np.array(marker.xyz_d65)
    inside = np.clip(linear, 0, 1)
    outside = bool(np.abs(linear - inside).max() > _GAMUT_TOLERANCE)
    return [float(value) for value in encode(inside, "srgb")], outside


def _sentences(target: Target, ruler_m: float) -> tuple[str, str]:
    nx, ny = target.squares
    width, height = _board_wh(target)
    discs = sorted({f"{marker.diameter_m * 1e3:.4g}" for marker in target.markers}, key=float)
    holds = f", discs of {' and '.join(discs[:3])} mm" if discs else ""
    return (
        f"{nx} x {ny} squares of {_size_mm(target)} mm{holds}; together "
        f"{width * 1e3:.6g} x {height * 1e3:.6g} mm.",
        f"Print at 100 %, without fitting to the page, and measure: this ruler is "
        f"{ruler_m * 1e3:g} mm long.",
    )


def _draw_strip(canvas: "Canvas", target: Target, placing: _Placing, ruler_m: float) -> None:
    """Draw ruler, text and arrow in a strip whose long side is x and whose board side is up."""
    from reportlab.pdfbase.pdfmetrics import stringWidth

    millimetre = 1e-3 / _POINT_M
    length = placing.strip_length / _POINT_M
    top = _STRIP_M / _POINT_M
    start = 2 * millimetre  # the first figure is centred on the first tick
    canvas.setFillColorRGB(0, 0, 0)
    canvas.setStrokeColorRGB(0, 0, 0)
    canvas.setLineWidth(0.12 * millimetre)
    canvas.setFont("Helvetica", 7)
    n_ticks = round(ruler_m * 1e3)
    for tick in range(n_ticks + 1):
        x = start + tick * millimetre
        tall = 4.5 if tick % 10 == 0 else 3.3 if tick % 5 == 0 else 2.2
        canvas.line(x, top, x, top - tall * millimetre)
        if tick % 10 == 0:
            unit = " cm" if tick == n_ticks else ""
            shift = stringWidth(unit, "Helvetica", 7) / 2
            canvas.drawCentredString(x + shift, top - 7.2 * millimetre, f"{tick // 10}{unit}")
    sentences = _sentences(target, ruler_m)
    widest = max(stringWidth(sentence, "Helvetica", 1) for sentence in sentences)
    room = length - start - 12 * millimetre  # the arrow stands at the end
    font_size = min(8.0, room / widest)
    canvas.setFont("Helvetica", font_size)
    for line, sentence in enumerate(sentences):
        canvas.drawString(start, (4.6 - 3.6 * line) * millimetre, sentence)
    canvas.saveState()
    canvas.translate(length - 4 * millimetre, 4.0 * millimetre)
    if placing.side == "right":
        canvas.rotate(-90)
    _draw_arrow(canvas, millimetre)
    canvas.restoreState()


def _draw_arrow(canvas: "Canvas", millimetre: float) -> None:
    """Draw an arrow to the board's first row, about the origin, 8 mm high."""
    path = canvas.beginPath()
    for index, (x, y) in enumerate(_arrow_mm()):
        (path.lineTo if index else path.moveTo)(x * millimetre, y * millimetre)
    path.close()
    canvas.drawPath(path, stroke=0, fill=1)
    canvas.setFont("Helvetica", 7)
    canvas.drawCentredString(0, -3.4 * millimetre, "top")


def _arrow_mm() -> Iterator[tuple[float, float]]:
    yield from ((0, 4), (1.6, 1.4), (0.4, 1.4), (0.4, -0.8))
    yield from ((-0.4, -0.8), (-0.4, 1.4), (-1.6, 1.4))


def _tagged_srgb(pdf: bytes) -> bytes:
    """Say that the page's RGB is sRGB: as the output intent, and as the default of the page."""
    from pypdf import PdfReader, PdfWriter
    from pypdf.generic import (
        ArrayObject,
        DecodedStreamObject,
        DictionaryObject,
        NameObject,
        NumberObject,
        TextStringObject,
    )

    writer = PdfWriter(clone_from=PdfReader(io.BytesIO(pdf)))
    writer.pdf_header = "%PDF-1.7"  # ICC profiles of version 4 need 1.5 or later
    profile = DecodedStreamObject()
    profile.set_data(_srgb_profile())
    compressed = profile.flate_encode()
    compressed[NameObject("/N")] = NumberObject(3)
    compressed[NameObject("/Alternate")] = NameObject("/DeviceRGB")
    reference = writer._add_object(compressed)  # noqa: SLF001 (pypdf has no public name for it)
    name = TextStringObject("sRGB IEC61966-2.1")
    intent = DictionaryObject(
        {
            NameObject("/Type"): NameObject("/OutputIntent"),
            NameObject("/S"): NameObject("/GTS_PDFA1"),
            NameObject("/OutputConditionIdentifier"): name,
            NameObject("/Info"): name,
            NameObject("/DestOutputProfile"): reference,
        }
    )
    writer.root_object[NameObject("/OutputIntents")] = ArrayObject([writer._add_object(intent)])  # noqa: SLF001
    resources = writer.pages[0]["/Resources"].get_object()
    if not isinstance(resources, DictionaryObject):
        raise TypeError("the drawn page has no resources")
    resources[NameObject("/ColorSpace")] = DictionaryObject(
        {NameObject("/DefaultRGB"): ArrayObject([NameObject("/ICCBased"), reference])}
    )
    out = io.BytesIO()
    writer.write(out)
    return out.getvalue()


def _srgb_profile() -> bytes:
    from PIL import ImageCms

    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    # Bytes 24 to 35 are the moment it was made (ICC.1:2022, 7.2.8); 1 January 2000 keeps the
    # file the same from run to run. The profile's checksum, bytes 84 to 99, is left at "none".
    profile[24:36] = b"\x07\xd0\x00\x01\x00\x01" + bytes(6)
    profile[84:100] = bytes(16)
    return bytes(profile)


def _replace_file(path: Path, content: bytes) -> None:
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); check -o") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(name).chmod(0o644)  # mkstemp keeps files to their owner
        Path(name).replace(path)
    except OSError as error:
        with suppress(OSError):
            Path(name).unlink()
        raise OutputError(f"{path}: cannot be written ({error.strerror}); check -o") from error
