"""Colour of a rig from views of discs: what a user may ask for, and the fall-off of lenses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from calichrome.apply import Corrector, FrameFormat, OutputSpace, SourceMap
from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colorimetry.rgb_spaces import XYZ_FROM_RGB
from calichrome.colour.models import MODELS
from calichrome.colour.rig_fit import ColourSettings
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import RecordingError
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import solve_rig
from calichrome.imaging import Image, Pixels
from calichrome.observations import BoardView, Dataset, DiscSamples
from calichrome.pipeline.calibrate import Calibration, CalibrationSettings, calibrate_dataset
from calichrome.pipeline.solve_colour import ColourChoices, ColourModelName, RigColour, solve_colour
from calichrome.rig import Camera, load_rig, save_rig
from calichrome.target import Paper, Target

_SIZE_WH = (640, 480)
_LENS = BrownConrady(fx=600, fy=601, cx=322, cy=238, k1=-0.1, k2=0.02)
_CAMERAS = {"a": Pose.identity(), "b": Pose.from_rotvec([0, 0.3, 0], [-0.25, 0, 0.04])}
_FROM_XYZ = {  # what the cameras make of XYZ; a screen could show what a takes
    "a": np.array([[1.9, -0.6, -0.3], [-0.7, 1.6, 0.1], [0.1, -0.2, 1.0]]) * 0.8,
    "b": np.array([[1.5, -0.3, -0.2], [-0.4, 1.4, 0.0], [0.0, -0.1, 1.1]]) * 0.7,
}
_FALL_OFF = {"a": (-0.45, 0.04), "b": (-0.25, 0.02)}  # of log gain by r^2 and r^4


def _vignetting(camera: str) -> Vignetting:
    radial = (*_FALL_OFF[camera], 0.0, 0.0, 0.0)
    return Vignetting(
        centre_px=np.array([_LENS.cx, _LENS.cy]),
        half_diagonal_px=400.0,
        coefficients=np.array([radial] * 3),
        covariance=np.zeros((3, 5, 5)),
        covered_radius=1.2,
    )


@pytest.fixture(scope="module")
def target(standard_target: Target) -> Target:
    paper = Paper(white_xyz_d65=(0.80, 0.85, 0.88), black_xyz_d65=(0.04, 0.042, 0.045))
    return replace(standard_target, colours_measured=True, paper=paper)


def _held(target: Target, n_frames: int) -> dict[str, Pose]:
    """Boards at all places of the picture, tilted each to another side."""
    centre = target.corners_board.mean(axis=0)
    poses = {}
    for index in range(n_frames):
        angle = 2.4 * index
        turn = Pose.from_rotvec([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.2], np.zeros(3))
        place = [0.12 * np.sin(1.7 * index), 0.09 * np.cos(2.9 * index), 0.55 + 0.02 * index]
        poses[f"{index:02d}"] = Pose(np.eye(3), np.array(place)) @ turn @ Pose(np.eye(3), -centre)
    return poses


def _dataset(
    target: Target, *, noise: float, n_frames: int = 6, vignetted: bool = False
) -> Dataset:
    rng = np.random.default_rng(6)
    paper = target.paper
    views: dict[str, dict[str, BoardView]] = {}
    for camera, cam_from_ref in _CAMERAS.items():
        of_white, of_black = (
            np.asarray(xyz) @ _FROM_XYZ[camera].T
            for xyz in (paper.white_xyz_d65, paper.black_xyz_d65)
        )
        views[camera] = {}
        for index, (frame, ref_from_board) in enumerate(_held(target, n_frames).items()):
            cam_from_board = cam_from_ref @ ref_from_board
            corners, centres = (
                _LENS.project(cam_from_board.apply(points))
                for points in (target.corners_board, target.marker_centres_board)
            )
            gain = _vignetting(camera).gain(centres) if vignetted else np.ones((len(centres), 3))
            gain = gain * (1 - 0.02 * index)
            rgb = target.marker_xyz_d65 @ _FROM_XYZ[camera].T
            rgb = gain * rgb * rng.normal(1, noise, rgb.shape)
            n = len(rgb)
            discs = DiscSamples(
                marker_ids=np.arange(n), centres_px=centres, mean_rgb=rgb, median_rgb=rgb,
                cov_rgb=np.broadcast_to(1e-6 * np.eye(3), (n, 3, 3)), n_px=np.full(n, 60),
                clipped=np.zeros(n), white_rgb=gain * of_white * rng.normal(1, 1e-3, (n, 3)),
                black_rgb=gain * of_black * rng.normal(1, 1e-3, (n, 3)),
            )  # fmt: skip
            pixels = corners + rng.normal(0, 0.1, corners.shape)
            views[camera][frame] = BoardView(
                corner_ids=np.arange(len(pixels)), corners_px=pixels, discs=discs
            )
    return Dataset(sizes_wh=dict.fromkeys(views, _SIZE_WH), views=views)


def _as_linear(dataset: Dataset) -> dict[str, EncodingName | ToneCurve | None]:
    return dict.fromkeys(dataset.cameras, "linear")


Solve = Callable[[ColourSettings | None], RigColour]


@pytest.fixture(scope="module")
def noisy(target: Target) -> tuple[Dataset, RigSolution]:
    dataset = _dataset(target, noise=0.03)
    return dataset, solve_rig(dataset, target)


@pytest.fixture(scope="module")
def solve(noisy: tuple[Dataset, RigSolution], target: Target) -> Solve:
    dataset, solved = noisy
    return lambda settings: solve_colour(dataset, target, solved, _as_linear(dataset), settings)


# --- what a user may say --------------------------------------------------------------------------


def test_choices_become_settings() -> None:
    choices = ColourChoices(
        colour="hue-plane", colour_space="oklab", colour_priority=("foliage=2", "light_skin=0.5"),
        colour_mean_error=True, reference_camera_look="a",
    )  # fmt: skip
    assert choices.colour_settings() == ColourSettings(
        model="hue-plane", space="oklab", priorities={"foliage": 2.0, "light_skin": 0.5},
        mean_error=True, look_of="a",
    )  # fmt: skip
    assert ColourChoices().colour_settings() == ColourSettings()
    assert ColourSettings().names == tuple(MODELS)
    assert ColourChoices(colour="none").colour_settings() is None
    assert set(get_args(ColourModelName)) == {"auto", "none", *MODELS}


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        (
            ColourChoices(colour_priority=("foliage",)),
            "--colour-priority foliage: give NAME=WEIGHT",
        ),
        (ColourChoices(colour_priority=("=2",)), "--colour-priority =2: give NAME=WEIGHT"),
        (ColourChoices(colour_priority=("sky=0",)), "--colour-priority sky=0: give NAME=WEIGHT"),
        (ColourChoices(colour_priority=("sky=-1",)), "--colour-priority sky=-1: give NAME=WEIGHT"),
        (ColourChoices(colour_priority=("sky=inf",)), "--colour-priority sky=inf: give NAME="),
        (ColourChoices(colour_priority=("sky=nan",)), "--colour-priority sky=nan: give NAME="),
    ],
)
def test_what_cannot_be_read_is_said(choices: ColourChoices, sentence: str) -> None:
    with pytest.raises(RecordingError) as caught:
        choices.colour_settings()
    assert str(caught.value).startswith(sentence)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (
            ColourSettings(look_of="middle"),
            "--reference-camera-look middle: there is no such camera; there are a, b",
        ),
        (
            ColourSettings(priorities={"sky": 2.0, "foliage": 1.0, "grass": 3.0}),
            "--colour-priority: no disc of the target is called grass, sky",
        ),
    ],
)
def test_unknown_names_are_said(settings: ColourSettings, sentence: str, solve: Solve) -> None:
    with pytest.raises(RecordingError) as caught:
        solve(settings)
    assert str(caught.value) == sentence


def test_none_is_nothing(solve: Solve) -> None:
    found = solve(None)
    assert (dict(found.solutions), dict(found.vignettings), found.findings) == ({}, {}, ())


def test_a_named_model_is_taken(solve: Solve) -> None:
    for name in ("white-balance", "cheung-10", "thin-plate"):
        found = solve(ColourSettings(model=name))
        assert {item.model.MODEL for item in found.solutions.values()} == {name}
        for item in found.solutions.values():
            assert [candidate.name for candidate in item.candidates] == [name]


# --- priorities and looks -------------------------------------------------------------------------


@pytest.mark.parametrize("mean_error", [False, True])
def test_priorities_lower_the_error_of_their_discs(
    solve: Solve, target: Target, *, mean_error: bool
) -> None:
    """Each disc in turn, weighed 30 times, of a matrix that cannot meet all of them."""
    names = [marker.name for marker in target.markers]
    settings = ColourSettings(model="linear-white", share=False, mean_error=mean_error)
    plain = solve(settings).solutions["a"].fit_delta_e
    for name in ("foliage", "light_skin", "blue", "orange"):
        weighed = solve(replace(settings, priorities={name: 30.0})).solutions["a"].fit_delta_e
        rows = [index for index, item in enumerate(names) if item == name]
        assert weighed[rows].mean() < 0.8 * plain[rows].mean()
        assert weighed.mean() > plain.mean() - 0.05


@pytest.mark.parametrize("look", ["a", "b"])
def test_other_cameras_get_the_look_of_one(look: str, target: Target) -> None:
    """Their corrected discs are that camera's own pictures, read as the sRGB they are shown as."""
    dataset = _dataset(target, noise=0.0)
    settings = ColourSettings(model="linear", look_of=look)
    solved = solve_rig(dataset, target)
    found = solve_colour(dataset, target, solved, _as_linear(dataset), settings)
    shown = found.solutions[look].disc_rgb @ XYZ_FROM_RGB["srgb"].T
    for camera in _CAMERAS:
        np.testing.assert_allclose(found.solutions[camera].disc_xyz, shown, atol=2e-3)
    off = np.abs(shown - target.marker_xyz_d65).max()
    assert off > 0.05  # it is another look than the target's


@pytest.mark.parametrize("model", ["linear-white", "root-polynomial-2-white"])
def test_looks_keep_white(model: str, solve: Solve) -> None:
    """White paper in one camera's picture is white paper in the other's."""
    found = solve(ColourSettings(model=model, look_of="a")).solutions
    shown = XYZ_FROM_RGB["srgb"] @ found["a"].white_rgb
    for camera in _CAMERAS:
        np.testing.assert_allclose(
            found[camera].model.apply(found[camera].white_rgb), shown, rtol=1e-9
        )


def test_errors_are_told_against_the_look(solve: Solve) -> None:
    """The camera itself is its own look by a matrix, left-out discs too; against the target not."""
    found = solve(ColourSettings(model="linear", look_of="a")).solutions["a"]
    assert np.nanmax(found.held_out_delta_e) < 0.01
    (candidate,) = found.candidates
    assert candidate.left_out_delta_e.max() < 0.01


# --- fall-off -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def vignetted(target: Target) -> Calibration:
    dataset = _dataset(target, noise=0.002, n_frames=12, vignetted=True)
    return calibrate_dataset(dataset, target, CalibrationSettings(colour="linear-white"))


def test_fall_off_goes_into_the_file_and_back(vignetted: Calibration, tmp_path: Path) -> None:
    save_rig(vignetted.rig, None, tmp_path / "rig.json")
    read = load_rig(tmp_path / "rig.json")
    pixels = np.random.default_rng(1).uniform([100, 80], [540, 400], (200, 2))
    for camera in _CAMERAS:
        stored, solved = read.cameras[camera].vignetting, vignetted.rig.cameras[camera].vignetting
        assert stored is not None
        assert solved is not None
        np.testing.assert_array_equal(stored.gain(pixels), solved.gain(pixels))
        np.testing.assert_allclose(stored.gain(pixels), _vignetting(camera).gain(pixels), rtol=0.02)


def _flat(camera: str, level: FloatArray) -> Image:
    """An evenly lit wall as this camera's lens shows it, linear 16 bit."""
    pixels = level * _vignetting(camera).gain_map(_SIZE_WH)
    return Image(pixels=np.rint(65535 * pixels).astype(np.uint16), encoding="linear", bits=16)


def _apply(
    image: Image, camera: Camera, space: OutputSpace, source_map: SourceMap | None = None
) -> Pixels:
    return Corrector(camera, space, source_map, frames=FrameFormat.of(image)).apply(image.pixels)


@pytest.mark.parametrize("camera", _CAMERAS)
def test_a_flat_wall_comes_out_flat(camera: str, vignetted: Calibration, tmp_path: Path) -> None:
    save_rig(vignetted.rig, None, tmp_path / "rig.json")
    read = load_rig(tmp_path / "rig.json").cameras[camera]
    assert read.colour is not None
    level = 0.5 * read.colour.white_rgb
    wall = _flat(camera, level)
    inner = np.s_[60:420, 80:560]  # where the board was
    stored = wall.pixels[inner].astype(np.float64)
    assert np.ptp(stored, axis=(0, 1)).min() > 0.1 * stored.max()
    corrected = _apply(wall, read, "xyz-d65")[inner]
    expected = read.colour.xyz_from_rgb(level)
    np.testing.assert_allclose(
        corrected, np.broadcast_to(expected, corrected.shape), atol=0.02 * expected.max()
    )
    # the same through a map, each output pixel divided by the gain of where it comes from
    x, y = np.meshgrid(np.arange(_SIZE_WH[0]), np.arange(_SIZE_WH[1]))
    turned = np.stack([_SIZE_WH[0] - 1 - x, _SIZE_WH[1] - 1 - y], axis=-1).astype(np.float32)
    mapped = _apply(wall, read, "xyz-d65", source_map=turned)
    np.testing.assert_allclose(mapped[::-1, ::-1][inner], corrected, atol=1e-3 * expected.max())
    untouched = _apply(wall, read, "none")
    np.testing.assert_array_equal(untouched, wall.pixels)
