"""Two calibrated cameras by hand."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colour.models.linear import Linear
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.rig import Camera, CameraColour, Rig
from calichrome.target import chessboard

_SIZE_WH = (32, 24)


@pytest.fixture
def rig() -> Rig:
    """Two pinholes side by side; linear camera values are XYZ."""
    lens = BrownConrady(fx=30, fy=30, cx=15.5, cy=11.5)
    left = Camera(
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
            model=Linear.from_matrix(np.eye(3)),
            encoding="linear",
            white_rgb=np.ones(3),
            delta_e_2000={"fit_mean": 1.0, "held_out_mean": 1.0, "held_out_p95": 1.0},
        ),
    )
    right = replace(left, cam_from_ref=Pose(np.eye(3), np.array([-0.1, 0, 0])))
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="left",
        cameras={"left": left, "right": right},
        pairs=(),
        frames={},
    )
