"""Objects followed from instant to instant: each claims its region in every camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from calichrome.core.arrays import FloatArray
from calichrome.rig import CameraCovariance, Rig
from calichrome.tracking.hypotheses import find_objects
from calichrome.tracking.likelihood import AssociationSettings, RegionTable, gate
from calichrome.tracking.motion import Gaussian, predict, update
from calichrome.tracking.regions import Region
from calichrome.tracking.surface_colour import colour_covariance
from calichrome.tracking.track import Sighting, Step, Track
from calichrome.tracking.view import View, views_of

__all__ = ["Tracker", "TrackingSettings"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingSettings:
    """How objects are followed.

    Parameters
    ----------
    acceleration_m_s2
        Usual acceleration of objects, for the prediction from one instant to the next; what is
        reported stands on the accelerations that the data show.
    n_confirm
        Instants at which a new object must be seen before it counts.
    max_gap_s
        An object that is hidden from all cameras for longer is lost.
    """

    acceleration_m_s2: float = 10.0
    n_confirm: int = 3
    max_gap_s: float = 0.5


class Tracker:
    """Follow objects through the regions that cameras see.

    Parameters
    ----------
    rig
        The calibration.
    covariance
        `Evidence.joint`, so that its doubts count; None: it is exact.
    association, settings
        What regions of one object may differ by, and how objects move.

    Notes
    -----
    At each instant every object is predicted, and in each camera the regions are given to the
    confirmed objects so that the sum of the negative log-likelihoods is least, within a chi-square
    gate; then to the tentative ones. Regions that are left and do not lie on an object make new
    ones. The state is updated with all whole regions of an object together, those that contradict
    the others left out.
    """

    def __init__(
        self,
        rig: Rig,
        covariance: CameraCovariance | None = None,
        *,
        association: AssociationSettings | None = None,
        settings: TrackingSettings | None = None,
    ) -> None:
        self.views: Mapping[str, View] = views_of(rig, covariance)
        self.association = association or AssociationSettings()
        self.settings = settings or TrackingSettings()
        self._covariance = covariance
        self._alive: list[Track] = []
        self._ended: list[Track] = []
        self._last_s: float | None = None
        self._next = 1

    @property
    def tracks(self) -> tuple[Track, ...]:
        """All confirmed tracks so far, ended ones too, by number."""
        everything = [track for track in (*self._ended, *self._alive) if track.confirmed]
        return tuple(sorted(everything, key=lambda track: track.number))

    def update(
        self, frame: str, time_s: float, regions: Mapping[str, Sequence[Region]]
    ) -> tuple[Track, ...]:
        """Take in one instant.

        Parameters
        ----------
        frame
            Its name.
        time_s
            Later than the one before.
        regions
            camera -> what it sees; cameras without a picture are left out.

        Returns
        -------
        tuple of Track
            The confirmed ones that are alive.

        Raises
        ------
        ValueError
            If time does not go on.
        """
        interval_s = 0.0 if self._last_s is None else time_s - self._last_s
        if self._last_s is not None and interval_s <= 0:
            raise ValueError(f"update: {time_s} s is not after {self._last_s} s")
        self._last_s = time_s
        tables = {
            camera: RegionTable.of(self.views[camera], own, self.association)
            for camera, own in regions.items()
        }
        free = {camera: set(range(len(own))) for camera, own in regions.items()}
        # white noise whose velocity spreads as by this acceleration, held for one interval
        density = self.settings.acceleration_m_s2**2 * interval_s
        for group in (True, False):
            some = [track for track in self._alive if track.confirmed is group]
            states = [predict(track.state, interval_s, density) for track in some]
            claims = self._claims(some, states, tables, free)
            for track, state, claim in zip(some, states, claims, strict=True):
                self._step(track, frame, time_s, state, claim, tables)
        self._end(time_s)
        self._explain(tables, free)
        for item in find_objects(tables, self.association, covariance=self._covariance, free=free):
            track = Track(number=self._next)
            self._next += 1
            self._alive.append(track)
            start = Gaussian.diffuse(item.position_ref)
            self._step(track, frame, time_s, start, item.regions, tables)
        return tuple(track for track in self._alive if track.confirmed)

    def _claims(
        self,
        tracks: Sequence[Track],
        states: Sequence[Gaussian],
        tables: Mapping[str, RegionTable],
        free: Mapping[str, set[int]],
    ) -> list[dict[str, int]]:
        """Give each track at most one region per camera."""
        claims: list[dict[str, int]] = [{} for _ in tracks]
        if not tracks:
            return claims
        points = np.stack([state.position_m for state in states])
        cov_m2 = np.stack([state.cov[:3, :3] for state in states])
        lab = np.stack([track.lab_d65 for track in tracks])
        one = colour_covariance(
            np.nan_to_num(lab, nan=50.0),
            self.association.colour_sigma_de,
            self.association.light_sigma,
        )
        n_views = np.array([max(1, track.n_views) for track in tracks])
        for camera, table in tables.items():
            left = sorted(free[camera])
            if not left:
                continue
            seen = table.view.look(points)
            doubt = seen.d_points @ cov_m2 @ seen.d_points.swapaxes(1, 2)
            if table.view.cov is not None:
                doubt = doubt + seen.d_camera @ table.view.cov @ seen.d_camera.swapaxes(1, 2)
            chi_square, freedom, cost = table.cost(
                pixels=seen.pixels,
                cov_px2=doubt,
                lab=lab,
                lab_cov=one / n_views[:, None, None],
                log_radius=np.array([track.log_radius for track in tracks]),
                radius_sigma=np.hypot(
                    self.association.size_sigma, [track.size_sigma for track in tracks]
                ),
                distance_m=seen.distance_m,
            )
            limits = np.vectorize(lambda n: gate(n, self.association.false_alarm))(freedom)
            for row, column in _assigned(chi_square, limits, cost, left):
                claims[row][camera] = column
                free[camera].discard(column)
        return claims

    def _step(
        self,
        track: Track,
        frame: str,
        time_s: float,
        state: Gaussian,
        claim: Mapping[str, int],
        tables: Mapping[str, RegionTable],
    ) -> None:
        """Update a track with the regions that it claimed."""
        sizes = {
            camera: tables[camera].log_radius(index, state.position_m)
            for camera, index in claim.items()
        }
        whole = {
            camera: index
            for camera, index in claim.items()
            if tables[camera].regions[index].whole and track.is_whole(sizes[camera])
        }
        state, used = self._measured(state, whole, tables)
        sightings = {
            camera: Sighting.of(tables[camera].regions[index], sizes[camera], used=camera in used)
            for camera, index in claim.items()
        }
        track.steps.append(Step(frame=frame, time_s=time_s, state=state, sightings=sightings))
        track.learn(sightings.values())
        track.confirmed = track.confirmed or track.n_seen >= self.settings.n_confirm

    def _measured(
        self, state: Gaussian, claim: Mapping[str, int], tables: Mapping[str, RegionTable]
    ) -> tuple[Gaussian, set[str]]:
        """Update with all views together; the one that misses most is left out while it must be."""
        used = dict(claim)
        limit = gate(2, self.association.false_alarm)
        while used:
            measured = state
            for _ in range(2):  # once more about the better place: projection is not linear
                information, vector = np.zeros((3, 3)), np.zeros((3, 1))
                for camera, index in used.items():
                    table = tables[camera]
                    point = measured.position_m
                    seen = table.view.look(point[None])
                    slope = seen.d_points[0]
                    weight = slope.T @ np.linalg.inv(table.cov_px2[index])
                    missed = table.centres_px[index] - seen.pixels[0] + slope @ point
                    information += weight @ slope
                    vector[:, 0] += weight @ missed
                measured = update(state, information, vector)
            misses = {
                camera: self._miss(measured, tables[camera], index)
                for camera, index in used.items()
            }
            worst = max(misses, key=lambda camera: misses[camera])
            if misses[worst] <= limit or len(used) < 3:
                return measured, set(used)
            del used[worst]
        return state, set()

    @staticmethod
    def _miss(state: Gaussian, table: RegionTable, index: int) -> float:
        """Squared residual in units of the region's covariance, with the camera's doubts."""
        seen = table.view.look(state.position_m[None])
        cov = table.cov_px2[index]
        if table.view.cov is not None:
            cov = cov + seen.d_camera[0] @ table.view.cov @ seen.d_camera[0].T
        miss = table.centres_px[index] - seen.pixels[0]
        return float(miss @ np.linalg.solve(cov, miss))

    def _explain(self, tables: Mapping[str, RegionTable], free: Mapping[str, set[int]]) -> None:
        """Take regions off that lie on known objects: what is merged is nothing new."""
        if not self._alive:
            return
        points = np.stack([track.state.position_m for track in self._alive])
        for camera, table in tables.items():
            pixels = table.view.look(points).pixels
            free[camera] -= {i for i in free[camera] if table.regions[i].covers(pixels).any()}

    def _end(self, time_s: float) -> None:
        """Part with tracks that were not seen for too long; the last steps without sight go."""
        alive = []
        for track in self._alive:
            last = next(step for step in reversed(track.steps) if step.sightings)
            gap_s = self.settings.max_gap_s if track.confirmed else 0.0
            if time_s - last.time_s > gap_s and not track.steps[-1].sightings:
                while not track.steps[-1].sightings:
                    track.steps.pop()
                self._ended.append(track)
            else:
                alive.append(track)
        self._alive = alive


def _assigned(
    chi_square: FloatArray, limits: FloatArray, cost: FloatArray, left: Sequence[int]
) -> list[tuple[int, int]]:
    """Pairs (object, region) of least total cost among those within their gates."""
    own = np.ix_(range(len(chi_square)), left)
    within = chi_square[own] <= limits[own]
    if not within.any():
        return []
    # every pair within its gate is better than none
    shifted = np.where(within, cost[own] - cost[own][within].max() - 1, 0.0)
    rows, columns = linear_sum_assignment(shifted)
    return [
        (int(row), left[column])
        for row, column in zip(rows, columns, strict=True)
        if within[row, column]
    ]
