"""NAME.csv and its neighbours: what is written is read, what is damaged is named."""

from pathlib import Path

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.errors import FileFormatError, OutputError
from calichrome.observations import (
    BoardView,
    Dataset,
    DiscSamples,
    read_corners,
    write_observations,
)

_SIZES_WH = {"left": (640, 480), "right, 2": (800, 600)}
_N_CORNERS = 54


def _discs(rng: np.random.Generator) -> DiscSamples:
    root = rng.normal(0, 0.01, (4, 3, 3))
    white = rng.uniform(0.6, 0.9, (4, 3))
    white[2] = np.nan  # clipped or hidden
    mean = rng.uniform(0, 1, (4, 3))
    return DiscSamples(
        marker_ids=np.array([0, 2, 3, 7]),
        centres_px=rng.uniform(0, 480, (4, 2)),
        mean_rgb=mean,
        median_rgb=mean,
        cov_rgb=root @ np.swapaxes(root, 1, 2),
        n_px=np.array([100, 200, 1, 37]),
        clipped=np.array([0, 0.25, 0, 1]),
        white_rgb=white,
        black_rgb=rng.uniform(0, 0.1, (4, 3)),
    )


def _view(rng: np.random.Generator, *, cov: bool, discs: bool) -> BoardView:
    ids = np.sort(rng.permutation(_N_CORNERS)[:30])
    root = rng.normal(0, 0.1, (30, 2, 2))
    return BoardView(
        corner_ids=ids,
        corners_px=rng.uniform(0, 640, (30, 2)),
        cov_px=root @ np.swapaxes(root, 1, 2) + 1e-4 * np.eye(2) if cov else None,
        discs=_discs(rng) if discs else None,
    )


@pytest.fixture
def dataset(rng: np.random.Generator) -> Dataset:
    return Dataset(
        sizes_wh=_SIZES_WH,
        views={
            "left": {
                "0001": _view(rng, cov=True, discs=True),
                "0002": _view(rng, cov=True, discs=False),
            },
            "right, 2": {'1 "quoted"': _view(rng, cov=False, discs=False)},
        },
    )


def _close(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-7)  # written with eight digits


def test_what_is_written_is_read(dataset: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "found.csv"
    write_observations(dataset, [("left", "0003", "no board, or dark")], path)
    read = read_corners(path, _SIZES_WH, _N_CORNERS)
    assert read.sizes_wh == dataset.sizes_wh
    assert {camera: list(seen) for camera, seen in read.views.items()} == {
        camera: list(seen) for camera, seen in dataset.views.items()
    }
    for camera, seen in dataset.views.items():
        for frame, view in seen.items():
            again = read.views[camera][frame]
            np.testing.assert_array_equal(again.corner_ids, view.corner_ids)
            np.testing.assert_allclose(again.corners_px, view.corners_px, atol=5.1e-7)  # 6 decimals
            if view.cov_px is None:
                assert again.cov_px is None
            else:
                assert again.cov_px is not None
                _close(again.cov_px, view.cov_px)
    rejected = (tmp_path / "found.rejected.csv").read_text()
    assert rejected == 'camera,frame,reason\nleft,0003,"no board, or dark"\n'


def test_discs_are_read_as_written(dataset: Dataset, tmp_path: Path) -> None:
    write_observations(dataset, [], tmp_path / "found.csv")
    read = read_corners(tmp_path / "found.csv", _SIZES_WH, _N_CORNERS)
    discs, again = (item.views["left"]["0001"].discs for item in (dataset, read))
    assert discs is not None
    assert again is not None
    np.testing.assert_array_equal(again.marker_ids, discs.marker_ids)
    np.testing.assert_array_equal(again.n_px, discs.n_px)
    _close(again.centres_px, discs.centres_px)
    _close(again.mean_rgb, discs.mean_rgb)
    _close(again.cov_rgb, discs.cov_rgb)
    _close(again.clipped, discs.clipped)
    _close(again.white_rgb, discs.white_rgb)  # nan stays nan
    _close(again.black_rgb, discs.black_rgb)
    assert read.views["left"]["0002"].discs is None


def test_nothing_is_overwritten(dataset: Dataset, tmp_path: Path) -> None:
    beside = tmp_path / "found.markers.csv"
    beside.write_text("mine")
    with pytest.raises(OutputError, match=r"found\.markers\.csv exists"):
        write_observations(dataset, [], tmp_path / "found.csv")
    assert not (tmp_path / "found.csv").exists()
    write_observations(dataset, [], tmp_path / "found.csv", force=True)
    assert beside.read_text() != "mine"


def test_no_board_leaves_the_header(tmp_path: Path) -> None:
    write_observations(Dataset(sizes_wh={}, views={}), [], tmp_path / "found.csv")
    assert (tmp_path / "found.csv").read_text() == "camera,frame,corner,x,y,sxx,sxy,syy\n"
    assert read_corners(tmp_path / "found.csv", {}, _N_CORNERS).frames == ()


def _read(tmp_path: Path, text: str) -> BoardView:
    path = tmp_path / "in.csv"
    path.write_text(text)
    return read_corners(path, _SIZES_WH, _N_CORNERS).views["left"]["1"]


def test_one_sigma_is_a_round_covariance(tmp_path: Path) -> None:
    view = _read(tmp_path, "camera,frame,corner,x,y,sigma\nleft,1,0,5,6,0.5\nleft,1,3,7,8,0.1\n")
    assert view.cov_px is not None
    np.testing.assert_allclose(view.cov_px, [0.25 * np.eye(2), 0.01 * np.eye(2)])


@pytest.mark.parametrize(
    "text",
    [
        "camera,frame,corner,x,y\nleft,1,0,5,6\n",
        "camera,frame,corner,x,y,sxx,sxy,syy\nleft,1,0,5,6,,,\n",
        "camera,frame,corner,x,y,sigma\nleft,1,0,5,6,\n",
        "y,x,corner,frame,camera,remark\n6,5,0,1,left,fine\n",
        "\ufeffcamera,frame,corner,x,y\r\nleft,1,0,5,6\r\n",
    ],
    ids=["absent", "empty", "no sigma", "other order", "from a spreadsheet"],
)
def test_covariance_may_be_absent(text: str, tmp_path: Path) -> None:
    view = _read(tmp_path, text)
    assert view.cov_px is None
    np.testing.assert_array_equal(view.corners_px, [[5, 6]])


_HEADER = "camera,frame,corner,x,y,sxx,sxy,syy\nleft,1,0,5,6,1,0,1\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("camera,frame,x,y\n", "lacks the columns corner"),
        ("", "lacks the columns camera, frame, corner, x, y"),
        (_HEADER + "left,1,one,5,6,1,0,1\n", "line 3: corner 'one' is no number"),
        (_HEADER + "left,1,1,5 px,6,1,0,1\n", "line 3: x '5 px' is no number"),
        (_HEADER + "left,1,1,5,,1,0,1\n", "line 3: x and y must be finite"),
        (_HEADER + "left,1,1,nan,6,1,0,1\n", "line 3: x and y must be finite"),
        (_HEADER + "left,1,54,5,6,1,0,1\n", "line 3: corner 54, .* 0 to 53"),
        (_HEADER + "left,1,-1,5,6,1,0,1\n", "line 3: corner -1"),
        (_HEADER + "left,1,1,5,6,1,2,1\n", "line 3: sxx, sxy, syy are no covariance"),
        (_HEADER + "left,1,1,5,6,-1,0,-1\n", "line 3: sxx, sxy, syy are no covariance"),
        (_HEADER + "left,1,1,5,6,1,0\n", "line 3: wrong number of cells"),
        (_HEADER + "left,1,1,5,6,1,0,1,9\n", "line 3: wrong number of cells"),
        (_HEADER + "left,1,0,7,8,1,0,1\n", "camera left, frame 1: a corner stands twice"),
        (_HEADER + "middle,1,0,7,8,1,0,1\n", "size of camera middle is unknown.*--size middle="),
        ("camera,frame,corner,x,y,sigma\nleft,1,0,5,6,0\n", "line 2: sigma must be positive"),
    ],
)
def test_damage_is_named(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=reason) as caught:
        _read(tmp_path, text)
    assert "in.csv" in str(caught.value)


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_bytes(b"\x89PNG\r\n\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="cannot be read as CSV"):
        read_corners(path, _SIZES_WH, _N_CORNERS)
    with pytest.raises(FileFormatError, match="cannot be read as CSV"):
        read_corners(tmp_path / "absent.csv", _SIZES_WH, _N_CORNERS)


def test_damaged_discs_are_named(dataset: Dataset, tmp_path: Path) -> None:
    write_observations(dataset, [], tmp_path / "found.csv")
    beside = tmp_path / "found.markers.csv"
    lines = beside.read_text().splitlines()
    cells = lines[2].split(",")
    cells[5] = "red"
    beside.write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]) + "\n")
    with pytest.raises(FileFormatError, match=r"found\.markers\.csv, line 3: r 'red'"):
        read_corners(tmp_path / "found.csv", _SIZES_WH, _N_CORNERS)


@pytest.mark.parametrize("column", ["marker", "x", "n_px"])
def test_discs_need_their_numbers(column: str, dataset: Dataset, tmp_path: Path) -> None:
    write_observations(dataset, [], tmp_path / "found.csv")
    beside = tmp_path / "found.markers.csv"
    header, first, *rest = beside.read_text().splitlines()
    cells = first.split(",")
    cells[header.split(",").index(column)] = ""
    beside.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    with pytest.raises(FileFormatError, match=rf"found\.markers\.csv, line 2: {column}"):
        read_corners(tmp_path / "found.csv", _SIZES_WH, _N_CORNERS)
