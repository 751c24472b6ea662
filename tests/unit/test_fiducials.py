"""Boards with codes: their layout against OpenCV's, and their corners against rendered truth."""

import itertools
import json
import pickle
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography
from calichrome.detection.fiducials import detect_coded_board
from calichrome.errors import TargetError
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.target import (
    AprilGridTarget,
    CharucoTarget,
    CodedTarget,
    chessboard,
    parse_target,
    target_from_json,
    target_to_json,
    with_square_size,
)
from calichrome.target.fiducial import ARUCO_DICTIONARIES

CHARUCO = "charuco:6x5:4X4_100:30mm:22.5mm"
APRILGRID = "aprilgrid:4x3:36h11:40mm:0.3"
SQUARE_PX = 240  # of the drawn board, before it is rendered
SUPERSAMPLED = 4


def _coded(text: str) -> CodedTarget:
    target = parse_target(text)
    assert isinstance(target, CodedTarget)
    return target


def _dictionary(target: CodedTarget) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{target.dictionary}"))


def _charuco_of_opencv(target: CharucoTarget, *, legacy: bool) -> cv2.aruco.CharucoBoard:
    square = target.square_m[0]
    board = cv2.aruco.CharucoBoard(
        target.squares, square, square * target.marker_share, _dictionary(target)
    )
    board.setLegacyPattern(legacy)
    return board


def _drawn_charuco(target: CharucoTarget, *, legacy: bool) -> tuple[FloatArray, FloatArray]:
    """Draw by OpenCV; also the map from its pixels to the board frame."""
    size = target.squares[0] * SQUARE_PX, target.squares[1] * SQUARE_PX
    drawn = _charuco_of_opencv(target, legacy=legacy).generateImage(size, marginSize=0)
    margin = SQUARE_PX // 2
    drawn = np.pad(np.asarray(drawn, float), margin, constant_values=255)
    return drawn, _to_board(target.square_m[0] / SQUARE_PX, 1.5 * SQUARE_PX)


def _drawn_april_grid(target: AprilGridTarget, quarters: int) -> tuple[FloatArray, FloatArray]:
    """Draw as kalibr does: tags count from the lower left, black squares at all corners."""
    gap = round(SQUARE_PX * target.spacing)
    columns, rows = target.tags_xy
    pitch = SQUARE_PX + gap
    drawn = np.full((rows * pitch + 3 * gap, columns * pitch + 3 * gap), 255, np.uint8)
    for row, column in itertools.product(range(rows), range(columns)):
        tag = cv2.aruco.generateImageMarker(
            _dictionary(target), row * columns + column, SQUARE_PX, borderBits=2
        )
        y, x = 2 * gap + (rows - 1 - row) * pitch, 2 * gap + column * pitch
        drawn[y : y + SQUARE_PX, x : x + SQUARE_PX] = np.rot90(tag, quarters)
    for row, column in itertools.product(range(rows + 1), range(columns + 1)):
        y, x = gap + row * pitch, gap + column * pitch
        drawn[y : y + gap, x : x + gap] = 0
    return drawn.astype(float), _to_board(target.square_m[0] / SQUARE_PX, 2 * gap)


def _to_board(metres_per_px: float, origin_px: float) -> FloatArray:
    shift = metres_per_px * (0.5 - origin_px)
    return np.array([[metres_per_px, 0, shift], [0, metres_per_px, shift], [0, 0, 1]])


def _render(
    drawn: FloatArray,
    to_board: FloatArray,
    target: CodedTarget,
    rng: np.random.Generator,
    size_wh: tuple[int, int] = (480, 400),
) -> tuple[Image, FloatArray]:
    """Render a tilted view; also where all corners are, (n_corners, 2), pixels."""
    turn = cv2.Rodrigues(np.array([0.35, -0.3, rng.uniform(-0.3, 0.3)]))[0]
    middle = np.append(target.corners_board[:, :2].mean(axis=0), 0)
    extent = np.ptp(target.corners_board[:, :2], axis=0).max() + 2 * target.square_m[0]
    focal = 1200.0
    away = np.array([0, 0, focal * extent / (0.85 * min(size_wh))]) - turn @ middle
    centre = np.array(size_wh) / 2 + rng.uniform(-0.5, 0.5, 2)
    camera = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    to_pixels = camera @ np.column_stack([turn[:, :2], away])
    half = (SUPERSAMPLED - 1) / 2
    finer = np.array([[SUPERSAMPLED, 0, half], [0, SUPERSAMPLED, half], [0, 0, 1]])
    fine_wh = size_wh[0] * SUPERSAMPLED, size_wh[1] * SUPERSAMPLED
    fine = cv2.warpPerspective(
        drawn.astype(np.float32), finer @ to_pixels @ to_board, fine_wh, borderValue=170
    )
    grey = cv2.GaussianBlur(cv2.resize(fine, size_wh, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    grey = 30 + 0.75 * grey + rng.normal(0, 2, grey.shape)
    if target.inverted:
        grey = 255 - grey
    pixels = np.rint(np.clip(grey, 0, 255)).astype(np.uint8)
    return _picture(pixels), apply_homography(to_pixels, target.corners_board[:, :2])


def _picture(pixels: np.typing.NDArray[np.uint8]) -> Image:
    return Image(pixels=pixels, encoding="srgb", bits=8)


def _view(found: BoardView | NotFound) -> BoardView:
    assert isinstance(found, BoardView), found
    return found


def _errors(found: BoardView | NotFound, truth_px: FloatArray) -> FloatArray:
    view = _view(found)
    return np.asarray(np.linalg.norm(view.corners_px - truth_px[view.corner_ids], axis=1))


# what is printed


def test_dictionaries_are_those_of_opencv() -> None:
    named = {name for name in dir(cv2.aruco) if name.startswith("DICT_")}
    by_number = {getattr(cv2.aruco, name): name for name in named}
    ours = {getattr(cv2.aruco, f"DICT_{name}") for name in ARUCO_DICTIONARIES}
    assert ours == set(by_number)
    for name, (bits, count) in ARUCO_DICTIONARIES.items():
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        assert (known.markerSize, len(known.bytesList)) == (bits, count), name


@pytest.mark.parametrize("counts", ["4x5", "5x4", "7x6"])
@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_stands_as_opencv_draws_it(counts: str, legacy: bool) -> None:  # noqa: FBT001
    target = _coded(f"charuco:{counts}:5X5_100:30mm:21mm")
    assert isinstance(target, CharucoTarget)
    known = replace(target, legacy=legacy)
    board = _charuco_of_opencv(target, legacy=legacy)
    # OpenCV's frame begins at the outer corner of square [0, 0], ours at its inner one
    outlines = np.array(board.getObjPoints())[..., :2] - 0.03
    np.testing.assert_allclose(known.code_outlines(0), outlines, atol=1e-7)  # float32 there
    corners = np.asarray(board.getChessboardCorners()) - [0.03, 0.03, 0]
    np.testing.assert_allclose(known.corners_board, corners, atol=1e-7)
    open_layout = target.code_outlines(int(legacy) if target.n_layouts == 2 else 0)
    np.testing.assert_allclose(open_layout, known.code_outlines(0))


def test_april_grid_counts_as_kalibr_and_lies_as_our_boards() -> None:
    """kalibr: tag 0 at the lower left, 1 right of it; 88 mm tags, 0.3 of that between them."""
    target = _coded("aprilgrid:6x6:36h11:88mm:0.3")
    assert target.corners_xy == (12, 12)
    pitch = 0.088 * 1.3
    np.testing.assert_allclose(
        target.corners_board[:4, 0], [0, 0.088, pitch, pitch + 0.088], atol=1e-12
    )
    first, second = target.code_outlines(0)[:2]
    bottom = 5 * pitch  # y grows downwards
    expected = [[0, bottom], [0.088, bottom], [0.088, bottom + 0.088], [0, bottom + 0.088]]
    np.testing.assert_allclose(first, expected, atol=1e-12)
    np.testing.assert_allclose(second - first, np.tile([pitch, 0], (4, 1)), atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [CHARUCO, f"{CHARUCO}:inverted", "charuco:6x6:DICT_6X6_250:30mm:20mm:legacy", APRILGRID,
     "aprilgrid:4x3:tag25h9:40x40.2mm:0.25"],
)  # fmt: skip
def test_a_coded_board_survives_its_file_and_a_process(text: str) -> None:
    target = _coded(text)
    assert target_from_json(json.loads(json.dumps(target_to_json(target)))) == target
    assert pickle.loads(pickle.dumps(target)) == target  # noqa: S301 (ours, a moment old)
    assert target.has_unique_orientation
    assert len(target.symmetries) == 1


def test_a_measured_square_scales_codes_too() -> None:
    target = _coded(CHARUCO)
    larger = with_square_size(target, (0.06, 0.06))
    assert isinstance(larger, CharucoTarget)
    np.testing.assert_allclose(larger.code_outlines(0), 2 * target.code_outlines(0))
    assert larger.clearance_m == pytest.approx(2 * target.clearance_m)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("charuco:6x5:4X4_99:30mm:20mm", "there are 4X4_50, 4X4_100"),
        ("charuco:6x5:4X4_50:30mm:30mm", "do not fit into it"),
        ("charuco:6x5:4X4_50:30:20mm", "has no unit"),
        ("charuco:6x5:4X4_50:30mm", "write charuco:COLSxROWS:DICT:SQUARE:MARKER"),
        ("charuco:6x5:4X4_50:30mm:20mm:upside", "write charuco:COLSxROWS"),
        ("charuco:6x6:4X4_50:30mm:20mm:legacy:current", "write charuco:COLSxROWS"),
        ("charuco:20x20:4X4_50:30mm:20mm", "needs 200 codes, 4X4_50 has 50"),
        ("charuco:3x5:4X4_50:30mm:20mm", "needs 4x4 squares"),
        ("aprilgrid:6x6:36h12:88mm:0.3", "there are 16h5, 25h9, 36h10, 36h11"),
        ("aprilgrid:1x6:36h11:88mm:0.3", "2x2 is the smallest"),
        ("aprilgrid:6x6:36h11:88mm:3", "like 0.3"),
        ("aprilgrid:6x6:36h11:88mm", "write aprilgrid:COLSxROWS:FAMILY:SIZE:SPACING"),
    ],
)
def test_what_is_wrong_is_said(text: str, says: str) -> None:
    with pytest.raises(TargetError, match=re.escape(says)) as refused:
        parse_target(text)
    assert text in str(refused.value)


def test_a_file_of_another_board_is_refused() -> None:
    data = target_to_json(_coded(APRILGRID))
    data["squares"] = [8, 7]
    with pytest.raises(TargetError, match="2 n"):
        target_from_json(data)
    data["codes"] = {"kind": "circles"}
    with pytest.raises(TargetError, match="codes"):
        target_from_json(data)


# what is seen


@pytest.mark.parametrize("options", ["", ":inverted"])
def test_charuco_corners_come_out_where_they_are(options: str, rng: np.random.Generator) -> None:
    target = _coded(CHARUCO + options)
    assert isinstance(target, CharucoTarget)
    drawn, to_board = _drawn_charuco(target, legacy=False)
    image, truth_px = _render(drawn, to_board, target, rng)
    errors = _errors(detect_coded_board(image, target), truth_px)
    assert len(errors) == target.n_corners
    assert errors.max() < 0.2  # rendered squares of 50 px measured: RMS 0.03, worst 0.1


@pytest.mark.parametrize("legacy", [False, True])
def test_the_picture_tells_the_layout(legacy: bool, rng: np.random.Generator) -> None:  # noqa: FBT001
    target = _coded("charuco:6x6:4X4_100:30mm:22.5mm")
    assert isinstance(target, CharucoTarget)
    assert target.n_layouts == 2
    drawn, to_board = _drawn_charuco(target, legacy=legacy)
    image, truth_px = _render(drawn, to_board, target, rng)
    errors = _errors(detect_coded_board(image, target), truth_px)
    assert len(errors) == target.n_corners
    assert errors.max() < 0.2
    found = detect_coded_board(image, replace(target, legacy=not legacy))
    assert isinstance(found, NotFound)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_april_grid_however_its_tags_are_turned(quarters: int, rng: np.random.Generator) -> None:
    target = _coded(APRILGRID)
    assert isinstance(target, AprilGridTarget)
    drawn, to_board = _drawn_april_grid(target, quarters)
    image, truth_px = _render(drawn, to_board, target, rng)
    errors = _errors(detect_coded_board(image, target), truth_px)
    assert len(errors) == target.n_corners
    assert errors.max() < 0.2


def test_a_part_of_a_board_keeps_its_names(rng: np.random.Generator) -> None:
    target = _coded(CHARUCO)
    assert isinstance(target, CharucoTarget)
    image, truth_px = _render(*_drawn_charuco(target, legacy=False), target, rng)
    cut = _picture(np.ascontiguousarray(image.pixels[:, 200:]))
    view = _view(detect_coded_board(cut, target))
    errors = np.linalg.norm(
        view.corners_px + np.array([200, 0]) - truth_px[view.corner_ids], axis=1
    )
    assert errors.max() < 0.2
    # inside, with room for the window, and beside a code that is not cut
    clear = np.flatnonzero(truth_px[:, 0] > 200 + 60)
    assert set(clear) <= set(view.corner_ids) != set(range(target.n_corners))


def test_covered_corners_are_left_out(rng: np.random.Generator) -> None:
    target = _coded(CHARUCO)
    assert isinstance(target, CharucoTarget)
    image, truth_px = _render(*_drawn_charuco(target, legacy=False), target, rng)
    hidden = 8
    pixels = image.pixels.copy()
    centre = tuple(int(value) for value in np.rint(truth_px[hidden]))
    cv2.circle(pixels, centre, 7, 150, -1)  # a finger tip, clear of the codes
    view = _view(detect_coded_board(_picture(pixels), target))
    assert set(range(target.n_corners)) - set(view.corner_ids) == {hidden}


def test_reasons_name_what_to_do(rng: np.random.Generator) -> None:
    target = _coded(CHARUCO)
    assert isinstance(target, CharucoTarget)
    image, _ = _render(*_drawn_charuco(target, legacy=False), target, rng)
    cases = [
        (replace(target, inverted=True), image, "remove :inverted from --target"),
        (_coded("charuco:6x5:5X5_100:30mm:22.5mm"), image, "no code of the board"),
        (_coded("charuco:4x4:4X4_100:30mm:22.5mm"), image, "that do not stand as on the target"),
        (target, _picture(np.full((200, 200), 128, np.uint8)), "add light"),
        (target, _picture(np.full((200, 200), 255, np.uint8)), "overexposed"),
    ]
    for wanted, picture, says in cases:
        found = detect_coded_board(picture, wanted)
        assert isinstance(found, NotFound), says
        assert says in found.reason
    inverted = _picture(255 - image.pixels)
    found = detect_coded_board(inverted, target)
    assert isinstance(found, NotFound)
    assert "add :inverted to --target" in found.reason


def test_two_equal_boards_are_refused(rng: np.random.Generator) -> None:
    target = _coded(CHARUCO)
    assert isinstance(target, CharucoTarget)
    image, _ = _render(*_drawn_charuco(target, legacy=False), target, rng)
    found = detect_coded_board(_picture(np.hstack([image.pixels, image.pixels])), target)
    assert isinstance(found, NotFound)
    assert "two boards" in found.reason


def test_pictures_without_codes_show_no_board(rng: np.random.Generator) -> None:
    """Random blocks hold many quadrangles, and 4X4_1000 takes many of them for codes."""
    target = _coded("charuco:6x5:4X4_1000:30mm:22.5mm")
    for _ in range(5):
        blocks = rng.integers(0, 2, (40, 50), dtype=np.uint8) * 200 + 25
        pixels = cv2.resize(blocks, None, fx=12, fy=12, interpolation=cv2.INTER_NEAREST)
        assert isinstance(detect_coded_board(_picture(pixels), target), NotFound)


def test_a_chessboard_is_not_a_coded_board() -> None:
    assert not isinstance(chessboard((9, 6), (0.03, 0.03)), CodedTarget)
