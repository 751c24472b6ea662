"""The pinhole of undistorted pictures: what it must show and what it must not."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import BrownConrady, KannalaBrandt, Lens
from calichrome.geometry.rectified_area import ValidArea
from calichrome.geometry.undistortion import Pinhole, undistorted_pinhole

_SIZE_WH = (640, 480)
_LENSES = [
    BrownConrady(fx=520, fy=523, cx=330, cy=228, k1=-0.3, k2=0.11, p1=1e-3, p2=-2e-3, k3=-0.02),
    BrownConrady(fx=600, fy=590, cx=310, cy=250, k1=0.2, k2=0.05),
    KannalaBrandt(fx=330, fy=331, cx=322, cy=237, k1=-0.02, k2=0.003, k3=0, k4=0),
]


def _border(size_wh: tuple[int, int]) -> FloatArray:
    width, height = size_wh
    x, y = np.arange(width), np.arange(height)
    sides = [np.column_stack([x, np.full(width, row)]) for row in (0, height - 1)] + [
        np.column_stack([np.full(height, column), y]) for column in (0, width - 1)
    ]
    return np.concatenate(sides).astype(np.float64)


def _in_picture(lens: Lens, pinhole: Pinhole, pixels: FloatArray) -> FloatArray:
    """Where the camera sees what the pinhole shows at `pixels`."""
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(pinhole.matrix).T
    assert lens.sees(rays).all()
    return lens.project(rays)


def _shown(lens: Lens, pinhole: Pinhole, pixels: FloatArray) -> FloatArray:
    """Where the pinhole shows what the camera sees at `pixels`."""
    rays = lens.unproject(pixels)
    return (rays / rays[:, 2:] @ pinhole.matrix.T)[:, :2]


@pytest.mark.parametrize("lens", _LENSES)
@pytest.mark.parametrize("keep_size", [False, True])
def test_valid_has_no_border(lens: Lens, keep_size: bool) -> None:  # noqa: FBT001
    pinhole = undistorted_pinhole(lens, _SIZE_WH, "valid", keep_size=keep_size)
    seen = _in_picture(lens, pinhole, _border(pinhole.size_wh))
    room = np.minimum(seen, np.array(_SIZE_WH) - 1 - seen)
    assert room.min() > -1e-6
    # and touches the picture's border: two pixels are lost to even sizes, and 1/800 of the place
    assert room.min() < (0.01 if keep_size else 4)


@pytest.mark.parametrize("lens", _LENSES)
@pytest.mark.parametrize("keep_size", [False, True])
def test_all_shows_everything(lens: Lens, keep_size: bool) -> None:  # noqa: FBT001
    pinhole = undistorted_pinhole(lens, _SIZE_WH, "all", keep_size=keep_size)
    shown = _shown(lens, pinhole, _border(_SIZE_WH))
    room = np.minimum(shown, np.array(pinhole.size_wh) - 1 - shown)
    assert room.min() > -0.5
    assert room.min() < 2


@pytest.mark.parametrize("area", ["all", "valid"])
@pytest.mark.parametrize("lens", _LENSES)
def test_size_or_scale_is_kept(lens: Lens, area: ValidArea) -> None:
    kept = undistorted_pinhole(lens, _SIZE_WH, area, keep_size=True)
    free = undistorted_pinhole(lens, _SIZE_WH, area, keep_size=False)
    assert kept.size_wh == _SIZE_WH
    assert (free.fx, free.fy) == (min(lens.fx, lens.fy),) * 2
    assert all(side % 2 == 0 for side in free.size_wh)
    assert kept.fx == kept.fy
    # the same part of the scene: sizes are to each other as scales, within an even number of pixels
    ratio = np.array(free.size_wh) / np.array(kept.size_wh)
    np.testing.assert_allclose(ratio, free.fx / kept.fx, atol=2.5 / 480)


def test_without_distortion_nothing_changes() -> None:
    lens = BrownConrady(fx=500, fy=500, cx=319.5, cy=239.5)
    for area in ("all", "valid"):
        pinhole = undistorted_pinhole(lens, _SIZE_WH, area, keep_size=True)
        assert (pinhole.fx, pinhole.cx, pinhole.cy) == pytest.approx((500, 319.5, 239.5), abs=0.7)
