"""Corners of rendered boards against the truth, and the reasons where there are none."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.detection import detect_board
from calichrome.imaging import Image, open_recording
from calichrome.observations import BoardView, NotFound
from calichrome.synthetic import read_truth
from calichrome.target import Target, chessboard

Rendered = Callable[..., tuple[Image, FloatArray, Any]]

_PLAIN = replace(chessboard((7, 6), (0.03, 0.03)), white_margin_m=0.03)


def _rms_px(found: BoardView | NotFound, true_px: FloatArray) -> float:
    assert isinstance(found, BoardView), found
    np.testing.assert_array_equal(found.corner_ids, np.arange(len(true_px)))
    return float(np.sqrt(((found.corners_px - true_px) ** 2).sum(axis=1).mean()))


def _as_8_bit(image: Image) -> Image:
    encoded = np.where(
        image.pixels <= 0.0031308, 12.92 * image.pixels, 1.055 * image.pixels ** (1 / 2.4) - 0.055
    )
    return Image(pixels=np.rint(encoded * 255).astype(np.uint8), encoding="srgb", bits=8)


@pytest.mark.parametrize("turn_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("top_left", ["black", "white"])
def test_orientation_and_corners(render: Rendered, turn_deg: float, top_left: Any) -> None:  # noqa: ANN401
    """However the board is turned, each corner keeps its id: half a board would be 100 px off."""
    target = replace(_PLAIN, top_left=top_left)
    image, true_px, _ = render(target, turn_deg=turn_deg)
    found = detect_board(image, target)
    assert _rms_px(found, true_px) < 0.05
    assert isinstance(found, BoardView)
    assert not found.half_turn_ambiguous


@pytest.mark.parametrize("turn_deg", [20, 200])
def test_corners_beside_discs(render: Rendered, standard_target: Target, turn_deg: float) -> None:
    image, true_px, _ = render(standard_target, turn_deg=turn_deg, tilt_deg=30)
    assert _rms_px(detect_board(image, standard_target), true_px) < 0.05
    assert _rms_px(detect_board(_as_8_bit(image), standard_target), true_px) < 0.05


def test_equal_parity_is_ambiguous(render: Rendered) -> None:
    target = chessboard((7, 5), (0.03, 0.03))
    image, true_px, _ = render(target, turn_deg=180)
    found = detect_board(image, target)
    assert isinstance(found, BoardView)
    assert found.half_turn_ambiguous
    turned = replace(found, corners_px=found.corners_px[::-1])
    assert min(_rms_px(found, true_px), _rms_px(turned, true_px)) < 0.05


def test_mirrored_picture_of_a_both_odd_board(render: Rendered) -> None:
    target = chessboard((7, 5), (0.03, 0.03))
    image, _, _ = render(target)
    mirrored = replace(image, pixels=np.ascontiguousarray(image.pixels[:, ::-1]))
    found = detect_board(mirrored, target)
    assert isinstance(found, NotFound)
    assert "mirror" in found.reason
    assert "5x7" in found.reason


def test_the_other_spelling_of_a_both_odd_board(render: Rendered) -> None:
    image, _, _ = render(chessboard((7, 5), (0.03, 0.03)))
    found = detect_board(image, chessboard((5, 7), (0.03, 0.03)))
    assert isinstance(found, NotFound)
    assert "the target is 7x5" in found.reason


def test_swapped_counts_of_other_parity_are_the_same_board(render: Rendered) -> None:
    """7x6 with a black corner, said as 6x7: turned by 90 degrees it fits."""
    image, true_px, _ = render(_PLAIN)
    found = detect_board(image, chessboard((6, 7), (0.03, 0.03)))
    assert isinstance(found, BoardView)
    distances = np.linalg.norm(found.corners_px[:, None] - true_px[None], axis=2)
    assert distances.min(axis=1).max() < 0.15
    assert sorted(distances.argmin(axis=1)) == list(range(42))


@pytest.mark.parametrize("tilt_deg", [5, 20, 40])
def test_part_of_a_larger_board_is_none(render: Rendered, tilt_deg: float) -> None:
    """Nor is a lattice of every other corner, which OpenCV finds where it is asked for 5x4."""
    image, _, _ = render(_PLAIN, tilt_deg=tilt_deg)
    for corners_xy in ((7, 5), (6, 5), (6, 4), (5, 4), (4, 4), (4, 3), (3, 3)):
        found = detect_board(image, chessboard(corners_xy, (0.03, 0.03)))
        assert isinstance(found, NotFound), corners_xy
        assert "saw 7x6 inner corners" in found.reason


@pytest.mark.parametrize("side", ["left", "top"])
def test_board_that_is_cut_off(render: Rendered, side: str) -> None:
    image, true_px, _ = render(_PLAIN)
    x, y = true_px.min(axis=0).astype(int) + 20
    pixels = image.pixels[:, x:] if side == "left" else image.pixels[y:]
    found = detect_board(replace(image, pixels=np.ascontiguousarray(pixels)), _PLAIN)
    assert isinstance(found, NotFound)
    assert "7x6" in found.reason


def _covered(image: Image, places_px: FloatArray, radius_px: float) -> Image:
    y, x = np.mgrid[: image.size_wh[1], : image.size_wh[0]]
    distance = np.hypot(x[..., None] - places_px[:, 0], y[..., None] - places_px[:, 1])
    hidden = (distance < radius_px).any(axis=-1)[..., None]
    return replace(image, pixels=np.where(hidden, np.float32(0.2), image.pixels))


def test_hidden_corners_are_left_out(render: Rendered) -> None:
    image, true_px, _ = render(_PLAIN)
    found = detect_board(_covered(image, true_px[[9, 24]], 16), _PLAIN)
    assert isinstance(found, BoardView), found
    assert set(range(42)) - set(found.corner_ids.tolist()) == {9, 24}
    np.testing.assert_allclose(found.corners_px, true_px[found.corner_ids], atol=0.1)


def test_symmetric_board_with_a_hidden_corner_is_refused(render: Rendered) -> None:
    """Half a turn would renumber corners that are not there."""
    target = chessboard((7, 5), (0.03, 0.03))
    image, true_px, _ = render(target)
    found = detect_board(_covered(image, true_px[[10]], 16), target)
    assert isinstance(found, NotFound)
    assert "which way up" in found.reason


def test_part_of_a_board_is_told_by_its_colours(render: Rendered, standard_target: Target) -> None:
    image, true_px, _ = render(standard_target)
    x = int(true_px[:, 0].mean())
    half = replace(image, pixels=np.ascontiguousarray(image.pixels[:, x:]))
    found = detect_board(half, standard_target)
    assert isinstance(found, BoardView), found
    assert 20 < len(found.corner_ids) < 60
    seen_px = found.corners_px + np.array([x, 0])
    np.testing.assert_allclose(seen_px, true_px[found.corner_ids], atol=0.05)
    assert found.discs is not None
    assert len(found.discs) > 8


def test_simulated_pictures(simulated: Path, standard_target: Target) -> None:
    """Noise, mosaic and JPEG; small tilted squares, where OpenCV's corners are 2 px off."""
    truth = read_truth(simulated / "truth.json")
    recording = open_recording(simulated)
    for camera in recording.cameras:
        for frame in recording.files[camera]:
            image = recording.read(camera, frame)
            assert isinstance(image, Image)
            found = detect_board(image, standard_target)
            true_px = truth.images[camera, frame].corners_px
            # 0.05 px is what noise leaves; a corner that stayed where it was first seen is far off
            assert _rms_px(found, true_px) < 0.1
            assert isinstance(found, BoardView)
            assert np.abs(found.corners_px - true_px).max() < 0.5


def _flat(level: int) -> Image:
    return Image(pixels=np.full((360, 480, 3), level, np.uint8), encoding="srgb", bits=8)


@pytest.mark.parametrize(
    ("level", "words"), [(120, "add light"), (3, "add light"), (255, "overexposed")]
)
def test_reasons_on_flat_pictures(level: int, words: str) -> None:
    found = detect_board(_flat(level), _PLAIN)
    assert isinstance(found, NotFound)
    assert words in found.reason
    assert "7x6" in found.reason


def test_reason_on_an_overexposed_board(render: Rendered) -> None:
    image, _, _ = render(_PLAIN, gain=60)
    found = detect_board(_as_8_bit(image), _PLAIN)
    assert isinstance(found, NotFound)
    assert "close the aperture" in found.reason


def test_reason_on_clutter(rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 255, (360, 480, 3), dtype=np.uint8)
    found = detect_board(Image(pixels=pixels, encoding="srgb", bits=8), _PLAIN)
    assert isinstance(found, NotFound)
    assert "show it whole" in found.reason


def test_grey_pictures_have_no_discs(render: Rendered, standard_target: Target) -> None:
    image, true_px, _ = render(standard_target)
    grey = replace(image, pixels=np.ascontiguousarray(image.pixels[..., 1]))
    found = detect_board(grey, standard_target)
    assert _rms_px(found, true_px) < 0.05
    assert isinstance(found, BoardView)
    assert found.discs is None


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (9, 2), (12, 30)])
def test_tiny_pictures_show_no_board(shape: tuple[int, int], rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 255, (*shape, 3), dtype=np.uint8)
    found = detect_board(Image(pixels=pixels, encoding="srgb", bits=8), _PLAIN)
    assert isinstance(found, NotFound)
