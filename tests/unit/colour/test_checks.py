"""Doubts about encodings and exposures: when they fire, and when they must not."""

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D65
from calichrome.colour.checks import exposure_jumps, grey_slope

_LUMINANCE = np.array([0.9, 0.59, 0.36, 0.19, 0.09, 0.03])  # the grey row of a ColorChecker


@pytest.mark.parametrize("exponent", [1.0, 2.2, 1 / 2.2])
def test_slope_of_the_greys_is_the_exponent(exponent: float) -> None:
    xyz = _LUMINANCE[:, None] * D65
    rgb = 0.7 * _LUMINANCE[:, None] ** exponent * [0.5, 1, 0.8]
    slope = grey_slope(rgb, xyz)
    assert slope == pytest.approx(exponent, rel=1e-9)


def test_only_greys_count() -> None:
    xyz = np.concatenate([_LUMINANCE[:, None] * D65, [[0.2, 0.1, 0.02], [0.05, 0.1, 0.4]]])
    rgb = np.concatenate([_LUMINANCE[:, None] * np.ones(3), [[5.0, 7.0, 9.0], [np.nan] * 3]])
    assert grey_slope(rgb, xyz) == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("rows", [slice(0, 3), slice(0, 4)], ids=["three greys", "range 4.7"])
def test_too_few_greys_say_nothing(rows: slice) -> None:
    luminance = _LUMINANCE[rows, None]
    assert grey_slope(luminance * np.ones(3), luminance * D65) is None


def test_a_camera_that_jumps_alone_is_named() -> None:
    levels = {
        camera: {str(frame): gain * (0.5 + 0.1 * frame) for frame in range(6)}
        for camera, gain in (("a", 1.0), ("b", 0.7), ("c", 1.2))
    }
    assert exposure_jumps(levels) == []  # a board that turns to the lamp is brighter for all
    levels["b"]["3"] *= 1.5
    ((camera, frame, ratio),) = exposure_jumps(levels)
    assert (camera, frame) == ("b", "3")
    assert ratio == pytest.approx(1.5)


def test_small_changes_are_no_jumps() -> None:
    levels = {"a": dict.fromkeys("01234", 0.5), "b": {**dict.fromkeys("01234", 0.5), "2": 0.6}}
    assert exposure_jumps(levels) == []
    levels["b"]["2"] = 0.9
    assert [(frame, camera in "ab") for camera, frame, _ in exposure_jumps(levels)] == [("2", True)]


def test_two_shared_frames_say_nothing() -> None:
    levels = {"a": {"0": 0.5, "1": 0.5, "9": 1.0}, "b": {"0": 0.5, "1": 5.0, "8": 1.0}}
    assert exposure_jumps(levels) == []
