"""A rig with a lens of each model, and points in its view."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady, Lens
from calichrome.geometry.lenses.kannala_brandt import KannalaBrandt
from calichrome.geometry.lenses.rational import Rational
from calichrome.rig import Camera, Rig
from calichrome.target import chessboard

_SIZE_WH = (640, 480)
# k1 of the second is a number that YAML 1.1 takes for a string if it is written as Python does
_LENSES: dict[str, Lens] = {
    "left": BrownConrady(
        fx=610.1, fy=602.2, cx=322.3, cy=238.4, k1=-0.2, k2=0.08, p1=1e-3, p2=-5e-4, k3=-0.01
    ),
    "right": Rational(
        fx=600, fy=600.5, cx=318, cy=243, k1=1e-05, k2=0.12, p1=-2e-4, p2=3e-4, k3=0.004,
        k4=0.35, k5=0.11, k6=0.01,
    ),
    "wide": KannalaBrandt(fx=330, fy=331, cx=321, cy=239, k1=-0.02, k2=0.01, k3=-0.004, k4=6e-4),
}  # fmt: skip
_PLACES = {
    "left": Pose.identity(),
    "right": Pose.from_rotvec([0.01, 0.05, -0.02], [-0.1, 0.004, 0.002]),
    "wide": Pose.from_rotvec([-0.03, -0.08, 0.01], [0.15, -0.01, 0.01]),
}


def _camera(lens: Lens, cam_from_ref: Pose) -> Camera:
    """A camera without colour and without any sigma."""
    return Camera(
        size_wh=_SIZE_WH,
        lens=lens,
        lens_sigma=dict.fromkeys(lens.NAMES),
        cam_from_ref=cam_from_ref,
        sigma_rad=None,
        sigma_m=None,
        n_views=12,
        n_corners=600,
        rms_px=0.1,
    )


@pytest.fixture
def rig() -> Rig:
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="left",
        cameras={name: _camera(lens, _PLACES[name]) for name, lens in _LENSES.items()},
        pairs=(),
        frames={},
    )


@pytest.fixture
def points_ref(rng: np.random.Generator) -> FloatArray:
    """Points (200, 3) that all cameras see, metres."""
    return rng.uniform([-0.15, -0.12, 0.5], [0.15, 0.12, 1.2], (200, 3))
