"""What `observe` writes, as arrays: tracks, sightings, distances."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import BoolArray, FloatArray, IntArray

__all__ = [
    "Distances",
    "Sightings",
    "Tracks",
    "read_distances",
    "read_sightings",
    "read_tracks",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """The rows of tracks.csv.

    Parameters
    ----------
    frame, track : (n,) int
        Number of the frame in the truth; number of the track.
    positions_ref : (n, 3) float, metres
    cov_m2 : (n, 3, 3) float
    velocities_ref : (n, 3) float, metres per second
    lab_d65 : (n, 3) float
    """

    frame: IntArray
    track: IntArray
    positions_ref: FloatArray
    cov_m2: FloatArray
    velocities_ref: FloatArray
    lab_d65: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """What each camera saw of each track.

    Parameters
    ----------
    frame, track : (n,) int
    camera : (n,) str
    centres_px : (n, 2) float, pixels
    lab_d65 : (n, 3) float
        nan where it was not told.
    used : (n,) bool
        It counted for the place.
    """

    frame: IntArray
    track: IntArray
    camera: NDArray[np.str_]
    centres_px: FloatArray
    lab_d65: FloatArray
    used: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Distances:
    """Distance of each pair of tracks in each frame, and the bound that it exceeds in 95 %.

    Parameters
    ----------
    frame : (n,) int
    tracks : (n, 2) int
    lower_m : (n,) float, metres
    """

    frame: IntArray
    tracks: IntArray
    lower_m: FloatArray


def _columns(path: Path) -> dict[str, list[str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}


def _numbers(table: dict[str, list[str]], *names: str) -> FloatArray:
    columns = [[float(text or "nan") for text in table.get(name, [])] for name in names]
    return np.array(columns, dtype=np.float64).T.reshape(-1, len(names))


def _integers(table: dict[str, list[str]], *names: str) -> IntArray:
    return np.array([[int(text) for text in table.get(name, [])] for name in names], dtype=np.int64)


def _frames(table: dict[str, list[str]], frame_ids: Sequence[str]) -> IntArray:
    number = {frame_id: index for index, frame_id in enumerate(frame_ids)}
    return np.array([number[name] for name in table.get("frame", [])], dtype=np.int64)


def read_sightings(path: Path, frame_ids: Sequence[str]) -> Sightings:
    """Read the file of --sightings; its frames must be among `frame_ids`."""
    table = _columns(path)
    return Sightings(
        frame=_frames(table, frame_ids),
        track=_integers(table, "track")[0],
        camera=np.array(table.get("camera", []), dtype=np.str_),
        centres_px=_numbers(table, "x", "y"),
        lab_d65=_numbers(table, "L", "a", "b"),
        used=_integers(table, "used")[0].astype(bool),
    )


def read_distances(path: Path, frame_ids: Sequence[str]) -> Distances:
    """Read the file of --distances; its frames must be among `frame_ids`."""
    table = _columns(path)
    return Distances(
        frame=_frames(table, frame_ids),
        tracks=_integers(table, "track_a", "track_b").T,
        lower_m=_numbers(table, "lower_95")[:, 0],
    )


def read_tracks(path: Path, frame_ids: Sequence[str]) -> Tracks:
    """Read tracks.csv; its frames must be among `frame_ids`."""
    table = _columns(path)
    xx, xy, xz, yy, yz, zz = _numbers(table, "sxx", "sxy", "sxz", "syy", "syz", "szz").T
    cov = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Tracks(
        frame=_frames(table, frame_ids),
        track=_integers(table, "track")[0],
        positions_ref=_numbers(table, "x", "y", "z"),
        cov_m2=np.moveaxis(cov, -1, 0),
        velocities_ref=_numbers(table, "vx", "vy", "vz"),
        lab_d65=_numbers(table, "L", "a", "b"),
    )
