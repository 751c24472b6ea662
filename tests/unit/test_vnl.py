"""mrcal's corner files: weights, holes, and whose picture it was."""

import re
from pathlib import Path

import numpy as np
import pytest

from calichrome.errors import FileFormatError
from calichrome.observations import Dataset, read_corners

SIZES = {"cam0": (640, 480), "left": (640, 480), "right": (320, 240)}


def _read(tmp_path: Path, text: str, n_corners: int = 4, pattern: str | None = None) -> Dataset:
    path = tmp_path / "corners.vnl"
    path.write_text(text, encoding="utf-8")
    return read_corners(path, SIZES, n_corners, pattern=pattern)


def _rows(name: str, *rows: str) -> str:
    return "".join(f"{name} {row}\n" for row in rows)


GOOD = ("1.5 2 0", "11 2 0", "1 12 0", "11 12 0")
HEADER = "## generated with mrgingham\n# filename x y level\n"


def test_the_example_of_mrcal(tmp_path: Path) -> None:
    """The sample of mrcal's recipe for other detectors: a toy 2x2 board, two cameras."""
    text = """#   filename      x    y  weight
frame0-cam0.jpg 10.2 12.5 1.0
frame0-cam0.jpg 21.2 15.1 1.0
frame0-cam0.jpg  9.4 19.5 0.5
frame0-cam0.jpg 21.3 23.6 1.0
frame0-cam1.jpg -    -    -
frame1-cam0.jpg -    -    -
frame1-cam1.jpg 30.1 39.6 0.25
frame1-cam1.jpg 45.8 38.5 1.0
frame1-cam1.jpg -    -    -
frame1-cam1.jpg 42.5 47.4 1.0
"""
    sizes = {"cam0": (640, 480), "cam1": (640, 480)}
    path = tmp_path / "corners.vnl"
    path.write_text(text, encoding="utf-8")
    dataset = read_corners(path, sizes, 4, pattern="{frame}-{camera}")
    assert {camera: list(views) for camera, views in dataset.views.items()} == {
        "cam0": ["frame0"],
        "cam1": ["frame1"],
    }
    whole, part = dataset.views["cam0"]["frame0"], dataset.views["cam1"]["frame1"]
    np.testing.assert_allclose(whole.corners_px[2], [9.4, 19.5])
    assert list(part.corner_ids) == [0, 1, 3]
    assert whole.cov_px is not None
    assert part.cov_px is not None
    np.testing.assert_allclose(whole.cov_px[2], 4 * np.eye(2))  # weight 1/2: noise twice as large
    np.testing.assert_allclose(part.cov_px[0], 16 * np.eye(2))


def test_levels_double_the_noise(tmp_path: Path) -> None:
    rows = _rows("1.png", "1 2 0", "11 2 1", "1 12 2", "11 12 -1")
    view = _read(tmp_path, HEADER + rows).views["cam0"]["1"]
    assert list(view.corner_ids) == [0, 1, 2]
    assert view.cov_px is not None
    np.testing.assert_allclose(view.cov_px[:, 0, 0], [1, 4, 16])  # mrcal: weight 2^-level


@pytest.mark.parametrize("header", [HEADER, "# filename x y\n", "# x y filename\n"])
def test_without_other_levels_there_is_no_covariance(tmp_path: Path, header: str) -> None:
    rows = {
        HEADER: _rows("1.png", *GOOD),
        "# filename x y\n": _rows("1.png", *(row[:-2] for row in GOOD)),
        "# x y filename\n": "".join(f"{row[:-2]} 1.png\n" for row in GOOD),
    }[header]
    view = _read(tmp_path, header + rows).views["cam0"]["1"]
    assert view.cov_px is None
    np.testing.assert_allclose(view.corners_px[0], [1.5, 2])


def test_a_picture_without_a_board_has_one_row(tmp_path: Path) -> None:
    """mrgingham(1) shows that row with two and with three dashes."""
    text = HEADER + "1.png - -\n2.png - - -\n" + _rows("3.png", *GOOD)
    assert list(_read(tmp_path, text).views["cam0"]) == ["3"]


def test_folders_are_cameras(tmp_path: Path) -> None:
    text = HEADER + _rows("/data/left/7.png", *GOOD) + _rows("/data/right/7.png", *GOOD)
    dataset = _read(tmp_path, text)
    assert dataset.cameras == ("left", "right")
    assert dataset.shared_frames("left", "right") == ("7",)
    assert dataset.sizes_wh["right"] == (320, 240)


def test_one_folder_may_be_a_known_camera(tmp_path: Path) -> None:
    text = HEADER + _rows("shots/left/7.png", *GOOD) + _rows("shots/left/8.png", *GOOD)
    assert _read(tmp_path, text).cameras == ("left",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (_rows("1.png", *GOOD), "lacks its first line, like # filename x y level"),
        ("# file x y\n", "has the columns file x y; wanted are filename x y"),
        (HEADER + _rows("1.png", *GOOD[:3]), "1.png has 3 corners, the target has 4"),
        (HEADER + "1.png 1 two 0\n", "line 3: 1 two 0 are no numbers"),
        (HEADER + "1.png 1 nan 0\n", "line 3: 1 nan 0 must be finite"),
        (HEADER + "1.png 1 2 0 5\n", "line 3: wrong number of cells"),
        (HEADER + "1.png 1 2 900\n", "level 900 is no level"),
        (HEADER + _rows("a/up/1.png", *GOOD) + _rows("a/down/1.png", *GOOD), "--size up="),
        (
            HEADER + "".join(_rows(f"{side}{n}.png", *GOOD) for side in "ab" for n in (1, 2)),
            "say which",
        ),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(FileFormatError, match=re.escape(says)):
        _read(tmp_path, text)
