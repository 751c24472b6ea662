"""Figures of tracks, sightings and distances against the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from benchmarks.observe.exchangeable import exchangeable
from benchmarks.observe.matching import Matching, match
from benchmarks.observe.tables import Distances, Sightings, Tracks

from calichrome.colorimetry.difference import delta_e_2000
from calichrome.core.arrays import FloatArray, IntArray
from calichrome.synthetic.workspace import WorkspaceTruth

__all__ = ["Associations", "Scores", "associations", "centre_sigmas_px", "score", "true_positions"]

_SETTLED = 5  # frames of a track before its speed counts
_NEAR = 1.5  # radii of a ball within which a region's centre may be a picture of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """What one run is worth.

    Parameters
    ----------
    position_ratio
        Root mean square of the distance to the truth over that of the predicted sigma.
    position_m, aligned_m
        Root mean square distance to the truth, before and after the best rigid motion of all.
    position_share
        Root mean square of that distance over the mean distance of the ball from the cameras.
    speed_share, velocity_share
        Root mean square error of the speed, and of the velocity vector, from the fifth frame of a
        track on, over the root mean square of the speed.
    n_tracks, n_swaps, n_fragments, n_lost
        Tracks; changes of a track's ball; tracks of a ball beyond its first; tracks that end before
        the recording while their ball is visible.
    missed, n_false
        Share of visible balls without a track; rows of tracks near no ball.
    colour_de
        Difference CIEDE2000 between two cameras of a ball's mean colour over time, mean over pairs
        of cameras and balls.
    colour_frame_de
        The same between the colours of single frames.
    coverage
        Share of pairs and frames whose distance is above its 95 % lower bound.
    """

    position_ratio: float
    position_m: float
    aligned_m: float
    position_share: float
    speed_share: float
    velocity_share: float
    n_tracks: int
    n_swaps: int
    n_fragments: int
    n_lost: int
    missed: float
    n_false: int
    colour_de: float
    colour_frame_de: float
    coverage: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Associations:
    """Sightings that counted, of exchangeable balls, in the cameras and frames in which they are.

    Parameters
    ----------
    n_frames, n_cases
        Frames with exchangeable balls; all combinations of frame, pair of cameras, pair of balls.
    n_sightings
        Sightings of these balls in these cameras and frames.
    n_wrong
        Of these, the ones given to another ball's track.
    n_wrong_anywhere
        Sightings given to another ball's track in all frames.
    """

    n_frames: int
    n_cases: int
    n_sightings: int
    n_wrong: int
    n_wrong_anywhere: int


def true_positions(truth: WorkspaceTruth) -> FloatArray:
    """Positions of the balls as the true reference camera sees them, (n_frames, n_balls, 3)."""
    world = np.stack([ball.positions_world for ball in truth.balls], axis=1)
    return truth.cameras[truth.reference_camera].cam_from_world.apply(world)


def score(
    tracks: Tracks, sightings: Sightings, distances: Distances, truth: WorkspaceTruth
) -> tuple[Scores, Matching]:
    """Hold a run against the truth."""
    positions = true_positions(truth)
    matching = match(tracks, truth, positions)
    good = matching.ball_of_row >= 0
    frames, balls = tracks.frame[good], matching.ball_of_row[good]
    wanted, found = positions[frames, balls], tracks.positions_ref[good]
    error = np.linalg.norm(found - wanted, axis=1)
    sigma2 = np.trace(tracks.cov_m2[good], axis1=1, axis2=2)
    away = _distance_from_cameras(truth)[frames, balls]
    speed_error, velocity_error = _speed_errors(tracks, truth, matching)
    colour, colour_frame = _colour_between_cameras(sightings, matching, tracks, len(truth.balls))
    return Scores(
        position_ratio=_rms(error) / float(np.sqrt(sigma2.mean())),
        position_m=_rms(error),
        aligned_m=_rms(np.linalg.norm(_aligned(found, wanted) - wanted, axis=1)),
        position_share=_rms(error / away),
        speed_share=speed_error,
        velocity_share=velocity_error,
        n_tracks=len(np.unique(tracks.track)),
        n_swaps=matching.n_swaps,
        n_fragments=matching.n_fragments,
        n_lost=_n_lost(tracks, matching),
        missed=matching.missed,
        n_false=matching.n_false,
        colour_de=colour,
        colour_frame_de=colour_frame,
        coverage=_coverage(distances, tracks, matching, positions),
    ), matching


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def _aligned(points: FloatArray, wanted: FloatArray) -> FloatArray:
    """Move points (n, 3) rigidly to where they fit best (Kabsch)."""
    middle, target = points.mean(axis=0), wanted.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (wanted - target))
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    return np.asarray((points - middle) @ (u @ flip @ vt) + target)


def _distance_from_cameras(truth: WorkspaceTruth) -> FloatArray:
    """Mean over cameras of the distance to each ball, (n_frames, n_balls), metres."""
    world = np.stack([ball.positions_world for ball in truth.balls], axis=1)
    each = [
        np.linalg.norm(camera.cam_from_world.apply(world), axis=-1)
        for camera in truth.cameras.values()
    ]
    return np.asarray(np.mean(each, axis=0))


def _speed_errors(tracks: Tracks, truth: WorkspaceTruth, matching: Matching) -> tuple[float, float]:
    rotation = truth.cameras[truth.reference_camera].cam_from_world.rotation
    world = np.stack([ball.velocities_world for ball in truth.balls], axis=1)
    first = {int(track): tracks.frame[tracks.track == track].min() for track in set(tracks.track)}
    age = tracks.frame - np.array([first[int(track)] for track in tracks.track])
    settled = (matching.ball_of_row >= 0) & (age >= _SETTLED)
    wanted = (world @ rotation.T)[tracks.frame[settled], matching.ball_of_row[settled]]
    found = tracks.velocities_ref[settled]
    speed, true_speed = np.linalg.norm(found, axis=1), np.linalg.norm(wanted, axis=1)
    usual = _rms(true_speed)
    return _rms(speed - true_speed) / usual, _rms(np.linalg.norm(found - wanted, axis=1)) / usual


def _n_lost(tracks: Tracks, matching: Matching) -> int:
    last = len(matching.visible) - 1
    lost = 0
    for track in np.unique(tracks.track):
        rows = np.flatnonzero(tracks.track == track)
        row = rows[tracks.frame[rows].argmax()]
        ball, frame = matching.ball_of_row[row], tracks.frame[row]
        lost += frame < last and (ball < 0 or bool(matching.visible[frame + 1, ball]))
    return int(lost)


def _ball_of_track(tracks: Tracks, matching: Matching, n_balls: int) -> Mapping[int, int]:
    """Return the ball that each track follows most of its life; -1: none."""
    result = {}
    for track in np.unique(tracks.track):
        balls = matching.ball_of_row[tracks.track == track]
        counts = np.bincount(balls[balls >= 0], minlength=n_balls)
        result[int(track)] = int(counts.argmax()) if counts.any() else -1
    return result


def _colour_between_cameras(
    sightings: Sightings, matching: Matching, tracks: Tracks, n_balls: int
) -> tuple[float, float]:
    owner = _ball_of_track(tracks, matching, n_balls)
    balls = np.array([owner[int(track)] for track in sightings.track])
    told = sightings.used & np.isfinite(sightings.lab_d65).all(axis=1)
    means: list[float] = []
    single: list[float] = []
    for ball in range(n_balls):
        mine = {
            camera: (sightings.frame[rows], sightings.lab_d65[rows])
            for camera in np.unique(sightings.camera)
            if (rows := np.flatnonzero(told & (balls == ball) & (sightings.camera == camera))).size
        }
        for (frames_a, lab_a), (frames_b, lab_b) in combinations(mine.values(), 2):
            means.append(float(delta_e_2000(lab_a.mean(axis=0), lab_b.mean(axis=0))))
            _, in_a, in_b = np.intersect1d(frames_a, frames_b, return_indices=True)
            single.extend(delta_e_2000(lab_a[in_a], lab_b[in_b]))
    nan = float("nan")
    return (float(np.mean(means)) if means else nan, float(np.mean(single)) if single else nan)


def _coverage(
    distances: Distances, tracks: Tracks, matching: Matching, positions: FloatArray
) -> float:
    ball = {
        (int(frame), int(track)): int(found)
        for frame, track, found in zip(
            tracks.frame, tracks.track, matching.ball_of_row, strict=True
        )
    }
    held = []
    for frame, (a, b), lower_m in zip(
        distances.frame, distances.tracks, distances.lower_m, strict=True
    ):
        balls = [ball.get((int(frame), int(track)), -1) for track in (a, b)]
        if min(balls) >= 0:
            apart = np.linalg.norm(positions[frame, balls[0]] - positions[frame, balls[1]])
            held.append(apart >= lower_m)
    return float(np.mean(held)) if held else float("nan")


def _seen_balls(sightings: Sightings, truth: WorkspaceTruth) -> tuple[IntArray, FloatArray]:
    """Find which ball each sighting is a picture of, by the truth.

    Returns
    -------
    ball : (n,) int
        -1: of none, or of two that overlap in the picture.
    error_px : (n, 2) float
        From the image of its centre.
    """
    n = len(sightings.frame)
    ball_of, error = np.full(n, -1), np.full((n, 2), np.nan)
    world = np.stack([ball.positions_world for ball in truth.balls], axis=1)
    for camera_id, camera in truth.cameras.items():
        points_cam = camera.cam_from_world.apply(world)
        shape = points_cam.shape[:2]
        pixels = camera.lens.project(points_cam.reshape(-1, 3)).reshape(*shape, 2)
        radii_m = np.array([ball.radius_m for ball in truth.balls])
        radii_px = camera.lens.fx * radii_m / points_cam[..., 2]
        shares = np.stack([ball.seen[camera_id] for ball in truth.balls], axis=1)
        rows = np.flatnonzero(sightings.camera == camera_id)
        for row in rows:
            frame = sightings.frame[row]
            apart = np.linalg.norm(sightings.centres_px[row] - pixels[frame], axis=1)
            apart = np.where(shares[frame] > 0.05, apart / radii_px[frame], np.inf)
            near = np.flatnonzero(apart < _NEAR)
            if len(near) == 1:
                ball_of[row] = near[0]
                error[row] = sightings.centres_px[row] - pixels[frame, near[0]]
    return ball_of, error


def centre_sigmas_px(sightings: Sightings, truth: WorkspaceTruth) -> dict[str, float]:
    """Measure the sigma per coordinate of the centres that counted, by camera, robustly."""
    ball, error = _seen_balls(sightings, truth)
    result = {}
    for camera in truth.cameras:
        rows = (sightings.camera == camera) & sightings.used & (ball >= 0)
        spread = error[rows] - np.median(error[rows], axis=0)
        result[camera] = float(1.4826 * np.median(np.abs(spread)))
    return result


def associations(
    tracks: Tracks,
    sightings: Sightings,
    matching: Matching,
    truth: WorkspaceTruth,
    sigma_px: Mapping[str, float],
) -> Associations:
    """Count sightings that were given to the wrong track, where geometry leaves the choice open."""
    ball, _ = _seen_balls(sightings, truth)
    owner = _ball_of_track(tracks, matching, len(truth.balls))
    given = np.array([owner[int(track)] for track in sightings.track])
    known = (ball >= 0) & sightings.used
    wrong = known & (given != ball)
    n_cases, any_frame = 0, np.zeros(len(truth.frame_ids), dtype=bool)
    open_choice = np.zeros(len(ball), dtype=bool)
    for pair, alike in exchangeable(truth, sigma_px).items():
        n_cases += int(alike.sum()) // 2
        any_frame |= alike.any(axis=(1, 2))
        in_pair = np.isin(sightings.camera, pair) & known
        rows = np.flatnonzero(in_pair)
        open_choice[rows] |= np.asarray(alike.any(axis=2))[sightings.frame[rows], ball[rows]]
    return Associations(
        n_frames=int(any_frame.sum()),
        n_cases=n_cases,
        n_sightings=int(open_choice.sum()),
        n_wrong=int((wrong & open_choice).sum()),
        n_wrong_anywhere=int(wrong.sum()),
    )
