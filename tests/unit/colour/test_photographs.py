"""Real photographs of charts; the bars are those of benchmarks/colour/photographs.py."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.colour.bands import BandChart
from benchmarks.colour.photographs import Photograph, photographs

WORST_CAMERA = 5.7
"""Mean leave-one-out dE2000 of a matrix: the worst of 51 measured cameras under 3 lights."""


@pytest.fixture(scope="module")
def pictures(data: Path) -> dict[str, Photograph]:
    assert data.is_dir()  # the fixture tells whether there are test data at all
    return {picture.name: picture for picture in photographs()}


@pytest.mark.parametrize("name", ["andriy_linear", "macduff", "macduff2"])
def test_whole_charts_are_found_and_fitted(name: str, pictures: dict[str, Photograph]) -> None:
    picture = pictures[name]
    assert picture.corners_px is None
    assert picture.fitted.trustworthy
    assert picture.fitted.used.all()
    assert picture.left_out < WORST_CAMERA


def test_chart_under_a_leaf_is_refused(pictures: dict[str, Photograph]) -> None:
    fitted = pictures["plantcv_partial"].fitted
    assert not fitted.trustworthy
    (doubt,) = [item for item in fitted.doubts if item.severity == "critical"]
    assert doubt.code == "target_contradicted"
    # fully hidden by the leaf: orange, blue, green, white, neutral 8
    for hidden in ("orange", "blue", "green", "white_95", "neutral_8"):
        assert f"{hidden} (" in doubt.text


def test_clipped_and_tilted_charts_are_told(pictures: dict[str, Photograph]) -> None:
    over = pictures["andriy_linear, exposed x1.5 (by us)"]
    assert any("clipped" in text for text in over.reading.remarks)
    assert over.fitted.reasons[18] == "clipped"
    projected = pictures["bllanos, projector light"]
    assert any("tilted" in text for text in projected.reading.remarks)
    assert any(doubt.code == "uneven_light" for doubt in projected.fitted.doubts)


@pytest.mark.parametrize("band", [450, 500, 550, 600, 650, 700])
def test_camera_is_linear_over_the_exposures(band: int, data: Path) -> None:
    """25 to 3916 ms; the exponent of time is 1 and the levels are proportional to it."""
    found = BandChart(data / "chart_bllanos").linearity(band)
    assert found is not None
    assert found.n > 50
    assert found.exponent == pytest.approx(1, abs=0.02)
    assert found.residual < 0.02


def test_seven_bands_tell_reflectance(data: Path) -> None:
    chart = BandChart(data / "chart_bllanos")
    told, truth = chart.left_out
    assert np.sqrt(np.mean((told - truth)[:, 1:] ** 2)) < 0.03
    assert np.sqrt(np.mean((chart.left_out_spectra - chart.spectra) ** 2)) < 0.04
