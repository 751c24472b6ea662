"""Find the fall-off of each lens from what several cameras see of one board in one instant."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.colour.shading import Vignetting, shading_terms
from calichrome.colour.shading_readings import (
    FEWEST_DISCS,
    WhiteReadings,
    collect_white_readings,
    picture_frame,
)
from calichrome.core.arrays import FloatArray, IntArray
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["VignettingFit", "fit_vignetting"]

_SD_RADIAL = (1.0, 0.3, 0.3)
"""Of the log of the gain at the corner by r^2, r^4, r^6, before any data: cos^4 has, if half the
diagonal is 30 degrees, -0.67, 0.11, -0.02, if it is 40 degrees -1.4, 0.5, -0.2."""
_SD_TILT = {True: 0.004, False: 0.02}
"""Of the slope across the picture per half diagonal, with the principal point known or not: a
fall-off of 40 % (slope 0.8 at the corner) about a centre 0.5 % (4 px of a picture of 1280x960) or
2.5 % of the half diagonal off."""
_MOST_UNCERTAIN = 0.02
"""Relative sigma of the gain where the board was, from which a map is refused: beyond 4 % (95 %) it
would be seen as a false shade of grey (1.5 dE2000)."""
_APPROXIMATE = 0.002  # largest error on simulated readings without noise, 12 of two cameras
_FIRST_VARIANCES = {"jump": 1e-4, "channel": 1e-4, "tint": 1e-1}  # 1 %, 1 %, 0.3: any will do
_FIRST_NOISE = 1e-4
_ROUNDS = 30
_SETTLED = 0.01  # relative change of every variance
_LEAST_NOISE = (
    1e-10  # variance of log levels: a thousandth of an 8-bit step; made-up data have none
)
_REDESCEND = 6.0  # robust sigmas at which a reading counts no more (Tukey's biweight)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VignettingFit:
    """A lens' fall-off and how it was found.

    Parameters
    ----------
    vignetting
        The map.
    n_readings
        White readings of this camera that another camera shares.
    sigma
        Largest relative standard deviation of the map, about its mean, where the board was.
    residual
        Robust relative scatter of the readings about the fit.
    """

    vignetting: Vignetting
    n_readings: int
    sigma: float
    residual: float


def fit_vignetting(
    dataset: Dataset, target: Target, centres_px: Mapping[str, FloatArray] | None = None
) -> dict[str, VignettingFit | str]:
    """Separate what is fixed to the pictures from the light on the board.

    Parameters
    ----------
    dataset
        Views with discs, measured with the encoding removed.
    target
        The board: which squares lie around its discs.
    centres_px
        Principal point of each camera; the middle of the picture where absent. A fall-off of 40 %
        about a centre that is 2 % of the half diagonal off is 1.5 % wrong.

    Returns
    -------
    camera -> VignettingFit or str
        The sentence says why the data do not tell.

    Notes
    -----
    ``log white[c, f, m, k] = light[f, m, k] + exposure[c, k] + jump[c, f] + shading[c, k](pixel)
    + tint[c, k] . (log R/G, log B/G of the light)``, for camera c, frame f, disc m, channel k. The
    light is free at every disc of every frame and drops out by subtracting the mean over cameras.
    Exposure jumps, what channels differ in, and the tint (sensors see a change of the light's
    colour differently) are random effects whose variances the data tell (restricted maximum
    likelihood by fixed-point steps [1]_). Readings of one view share noise; the information of all
    is scaled down by how much more whole frames scatter than single readings say.

    References
    ----------
    .. [1] D. A. Harville, "Maximum Likelihood Approaches to Variance Component Estimation", JASA 72
       (358), 1977, pp. 320-338, eq. 6.3 ff.
    """
    centres_px = centres_px or {}
    readings = collect_white_readings(dataset, target, centres_px)
    shared = readings.where(np.bincount(readings.place)[readings.place] > 1)
    results: dict[str, VignettingFit | str] = dict.fromkeys(
        dataset.views,
        "no other camera sees the discs in the same frames, and one camera alone cannot tell the "
        "fall-off of its lens from that of the lamps",
    )
    if not len(shared.camera):
        return results
    sd_tilt = np.array([_SD_TILT[camera in centres_px] for camera in dataset.views])
    solution = _solve(shared, sd_tilt)
    for index, camera in enumerate(dataset.views):
        mine = shared.camera == index
        if not mine.any():
            continue
        coefficients, covariance = solution.of_camera(index)
        terms = shading_terms(shared.places[mine])
        terms = terms - terms.mean(axis=0)
        variance = np.einsum("ni,kij,nj->nk", terms, covariance, terms)
        sigma = float(np.hypot(np.sqrt(variance.max()), _APPROXIMATE))
        if sigma > _MOST_UNCERTAIN:
            results[camera] = (
                f"its fall-off stays open by {sigma:.1%} where the board was; record more frames, "
                f"with the board at all places of the picture and seen by cameras farther apart"
            )
            continue
        centre, unit = picture_frame(dataset.sizes_wh[camera], centres_px.get(camera))
        results[camera] = VignettingFit(
            vignetting=Vignetting(
                centre_px=centre,
                half_diagonal_px=unit,
                coefficients=coefficients,
                covariance=covariance,
                covered_radius=float(np.linalg.norm(shared.places[mine], axis=1).max()),
            ),
            n_readings=int(mine.sum()),
            sigma=sigma,
            residual=solution.residual,
        )
    return results


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Where the unknowns of the mixed model are.

    `exposure` 3 per camera; `common` shading of all channels, 5 per camera in units of their prior
    sigmas `sd` (n_cameras, 5); `random` by name: `jump` 1 per view, `channel` what a channel's
    shading differs in, r^2 and r^4, 6 per camera, `tint` 6 per camera.
    """

    exposure: slice
    common: slice
    random: Mapping[str, slice]
    sd: FloatArray

    @classmethod
    def of(cls, n_views: int, sd: FloatArray) -> "_Columns":
        n_cameras = len(sd)
        sizes = [3 * n_cameras, 5 * n_cameras, n_views, 6 * n_cameras, 6 * n_cameras]
        ends = np.cumsum(sizes)
        exposure, common, jump, channel, tint = (
            slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)
        )
        return cls(exposure, common, {"jump": jump, "channel": channel, "tint": tint}, sd)

    def __len__(self) -> int:
        return int(self.random["tint"].stop)

    def shading(self, camera: int) -> FloatArray:
        """Return the matrix (3, 5, P) from the unknowns to a camera's coefficients."""
        matrix = np.zeros((3, 5, len(self)))
        at = self.common.start + 5 * camera
        matrix[:, :, at : at + 5] = np.diag(self.sd[camera])
        for k in range(3):
            at = self.random["channel"].start + 2 * (len(self.sd) * k + camera)
            matrix[k, :2, at : at + 2] = np.eye(2)
        return matrix

    def design(self, readings: WhiteReadings) -> FloatArray:
        """Return the derivatives of the logs by the unknowns but `tint`, (N, 3, P)."""
        n_rows, n_cameras = len(readings.camera), len(self.sd)
        is_camera = np.eye(n_cameras)[readings.camera]
        scaled = readings.terms * self.sd[readings.camera]
        design = np.zeros((n_rows, 3, len(self)))
        design[:, :, self.common] = _by_camera(is_camera, scaled)[:, None]
        design[:, :, self.random["jump"]] = np.eye(int(readings.view.max()) + 1)[readings.view][
            :, None
        ]
        for k in range(3):
            _block(design, self.exposure, k)[:] = is_camera
            _block(design, self.random["channel"], k)[:] = _by_camera(
                is_camera, readings.terms[:, :2]
            )
        return design

    def fill_tint(self, design: FloatArray, readings: WhiteReadings, tints: FloatArray) -> None:
        """Set the derivatives by `tint` for colours (N, 2) of the light."""
        columns = _by_camera(np.eye(len(self.sd))[readings.camera], tints)
        for k in range(3):
            _block(design, self.random["tint"], k)[:] = columns


def _by_camera(is_camera: FloatArray, terms: FloatArray) -> FloatArray:
    """Spread terms (N, T) over columns of their camera, (N, n_cameras T)."""
    return np.asarray((is_camera[:, :, None] * terms[:, None]).reshape(len(terms), -1))


def _block(design: FloatArray, part: slice, channel: int) -> FloatArray:
    """Return the columns of a part that act on one channel, as a view."""
    size = (part.stop - part.start) // 3
    start = part.start + channel * size
    return design[:, channel, start : start + size]


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Unknowns (P,), their covariance, and the robust scatter of the readings."""

    columns: _Columns
    values: FloatArray
    covariance: FloatArray
    residual: float

    def of_camera(self, camera: int) -> tuple[FloatArray, FloatArray]:
        """Return coefficients (3, 5) and covariance (3, 5, 5) of one camera."""
        mine = self.columns.shading(camera)
        return mine @ self.values, mine @ self.covariance @ np.swapaxes(mine, 1, 2)


def _solve(readings: WhiteReadings, sd_tilt: FloatArray) -> _Solution:
    """Solve the mixed linear model of all three channels; see `fit_vignetting`."""
    sd = np.column_stack([np.tile(_SD_RADIAL, (len(sd_tilt), 1)), sd_tilt, sd_tilt])
    columns = _Columns.of(int(readings.view.max()) + 1, sd)
    lens = np.stack([columns.shading(camera) for camera in range(len(sd))])
    design = columns.design(readings)
    # about each camera's own level, so that exposures are of the order of 1 as all unknowns are
    logs = readings.logs.copy()
    for camera in np.unique(readings.camera):
        mine = readings.camera == camera
        logs[mine] -= np.median(logs[mine], axis=0)
    variances, noise = dict(_FIRST_VARIANCES), _FIRST_NOISE
    weights = readings.weights / readings.weights.mean()
    trust = weights
    values = np.zeros(len(columns))
    for _ in range(_ROUNDS):
        columns.fill_tint(design, readings, _tints(readings, lens @ values))
        inside, left, n_places = _without_light(design, logs, readings.place, trust)
        weighted = (inside * trust[:, None, None]).reshape(-1, len(columns)).T
        normal = weighted @ inside.reshape(-1, len(columns))
        prior = np.ones(len(columns))
        for name, part in columns.random.items():
            prior[part] = 1 / variances[name]
        covariance = np.asarray(np.linalg.inv(normal / noise + np.diag(prior)), dtype=np.float64)
        values = covariance @ (weighted @ left.ravel()) / noise
        residuals = left - inside @ values

        n_used = len(columns) - prior @ np.diag(covariance)
        n_free = max(3 * float((trust > 0).sum() - n_places) - float(n_used), 1.0)
        plain = max(float((trust[:, None] * residuals**2).sum()) / n_free, _LEAST_NOISE)
        scores = np.zeros((int(readings.frame.max()) + 1, len(columns)))
        np.add.at(
            scores, readings.frame, np.einsum("nki,nk->ni", inside, trust[:, None] * residuals)
        )
        scatter = float(np.einsum("fi,ij,fj->", scores, covariance, scores)) / plain
        excess = scatter / max(float((covariance * normal).sum()), 1e-12)
        update = {
            name: _variance(values[part], np.diag(covariance)[part], variances[name])
            for name, part in columns.random.items()
        }
        updated = max(excess, 1.0) * plain
        changes = [updated / noise, *(update[name] / variances[name] for name in update)]
        variances, noise = update, updated
        off = np.abs(residuals).max(axis=1) * np.sqrt(weights)
        sigma = 1.4826 * float(np.median(off)) + 1e-9
        trust = weights * np.maximum(1 - (off / (_REDESCEND * sigma)) ** 2, 0) ** 2
        if np.abs(np.log(changes)).max() < _SETTLED:
            break
    return _Solution(columns, values, covariance, sigma)


def _without_light(
    design: FloatArray, logs: FloatArray, place: IntArray, trust: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """Subtract the weighted mean over cameras at each disc of each frame, where light is free.

    Returns the design (N, 3, P), the logs (N, 3) and how many places take a degree of freedom.
    """
    rows = np.concatenate([design, logs[..., None]], axis=2)
    total = np.bincount(place, weights=trust)
    sums = np.zeros((len(total), *rows.shape[1:]))
    np.add.at(sums, place, rows * trust[:, None, None])
    rows = rows - (sums / np.maximum(total, 1e-9)[:, None, None])[place]
    return rows[..., :-1], rows[..., -1], int((total > 0).sum())


def _variance(values: FloatArray, doubt: FloatArray, before: float) -> float:
    """Return the next variance of random effects: mean square over how many the data tell."""
    n_told = len(values) - float(doubt.sum()) / before
    return min(max(float(values @ values) / max(n_told, 1e-3), 1e-10), 10.0)


def _tints(readings: WhiteReadings, coefficients: FloatArray) -> FloatArray:
    """Colour of the light, log R/G and B/G without the lens and about each camera's mean, (N, 2).

    Smoothed by a quadratic over each view: its noise would make it seem of no effect.
    """
    lens = np.einsum("nkt,nt->nk", coefficients[readings.camera], readings.terms)
    logs = readings.logs - lens
    tints = logs[:, [0, 2]] - logs[:, 1:2]
    for index in range(int(readings.view.max()) + 1):
        mine = readings.view == index
        u, v = (readings.places[mine] - readings.places[mine].mean(axis=0)).T
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        terms = terms[:, : 6 if mine.sum() >= FEWEST_DISCS else 1]
        tints[mine] = terms @ np.linalg.lstsq(terms, tints[mine], rcond=None)[0]
    for camera in np.unique(readings.camera):
        mine = readings.camera == camera
        tints[mine] -= tints[mine].mean(axis=0)
    return np.asarray(tints)
