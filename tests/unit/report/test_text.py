"""What a person reads."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.findings import finding
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.report.text import distance_text, summary, table, with_sigma
from calichrome.rig import Camera, Rig
from calichrome.target import chessboard

_LENS = BrownConrady(fx=600.12, fy=601, cx=320, cy=240)
_CAMERA = Camera(
    size_wh=(640, 480),
    lens=_LENS,
    lens_sigma=dict.fromkeys(_LENS.NAMES, 0.3),
    cam_from_ref=Pose(np.eye(3), np.array([-0.3, 0, 0.4])),
    sigma_rad=np.full(3, 1e-3),
    sigma_m=np.array([1e-3, 1e-3, 1e-3]),
    cov_m=1e-6 * np.eye(3),
    n_views=12,
    n_corners=600,
    rms_px=0.1,
)


@pytest.fixture
def rig() -> Rig:
    reference = replace(_CAMERA, cam_from_ref=Pose.identity(), sigma_m=np.zeros(3))
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="left",
        cameras={"left": reference, "right": _CAMERA},
        pairs=(),
        frames={},
    )


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (1104.408, 0.53, "1104.41 ± 0.53"),
        (1104.408, 5.3, "1104.4 ± 5.3"),
        (1104.408, 53.0, "1104 ± 53"),
        (3.14159, None, "3.14"),
        (3.14159, 0.0, "3.14"),
        (3.14159, float("nan"), "3.14"),
    ],
)
def test_two_digits_of_uncertainty(value: float, sigma: float | None, expected: str) -> None:
    assert with_sigma(value, sigma) == expected


def test_sigma_of_a_distance_is_along_the_line() -> None:
    """3-4-5: 500 mm; one millimetre on each axis is one along any line."""
    assert distance_text(_CAMERA) == "500.0 ± 1.0"


def test_columns_are_aligned() -> None:
    lines = table(["camera", "px"], [["a", "1000"], ["longer", "2"]])
    assert lines == ["camera    px", "a       1000", "longer     2"]


def test_gravest_finding_comes_first_and_each_code_once(rig: Rig) -> None:
    findings = (
        finding("few_views", "left has 5"),
        finding("few_views", "right has 6"),
        finding("scale_unverified", "nominal"),
        finding("weak_geometry", "parallel"),
    )
    text = summary(replace(rig, findings=findings))
    assert text.index("critical weak_geometry: parallel") < text.index("few_views: left has 5")
    assert text.index("few_views") < text.index("scale_unverified")
    assert "right has 6" not in text
    assert "(and 1 more like this)" in text
    assert "Trustworthy: NO" in text


def test_clean_rig_is_trustworthy_in_few_lines(rig: Rig) -> None:
    text = summary(rig)
    assert "Trustworthy: yes." in text
    assert "reference" in text
    assert "600.12 ± 0.30" in text
    assert len(text.splitlines()) < 15
