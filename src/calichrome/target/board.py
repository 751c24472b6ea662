"""What is printed: squares, corners, discs, and where they are on the board."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.errors import TargetError

__all__ = ["Marker", "Paper", "SquareColour", "Target", "chessboard"]

SquareColour = Literal["black", "white"]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Marker:
    """One colour disc in the centre of a square.

    Parameters
    ----------
    square : (2,) int
        Column ix and row iy of its square; [0, 0] is the top-left square.
    name
        Name of the colour; discs that share it share the colour.
    diameter_m
        Metres.
    background
        Colour of the square.
    xyz_d65 : (3,) float
        CIE 1931 2 degree tristimulus values under D65, Y = 1 for the perfect diffuser.
    extra
        Keys of the file that this release does not know; kept when it is written again.
    """

    square: tuple[int, int]
    name: str
    diameter_m: float
    background: SquareColour
    xyz_d65: Triple
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Paper:
    """The paper and the black ink, as measured: XYZ under D65, Y = 1 for the perfect diffuser.

    `extra` holds keys of the file that this release does not know.
    """

    white_xyz_d65: Triple | None = None
    black_xyz_d65: Triple | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A chessboard, with colour discs or without.

    Parameters
    ----------
    squares : (2,) int
        Number of squares along x and y.
    square_m : (2,) float
        Width and height of one square, metres.
    top_left
        Colour of square [0, 0].
    white_margin_m
        White around the squares, metres; None if unknown.
    markers
        The discs; a marker id is an index into this tuple.
    square_size_measured, colours_measured
        True if these were measured on the print and are not the nominal values.
    extra
        Keys of the file that this release does not know; kept when it is written again.

    Notes
    -----
    Board frame: the inner corner between squares [0, 0] and [1, 1] is the origin, x right along
    columns, y down along rows, z into the board, away from the viewer (docs/conventions.md).
    """

    squares: tuple[int, int]
    square_m: tuple[float, float]
    top_left: SquareColour = "black"
    white_margin_m: float | None = None
    markers: tuple[Marker, ...] = ()
    paper: Paper = field(default_factory=Paper)
    square_size_measured: bool = False
    colours_measured: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if min(self.squares) < 4:
            raise TargetError(
                f"the target has {self.squares[0]}x{self.squares[1]} squares: a board needs 4x4 "
                f"squares (3x3 inner corners) or more to fix a pose; count the squares, not the "
                f"points where they meet"
            )
        if max(self.squares) > 200:
            raise TargetError(
                f"the target has {self.squares[0]}x{self.squares[1]} squares: more than 200 along "
                f"one side is not a board; check the numbers"
            )
        if not all(0 < side < 100 for side in self.square_m):
            raise TargetError(f"squares of {self.square_m} m are not possible: give their size")
        seen: set[tuple[int, int]] = set()
        for index, marker in enumerate(self.markers):
            ix, iy = marker.square
            where = f"disc {index} ({marker.name})"
            if not (0 <= ix < self.squares[0] and 0 <= iy < self.squares[1]):
                raise TargetError(f"{where} lies in square {marker.square}, outside the board")
            if marker.square in seen:
                raise TargetError(f"{where}: square {marker.square} holds two discs; remove one")
            seen.add(marker.square)
            if not 0 < marker.diameter_m < min(self.square_m):
                raise TargetError(
                    f"{where}: a diameter of {marker.diameter_m * 1e3:g} mm does not fit into its "
                    f"square of {min(self.square_m) * 1e3:g} mm"
                )
            if marker.background != self.square_colour(ix, iy):
                raise TargetError(
                    f"{where}: background says {marker.background}, but square {marker.square} is "
                    f"{self.square_colour(ix, iy)}; correct background or top_left_square"
                )

    @property
    def corners_xy(self) -> tuple[int, int]:
        """Number of inner corners along x and y."""
        return self.squares[0] - 1, self.squares[1] - 1

    @property
    def n_corners(self) -> int:
        """Number of inner corners."""
        return self.corners_xy[0] * self.corners_xy[1]

    @property
    def corners_board(self) -> FloatArray:
        """Inner corners, row-major, shape (n_corners, 3), metres, z = 0."""
        nx, ny = self.corners_xy
        x, y = np.meshgrid(np.arange(nx) * self.square_m[0], np.arange(ny) * self.square_m[1])
        return np.stack([x.ravel(), y.ravel(), np.zeros(nx * ny)], axis=1)

    @property
    def marker_squares(self) -> IntArray:
        """Squares of the discs, shape (n_markers, 2)."""
        squares = [marker.square for marker in self.markers]
        return np.array(squares, dtype=np.int64).reshape(-1, 2)

    @property
    def marker_centres_board(self) -> FloatArray:
        """Disc centres, shape (n_markers, 3), metres, z = 0."""
        centres = (self.marker_squares - 0.5) * np.array(self.square_m)
        return np.concatenate([centres, np.zeros((len(centres), 1))], axis=1)

    @property
    def marker_xyz_d65(self) -> FloatArray:
        """Reference colours, shape (n_markers, 3), Y = 1 for the perfect diffuser."""
        return np.array([marker.xyz_d65 for marker in self.markers]).reshape(-1, 3)

    @property
    def black_squares(self) -> BoolArray:
        """Which squares are black, shape (squares_y, squares_x), indexed [iy, ix]."""
        ix, iy = np.meshgrid(np.arange(self.squares[0]), np.arange(self.squares[1]))
        return np.asarray(((ix + iy) % 2 == 0) == (self.top_left == "black"))

    @property
    def has_unique_orientation(self) -> bool:
        """Whether the squares alone tell the board from itself turned by half a turn."""
        return sum(self.corners_xy) % 2 == 1

    @property
    def symmetries(self) -> tuple[IntArray, ...]:
        """Permutations of the corner ids by turns that keep the colours of the squares.

        The first is the identity; discs are not looked at. Quarter turns count only where
        squares are square.
        """
        ids = np.arange(self.n_corners).reshape(self.corners_xy[1], self.corners_xy[0])
        found = []
        for quarters in range(4):
            corners = np.rot90(ids, quarters)
            squares = np.rot90(self.black_squares, quarters)
            fits = corners.shape == ids.shape and np.array_equal(squares, self.black_squares)
            if fits and (quarters % 2 == 0 or self.square_m[0] == self.square_m[1]):
                found.append(corners.ravel())
        return tuple(found)

    def square_colour(self, ix: int, iy: int) -> SquareColour:
        """Colour of square [ix, iy]."""
        # Not by `black_squares`: a file may hold thousands of discs, each asking for its square.
        same = (ix + iy) % 2 == 0
        return "black" if same == (self.top_left == "black") else "white"


def chessboard(corners_xy: tuple[int, int], square_m: tuple[float, float]) -> Target:
    """Return a plain board of NxM inner corners whose square [0, 0] is black."""
    return Target(squares=(corners_xy[0] + 1, corners_xy[1] + 1), square_m=square_m)
