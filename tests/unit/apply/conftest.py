"""A calibrated camera by hand."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colour.models.linear import Linear
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.rig import Camera, CameraColour

_SIZE_WH = (160, 120)
_XYZ_FROM_RGB = np.array([[0.50, 0.30, 0.18], [0.24, 0.70, 0.06], [0.02, 0.12, 0.98]])


@pytest.fixture
def camera() -> Camera:
    """A wide lens with clear distortion, and colours by a 3x3."""
    lens = BrownConrady(
        fx=120, fy=121, cx=82, cy=57, k1=-0.25, k2=0.06, p1=1e-3, p2=-5e-4, k3=-0.004
    )
    return Camera(
        size_wh=_SIZE_WH,
        lens=lens,
        lens_sigma=dict.fromkeys(lens.NAMES),
        cam_from_ref=Pose.identity(),
        sigma_rad=None,
        sigma_m=None,
        n_views=12,
        n_corners=600,
        rms_px=0.1,
        colour=CameraColour(
            model=Linear.from_matrix(_XYZ_FROM_RGB),
            encoding="srgb",
            white_rgb=np.ones(3),
            delta_e_2000={"fit_mean": 1.0, "held_out_mean": 1.2, "held_out_p95": 2.0},
        ),
    )


@pytest.fixture
def linear_camera(camera: Camera) -> Camera:
    """The same, storing linear values."""
    assert camera.colour is not None
    return replace(camera, colour=replace(camera.colour, encoding="linear"))
