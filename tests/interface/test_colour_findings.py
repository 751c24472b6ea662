"""What is said of light and colour that change: inside a recording, and since the calibration."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calichrome.colorimetry.encoding import encode, linearise
from calichrome.colour import fit
from calichrome.colour.illuminants import leave_out_other_light
from calichrome.colour.samples import collect_samples, disc_means
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import SEVERITIES
from calichrome.observations import BoardView, Dataset, DiscSamples
from calichrome.target import Target, colour_checker_palette

Cli = Callable[..., Any]
Change = Callable[[FloatArray], FloatArray]

_SATURATION = np.array([[1.20, -0.12, -0.08], [-0.08, 1.16, -0.08], [-0.06, -0.16, 1.22]])
"""Turns a camera's colours against each other and leaves greys."""


def _codes(found: dict[str, Any]) -> set[str]:
    assert all(item["severity"] == SEVERITIES[item["code"]] for item in found["findings"])
    return {item["code"] for item in found["findings"]}


@pytest.fixture
def still(simulated: Path, tmp_path: Path) -> Callable[[Mapping[str, Change]], Path]:
    """One picture of each camera that the rig was calibrated with, changed in linear light."""

    def copy(changes: Mapping[str, Change]) -> Path:
        folder = tmp_path / "still"
        shutil.rmtree(folder, ignore_errors=True)
        for camera in ("cam0", "cam1"):
            (folder / camera).mkdir(parents=True)
            path = sorted((simulated / camera).iterdir())[3]
            stored = cv2.imread(str(path))
            assert stored is not None
            if camera in changes:
                linear = linearise(stored[..., ::-1] / 255, "srgb")
                changed = encode(np.clip(changes[camera](linear), 0, 1), "srgb")
                stored = np.rint(255 * changed).astype(np.uint8)[..., ::-1]
            assert cv2.imwrite(str(folder / camera / "new.png"), stored)
        return folder

    return copy


def _darker(linear: FloatArray) -> FloatArray:
    return np.asarray(0.75 * linear)


def _bluer(linear: FloatArray) -> FloatArray:
    return np.asarray(linear * np.array([0.8, 0.9, 0.95]))


def _saturated(linear: FloatArray) -> FloatArray:
    return np.asarray(0.9 * linear @ _SATURATION.T)


# --- check ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "kind"),
    [(_darker, "exposure"), (_bluer, "white balance"), (_saturated, "matrix")],
)
def test_colour_drift_fires(
    cli: Cli,
    simulated_rig: Path,
    still: Callable[[Mapping[str, Change]], Path],
    change: Change,
    kind: str,
) -> None:
    outcome = cli("check", simulated_rig, still({"cam0": change}), "--json")
    assert (outcome.code, outcome.err) == (3, "")
    assert _codes(outcome.json) == {"colour_drift"}  # and no word on geometry
    (found,) = [item for item in outcome.json["findings"] if item["camera"] == "cam0"]
    assert found["change"] == kind
    assert found["chance"] < 1e-3
    told = outcome.json["colour"]["cameras"]
    if kind == "exposure":
        assert told["cam0"]["exposure"] == pytest.approx(0.75, rel=0.02)
    elif kind == "white balance":
        expected = np.array([0.8, 0.9, 0.95]) / np.prod([0.8, 0.9, 0.95]) ** (1 / 3)
        np.testing.assert_allclose(told["cam0"]["balance"], expected, rtol=0.02)
    else:
        assert told["cam1"]["change"] != "matrix"


def test_colour_drift_does_not_fire(
    cli: Cli, simulated_rig: Path, still: Callable[[Mapping[str, Change]], Path]
) -> None:
    """Nor if the lamp is dimmed for all cameras alike."""
    found = cli("check", simulated_rig, still({}), "--json").json
    assert _codes(found) == set()
    assert {item["change"] for item in found["colour"]["cameras"].values()} == {"nothing"}
    dimmed = cli("check", simulated_rig, still({"cam0": _darker, "cam1": _darker}), "--json").json
    assert dimmed["unchanged"]
    assert "colour_drift" not in _codes(dimmed)
    ratio = dimmed["colour"]["light"]["level"] / found["colour"]["light"]["level"]
    assert ratio == pytest.approx(0.75, rel=0.01)


def _dim(linear: FloatArray) -> FloatArray:
    return np.asarray(0.3 * linear)


def test_light_changed_fires(
    cli: Cli, simulated_rig: Path, still: Callable[[Mapping[str, Change]], Path]
) -> None:
    outcome = cli("check", simulated_rig, still({"cam0": _dim, "cam1": _dim}))
    assert outcome.code == 0  # that is no change of a camera
    assert "note     light_changed" in outcome.out
    assert "times that of the calibration" in outcome.out
    assert "Unchanged" in outcome.out


def test_light_changed_does_not_fire(
    cli: Cli, simulated_rig: Path, still: Callable[[Mapping[str, Change]], Path]
) -> None:
    assert "light_changed" not in _codes(cli("check", simulated_rig, still({}), "--json").json)


# --- frames of one recording ----------------------------------------------------------------------


_UNDER_LAMP = np.array([[1.05, 0.12, -0.17], [-0.06, 1.03, 0.03], [0.02, -0.2, 1.18]])
"""Disc colours over white under one lamp, from those under another: greys stay."""


def _unchanged(values: FloatArray) -> FloatArray:
    return values


def _views(
    target: Target,
    rng: np.random.Generator,
    odd: Mapping[int, Change],
    n_frames: int = 8,
    odd_px: int = 60,
) -> dict[str, BoardView]:
    """Discs of a linear camera under one lamp, nearer or farther, in some frames changed."""
    n = len(target.markers)
    colours = np.clip(target.marker_xyz_d65, 1e-3, None)
    views = {}
    for frame in range(n_frames):
        level = rng.uniform(0.4, 0.7)
        change = odd.get(frame, _unchanged)
        rgb = change(colours) * level * rng.normal(1, 0.005, (n, 3))
        white = change(np.ones((n, 3))) * level * rng.normal(1, 0.002, (n, 3))
        views[f"{frame:02d}"] = BoardView(
            corner_ids=np.arange(0),
            corners_px=np.zeros((0, 2)),
            discs=DiscSamples(
                marker_ids=np.arange(n),
                centres_px=target.marker_centres_board[:, :2] * 1000 + 100,
                mean_rgb=rgb,
                median_rgb=rgb,
                cov_rgb=np.broadcast_to(1e-6 * np.eye(3), (n, 3, 3)),
                n_px=np.full(n, odd_px if frame in odd else 60),
                clipped=np.zeros(n),
                white_rgb=white,
                black_rgb=0.05 * white,
            ),
        )
    return views


def _dataset(**views: Mapping[str, BoardView]) -> Dataset:
    return Dataset(sizes_wh=dict.fromkeys(views, (640, 480)), views=views)


def _lamp(values: FloatArray) -> FloatArray:
    return np.asarray(values @ _UNDER_LAMP.T)


def test_illuminant_changes_fires(standard_target: Target, rng: np.random.Generator) -> None:
    odd = {3: _lamp}
    dataset = _dataset(a=_views(standard_target, rng, odd), b=_views(standard_target, rng, odd))
    kept, (found,) = leave_out_other_light(dataset)
    assert found.code == "illuminant_changes"
    assert (found.data["frame"], found.data["cameras"]) == ("03", ["a", "b"])
    assert "another spectrum" in found.text
    for views in kept.views.values():
        assert [frame for frame, view in views.items() if view.discs is None] == ["03"]


def test_illuminant_changes_names_the_camera(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """One camera alone may have changed its processing; the frame is left out all the same."""
    dataset = _dataset(
        a=_views(standard_target, rng, {3: _lamp}), b=_views(standard_target, rng, {})
    )
    kept, (found,) = leave_out_other_light(dataset)
    assert found.data["cameras"] == ["a"]
    assert "not in b" in found.text
    assert kept.views["b"]["03"].discs is None


def test_illuminant_changes_finds_several(
    standard_target: Target, rng: np.random.Generator
) -> None:
    odd = dict.fromkeys((1, 4, 6), _lamp)
    _, found = leave_out_other_light(_dataset(a=_views(standard_target, rng, odd)))
    assert [item.data["frame"] for item in found] == ["01", "04", "06"]


@pytest.mark.parametrize(
    "change",
    [
        lambda values: 0.4 * values,
        lambda values: values * np.array([1.3, 1.0, 0.8]),
        lambda values: values + 0.03,
    ],
    ids=["exposure", "white-balance", "stray-light"],
)
def test_illuminant_changes_does_not_fire(
    standard_target: Target, rng: np.random.Generator, change: Change
) -> None:
    dataset = _dataset(
        a=_views(standard_target, rng, {3: change}), b=_views(standard_target, rng, {})
    )
    kept, found = leave_out_other_light(dataset)
    assert found == ()
    assert kept is dataset


def test_illuminant_changes_does_not_fire_for_discs_that_pixels_smear(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """Demosaicing takes red and blue towards green where a disc is only a few pixels wide."""

    def smeared(values: FloatArray) -> FloatArray:
        return np.asarray(values - 0.2 * (values - values[:, 1:2]))

    small = _dataset(a=_views(standard_target, rng, {3: smeared}, odd_px=14))
    assert leave_out_other_light(small) == (small, ())
    large = _dataset(a=_views(standard_target, rng, {3: smeared}))
    assert leave_out_other_light(large)[1]  # there it is told from the other frames


def test_an_exposure_of_one_frame_does_not_change_the_colours(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """Whatever factor a frame has, discs over their white are what they were."""
    n = len(standard_target.markers)
    state = rng.bit_generator.state
    means = []
    for factor in (1.0, 0.35):
        rng.bit_generator.state = state
        views = _views(standard_target, rng, {3: partial(np.multiply, factor)})
        samples = collect_samples(views)
        assert samples is not None
        mean_rgb, n_views, _ = disc_means(samples, n)
        assert (n_views == 8).all()
        means.append(mean_rgb / samples.reference_light_rgb)
    np.testing.assert_allclose(means[1], means[0], rtol=0.003)  # only its weight is another


def test_few_frames_or_discs_say_nothing(standard_target: Target, rng: np.random.Generator) -> None:
    two = _views(standard_target, rng, {1: _lamp}, 2)
    assert leave_out_other_light(_dataset(a=two))[1] == ()
    board = replace(standard_target, markers=standard_target.markers[:7])
    assert leave_out_other_light(_dataset(a=_views(board, rng, {3: _lamp})))[1] == ()


class _Card:
    """A ColorChecker before a camera whose channels are mixtures of X, Y and Z."""

    def __init__(self, fall_off: float) -> None:
        self.places = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
        xyz = np.array([colour.xyz_d65 for colour in colour_checker_palette()])
        even = xyz @ np.linalg.inv(np.array([[0.5, 0.3, 0.1], [0.2, 0.7, 0.1], [0.1, 0.1, 0.9]])).T
        self.rgb = 0.7 * even * (1 - fall_off * self.places[:, :1] / 5)
        self.rgb_cov = np.zeros((24, 3, 3))
        self.clipped = np.zeros(24)

    def doubts(self) -> list[str]:
        found = fit(self, colour_checker_palette())
        assert not isinstance(found, str)
        return [item.code for item in found.doubts]


def test_uneven_light_fires() -> None:
    assert "uneven_light" in _Card(0.3).doubts()


def test_uneven_light_does_not_fire() -> None:
    assert _Card(0.0).doubts() == []
