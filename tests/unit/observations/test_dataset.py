import numpy as np
import pytest

from calichrome.observations import BoardView, Dataset


def _view() -> BoardView:
    return BoardView(corner_ids=np.arange(2), corners_px=np.zeros((2, 2)))


def test_frames_of_one_instant_are_shared() -> None:
    views = {"a": dict.fromkeys("312", _view()), "b": dict.fromkeys("4123", _view())}
    dataset = Dataset(sizes_wh={"a": (1, 1), "b": (1, 1)}, views=views)
    assert dataset.frames == ("3", "1", "2", "4")
    assert dataset.shared_frames("a", "b") == ("3", "1", "2")
    less = dataset.without_frames(frozenset("13"))
    assert {camera: list(seen) for camera, seen in less.views.items()} == {
        "a": ["2"],
        "b": ["4", "2"],
    }
    assert dataset.frames == ("3", "1", "2", "4")  # the first one is as it was


def test_corners_match_their_ids() -> None:
    with pytest.raises(ValueError, match=r"expected shape \(3, 2\), got \(2, 2\)"):
        BoardView(corner_ids=np.arange(3), corners_px=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="not finite"):
        BoardView(corner_ids=np.arange(1), corners_px=np.array([[0, np.nan]]))
