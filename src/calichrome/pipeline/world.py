"""Where the world is: the board of one frame as the floor, or points whose places are known."""

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError, SolveError
from calichrome.geometry.rig_solution import RigSolution

__all__ = ["place_world", "read_world_points"]

_COLUMNS = ("frame", "corner", "x", "y", "z")
_FLAT = 1e-3  # of the points' extent: nearer to one line they leave a turn open; a choice


def place_world(
    solution: RigSolution,
    points_board: FloatArray,
    *,
    frame: str | None = None,
    points: Path | None = None,
) -> Pose:
    """Return world_from_ref: the identity if nothing is said.

    Parameters
    ----------
    solution
        Where the boards are.
    points_board : (n, 3) float, metres
    frame
        The board in this frame is the floor: origin at its first corner, x along its columns, z up
        from the board (the board's own z points into it, so this is half a turn about x).
    points
        CSV file with columns frame, corner, x, y, z: world coordinates, metres, of board corners.

    Raises
    ------
    SolveError
        If the frame shows no board, or the points do not fix a place.
    FileFormatError
        If the file is not as described.
    """
    if frame is not None and points is not None:
        raise SolveError("give either --world-frame or --world-points")
    if frame is not None:
        board = _board(solution, frame, "--world-frame")
        return Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ board.inverse()
    if points is None:
        return Pose.identity()
    rows = read_world_points(points, len(points_board))
    in_ref = np.stack(
        [
            _board(solution, name, str(points)).apply(points_board[corner])
            for name, corner, _ in rows
        ]
    )
    in_world = np.stack([place for _, _, place in rows])
    spread = np.linalg.svd(in_world - in_world.mean(axis=0), compute_uv=False)
    if len(rows) < 3 or spread[1] < _FLAT * spread[0]:
        raise SolveError(f"{points}: give at least three points that are not on one line")
    turn, _ = Rotation.align_vectors(in_world - in_world.mean(axis=0), in_ref - in_ref.mean(axis=0))
    rotation = turn.as_matrix()
    return Pose(rotation, in_world.mean(axis=0) - rotation @ in_ref.mean(axis=0))


def read_world_points(path: Path, n_corners: int) -> list[tuple[str, int, FloatArray]]:
    """Read (frame, corner, world coordinates in metres) of known points.

    Raises
    ------
    FileFormatError
        If the file cannot be read or is not as described.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream)
            if tuple(reader.fieldnames or ()) != _COLUMNS:
                raise FileFormatError(f"{path}: the columns must be {','.join(_COLUMNS)}")
            rows = []
            for line, row in enumerate(reader, start=2):
                try:
                    corner = int(row["corner"])
                    place = np.array([float(row[axis]) for axis in "xyz"])
                except (TypeError, ValueError) as error:
                    raise FileFormatError(f"{path}, line {line}: {error}") from error
                if not 0 <= corner < n_corners or not np.isfinite(place).all():
                    raise FileFormatError(
                        f"{path}, line {line}: corner must be 0 to {n_corners - 1}, and x, y, z "
                        f"finite"
                    )
                rows.append((row["frame"], corner, place))
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from error
    return rows


def _board(solution: RigSolution, frame: str, asked: str) -> Pose:
    board = solution.ref_from_boards.get(frame)
    if board is None:
        raise SolveError(f"{asked}: no board was found in frame {frame}; name one that shows it")
    return board
