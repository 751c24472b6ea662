"""The ColorChecker card: found, turned, measured."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography
from calichrome.detection.card import (
    CARD_CORNERS,
    CARD_PLACES,
    CardReading,
    measure_card,
    read_card_corners,
)
from calichrome.detection.card_search import find_card
from calichrome.errors import DetectionError
from calichrome.imaging import Image
from calichrome.observations import NotFound
from calichrome.target import colour_checker_palette

SIZE = (900, 700)
FRAME = 0.04  # reflectance of what holds the patches
NOISE = 0.004
PX = 60  # per pitch of the drawing


def card_colours() -> FloatArray:
    """Linear sRGB of the patches, (24, 3), within 0..1."""
    xyz = np.array([colour.xyz_d65 for colour in colour_checker_palette()])
    return np.clip(xyz @ RGB_FROM_XYZ["srgb"].T, 0.01, 1)


def drawn(
    px_from_card: FloatArray,
    rng: np.random.Generator,
    *,
    level: float = 0.8,
    colours: FloatArray | None = None,
) -> Image:
    """A card of even patches seen through a plane-to-plane map from pitches to pixels."""
    colours = card_colours() if colours is None else colours
    card = np.full((6 * PX, 8 * PX, 3), FRAME)
    for place, colour in zip(CARD_PLACES, colours, strict=True):
        x, y = np.rint((place + np.array([4, 3])) * PX).astype(int)
        card[y - 25 : y + 25, x - 25 : x + 25] = colour
    from_drawing = np.array([[1 / PX, 0, -4 + 0.5 / PX], [0, 1 / PX, -3 + 0.5 / PX], [0, 0, 1]])
    background = rng.uniform(0.2, 0.5) * np.ones(3)
    seen = cv2.warpPerspective(
        card, px_from_card @ from_drawing, SIZE,
        flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=background.tolist(),
    )  # fmt: skip
    light = level * seen * (1 + rng.normal(0, NOISE, seen.shape))
    pixels = np.rint(65535 * np.clip(light, 0, 1)).astype(np.uint16)
    return Image(pixels=pixels, encoding="linear", bits=16)


def pose(tilt_deg: float, roll_deg: float) -> tuple[FloatArray, float]:
    """A map from pitches to pixels, and the angle to the line of sight, degrees."""
    turn = Rotation.from_euler("zxy", [roll_deg, tilt_deg, 0.6 * tilt_deg], degrees=True)
    axes, middle = turn.as_matrix(), np.array([0.3, -0.2, 13.0])
    camera = np.array([[1200, 0, (SIZE[0] - 1) / 2], [0, 1200, (SIZE[1] - 1) / 2], [0, 0, 1]])
    cosine = abs(axes[:, 2] @ middle) / np.linalg.norm(middle)
    return camera @ np.stack([axes[:, 0], axes[:, 1], middle], axis=1), float(
        np.degrees(np.arccos(cosine))
    )


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0, 25.0])
@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 172.0, -80.0])
def test_card_is_found_the_right_way_up(
    tilt_deg: float, roll_deg: float, rng: np.random.Generator
) -> None:
    to_px, _ = pose(tilt_deg, roll_deg)
    reading = find_card(drawn(to_px, rng))
    assert isinstance(reading, CardReading), reading
    pitch = np.linalg.norm(np.diff(apply_homography(to_px, CARD_PLACES[:2]), axis=0))
    away = np.linalg.norm(reading.centres_px - apply_homography(to_px, CARD_PLACES), axis=1)
    assert away.max() < 0.05 * pitch
    np.testing.assert_allclose(reading.rgb, 0.8 * card_colours(), rtol=0.01)


@pytest.mark.parametrize("n_covered", [4, 8, 11])
def test_card_is_found_under_a_leaf(n_covered: int, rng: np.random.Generator) -> None:
    """It hides the corner of the card from which its patches are counted."""
    to_px, _ = pose(8, 190)
    image = drawn(to_px, rng)
    leaf = apply_homography(to_px, np.array([[-3.1, -2.1], [3.2, -2.1], [-3.1, 2.2]]))
    reach = {4: 0.6, 8: 0.8, 11: 1.0}[n_covered]
    rim = np.rint(leaf[0] + reach * (leaf - leaf[0])).astype(np.int32)
    pixels = image.pixels.copy()
    cv2.fillPoly(pixels, [rim], (6000, 11000, 4500))
    reading = find_card(replace(image, pixels=pixels))
    assert isinstance(reading, CardReading), reading
    away = np.linalg.norm(reading.centres_px - apply_homography(to_px, CARD_PLACES), axis=1)
    assert away.max() < 8
    hidden = np.abs(reading.rgb - 0.8 * card_colours()).max(axis=1) > 0.05
    assert abs(hidden.sum() - n_covered) <= 2


def test_stated_covariance_is_that_of_the_means(rng: np.random.Generator) -> None:
    to_px, _ = pose(10, 0)
    corners = apply_homography(to_px, CARD_PLACES[list(CARD_CORNERS)])
    readings = [measure_card(drawn(to_px, rng), corners) for _ in range(30)]
    scatter = np.var([reading.rgb for reading in readings], axis=0, ddof=1)
    stated = np.mean([np.diagonal(r.rgb_cov, axis1=1, axis2=2) for r in readings], axis=0)
    assert 0.8 < np.mean(scatter / stated) < 1.25


def test_tilt_is_told(rng: np.random.Generator) -> None:
    for tilt_deg in (15.0, 30.0, 45.0):
        to_px, true_deg = pose(tilt_deg, 20)
        corners = apply_homography(to_px, CARD_PLACES[list(CARD_CORNERS)])
        reading = measure_card(drawn(to_px, rng), corners)
        assert reading.tilt_deg == pytest.approx(true_deg, abs=0.5)
        assert any("tilted" in text for text in reading.remarks) == (tilt_deg > 10)


def test_card_that_faces_the_camera_gets_no_remark(rng: np.random.Generator) -> None:
    reading = find_card(drawn(pose(0, 0)[0], rng))
    assert isinstance(reading, CardReading)
    assert reading.remarks == ()


def test_clipped_patches_are_told(rng: np.random.Generator) -> None:
    to_px, _ = pose(5, 0)
    corners = apply_homography(to_px, CARD_PLACES[list(CARD_CORNERS)])
    reading = measure_card(drawn(to_px, rng, level=1.4), corners)
    brightest = card_colours().max(axis=1) * 1.4
    np.testing.assert_array_equal(reading.clipped[brightest > 1.05], 1)
    np.testing.assert_array_equal(reading.clipped[brightest < 0.95], 0)
    assert any("clipped" in text for text in reading.remarks)


def test_half_covered_patch_says_so_in_its_covariance(rng: np.random.Generator) -> None:
    to_px, _ = pose(0, 0)
    corners = apply_homography(to_px, CARD_PLACES[list(CARD_CORNERS)])
    image = drawn(to_px, rng)
    x = round(corners[0, 0])
    pixels = image.pixels.copy()
    pixels[:, :x] = 20_000
    reading = measure_card(replace(image, pixels=pixels), corners)
    relative = np.sqrt(np.trace(reading.rgb_cov, axis1=1, axis2=2)) / reading.rgb.mean(axis=1)
    assert relative[0] > 20 * np.median(relative)


def test_patches_outside_the_picture_are_unseen(rng: np.random.Generator) -> None:
    to_px, _ = pose(0, 0)
    image = drawn(to_px, rng)
    corners = apply_homography(to_px, CARD_PLACES[list(CARD_CORNERS)])
    cut = replace(image, pixels=image.pixels[:, : round(corners[1, 0])])
    reading = measure_card(cut, corners)
    unseen = ~np.isfinite(reading.rgb).all(axis=1)
    np.testing.assert_array_equal(unseen, CARD_PLACES[:, 0] > 2)


def test_what_is_no_card_is_not_found(rng: np.random.Generator) -> None:
    """A card of 24 other colours looks like one but for its colours."""
    to_px, _ = pose(0, 0)
    image = drawn(to_px, rng)
    assert isinstance(find_card(replace(image, pixels=image.pixels[..., 0])), NotFound)
    noise = rng.integers(0, 65535, image.pixels.shape).astype(np.uint16)
    assert isinstance(find_card(replace(image, pixels=noise)), NotFound)
    found = find_card(drawn(to_px, rng, colours=rng.permutation(card_colours())))
    assert isinstance(found, NotFound)
    assert "ColorChecker" in found.reason


def test_eight_bit_pictures_are_linearised(rng: np.random.Generator) -> None:
    to_px, _ = pose(8, 0)
    image = drawn(to_px, rng)
    coded = np.rint(255 * encode(image.linear(), "srgb")).astype(np.uint8)
    reading = find_card(Image(pixels=coded, encoding="srgb", bits=8))
    assert isinstance(reading, CardReading)
    np.testing.assert_allclose(reading.rgb, 0.8 * card_colours(), rtol=0.02)


def test_corners_are_read(tmp_path: Path) -> None:
    path = tmp_path / "corners.csv"
    path.write_text("x,y\n1,2\n101,3\n100.5,60\n2,61\n", encoding="utf-8")
    np.testing.assert_array_equal(read_card_corners(path), [[1, 2], [101, 3], [100.5, 60], [2, 61]])


@pytest.mark.parametrize(
    "text", ["", "x,y\n1,2\n", "1,2\n3,4\n5,6\n7,8\n", "x,y\n1,2\n3,4\n5,nan\n7,8\n", "x,y\na,b\n"]
)
def test_corners_that_cannot_be_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "corners.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DetectionError, match="centres of the corner patches"):
        read_card_corners(path)


def test_corners_that_are_no_quadrangle(rng: np.random.Generator) -> None:
    image = drawn(pose(0, 0)[0], rng)
    with pytest.raises(ValueError, match="in order around it"):
        measure_card(image, np.array([[0.0, 0], [100, 100], [100, 0], [0, 100]]))
