"""The page is read back: what stands in the content stream, in millimetres."""

import io
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageCms
from pypdf import PdfReader
from pypdf.generic import ContentStream

from calichrome.core.arrays import FloatArray
from calichrome.errors import OutputError, TargetError
from calichrome.target import (
    PAPERS_M,
    PrintedPage,
    Target,
    parse_paper,
    with_square_size,
    write_pdf,
)

_MM = 25.4 / 72
_EXACT_MM = 1e-3
_EDGE_MM = 5.0


@dataclass
class _Drawn:
    """What a page shows; lower left is the origin, y up, millimetres."""

    size: FloatArray
    rectangles: list[tuple[FloatArray, tuple[float, ...]]] = field(default_factory=list)
    discs: list[tuple[FloatArray, tuple[float, ...]]] = field(default_factory=list)
    lines: list[FloatArray] = field(default_factory=list)
    shapes: list[FloatArray] = field(default_factory=list)
    text: list[tuple[str, FloatArray]] = field(default_factory=list)

    def add(self, points: FloatArray, kind: bytes, fill: tuple[float, ...]) -> None:
        if kind == b"re":
            self.rectangles.append((np.sort(points, axis=0), fill))
        elif kind == b"c":
            self.discs.append((points, fill))
        else:
            (self.lines if len(points) == 2 else self.shapes).append(points)

    @property
    def board(self) -> FloatArray:
        """Lower-left and upper-right corner of the black squares."""
        corners = np.concatenate([corners for corners, _ in self.rectangles])
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    @property
    def ink(self) -> Iterator[FloatArray]:
        yield from (corners for corners, _ in self.rectangles)
        yield from self.lines
        yield from self.shapes


def _matrix(operands: list[Any]) -> FloatArray:
    a, b, c, d, e, f = (float(value) for value in operands)
    return np.array([[a, b, 0], [c, d, 0], [e, f, 1]])


def _operations(reader: PdfReader) -> Iterator[tuple[bytes, list[Any], FloatArray]]:
    """Yield what is drawn with the matrix from its points to the page in millimetres."""
    (page,) = reader.pages
    millimetres = np.diag([_MM, _MM, 1])
    stack = [np.eye(3)]
    for operands, name in ContentStream(page.get_contents(), reader).operations:
        if name == b"q":
            stack.append(stack[-1])
        elif name == b"Q":
            stack.pop()
        elif name == b"cm":
            stack[-1] = _matrix(operands) @ stack[-1]
        else:
            yield name, operands, stack[-1] @ millimetres


def _placed(points: list[list[float]], mm_from_points: FloatArray) -> FloatArray:
    return np.asarray((np.column_stack([points, np.ones(len(points))]) @ mm_from_points)[:, :2])


def _read(path: Path) -> _Drawn:
    reader = PdfReader(path)
    box = reader.pages[0].mediabox
    drawn = _Drawn(np.array([float(box.width), float(box.height)]) * _MM)
    fill: tuple[float, ...] = ()
    points: list[list[float]] = []  # of the path: for curves, the ends of their arcs
    kinds: list[bytes] = []
    text_at = np.zeros(2)
    for name, operands, mm_from_points in _operations(reader):
        if name == b"rg":
            fill = tuple(float(value) for value in operands)
        elif name in {b"m", b"l", b"c", b"re"}:
            numbers = [float(value) for value in operands]
            points.append(numbers[:2] if name == b"re" else numbers[-2:])
            if name == b"re":
                points.append([numbers[0] + numbers[2], numbers[1] + numbers[3]])
            kinds.append(name)
        elif name in {b"f", b"f*", b"S"}:
            drawn.add(_placed(points, mm_from_points), kinds[-1], fill)
            points, kinds = [], []
        elif name == b"Tm":
            text_at = (_matrix(operands) @ mm_from_points)[2, :2]
        elif name == b"Tj":
            drawn.text.append((str(operands[0]), text_at))
    return drawn


@pytest.fixture(scope="module", params=["A4", "A3", "portrait", "oblong"])
def printed(
    request: pytest.FixtureRequest, board: Target, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Target, PrintedPage, _Drawn]:
    paper: Any = request.param
    if request.param == "portrait":  # a board that is higher than wide turns the paper
        board = Target(squares=(5, 8), square_m=(0.03, 0.03))
        paper = "letter"
    elif request.param == "oblong":
        board = replace(board, square_m=(0.028, 0.0263))
        paper = (0.31, 0.29)
    path = tmp_path_factory.mktemp("pdf") / "board.pdf"
    return board, write_pdf(board, path, paper=paper), _read(path)


Printed = tuple[Target, PrintedPage, _Drawn]


def test_the_page_is_the_paper(printed: Printed) -> None:
    _, page, drawn = printed
    np.testing.assert_allclose(drawn.size, np.array(page.paper_wh_m) * 1e3, atol=_EXACT_MM)


def test_squares_are_where_the_board_has_them(printed: Printed) -> None:
    target, page, drawn = printed
    x0, y1 = drawn.board[0, 0], drawn.board[1, 1]
    width, height = np.array(target.square_m) * 1e3
    wanted = {
        (x0 + ix * width, y1 - (iy + 1) * height) for iy, ix in np.argwhere(target.black_squares)
    }
    lower_left = np.array(sorted(tuple(corners[0]) for corners, _ in drawn.rectangles))
    np.testing.assert_allclose(lower_left, np.array(sorted(wanted)), atol=_EXACT_MM)
    for corners, fill in drawn.rectangles:
        np.testing.assert_allclose(corners[1] - corners[0], [width, height], atol=_EXACT_MM)
        assert fill == (0, 0, 0)
    assert page.white_margin_m > 0


def test_discs_are_in_the_middle_of_their_squares(printed: Printed) -> None:
    target, _, drawn = printed
    assert len(drawn.discs) == len(target.markers)
    corner = np.array([drawn.board[0, 0], drawn.board[1, 1]])
    size = np.array(target.square_m) * 1e3
    for marker, (points, _) in zip(target.markers, drawn.discs, strict=True):
        centre = corner + (np.array(marker.square) + 0.5) * size * [1, -1]
        radius = np.linalg.norm(points - centre, axis=1)  # of the ends of its four arcs
        np.testing.assert_allclose(radius, marker.diameter_m / 2 * 1e3, atol=_EXACT_MM)


def test_all_ink_is_inside_the_printable_area(printed: Printed) -> None:
    _, _, drawn = printed
    for points in drawn.ink:
        assert (points >= _EDGE_MM - _EXACT_MM).all()
        assert (points <= drawn.size - _EDGE_MM + _EXACT_MM).all()
    for _, at in drawn.text:
        assert (at >= _EDGE_MM).all()
        assert (at <= drawn.size - _EDGE_MM).all()


def test_the_white_margin_is_what_is_said(printed: Printed) -> None:
    target, page, drawn = printed
    low, high = drawn.board
    gaps = [*low, *(drawn.size - high)]
    for points in [*drawn.lines, *drawn.shapes, *(at[None] for _, at in drawn.text)]:
        outside = np.maximum(low - points, points - high).max(axis=1)
        gaps.append(outside.min())
    assert min(gaps) == pytest.approx(page.white_margin_m * 1e3, abs=_EXACT_MM)
    assert page.white_margin_m >= max(max(target.square_m) / 3, 0.006)


def test_the_ruler_is_as_long_as_it_says(printed: Printed) -> None:
    _, page, drawn = printed
    feet = np.array([line[0] for line in drawn.lines])
    along = int(np.argmax(np.ptp(feet, axis=0)))
    positions = np.sort(feet[:, along])
    np.testing.assert_allclose(np.diff(positions), 1, atol=_EXACT_MM)
    assert positions[-1] - positions[0] == pytest.approx(page.ruler_m * 1e3, abs=_EXACT_MM)
    assert np.ptp(feet[:, 1 - along]) < _EXACT_MM
    words = " ".join(text for text, _ in drawn.text)
    assert f"this ruler is {page.ruler_m * 1e3:g} mm long" in words
    figures = [text.split()[0] for text, _ in drawn.text if text.split()[0].isdigit()]
    assert {str(number) for number in range(round(page.ruler_m * 100) + 1)} <= set(figures)


def test_the_arrow_points_to_the_first_row(printed: Printed) -> None:
    _, _, drawn = printed
    (arrow,) = drawn.shapes
    above = arrow[:, 1] - arrow[:, 1].mean()
    tip = arrow[np.argmax(above)]
    assert tip[0] == pytest.approx(arrow[:, 0].mean(), abs=_EXACT_MM)
    assert above.max() > -above.min() > 0  # the head is the heavy end
    assert next(at for text, at in drawn.text if text == "top")[1] < arrow[:, 1].min()


def test_colours_are_srgb_and_tagged(printed: Printed, tmp_path: Path) -> None:
    target, page, drawn = printed
    path = tmp_path / "again.pdf"
    write_pdf(target, path, paper=page.paper_wh_m)
    reader = PdfReader(path)
    default: Any = reader.pages[0]["/Resources"]["/ColorSpace"]["/DefaultRGB"]  # type: ignore[index]
    intent: Any = reader.root_object["/OutputIntents"][0]  # type: ignore[index]
    for stream in (default[1].get_object(), intent["/DestOutputProfile"].get_object()):
        assert stream["/N"] == 3
        profile = ImageCms.ImageCmsProfile(io.BytesIO(stream.get_data()))
        assert "sRGB" in ImageCms.getProfileDescription(profile)
        assert int.from_bytes(stream.get_data()[24:26]) == 2000  # not the year of this run
    if not target.markers:
        return
    # littleCMS reads the fill colours through that profile as Lab of D50: an oracle for all of it
    fills = np.array([fill for _, fill in drawn.discs])
    pixels = Image.fromarray(np.round(fills * 255).astype(np.uint8)[None])
    lab = ImageCms.createProfile("LAB", 5003)
    to_lab = ImageCms.buildTransform(
        profile, lab, "RGB", "LAB", ImageCms.Intent.RELATIVE_COLORIMETRIC
    )
    converted = ImageCms.applyTransform(pixels, to_lab)
    assert converted is not None
    read = np.asarray(converted, dtype=np.int64).reshape(-1, 3)
    read[:, 1:] = (read[:, 1:] + 128) % 256 - 128  # a*, b* are signed bytes
    import colour

    for marker, (lightness, a, b) in zip(target.markers, read.tolist(), strict=True):
        if marker.name in page.clipped_colours:
            continue
        xyz_d50 = colour.chromatic_adaptation(
            marker.xyz_d65,
            np.array([0.95047, 1.0, 1.08883]),
            np.array([0.96422, 1.0, 0.82521]),
            transform="Bradford",
        )
        wanted = colour.XYZ_to_Lab(xyz_d50, colour.XYZ_to_xy([0.96422, 1.0, 0.82521]))
        assert lightness * 100 / 255 == pytest.approx(wanted[0], abs=1)
        assert (a, b) == pytest.approx(tuple(wanted[1:]), abs=1.5)  # whole numbers in 8-bit Lab


def test_colours_outside_srgb_are_named(printed: Printed) -> None:
    target, page, _ = printed
    # the ColorChecker's cyan is the one patch outside sRGB, as its makers say
    assert page.clipped_colours == (("cyan",) if target.markers else ())


def test_a_viewer_does_not_scale(board: Target, tmp_path: Path) -> None:
    write_pdf(board, tmp_path / "board.pdf")
    preferences: Any = PdfReader(tmp_path / "board.pdf").root_object["/ViewerPreferences"]
    assert preferences["/PrintScaling"] == "/None"


def test_equal_boards_give_equal_bytes(board: Target, tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        write_pdf(board, tmp_path / name)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pdf", "b.pdf"]


def test_a_board_too_large_names_squares_and_paper_that_do(board: Target, tmp_path: Path) -> None:
    large = with_square_size(board, (0.034, 0.034))
    with pytest.raises(TargetError, match="do not fit on paper of 210 x 297 mm") as caught:
        write_pdf(large, tmp_path / "board.pdf", paper="A4")
    assert not list(tmp_path.iterdir())
    text = str(caught.value)
    squares_mm = float(text.partition("squares of ")[2].rpartition("squares of ")[2].split("mm")[0])
    fits = with_square_size(board, (squares_mm * 1e-3,) * 2)
    assert write_pdf(fits, tmp_path / "small.pdf", paper="A4")
    too_large = with_square_size(board, ((squares_mm + 0.1) * 1e-3,) * 2)
    with pytest.raises(TargetError):
        write_pdf(too_large, tmp_path / "board.pdf", paper="A4")
    named = text.rpartition("paper ")[2].split()[0]
    assert write_pdf(large, tmp_path / "large.pdf", paper=named)
    smaller = [name for name in PAPERS_M if np.prod(PAPERS_M[name]) < np.prod(PAPERS_M[named])]
    for name in smaller:
        with pytest.raises(TargetError):
            write_pdf(large, tmp_path / "board.pdf", paper=name)


def test_a_board_for_no_paper_says_so(board: Target, tmp_path: Path) -> None:
    huge = with_square_size(board, (0.2, 0.2))
    with pytest.raises(TargetError, match="no listed paper is large enough"):
        write_pdf(huge, tmp_path / "board.pdf", paper="A0")
    assert write_pdf(huge, tmp_path / "board.pdf", paper="2x1.5m").white_margin_m > 0.06


def test_the_printable_margin_is_respected(board: Target, tmp_path: Path) -> None:
    write_pdf(board, tmp_path / "board.pdf", printable_margin_m=0.03)
    drawn = _read(tmp_path / "board.pdf")
    for points in drawn.ink:
        assert (points >= 30 - _EXACT_MM).all()
        assert (points <= drawn.size - 30 + _EXACT_MM).all()


def test_white_of_a_third_of_a_square_is_kept(board: Target, tmp_path: Path) -> None:
    # 252 mm of squares and 9.33 mm on both sides; the ruler is below
    assert write_pdf(board, tmp_path / "board.pdf", paper=(0.271, 0.209)).ruler_m == 0.2
    with pytest.raises(TargetError, match=r"9\.3 mm of white"):
        write_pdf(board, tmp_path / "board.pdf", paper=(0.270, 0.209))


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("A4", (0.210, 0.297)),
        ("a0", (0.841, 1.189)),
        ("Letter", (8.5 * 0.0254, 11 * 0.0254)),
        ("tabloid", (11 * 0.0254, 17 * 0.0254)),
        ("600x900mm", (0.6, 0.9)),
        ("24x36in", (24 * 0.0254, 36 * 0.0254)),
    ],
)
def test_papers_by_name_and_size(text: str, size: tuple[float, float]) -> None:
    assert parse_paper(text) == pytest.approx(size)


@pytest.mark.parametrize("text", ["A9", "", "600x900", "-1x2mm"])
def test_what_is_no_paper_is_refused(text: str) -> None:
    with pytest.raises(TargetError, match="A4, letter"):
        parse_paper(text)


@pytest.mark.parametrize(
    ("paper", "edge"), [((0.3, 6.0), 0.005), ((0.2, 0.3), 0.1), ((0.2, 0.3), -0.001)]
)
def test_impossible_pages_are_refused(
    board: Target, tmp_path: Path, paper: tuple[float, float], edge: float
) -> None:
    with pytest.raises(TargetError, match=r"use a smaller one|usually 5 mm"):
        write_pdf(board, tmp_path / "board.pdf", paper=paper, printable_margin_m=edge)


def test_a_folder_is_not_replaced(board: Target, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        write_pdf(board, tmp_path)
