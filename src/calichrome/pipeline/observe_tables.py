"""What was observed, as CSV files."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from calichrome.core.arrays import FloatArray
from calichrome.core.files import writing_file
from calichrome.pipeline.observe import Observation, Row
from calichrome.tracking import Trajectory, distance_bounds

__all__ = ["Distance", "distances", "write_distances", "write_sightings", "write_tracks"]

_TRACK_COLUMNS = (
    "time_s", "frame", "track", "x", "y", "z", "sxx", "sxy", "sxz", "syy", "syz", "szz",
    "vx", "vy", "vz", "L", "a", "b", "cameras", "class", "dx", "dy", "dz",
)  # fmt: skip
_SIGHTING_COLUMNS = (
    "time_s", "frame", "track", "camera", "x", "y", "left", "top", "right", "bottom",
    "half_angle", "L", "a", "b", "used",
)  # fmt: skip
_DISTANCE_COLUMNS = ("time_s", "frame", "track_a", "track_b", "distance", "sigma", "lower_95",
                     "gap_lower_95")  # fmt: skip
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """How far two objects are apart at one instant.

    Parameters
    ----------
    time, frame
        As in `Row`.
    tracks
        Numbers of the two.
    distance_m, sigma_m
        Between their centres, and its standard deviation.
    lower_95_m
        What the distance of the centres exceeds with 95 % probability.
    gap_lower_95_m
        The same less what the silhouettes of both reach towards each other; nan: not known.
    """

    time: float
    frame: str
    tracks: tuple[int, int]
    distance_m: float
    sigma_m: float
    lower_95_m: float
    gap_lower_95_m: float


def write_tracks(
    path: Path, rows: Iterable[Row], classes: Mapping[int, str], *, force: bool
) -> None:
    """Write the tracks.csv of docs/file-format.md."""
    _write(path, _TRACK_COLUMNS, (_track_cells(row, classes) for row in rows), force=force)


def write_sightings(path: Path, rows: Iterable[Row], *, force: bool) -> None:
    """Write what each camera saw of each object."""
    _write(path, _SIGHTING_COLUMNS, _sighting_cells(rows), force=force)


def write_distances(path: Path, found: Iterable[Distance], *, force: bool) -> None:
    """Write the distance of every pair of objects at every instant."""
    cells = (
        [
            _number(item.time), item.frame, str(item.tracks[0]), str(item.tracks[1]),
            _number(item.distance_m), _number(item.sigma_m), _number(item.lower_95_m),
            _number(item.gap_lower_95_m),
        ]
        for item in found
    )  # fmt: skip
    _write(path, _DISTANCE_COLUMNS, cells, force=force)


def distances(observation: Observation, rows: Sequence[Row]) -> Iterator[Distance]:
    """Yield the distances of all pairs of objects, pair by pair.

    Parameters
    ----------
    observation
        What was seen.
    rows
        Of the same.
    """
    quantile = float(ndtri(0.95))
    extents = {(row.frame, row.track): row.extent_m for row in rows}
    turn = observation.watch.rig.world_from_ref.rotation
    unit_s = observation.watch.time_unit_s
    for first, second in combinations(observation.trajectories, 2):
        frames, places = _common(first, second)
        if not frames:
            continue
        bounds = distance_bounds(first, second, places)
        numbers = first.track.number, second.track.number
        for index, frame in enumerate(frames):
            lower = max(bounds.distance_m[index] - quantile * bounds.sigma_m[index], 0.0)
            unit = turn @ bounds.direction_ref[index]
            reach = sum(
                float(np.linalg.norm(unit * extents[frame, number] / 2)) for number in numbers
            )
            yield Distance(
                time=float(first.times_s[places[index][0]]) / unit_s,
                frame=frame,
                tracks=numbers,
                distance_m=float(bounds.distance_m[index]),
                sigma_m=float(bounds.sigma_m[index]),
                lower_95_m=float(lower),
                gap_lower_95_m=max(float(lower) - reach, 0.0) if np.isfinite(reach) else np.nan,
            )


def _common(first: Trajectory, second: Trajectory) -> tuple[list[str], list[tuple[int, int]]]:
    """Frames in which both are alive, and their index in each."""
    places = {step.frame: index for index, step in enumerate(second.track.steps)}
    both = [
        (step.frame, (index, places[step.frame]))
        for index, step in enumerate(first.track.steps)
        if step.frame in places
    ]
    return [frame for frame, _ in both], [pair for _, pair in both]


def _track_cells(row: Row, classes: Mapping[int, str]) -> list[str]:
    return [
        _number(row.time),
        row.frame,
        str(row.track),
        *_numbers(row.position_m),
        *(f"{value:.6e}" for value in row.cov_m2[_UPPER]),
        *_numbers(row.velocity),
        *_numbers(row.lab_d65),
        " ".join(row.sightings),
        classes.get(row.track, ""),
        *_numbers(row.extent_m),
    ]


def _sighting_cells(rows: Iterable[Row]) -> Iterator[list[str]]:
    for row in rows:
        for camera, seen in row.sightings.items():
            lab = np.full(3, np.nan) if seen.colour is None else seen.colour.lab_d65
            yield [
                _number(row.time),
                row.frame,
                str(row.track),
                camera,
                *_numbers(seen.centre_px),
                *map(str, seen.box),
                _number(seen.half_angle_rad),
                *_numbers(lab),
                str(int(seen.used)),
            ]


def _numbers(values: FloatArray) -> list[str]:
    return [_number(float(value)) for value in values]


def _number(value: float) -> str:
    """Write to a micrometre or a microsecond; empty: not known."""
    return "" if np.isnan(value) else f"{value:.6f}"


def _write(
    path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]], *, force: bool
) -> None:
    with (
        writing_file(path, force=force) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(rows)
