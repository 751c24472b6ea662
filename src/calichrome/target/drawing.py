"""The page for the printer: exact scale, vectors, tagged sRGB."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.files import writing_file
from calichrome.target.board import Marker, Target
from calichrome.target.page import (
    STRIP_M,
    Placing,
    board_wh_m,
    parse_paper,
    place_board,
    size_mm,
)

if TYPE_CHECKING:
    from reportlab.pdfgen.canvas import Canvas

__all__ = ["PrintedPage", "write_pdf"]

_POINT_M = 0.0254 / 72
_MM = 1e-3 / _POINT_M  # points
_FONT = "Helvetica"
_GAMUT_TOLERANCE = 5e-4  # of linear RGB; below one step of 8 bits
_ARROW_MM = ((0, 4), (1.6, 1.4), (0.4, 1.4), (0.4, -0.8), (-0.4, -0.8), (-0.4, 1.4), (-1.6, 1.4))


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
    placing = place_board(target, paper_wh, printable_margin_m)
    pdf, clipped = _drawn(target, placing, printable_margin_m, title)
    with writing_file(path, force=True) as temporary:
        temporary.write_bytes(_tagged_srgb(pdf))
    return PrintedPage(
        paper_wh_m=placing.page_wh,
        white_margin_m=round(placing.white_margin, 6),
        ruler_m=placing.ruler,
        clipped_colours=clipped,
    )


def _drawn(
    target: Target, placing: Placing, edge_m: float, title: str
) -> tuple[bytes, tuple[str, ...]]:
    from reportlab.pdfgen.canvas import Canvas

    page_pt = placing.page_wh[0] / _POINT_M, placing.page_wh[1] / _POINT_M
    buffer = io.BytesIO()
    canvas = Canvas(buffer, pagesize=page_pt, invariant=1, pageCompression=1)
    canvas.setTitle(title)
    canvas.setSubject(" ".join(_sentences(target, placing.ruler)))
    canvas.setAuthor("")
    canvas.setCreator("calichrome")
    canvas.setViewerPreference("PrintScaling", "None")
    # The squares are counted from the top-left corner of the board, y down.
    canvas.saveState()
    x, y = placing.board_xy
    canvas.translate(x / _POINT_M, (y + board_wh_m(target)[1]) / _POINT_M)
    _draw_squares(canvas, target)
    clipped = _draw_discs(canvas, target)
    canvas.restoreState()
    canvas.saveState()
    start = placing.strip_from_to[0]
    if placing.side == "below":
        canvas.translate(start / _POINT_M, edge_m / _POINT_M)
    else:  # read from the right: the strip's upper side is towards the board
        canvas.translate((placing.page_wh[0] - edge_m) / _POINT_M, start / _POINT_M)
        canvas.rotate(90)
    _draw_strip(canvas, target, placing)
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
        x, y = (
            (index + 0.5) * side / _POINT_M
            for index, side in zip(marker.square, target.square_m, strict=True)
        )
        canvas.circle(x, -y, marker.diameter_m / 2 / _POINT_M, stroke=0, fill=1)
    return tuple(clipped)


def _srgb(marker: Marker) -> tuple[list[float], bool]:
    linear = RGB_FROM_XYZ["srgb"] @ np.array(marker.xyz_d65)
    inside = np.clip(linear, 0, 1)
    outside = bool(np.abs(linear - inside).max() > _GAMUT_TOLERANCE)
    return [float(value) for value in encode(inside, "srgb")], outside


def _sentences(target: Target, ruler_m: float) -> tuple[str, str]:
    nx, ny = target.squares
    width, height = board_wh_m(target)
    discs = sorted({f"{marker.diameter_m * 1e3:.4g}" for marker in target.markers}, key=float)
    holds = f", discs of {' and '.join(discs[:3])} mm" if discs else ""
    what = (
        f"{nx} x {ny} squares of {size_mm(target)} mm{holds}; together {width * 1e3:.6g} x "
        f"{height * 1e3:.6g} mm."
    )
    how = (
        f"Print at 100 %, without fitting to the page, and measure: this ruler is "
        f"{ruler_m * 1e3:g} mm long."
    )
    return what, how


def _draw_strip(canvas: "Canvas", target: Target, placing: Placing) -> None:
    """Draw ruler, text and arrow along x; the board is above."""
    from reportlab.pdfbase.pdfmetrics import stringWidth

    length = (placing.strip_from_to[1] - placing.strip_from_to[0]) / _POINT_M
    top = STRIP_M / _POINT_M
    # Half a figure stands before the first tick, and must stay inside the printable area.
    start = 2 * _MM
    canvas.setFillColorRGB(0, 0, 0)
    canvas.setStrokeColorRGB(0, 0, 0)
    canvas.setLineWidth(0.12 * _MM)
    canvas.setFont(_FONT, 7)
    n_ticks = round(placing.ruler * 1e3)
    for tick in range(n_ticks + 1):
        x = start + tick * _MM
        tall = 4.5 if tick % 10 == 0 else 3.3 if tick % 5 == 0 else 2.2
        canvas.line(x, top, x, top - tall * _MM)
        if tick % 10 == 0:
            unit = " cm" if tick == n_ticks else ""
            shift = stringWidth(unit, _FONT, 7) / 2
            canvas.drawCentredString(x + shift, top - 7.2 * _MM, f"{tick // 10}{unit}")
    sentences = _sentences(target, placing.ruler)
    room = length - start - 8 * _MM  # the arrow stands at the end
    widest = max(stringWidth(sentence, _FONT, 1) for sentence in sentences)
    canvas.setFont(_FONT, min(8.0, room / widest))
    for line, sentence in enumerate(sentences):
        canvas.drawString(start, (4.8 - 3.6 * line) * _MM, sentence)
    canvas.saveState()
    canvas.translate(length - 3 * _MM, 4.8 * _MM)
    if placing.side == "right":
        canvas.rotate(-90)
    _draw_arrow(canvas)
    canvas.restoreState()


def _draw_arrow(canvas: "Canvas") -> None:
    """Draw an arrow to the board's first row, about the origin."""
    path = canvas.beginPath()
    for index, (x, y) in enumerate(_ARROW_MM):
        (path.lineTo if index else path.moveTo)(x * _MM, y * _MM)
    path.close()
    canvas.drawPath(path, stroke=0, fill=1)
    canvas.setFont(_FONT, 7)
    canvas.drawCentredString(0, -3.4 * _MM, "top")


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
    writer.pdf_header = "%PDF-1.7"  # the first whose text knows ICC profiles of version 4
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
    writer.root_object[NameObject("/OutputIntents")] = ArrayObject([intent])
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
