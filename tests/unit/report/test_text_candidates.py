"""The table of colour models."""

import numpy as np

from calichrome.colour.models.linear import Linear
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.report.text_candidates import candidates_text
from calichrome.rig import Camera, CameraColour, Rig
from calichrome.target import chessboard

_LENS = BrownConrady(fx=600, fy=601, cx=320, cy=240)
_TRIED = {
    "model": "linear", "why_not": None, "n_free": 9, "solver": "closed form", "fit_mean": 0.91,
    "left_out_mean": 1.12, "left_out_p95": 2.53, "exposure_delta_e": 0.0, "gain": 1.25,
    "white_delta_e": 0.31, "hue_reversals": 0, "ns_per_pixel": 41.3,
}  # fmt: skip


def _camera(colour: CameraColour | None) -> Camera:
    return Camera(
        size_wh=(640, 480), lens=_LENS, lens_sigma={}, cam_from_ref=Pose.identity(),
        sigma_rad=None, sigma_m=None, n_views=12, n_corners=600, rms_px=0.1, colour=colour,
    )  # fmt: skip


def test_every_model_has_a_row_with_its_numbers_or_its_reason() -> None:
    colour = CameraColour(
        model=Linear.from_matrix(np.eye(3)),
        encoding="srgb",
        white_rgb=np.ones(3),
        delta_e_2000={},
        candidates=(_TRIED, {"model": "cheung-20", "why_not": "needs 21 colours"}),
    )
    rig = Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="left",
        cameras={"left": _camera(colour), "blind": _camera(None)},
        pairs=(),
        frames={},
    )
    _, title, _, linear, cheung = candidates_text(rig).splitlines()
    assert "left" in title
    assert linear.split() == [
        "linear", "9", "closed", "form", "0.91", "1.12", "2.53", "0.00", "1.2", "0.31", "0", "41",
        "taken",
    ]  # fmt: skip
    assert cheung.split() == ["cheung-20", *"-" * 10, "needs", "21", "colours"]
    assert "blind" not in candidates_text(rig)
