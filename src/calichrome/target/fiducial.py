"""Boards whose corners are named by printed codes: ChArUco boards and AprilGrids.

Both are chessboards: a ChArUco board has codes in its white squares; an AprilGrid with its black
corner squares is a chessboard whose rows and columns are wide (tags) and narrow (gaps) in turn. So
both are a `Target`, with corners that count row by row, and no colours. Since every code has a
number, a part of such a board is as good as the whole, and no turn of it looks the same.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.errors import TargetError
from calichrome.target.board import Target

__all__ = [
    "APRILTAG_FAMILIES",
    "ARUCO_DICTIONARIES",
    "AprilGridTarget",
    "CharucoTarget",
    "CodedTarget",
    "april_grid",
    "charuco_board",
]

APRILTAG_FAMILIES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"16h5": (4, 30), "25h9": (5, 35), "36h10": (6, 2320), "36h11": (6, 587)}
)
"""Family -> data bits along a side, number of codes; the second number of the name is the least
Hamming distance."""

ARUCO_DICTIONARIES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {f"{n}X{n}_{count}": (n, count) for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)}
    | {"ARUCO_ORIGINAL": (5, 1024), "ARUCO_MIP_36h12": (6, 250)}
    | {f"APRILTAG_{family}": size for family, size in APRILTAG_FAMILIES.items()}
)
"""OpenCV's predefined dictionaries, without DICT_ -> data bits along a side, number of codes."""

_KALIBR_BORDER = 2
"""Black bits around the data of a tag, as kalibr prints it (`kalibr_create_target_pdf`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CodedTarget(Target):
    """A chessboard whose corners are named by codes; see `CharucoTarget`, `AprilGridTarget`.

    Parameters
    ----------
    dictionary
        A key of `ARUCO_DICTIONARIES`.
    inverted
        Whether black and white are exchanged on the print.
    """

    dictionary: str
    inverted: bool = False

    def __post_init__(self) -> None:
        Target.__post_init__(self)  # zero-argument super() does not know slotted classes
        if self.markers:
            raise TargetError("a board with codes has no colour discs; use a chessboard for them")
        if self.dictionary not in ARUCO_DICTIONARIES:
            known = ", ".join(ARUCO_DICTIONARIES)
            raise TargetError(f"dictionary {self.dictionary} is not known; there are {known}")
        n_known = ARUCO_DICTIONARIES[self.dictionary][1]
        n_codes = len(self.code_outlines(0))
        if n_codes > n_known:
            raise TargetError(
                f"the board needs {n_codes} codes, {self.dictionary} has {n_known}; correct the "
                f"counts or the dictionary"
            )

    @property
    def has_unique_orientation(self) -> bool:
        """Codes tell which way up the board is."""
        return True

    @property
    def symmetries(self) -> tuple[IntArray, ...]:
        """Only the identity: codes tell all turns apart."""
        return (np.arange(self.n_corners),)

    @property
    def border_bits(self) -> int:
        """Width of the black border of a code, in bits."""
        raise NotImplementedError

    @property
    def n_layouts(self) -> int:
        """In how many ways the codes may stand on the board; the picture decides."""
        raise NotImplementedError

    def code_outlines(self, layout: int) -> FloatArray:
        """Corners of all codes in the board frame, shape (n_codes, 4, 2), metres.

        In the order in which a reader that holds the code upright sees them: top left, top right,
        bottom right, bottom left.
        """
        raise NotImplementedError

    def begins_black(self, layout: int) -> bool:
        """Whether square [0, 0] is black, before an inversion."""
        raise NotImplementedError

    @property
    def reach_m(self) -> float:
        """How far a corner of the board is from the nearest corners of its codes, metres."""
        raise NotImplementedError

    @property
    def clearance_m(self) -> float:
        """Half-width of the largest square around a corner that shows the corner alone, metres."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoTarget(CodedTarget):
    """A chessboard with an ArUco code in every white square, as OpenCV prints it.

    Parameters
    ----------
    marker_share
        Side of a code over side of a square.
    legacy
        True: the board begins with a white square where its rows are even in number, as OpenCV
        printed it before 4.6; False: with a black one; None: the pictures decide. Boards with an
        odd number of rows are the same in both.
    """

    marker_share: float
    legacy: bool | None = None

    def __post_init__(self) -> None:
        if not 0 < self.marker_share < 1:
            raise TargetError(
                f"codes of {self.marker_share:.3g} times the side of a square do not fit into it; "
                f"correct the size of the square or of the marker"
            )
        CodedTarget.__post_init__(self)

    @property
    def border_bits(self) -> int:
        """One, as OpenCV prints it."""
        return 1

    @property
    def n_layouts(self) -> int:
        """Two, where it is not known which of OpenCV's layouts was printed."""
        return 2 if self.legacy is None and self.squares[1] % 2 == 0 else 1

    def code_outlines(self, layout: int) -> FloatArray:
        """Return the corners of the codes; layout 1 is the one before OpenCV 4.6."""
        parity = np.add.outer(*map(np.arange, self.squares[::-1])) % 2
        iy, ix = np.nonzero(parity == int(self.begins_black(layout)))
        centres = np.stack([ix, iy], axis=1) - 0.5
        return np.asarray((centres[:, None] + _UPRIGHT * self.marker_share) * self.square_m)

    def begins_black(self, layout: int) -> bool:
        """Return False for an even number of rows in the layout before OpenCV 4.6."""
        is_legacy = layout == 1 if self.legacy is None else self.legacy
        return not (is_legacy and self.squares[1] % 2 == 0)

    @property
    def reach_m(self) -> float:
        """Along the diagonal of the margin between square and code."""
        return 0.5 * (1 - self.marker_share) * math.hypot(*self.square_m)

    @property
    def clearance_m(self) -> float:
        """The margin between square and code."""
        return 0.5 * (1 - self.marker_share) * min(self.square_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class AprilGridTarget(CodedTarget):
    """Kalibr's AprilGrid: tags with black squares where the corners of four meet.

    Tag [0, 0] of kalibr is at the lower left, tags count along rows, upwards; here corners count
    as on every board, from the upper left downwards. `squares` counts the wide and the narrow
    columns: 2 n + 1 for n tags. `square_m` is the size of a tag.

    Parameters
    ----------
    spacing
        Gap between two tags over the size of a tag.

    References
    ----------
    .. [1] J. Maye, P. Furgale, R. Siegwart, "Self-supervised calibration for robotic systems",
       IV 2013; the board of https://github.com/ethz-asl/kalibr, "Calibration targets".
    """

    spacing: float

    def __post_init__(self) -> None:
        if not 0 < self.spacing <= 1:
            raise TargetError(
                f"a spacing of {self.spacing:g} is not possible: it is the gap between two tags "
                f"over the size of a tag, like 0.3"
            )
        if not all(count % 2 for count in self.squares):
            raise TargetError(
                f"an AprilGrid has 2 n + 1 columns and rows, not {self.squares}; correct squares"
            )
        CodedTarget.__post_init__(self)

    @property
    def tags_xy(self) -> tuple[int, int]:
        """Number of tags along x and y."""
        return self.squares[0] // 2, self.squares[1] // 2

    @property
    def corners_board(self) -> FloatArray:
        """Corners of the tags, row-major, shape (n_corners, 3), metres, z = 0."""
        lines = []
        for count, size in zip(self.tags_xy, self.square_m, strict=True):
            starts = np.arange(count) * (1 + self.spacing) * size
            lines.append(np.stack([starts, starts + size], axis=1).ravel())
        x, y = np.meshgrid(*lines)
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)

    @property
    def border_bits(self) -> int:
        """Two, as kalibr prints it."""
        return _KALIBR_BORDER

    @property
    def n_layouts(self) -> int:
        """Four: printers turn the tags, all alike, and the picture tells how."""
        return 4

    def code_outlines(self, layout: int) -> FloatArray:
        """Return the corners of the tags, by number from the lower left; `layout` is their turn."""
        columns, rows = self.tags_xy
        grid = self.corners_board[:, :2].reshape(rows, 2, columns, 2, 2).transpose(0, 2, 1, 3, 4)
        top_left, top_right, bottom_left, bottom_right = grid[::-1].reshape(-1, 4, 2).swapaxes(0, 1)
        outlines = np.stack([top_left, top_right, bottom_right, bottom_left], axis=1)
        return np.roll(outlines, layout, axis=1)

    def begins_black(self, layout: int) -> bool:  # noqa: ARG002 (the same for all)
        """Kalibr's black squares stand at all corners of all tags."""
        return True

    @property
    def reach_m(self) -> float:
        """Nothing: the corners of the board are those of its tags."""
        return 0.0

    @property
    def clearance_m(self) -> float:
        """The border of a tag or the gap between two, whichever is narrower."""
        bits = ARUCO_DICTIONARIES[self.dictionary][0] + 2 * self.border_bits
        return min(self.border_bits / bits, self.spacing) * min(self.square_m)


_UPRIGHT = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def charuco_board(
    squares: tuple[int, int],
    dictionary: str,
    square_m: tuple[float, float],
    marker_m: float,
    *,
    inverted: bool = False,
    legacy: bool | None = None,
) -> CharucoTarget:
    """Return a ChArUco board.

    Parameters
    ----------
    squares
        Number of squares along x and y.
    dictionary
        A key of `ARUCO_DICTIONARIES`.
    square_m, marker_m
        Sides of a square and of a code, metres.
    inverted, legacy
        See `CharucoTarget`.
    """
    begins_white = bool(legacy) and squares[1] % 2 == 0
    return CharucoTarget(
        squares=squares,
        square_m=square_m,
        top_left="white" if begins_white != inverted else "black",
        dictionary=dictionary,
        marker_share=marker_m / min(square_m),
        inverted=inverted,
        legacy=legacy,
    )


def april_grid(
    tags_xy: tuple[int, int], family: str, tag_m: tuple[float, float], spacing: float
) -> AprilGridTarget:
    """Return kalibr's AprilGrid of `tags_xy` tags of size `tag_m`, `spacing` of it apart."""
    if family not in APRILTAG_FAMILIES:
        known = ", ".join(APRILTAG_FAMILIES)
        raise TargetError(f"AprilTag family {family} is not known; there are {known}")
    if min(tags_xy) < 2:
        raise TargetError(f"an AprilGrid of {tags_xy[0]}x{tags_xy[1]} tags: 2x2 is the smallest")
    return AprilGridTarget(
        squares=(2 * tags_xy[0] + 1, 2 * tags_xy[1] + 1),
        square_m=tag_m,
        dictionary=f"APRILTAG_{family}",
        spacing=spacing,
    )
