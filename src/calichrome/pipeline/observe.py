"""A recording of a scene, turned into the tracks of its objects."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.pipeline.detect import Progress, silent
from calichrome.pipeline.watch import Watch, open_watch
from calichrome.rig import Evidence, Rig
from calichrome.tracking import (
    AssociationSettings,
    Background,
    ErrorSizes,
    PixelRays,
    Region,
    Sighting,
    Tracker,
    TrackingSettings,
    Trajectory,
    extent_of,
    find_regions,
    light_levels,
    mean_colour,
    smooth_tracks,
)

__all__ = ["Observation", "ObserveSettings", "Row", "observe"]

_SCALE_SIGMA = 0.005  # of a board whose size was not measured: as `calibrate` has it
_UNCORRECTED_DE = 10.0  # between sensors that are only white-balanced, measured on 190 surfaces
_MEAN_OF_THREE = 2.257  # mean length of the difference of two vectors of unit variance per axis


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveSettings:
    """How a scene is observed.

    Parameters
    ----------
    min_area
        Smaller regions of a picture are left out, pixels.
    darkest_shadow
        What only darkens the background to no less than this share of its light is taken as a
        shadow; 1: nothing is.
    acceleration
        Usual acceleration of objects, m/s^2, for the prediction from frame to frame.
    max_gap
        An object that no camera sees for longer is lost, seconds.
    colour_correction
        False: take camera values as sRGB, to see what the correction is worth.
    """

    min_area: int = 40
    darkest_shadow: float = 0.4
    acceleration: float = 10.0
    max_gap: float = 0.5
    colour_correction: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One object at one instant, in world coordinates.

    Parameters
    ----------
    time
        Seconds, or frames where no time is known.
    frame, track
        Names.
    position_m, velocity : (3,) float
        Metres; metres per unit of time.
    cov_m2 : (3, 3) float
        Of the position, all errors.
    lab_d65 : (3,) float
        nan where no camera told its colour.
    extent_m : (3,) float
        Sides of the upright box about it; nan where it is not known.
    sightings : camera -> Sighting
    """

    time: float
    frame: str
    track: int
    position_m: FloatArray
    velocity: FloatArray
    cov_m2: FloatArray
    lab_d65: FloatArray
    extent_m: FloatArray
    sightings: Mapping[str, Sighting]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observation:
    """What was seen.

    Parameters
    ----------
    watch
        The recording.
    trajectories
        One per object, in ref.
    errors
        Sizes of the errors that the tracks tell.
    light : camera -> float
        Factor of the light in which it sees objects; colours are given without it.
    n_born, n_lost
        Tracks that begin after the first frame, and tracks that end before the last.
    findings
        Of the recording and of the rig.
    """

    watch: Watch
    trajectories: tuple[Trajectory, ...]
    errors: ErrorSizes
    light: Mapping[str, float]
    n_born: int
    n_lost: int
    findings: tuple[Finding, ...]

    def rows(self) -> Iterator[Row]:
        """Yield objects by time, then by number."""
        found = [row for item in self.trajectories for row in self._rows_of(item)]
        yield from sorted(found, key=lambda row: (row.time, row.track))

    def _rows_of(self, item: Trajectory) -> Iterator[Row]:
        world_from_ref = self.watch.rig.world_from_ref
        turn, unit_s = world_from_ref.rotation, self.watch.time_unit_s
        views = item.views
        cov = turn @ item.cov[:, :3, :3] @ turn.T
        positions = world_from_ref.apply(item.positions_ref)
        for index, step in enumerate(item.track.steps):
            sightings = {
                camera: step.sightings[camera].in_light(self.light.get(camera, 1.0))
                for camera in self.watch.cameras
                if camera in step.sightings
            }
            colours = [seen.colour for seen in sightings.values() if seen.used and seen.colour]
            yield Row(
                time=step.time_s / unit_s,
                frame=step.frame,
                track=item.track.number,
                position_m=positions[index],
                velocity=turn @ item.velocities_ref[index] * unit_s,
                cov_m2=cov[index],
                lab_d65=mean_colour(colours) if colours else np.full(3, np.nan),
                extent_m=extent_of(item.positions_ref[index], sightings, views, world_from_ref),
                sightings=sightings,
            )


def observe(
    rig: Rig,
    evidence: Evidence | None,
    folder: Path,
    *,
    settings: ObserveSettings | None = None,
    pattern: str | None = None,
    background: tuple[int, int] | None = None,
    fps: float | None = None,
    progress: Progress = silent,
) -> Observation:
    """Find and follow what moves in a scene.

    Parameters
    ----------
    rig, evidence
        The calibration; without evidence it is taken as exact.
    folder, pattern, background, fps
        See `open_watch`.
    settings
        How to go about it.
    progress
        Called after each frame.

    Raises
    ------
    RecordingError
        As `open_watch`; or if a picture has another size than its camera.
    """
    settings = settings or ObserveSettings()
    watch = open_watch(
        rig,
        folder,
        pattern=pattern,
        background=background,
        fps=fps,
        corrected=settings.colour_correction,
    )
    covariance = None if evidence is None else evidence.joint
    tracker = Tracker(
        rig,
        covariance,
        association=AssociationSettings(colour_sigma_de=_colour_sigma(rig, settings)),
        settings=TrackingSettings(
            acceleration_m_s2=settings.acceleration, max_gap_s=settings.max_gap
        ),
    )
    unreadable: list[tuple[str, str, str]] = []
    for done, (frame, time_s, regions) in enumerate(
        _regions(watch, tracker, settings, unreadable, progress)
    ):
        tracker.update(frame, time_s, regions)
        progress("following", done + 1, len(watch.times_s))
    unmeasured = any(item.code == "scale_unverified" for item in rig.findings)
    trajectories, errors = smooth_tracks(
        tracker.tracks,
        tracker.views,
        covariance,
        scale_sigma=_SCALE_SIGMA if unmeasured else 0.0,
    )
    frames = list(watch.times_s)
    return Observation(
        watch=watch,
        trajectories=trajectories,
        errors=errors,
        light=light_levels(tracker.tracks),
        n_born=sum(item.track.steps[0].frame != frames[0] for item in trajectories),
        n_lost=sum(item.track.steps[-1].frame != frames[-1] for item in trajectories),
        findings=(
            *(item for item in rig.findings if item.severity == "critical"),
            *watch.findings,
            *_further_findings(covariance is None, unreadable),
        ),
    )


def _regions(
    watch: Watch,
    tracker: Tracker,
    settings: ObserveSettings,
    unreadable: list[tuple[str, str, str]],
    progress: Progress,
) -> Iterator[tuple[str, float, dict[str, tuple[Region, ...]]]]:
    """Learn the empty scene, then find the regions of every instant."""
    backgrounds, rays = {}, {}
    for done, camera in enumerate(watch.cameras):
        backgrounds[camera] = Background.learn(watch.empty_pictures(camera))
        view = tracker.views[camera]
        rays[camera] = PixelRays.through(view.lens, view.size_wh)
        progress("learning the background", done + 1, len(watch.cameras))
    for instant in watch.instants(unreadable):
        regions = {
            camera: find_regions(
                picture,
                backgrounds[camera],
                tracker.views[camera],
                rays[camera],
                min_area_px=settings.min_area,
                darkest_shadow=settings.darkest_shadow,
                in_colour=watch.in_colour,
            )
            for camera, picture in instant.pictures.items()
        }
        yield instant.frame, instant.time_s, regions


def _colour_sigma(rig: Rig, settings: ObserveSettings) -> float:
    """Per axis of Lab, of one camera: what the calibration found between cameras."""
    between = rig.inter_camera_delta_e_2000 or {}
    mean = between.get("held_out_mean") or between.get("mean")
    if not settings.colour_correction:
        return _UNCORRECTED_DE / _MEAN_OF_THREE
    if mean is None:
        return AssociationSettings().colour_sigma_de
    return max(mean / _MEAN_OF_THREE, AssociationSettings().colour_sigma_de)


def _further_findings(
    exact: bool,  # noqa: FBT001
    unreadable: list[tuple[str, str, str]],
) -> Iterator[Finding]:
    if exact:
        text = (
            "rig.npz is not beside the rig, or holds no joint covariance: the ± of places and "
            "distances leave out the errors of the calibration. Calibrate again, keep both files."
        )
        yield finding("calibration_taken_as_exact", text)
    for camera, frame, reason in unreadable:
        text = f"{camera}/{frame}: {reason}; that picture is left out."
        yield finding("unreadable_frame", text, camera=camera, frame=frame)
