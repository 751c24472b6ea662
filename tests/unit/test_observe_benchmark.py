"""The benchmark of observe: matching, exchangeable balls and scores on made-up tracks."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.observe.exchangeable import epipolar_distances_px, exchangeable
from benchmarks.observe.scoring import associations, centre_sigmas_px, score, true_positions
from benchmarks.observe.tables import Distances, Sightings, Tracks

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic import CameraTruth
from calichrome.synthetic.workspace import BallTruth, WorkspaceTruth

_N_FRAMES = 40
_SIGMA_M = 0.002


def _camera(x_m: float) -> CameraTruth:
    return CameraTruth(
        size_wh=(640, 480),
        lens=BrownConrady(fx=500.0, fy=500.0, cx=320.0, cy=240.0, k1=0, k2=0, p1=0, p2=0, k3=0),
        cam_from_world=Pose(np.eye(3), np.array([-x_m, 0, 0])),
        cam_from_ref=Pose(np.eye(3), np.array([-x_m, 0, 0])),
        sensitivity="",
        psf_sigma_px=0.6,
        vignetting_power=0.0,
        flare=0.0,
        white_balance=(1.0, 1.0, 1.0),
        encoding="srgb",
        bits=8,
    )


def _ball(name: str, start: list[float], velocity: list[float]) -> BallTruth:
    times_s = np.arange(_N_FRAMES) / 25
    return BallTruth(
        name=name,
        radius_m=0.05,
        xyz_d65=np.array([0.2, 0.2, 0.2]),
        positions_world=np.array(start) + times_s[:, None] * np.array(velocity),
        velocities_world=np.tile(velocity, (_N_FRAMES, 1)),
        seen={camera: np.ones(_N_FRAMES) for camera in ("a", "b")},
    )


@pytest.fixture
def truth() -> WorkspaceTruth:
    """Two cameras side by side; two balls side by side, at one height for the eighth frame only."""
    return WorkspaceTruth(
        reference_camera="a",
        cameras={"a": _camera(0.0), "b": _camera(0.5)},
        frame_ids=tuple(f"{index:04d}" for index in range(_N_FRAMES)),
        times_s=np.arange(_N_FRAMES) / 25,
        balls=(
            _ball("still", [0.0, 0.08, 2.0], [0.0, 0.0, 0.0]),
            _ball("falling", [0.3, 0.0, 2.0], [0.0, 0.25, 0.0]),
        ),
        seed=0,
    )


def _tracks(truth: WorkspaceTruth, numbers: IntArray, rng: np.random.Generator) -> Tracks:
    """Tracks with the truth's positions and noise of a known sigma; their numbers (n_frames, 2)."""
    positions = true_positions(truth)
    n_rows = positions.shape[0] * positions.shape[1]
    velocities = np.stack([ball.velocities_world for ball in truth.balls], axis=1)
    return Tracks(
        frame=np.repeat(np.arange(_N_FRAMES), 2),
        track=numbers.ravel(),
        positions_ref=positions.reshape(-1, 3) + rng.normal(0, _SIGMA_M, (n_rows, 3)),
        cov_m2=np.tile(np.eye(3) * _SIGMA_M**2, (n_rows, 1, 1)),
        velocities_ref=velocities.reshape(-1, 3) * 1.02,
        lab_d65=np.zeros((n_rows, 3)),
    )


def _sightings(truth: WorkspaceTruth, numbers: IntArray, lab_of_b: FloatArray) -> Sightings:
    positions = np.stack([ball.positions_world for ball in truth.balls], axis=1)
    parts = []
    for name, camera in truth.cameras.items():
        pixels = camera.lens.project(camera.cam_from_world.apply(positions.reshape(-1, 3)))
        parts.append((np.full(len(pixels), name), pixels))
    n_rows = len(parts[0][1])
    lab = np.tile([50.0, 0.0, 0.0], (2 * n_rows, 1))
    lab[n_rows:] = lab_of_b
    return Sightings(
        frame=np.tile(np.repeat(np.arange(_N_FRAMES), 2), 2),
        track=np.tile(numbers.ravel(), 2),
        camera=np.concatenate([names for names, _ in parts]),
        centres_px=np.concatenate([pixels for _, pixels in parts]),
        lab_d65=lab,
        used=np.ones(2 * n_rows, dtype=bool),
    )


def _no_distances() -> Distances:
    return Distances(
        frame=np.zeros(0, dtype=np.int64),
        tracks=np.zeros((0, 2), dtype=np.int64),
        lower_m=np.zeros(0),
    )


_STEADY = np.tile([1, 2], (_N_FRAMES, 1))


def test_epipolar_distance_is_zero_for_the_same_point(truth: WorkspaceTruth) -> None:
    points = np.array([[0.1, -0.2, 1.5], [0.2, 0.3, 2.5]])
    distance = epipolar_distances_px(truth.cameras["a"], truth.cameras["b"], points)
    np.testing.assert_allclose(np.diag(distance), 0, atol=1e-9)
    # Cameras side by side: lines are rows, and an offset of d rows is shared by two pictures.
    rows = 500 * points[:, 1] / points[:, 2]
    assert distance[0, 1] == pytest.approx(abs(rows[0] - rows[1]) / np.sqrt(2))


def test_balls_are_exchangeable_where_they_share_an_epipolar_plane(truth: WorkspaceTruth) -> None:
    # The falling ball moves by 2.5 px per frame; it is in the other's row in frame 8.
    (alike,) = exchangeable(truth, 0.5).values()
    assert np.flatnonzero(alike[:, 0, 1]).tolist() == [8]
    np.testing.assert_array_equal(alike, alike.swapaxes(1, 2))
    (wider,) = exchangeable(truth, {"a": 1.0, "b": 1.0}).values()
    assert np.flatnonzero(wider[:, 0, 1]).tolist() == [7, 8, 9]


def test_scores_of_known_errors(truth: WorkspaceTruth, rng: np.random.Generator) -> None:
    tracks = _tracks(truth, _STEADY, rng)
    lab_of_b = np.array([53.0, 0.0, 0.0])
    scores, matching = score(tracks, _sightings(truth, _STEADY, lab_of_b), _no_distances(), truth)
    assert (matching.ball_of_row >= 0).all()
    # 240 coordinates: the root mean square is known to 5 %
    assert scores.position_ratio == pytest.approx(1, abs=0.15)
    assert scores.position_m == pytest.approx(np.sqrt(3) * _SIGMA_M, rel=0.15)
    assert scores.speed_share == pytest.approx(0.02)
    assert (scores.n_swaps, scores.n_fragments, scores.n_lost, scores.n_false) == (0, 0, 0, 0)
    assert scores.missed == 0
    # CIEDE2000 of grey L = 50 and 53: dL / S_L, S_L = 1 + 0.015 d^2 / sqrt(20 + d^2), d = 1.5
    weight = 1 + 0.015 * 1.5**2 / np.sqrt(20 + 1.5**2)
    assert scores.colour_de == pytest.approx(3 / weight, rel=1e-6)


def test_swaps_fragments_and_losses_are_counted(
    truth: WorkspaceTruth, rng: np.random.Generator
) -> None:
    crossed = _STEADY.copy()
    crossed[20:] = [2, 1]
    no_sightings = _sightings(truth, _STEADY, np.zeros(3))
    scores, _ = score(_tracks(truth, crossed, rng), no_sightings, _no_distances(), truth)
    assert scores.n_swaps == 2
    broken = _STEADY.copy()
    broken[20:, 1] = 3
    scores, _ = score(_tracks(truth, broken, rng), no_sightings, _no_distances(), truth)
    assert (scores.n_swaps, scores.n_fragments, scores.n_lost) == (0, 1, 1)


def test_wrong_associations_are_counted_where_geometry_leaves_a_choice(
    truth: WorkspaceTruth, rng: np.random.Generator
) -> None:
    tracks, right = _tracks(truth, _STEADY, rng), _sightings(truth, _STEADY, np.zeros(3))
    _, matching = score(tracks, right, _no_distances(), truth)
    sigma_px = {"a": 0.5, "b": 0.5}
    good = associations(tracks, right, matching, truth, sigma_px)
    assert (good.n_frames, good.n_cases, good.n_sightings, good.n_wrong) == (1, 1, 4, 0)
    given = _STEADY.copy()
    given[8] = [2, 1]
    given[30] = [2, 1]
    wrong = associations(tracks, _sightings(truth, given, np.zeros(3)), matching, truth, sigma_px)
    assert (wrong.n_wrong, wrong.n_wrong_anywhere) == (4, 8)


def test_coverage_counts_pairs_and_frames(truth: WorkspaceTruth, rng: np.random.Generator) -> None:
    positions = true_positions(truth)
    apart = np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1)
    distances = Distances(
        frame=np.arange(_N_FRAMES),
        tracks=_STEADY,
        lower_m=apart + np.where(np.arange(_N_FRAMES) < 10, 0.01, -0.01),
    )
    tracks = _tracks(truth, _STEADY, rng)
    scores, _ = score(tracks, _sightings(truth, _STEADY, np.zeros(3)), distances, truth)
    assert scores.coverage == pytest.approx(0.75)


def test_sigma_of_centres_is_robust(truth: WorkspaceTruth, rng: np.random.Generator) -> None:
    sightings = _sightings(truth, _STEADY, np.zeros(3))
    noise = rng.normal(0, 0.3, sightings.centres_px.shape)
    noise[:4] += 5
    sightings.centres_px[:] += noise
    sigma_px = centre_sigmas_px(sightings, truth)
    # Of 160 coordinates; a median of so many is known to about 10 %
    assert sigma_px == pytest.approx({"a": 0.3, "b": 0.3}, rel=0.3)
