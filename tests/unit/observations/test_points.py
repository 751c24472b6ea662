"""Points of pictures as CSV: read in any order, refused by line."""

from pathlib import Path

import numpy as np
import pytest

from calichrome.errors import FileFormatError
from calichrome.observations.points import read_points

_SIZES = {"left": (640, 480), "right": (800, 600)}


def _file(folder: Path, *rows: str, header: str = "camera,frame,point,x,y") -> Path:
    path = folder / "points.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_points_are_put_together_by_frame_and_name(tmp_path: Path) -> None:
    path = _file(
        tmp_path, "right,7,tip,10,20,0.5", "left,7,tip,1,2,", "left,8,tip,3,4,2", "left,7,a,5,6,",
        header="camera,frame,point,x,y,sigma",
    )  # fmt: skip
    seen = read_points(path, _SIZES)
    assert seen.names == (("7", "tip"), ("8", "tip"), ("7", "a"))
    np.testing.assert_array_equal(seen.pixels["left"], [[1, 2], [3, 4], [5, 6]])
    np.testing.assert_array_equal(seen.pixels["right"], [[10, 20], [np.nan] * 2, [np.nan] * 2])
    np.testing.assert_array_equal(seen.cov_px2["right"][0], np.eye(2) * 0.25)
    np.testing.assert_array_equal(seen.cov_px2["left"][1], np.eye(2) * 4)
    assert np.isnan(seen.cov_px2["left"][0]).all()


def test_a_covariance_may_be_full(tmp_path: Path) -> None:
    path = _file(tmp_path, "left,1,a,1,2,4,1,9", header="camera,frame,point,x,y,sxx,sxy,syy")
    np.testing.assert_array_equal(read_points(path, _SIZES).cov_px2["left"], [[[4, 1], [1, 9]]])


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("top,1,a,1,2,", "the rig has no camera 'top'; it has left, right"),
        ("left,1,a,one,2,", "x 'one' is no number"),
        ("left,1,a,,2,", "x and y must be finite"),
        ("left,1,a,inf,2,", "x and y must be finite"),
        ("left,1,a,640,2,", "outside the pictures of left, which have 640x480"),
        ("left,1,a,1,2,0", "sigma must be positive"),
        ("left,1,a,1,2,inf", "sigma must be positive"),
        ("left,1,first,1,2,", "point first of frame 1 stands twice for camera left"),
        ("left,1,a,1,2", "wrong number of cells"),
    ],
)
def test_a_bad_row_is_named_by_its_line(row: str, says: str, tmp_path: Path) -> None:
    header = "camera,frame,point,x,y,sigma"
    path = _file(tmp_path, "left,1,first,1,2,", row, header=header)
    with pytest.raises(FileFormatError, match=f"points.csv, line 3: .*{says}"):
        read_points(path, _SIZES)


@pytest.mark.parametrize("cells", ["4,,9", "4,7,9", "-4,1,9", "4,1,inf"])
def test_what_is_no_covariance_is_refused(cells: str, tmp_path: Path) -> None:
    header = "camera,frame,point,x,y,sxx,sxy,syy"
    with pytest.raises(FileFormatError, match="line 2: sxx, sxy, syy are no covariance"):
        read_points(_file(tmp_path, f"left,1,a,1,2,{cells}", header=header), _SIZES)


def test_columns_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="lacks the columns camera, point"):
        read_points(_file(tmp_path, "1,2,3", header="frame,x,y"), _SIZES)
