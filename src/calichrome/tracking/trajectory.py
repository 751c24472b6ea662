"""Tracks after the fact: all instants together, and how sure each place and speed is.

Three kinds of error are kept apart. Noise is new in every frame, so smoothing lessens it. The
silhouette of an object may be off to one side for long (its shaded edge is lost, its lit one
blooms): a bias per object and camera, which smoothing leaves as it is. Errors of the calibration
are common to all objects and frames. The first two have sizes of their own, which the tracks tell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.geometry.triangulation import triangulate
from calichrome.rig import CameraCovariance
from calichrome.tracking.motion import Smoothed, minus_log_likelihood, smooth
from calichrome.tracking.track import Track
from calichrome.tracking.view import View

__all__ = ["ErrorSizes", "Trajectory", "smooth_tracks"]

_ROUNDS = 3  # of places, outliers and sizes of errors, each from the others
_DENSITIES = (1e-5, 1e4)  # m^2/s^3, of the acceleration: from a clock's hand to a thrown ball
_MOST_STEPS = 3_000  # that the sizes of the errors are told from; more tell no more


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorSizes:
    """What the tracks tell of the errors that made them.

    Parameters
    ----------
    noise
        Standard deviation of a centre's noise, in units of what `Region.cov_px2` says.
    silhouette
        The same of the lasting bias of a silhouette: what blurs an edge also hides its place.
    density_m2_s3
        Power density of the acceleration.
    """

    noise: float = 1.0
    silhouette: float = 0.0
    density_m2_s3: float = 1.0


_PRIOR_LOOKS = 10  # choice: 10 to 50 give the same places to 2 %
_FIRST = ErrorSizes(noise=2.0, silhouette=4.0)  # before the tracks tell: as of simulated balls


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """One object over time, smoothed.

    Parameters
    ----------
    track
        What it was made from.
    times_s : (T,) float
    positions_ref, velocities_ref : (T, 3) float, metres, metres per second
    own_cov : (T, 6, 6) float
        Of position and velocity, by noise and silhouettes: independent of other objects.
    d_cameras : (T, 6, K) float
        By the parameters of the cameras that `cameras_cov` is about, and the scale of the rig.
    cameras_cov : (K, K) float
    used : camera -> (T,) bool
        Which views the places stand on.
    views
        The cameras.
    """

    track: Track
    times_s: FloatArray
    positions_ref: FloatArray
    velocities_ref: FloatArray
    own_cov: FloatArray
    d_cameras: FloatArray
    cameras_cov: FloatArray
    used: Mapping[str, BoolArray]
    views: Mapping[str, View]

    @property
    def cov(self) -> FloatArray:
        """Of position and velocity, all errors, (T, 6, 6)."""
        shared = self.d_cameras @ self.cameras_cov @ self.d_cameras.swapaxes(1, 2)
        return np.asarray(self.own_cov + shared)


@dataclass(slots=True, eq=False)
class _Path:
    """A track as arrays over T instants and C cameras."""

    track: Track
    times_s: FloatArray
    points: FloatArray  # (T, 3)
    pixels: FloatArray  # (T, C, 2), nan where not seen
    noise_px2: FloatArray  # (T, C, 2, 2)
    whole: BoolArray  # (T, C): of its usual size
    used: BoolArray  # (T, C): whole, and in agreement with the other views

    @classmethod
    def of(cls, track: Track, cameras: Sequence[str]) -> "_Path":
        n_steps = len(track.steps)
        pixels = np.full((n_steps, len(cameras), 2), np.nan)
        noise = np.tile(np.eye(2), (n_steps, len(cameras), 1, 1))
        whole = np.zeros((n_steps, len(cameras)), dtype=bool)
        for row, step in enumerate(track.steps):
            for camera, sighting in step.sightings.items():
                column = cameras.index(camera)
                pixels[row, column] = sighting.centre_px
                noise[row, column] = sighting.cov_px2
                whole[row, column] = track.is_whole(sighting.log_radius)
        return cls(
            track=track,
            times_s=np.array([step.time_s for step in track.steps]),
            points=np.stack([step.state.position_m for step in track.steps]),
            pixels=pixels,
            noise_px2=noise,
            whole=whole,
            used=whole.copy(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The views of a path near its points."""

    missed: FloatArray  # (T, C, 2) observed less projected
    slope: FloatArray  # (T, C, 2, 3)
    by_camera: tuple[FloatArray, ...]  # C of (T, 2, P)


def _linearised(path: _Path, views: Sequence[View]) -> _Linear:
    seen = [view.look(path.points) for view in views]
    missed = path.pixels - np.stack([item.pixels for item in seen], axis=1)
    return _Linear(
        missed=missed,
        slope=np.stack([item.d_points for item in seen], axis=1),
        by_camera=tuple(item.d_camera for item in seen),
    )


def smooth_tracks(
    tracks: Sequence[Track],
    views: Mapping[str, View],
    covariance: CameraCovariance | None = None,
    *,
    scale_sigma: float = 0.0,
) -> tuple[tuple[Trajectory, ...], ErrorSizes]:
    """Estimate places and speeds from all instants of each track.

    Parameters
    ----------
    tracks
        From one `Tracker`.
    views
        Of the same.
    covariance
        Of the cameras; None: they are exact.
    scale_sigma
        Relative, of all lengths of the rig.

    Returns
    -------
    trajectories
        One per track.
    sizes
        Of the errors, as told by the tracks.

    Notes
    -----
    docs/tracking.md derives the estimates.
    """
    cameras = list(views)
    looking = [views[camera] for camera in cameras]
    cameras_cov = _joint(looking, covariance, scale_sigma)
    paths = [_Path.of(track, cameras) for track in tracks]
    sizes = _FIRST
    for _ in range(_ROUNDS):
        for path in paths:
            _choose_views(path, looking, sizes, cameras_cov)
            _place(path, looking, sizes)
        sizes = _error_sizes(paths, looking, cameras_cov)
        for path in paths:
            _reweigh(path, looking, sizes, cameras_cov)
    return tuple(_trajectory(path, looking, sizes, cameras_cov) for path in paths), sizes


def _joint(
    views: Sequence[View], covariance: CameraCovariance | None, scale_sigma: float
) -> FloatArray:
    """Covariance of all cameras and, last, of the logarithm of the scale."""
    n_parameters = sum(view.n_parameters for view in views)
    joint = np.zeros((n_parameters + 1, n_parameters + 1))
    if covariance is not None:
        joint[:-1, :-1] = covariance.of(*(view.camera for view in views))
    joint[-1, -1] = scale_sigma**2
    return joint


def _information(
    path: _Path, linear: _Linear, sizes: ErrorSizes, columns: Sequence[FloatArray] = ()
) -> tuple[FloatArray, FloatArray]:
    """Information (T, 3, 3) and vectors (T, 3, 1 + K) of every instant.

    `columns` are derivatives (T, C, 2, K) of the pixels by further parameters.
    """
    noise = path.noise_px2 * sizes.noise**2
    weight = np.linalg.inv(noise) * path.used[..., None, None]
    weighted = linear.slope.swapaxes(2, 3) @ weight  # (T, C, 3, 2)
    information = (weighted @ linear.slope).sum(axis=1)
    observed = np.nan_to_num(linear.missed) + np.einsum("tcij,tj->tci", linear.slope, path.points)
    parts = [np.einsum("tcij,tcj->ti", weighted, observed)[..., None]]
    parts += [-np.einsum("tcij,tcjk->tik", weighted, column) for column in columns]
    return information, np.concatenate(parts, axis=2)


def _place(path: _Path, views: Sequence[View], sizes: ErrorSizes) -> None:
    """Improve the points of a path; twice, since projection is not linear."""
    for _ in range(2):
        information, vectors = _information(path, _linearised(path, views), sizes)
        smoothed = smooth(path.times_s, information, vectors, sizes.density_m2_s3)
        path.points = smoothed.mean[:, :3, 0]


def _error_sizes(
    paths: Sequence[_Path], views: Sequence[View], cameras_cov: FloatArray
) -> ErrorSizes:
    """Tell the sizes of the errors from the longest tracks."""
    chosen, n_steps = [], 0
    for path in sorted(paths, key=lambda path: -int(path.used.sum())):
        chosen.append(path)
        n_steps += len(path.points)
        if n_steps > _MOST_STEPS:
            break
    noise, silhouette = _from_residuals(chosen, views, cameras_cov)
    return ErrorSizes(
        noise=noise, silhouette=silhouette, density_m2_s3=_density(chosen, views, noise)
    )


def _density(paths: Sequence[_Path], views: Sequence[View], noise: float) -> float:
    """Power density of the acceleration that makes the innovations the most likely."""
    prepared = []
    for path in paths:
        information, vectors = _information(path, _linearised(path, views), ErrorSizes(noise=noise))
        complete = path.used.sum(axis=1) > 1
        prepared.append((path.times_s, information, vectors, complete))

    def unlikely(log_density: float) -> float:
        density = float(np.exp(log_density))
        return sum(
            minus_log_likelihood(times_s, information, vectors, density, complete=complete)
            for times_s, information, vectors, complete in prepared
        )

    best = minimize_scalar(
        unlikely, bounds=tuple(np.log(_DENSITIES)), method="bounded", options={"xatol": 0.1}
    )
    return float(np.exp(best.x))


def _from_residuals(
    paths: Sequence[_Path], views: Sequence[View], cameras_cov: FloatArray
) -> tuple[float, float]:
    """Noise and bias of silhouettes, from what the views of one instant miss each other by.

    Of n views the residuals of the best point are ``r = (1 - Pi) e`` with Pi the projection on the
    columns of the slopes. What lasts drops out of the difference of two instants of the same views,
    whose squares are 2 (2 n - 3) for unit noise. In the squares of r themselves it stays: noise
    makes them 2 n - 3 on average, the calibration tr((1 - Pi) G S G'), and a bias of the stated
    covariance 2 n - 3 as well, all in units of the stated noise.
    """
    squares, expected, changes, twice, by_cameras = (0.0 for _ in range(5))
    for path in paths:
        last: _Residual | None = None
        for item in _residuals(path, views):
            if last is not None and (path.used[last.row] == path.used[item.row]).all():
                changes += float(((item.values - last.values) ** 2).sum())
                twice += 2 * float(np.trace(item.free))
            last = item
            squares += float((item.values**2).sum())
            expected += float(np.trace(item.free))
            by_cameras += float(item.by_cameras(cameras_cov).sum())
    if not twice:
        return 1.0, 0.0
    variance = changes / twice
    lasting = squares - variance * expected - by_cameras
    return float(np.sqrt(variance)), float(np.sqrt(max(lasting, 0.0) / expected))


def _reweigh(
    path: _Path, views: Sequence[View], sizes: ErrorSizes, cameras_cov: FloatArray
) -> None:
    """Scale the stated noise of each camera's views by what they miss the others by.

    An object may look much like its background from one side, so that a part of its edge is lost
    there: then all centres of that camera are worse than stated. The ratio is that of the squared
    residuals to the expected ones (estimation of variance components [1]_), drawn towards 1 as if
    by `_PRIOR_LOOKS` more looks. It is never below 1: what lasts is one draw for all looks, so that
    a camera which misses by little may be so by chance.

    References
    ----------
    .. [1] W. Förstner, B. P. Wrobel, "Photogrammetric Computer Vision", 2016, sec. 4.2.4.
    """
    usual = sizes.noise**2 + sizes.silhouette**2
    squares = np.full(len(views), 2 * _PRIOR_LOOKS * usual)
    expected = squares.copy()
    for item in _residuals(path, views):
        squares[item.own] += (item.values**2).reshape(-1, 2).sum(axis=1)
        from_cameras = item.by_cameras(cameras_cov)
        both = usual * np.diag(item.free) + from_cameras
        expected[item.own] += both.reshape(-1, 2).sum(axis=1)
    path.noise_px2 = path.noise_px2 * np.maximum(squares / expected, 1)[:, None, None]


@dataclass(frozen=True, slots=True, eq=False)
class _Residual:
    """What the n used views of one instant miss the best point by, in units of their noise."""

    row: int
    own: IntArray  # (n,) which views
    values: FloatArray  # (2n,)
    free: FloatArray  # (2n, 2n): 1 less what the point takes up
    moved: FloatArray  # (2n, K): by the parameters of the cameras

    def by_cameras(self, cameras_cov: FloatArray) -> FloatArray:
        """Return the variance (2n,) that the errors of the cameras give them."""
        return np.asarray(np.einsum("ij,jk,ik->i", self.moved, cameras_cov, self.moved))


def _residuals(path: _Path, views: Sequence[View]) -> Iterator[_Residual]:
    linear = _linearised(path, views)
    n_parameters = sum(view.n_parameters for view in views) + 1
    for row in np.flatnonzero(path.used.sum(axis=1) > 1):
        own = np.flatnonzero(path.used[row])
        white = np.linalg.inv(np.linalg.cholesky(path.noise_px2[row, own]))
        slope = (white @ linear.slope[row, own]).reshape(-1, 3)
        error = (white @ linear.missed[row, own, :, None]).reshape(-1)
        free = np.eye(len(error)) - slope @ np.linalg.pinv(slope)
        moved = np.zeros((len(own), 2, n_parameters))
        for place, index in enumerate(own):
            moved[place, :, _columns(views, int(index))] = linear.by_camera[index][row]
        yield _Residual(
            int(row), own, free @ error, free, free @ (white @ moved).reshape(len(error), -1)
        )


def _columns(views: Sequence[View], index: int) -> slice:
    """Where the parameters of one camera stand among all."""
    start = sum(view.n_parameters for view in views[:index])
    return slice(start, start + views[index].n_parameters)


def _choose_views(
    path: _Path, views: Sequence[View], sizes: ErrorSizes, cameras_cov: FloatArray
) -> None:
    """Use the views of each instant that agree with each other; none where that is not clear."""
    found = triangulate(
        np.where(path.whole[..., None], path.pixels, np.nan),
        [view.lens for view in views],
        [view.cam_from_ref for view in views],
        cov_px2=path.noise_px2 * (sizes.noise**2 + sizes.silhouette**2),
        cameras_cov=cameras_cov[:-1, :-1],
    )
    doubtful = found.few_views | found.behind | found.inconsistent
    path.used = found.used & ~doubtful[:, None]


def _trajectory(
    path: _Path, views: Sequence[View], sizes: ErrorSizes, cameras_cov: FloatArray
) -> Trajectory:
    """Places and speeds, and their derivatives by everything that lasts."""
    _place(path, views, sizes)
    linear = _linearised(path, views)
    n_steps, n_views, n_shared = len(path.points), len(views), len(cameras_cov)
    by_cameras = np.zeros((n_steps, n_views, 2, n_shared))
    by_bias = np.zeros((n_steps, n_views, 2, 2 * n_views))
    for index in range(n_views):
        by_cameras[:, index, :, _columns(views, index)] = linear.by_camera[index]
        root = np.linalg.cholesky(path.noise_px2[:, index])
        by_bias[:, index, :, 2 * index : 2 * index + 2] = root
    information, vectors = _information(path, linear, sizes, [by_cameras, by_bias])
    smoothed: Smoothed = smooth(path.times_s, information, vectors, sizes.density_m2_s3)
    state = smoothed.mean[:, :, 0]
    d_cameras = smoothed.mean[:, :, 1 : 1 + n_shared].copy()
    d_cameras[:, :, -1] = state  # the whole space is larger or smaller about ref
    d_bias = smoothed.mean[:, :, 1 + n_shared :]
    return Trajectory(
        track=path.track,
        times_s=path.times_s,
        positions_ref=state[:, :3],
        velocities_ref=state[:, 3:],
        own_cov=smoothed.cov + sizes.silhouette**2 * (d_bias @ d_bias.swapaxes(1, 2)),
        d_cameras=d_cameras,
        cameras_cov=cameras_cov,
        used={view.camera: path.used[:, index] for index, view in enumerate(views)},
        views={view.camera: view for view in views},
    )
