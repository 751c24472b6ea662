"""Which part of the board a lattice of corners is, and which way up.

A board seen whole is told by the colours of its squares, and its discs confirm it. A part of a
board with discs is told by the discs alone: every place and turn is judged by how well the nominal
colours explain what is seen (`colour_match`), and one is taken only if nothing else comes near.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.colour_match import (
    BoardColours,
    board_colours,
    chance_likelihood,
    match_colours,
)
from calichrome.detection.square_looks import (
    CornerLattice,
    LatticeToPixels,
    SquareLooks,
    look_at_squares,
)
from calichrome.imaging import Image
from calichrome.target import Target

__all__ = [
    "Candidates",
    "Placement",
    "candidate_placements",
    "choose_by_colour",
    "identify",
    "no_order_fits",
]

_TURNS = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]])
"""From lattice axes to board axes, without mirror images."""

_MIRROR = np.array([[-1, 0], [0, 1]])

_FEWEST_SQUARES = 10
"""Squares from which `_USUAL_EVIDENCE` is enough: the 12 of the smallest part that layouts are made
for (`target.layout.WINDOW`), of which two may be covered."""

_FEWEST_DISCS = 4.5
"""Discs that must look as the placement says (sum of probabilities). Without it two of 46 800
simulated views were placed wrongly: two and three discs, and fingers that looked like more."""

_LEAST_LEAD_OF_MIRROR = 20.0
"""Log likelihood ratio at which mirror images are believed: 8 more than for a placement, since one
picture in some thousand is mirrored. Of 900 simulated views with 30 % of the squares covered one
reached 12."""

_LOOSE = 3.0
"""Factor on the errors of colours before a whole board is called another one. Simulated boards lead
chance by 14 or more even where the print is off by 14 per Lab axis; another layout trails it by 100
or more."""

_NO_CONTRAST = "black and white squares cannot be told apart here: add light, or stop glare"
_MIRRORED = (
    "the picture is mirrored; switch mirroring off in the camera, or flip the pictures before use"
)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where the corners of a lattice are on the board.

    Parameters
    ----------
    corner_ids : (N,) int
        Row-major ids, in the order of the lattice.
    half_turn_ambiguous
        True if the ids may be turned by half a turn: nothing in the picture decides.
    """

    corner_ids: IntArray
    half_turn_ambiguous: bool


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Places and turns at which all corners are inner corners and black squares fall on black.

    Parameters
    ----------
    turns : (P, 2, 2) int
        Lattice axes to board axes.
    offsets : (P, 2) int
        Corner (i, j) is the board's ``turns @ (i, j) + offsets``.
    mirrored : (P,) bool
        Only a mirrored picture can look like this.
    """

    turns: IntArray
    offsets: IntArray
    mirrored: BoolArray

    def __len__(self) -> int:
        return len(self.turns)

    def corner_ids(self, index: int, lattice: CornerLattice, target: Target) -> IntArray:
        """Return the ids of the lattice's corners in one placement, (N,)."""
        corners = lattice.indices @ self.turns[index].T + self.offsets[index]
        return np.asarray(corners @ [1, target.corners_xy[0]], dtype=np.int64)

    def squares(self, cells: IntArray, target: Target) -> IntArray:
        """Return the board's squares, row-major, that lattice squares would be, (P, S)."""
        # Twice the centre keeps whole numbers: the centre of a square lies at half corners.
        centres = np.einsum("pij,sj->psi", self.turns, 2 * cells + 1) + 2 * self.offsets[:, None]
        return np.asarray((centres + 1) // 2 @ [1, target.squares[0]], dtype=np.int64)


def identify(
    image: Image, lattice: CornerLattice, to_pixels: LatticeToPixels, target: Target
) -> Placement | str:
    """Tell which corners of the board a lattice holds.

    Parameters
    ----------
    image
        Colour or grey.
    lattice
        Corners of one board, black and white known.
    to_pixels
        Where points of the lattice are in the picture.
    target
        The board.

    Returns
    -------
    Placement or str
        The sentence says why the corners stay unidentified.
    """
    extent = lattice.indices.max(axis=0) + 1
    seen = _like_target(extent, target)
    if (np.sort(extent) > np.sort(target.corners_xy)).any():
        nx, ny = target.corners_xy
        return f"saw {seen} inner corners, expected {nx}x{ny}: count them and correct --target"
    candidates = candidate_placements(lattice, target)
    whole = sorted(extent.tolist()) == sorted(target.corners_xy) and _rims_show(lattice.indices)
    looks = None
    if target.markers:
        looks = look_at_squares(image, lattice, to_pixels, _smallest_radius(target))
    if whole:
        return _identify_whole(candidates, looks, lattice, to_pixels, target)
    if not target.markers:
        nx, ny = target.corners_xy
        return f"plain boards must be seen whole; saw {seen} of {nx}x{ny} corners"
    chosen = choose_by_colour(candidates, looks, target)
    if isinstance(chosen, str):
        return chosen
    ids = candidates.corner_ids(chosen, lattice, target)
    return Placement(ids, half_turn_ambiguous=False)


def candidate_placements(lattice: CornerLattice, target: Target) -> Candidates:
    """Return every placement, mirrored ones too, that the black squares allow."""
    last = np.array(target.corners_xy) - 1
    turns, offsets = [], []
    for turn in np.concatenate([_TURNS, _TURNS @ _MIRROR]):
        corners = lattice.indices @ turn.T
        low, high = -corners.min(axis=0), last - corners.max(axis=0)
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        shifts = np.stack([x.ravel(), y.ravel()], axis=1)
        offsets.append(shifts)
        turns.append(np.broadcast_to(turn, (len(shifts), 2, 2)))
    found = Candidates(
        turns=np.concatenate(turns),
        offsets=np.concatenate(offsets),
        mirrored=np.repeat([False, True], [sum(map(len, turns[:4])), sum(map(len, turns[4:]))]),
    )
    # One square tells: the others alternate, on the board as in the lattice.
    twice_centre = found.turns.sum(axis=2) + 2 * found.offsets  # of the lattice's square (0, 0)
    even = (twice_centre + 1).sum(axis=1) // 2 % 2 == 0
    black = even == (target.top_left == "black")
    fits = black == (lattice.black_parity == 0)
    return Candidates(found.turns[fits], found.offsets[fits], found.mirrored[fits])


def choose_by_colour(
    candidates: Candidates, looks: SquareLooks | None, target: Target
) -> int | str:
    """Return the placement that the discs single out, or why there is none.

    Notes
    -----
    A placement is taken if the log likelihood of the colours leads that of every other one and
    that of the same colours arranged at random by what `_Evidence` wants, if `_FEWEST_DISCS` look
    as it says, and if no mirrored placement explains the colours better.

    False accepts: none in 43 500 simulated views of 9 to 20 squares of three boards, so below 7e-5
    per view (95 %); half of them with prints off by 3 per Lab axis and 2 % of the squares covered,
    half with 3 to 6 and 12 %, all under three lights with two cameras, random channel mixing and
    a third overexposed. Of 18 600 views of another board none was placed. Accepted of the former
    half, with 4x3 squares and 6 discs: 0.986 to 0.993. tests/recovery holds a smaller version.
    """
    if looks is None:
        return _NO_CONTRAST
    verdict = _judge(candidates, looks, board_colours(target), target)
    if verdict.is_mirrored:
        return _MIRRORED
    if verdict.over_chance <= 0:
        return (
            f"the {len(looks)} squares in view look like no part of the board; is target.json that "
            f"of this board, and the encoding of the pictures right?"
        )
    if verdict.best is None or not verdict.is_clear:
        return (
            f"the {len(looks)} squares in view may be more than one part of the board; show more "
            f"of its colour discs"
        )
    return verdict.best


@dataclass(frozen=True, slots=True)
class _Evidence:
    """Least log likelihood ratios over other placements and over chance."""

    over_others: float
    over_chance: float


_USUAL_EVIDENCE = _Evidence(over_others=12.0, over_chance=9.0)
"""Wrong placements in simulated views of 12 squares that pass the one: with 6 discs or more in view
their lead was 5.3 at most (6000 views on rough prints, 12 % of the squares covered), with fewer
discs 14.5 (4500 views). Of 6000 views of another board one passed both, with four discs that
looked right. `_FEWEST_DISCS` stops these."""

_STRONG_EVIDENCE = _Evidence(over_others=18.0, over_chance=14.0)
"""Where fewer than `_FEWEST_SQUARES` show. Views of 6 and 9 squares of another board reached 15.6
and 16.0, not both at once (7200 views)."""


@dataclass(frozen=True, slots=True)
class _Verdict:
    """What the colours say: log likelihood ratios of the best placement.

    `over_others` are all other placements of this hand, `over_mirrored` those of the other one;
    infinite where there are none. `mirrored_over_chance` is that of the best mirrored placement.
    `n_discs` look as the best placement says, of `n_squares` that were looked at.
    """

    best: int | None
    over_chance: float
    over_others: float
    over_mirrored: float
    mirrored_over_chance: float
    n_discs: float
    n_squares: int

    @property
    def evidence(self) -> _Evidence:
        """What it takes to believe a placement."""
        return _USUAL_EVIDENCE if self.n_squares >= _FEWEST_SQUARES else _STRONG_EVIDENCE

    @property
    def is_clear(self) -> bool:
        return (
            self.best is not None
            and self.over_chance >= self.evidence.over_chance
            and self.over_others >= self.evidence.over_others
            and self.over_mirrored > 0
            and self.n_discs >= _FEWEST_DISCS
        )

    @property
    def is_mirrored(self) -> bool:
        return (
            self.mirrored_over_chance >= self.evidence.over_chance
            and self.over_mirrored <= -_LEAST_LEAD_OF_MIRROR
        )


def _judge(
    candidates: Candidates, looks: SquareLooks, colours: BoardColours, target: Target
) -> _Verdict:
    squares = candidates.squares(looks.cells, target)
    match = match_colours(looks, colours, squares)
    fit = match.log_likelihood
    chance = chance_likelihood(looks, colours, target.black_squares.ravel())
    right = np.flatnonzero(~candidates.mirrored)
    of_mirrored = float(fit[candidates.mirrored].max(initial=-np.inf))
    if not len(right):
        return _Verdict(None, -np.inf, np.inf, -np.inf, of_mirrored - chance, 0.0, len(looks))
    best = int(right[fit[right].argmax()])
    has_disc = np.zeros(target.squares[0] * target.squares[1])
    has_disc[target.marker_squares @ [1, target.squares[0]]] = 1
    of_others = float(fit[right[right != best]].max(initial=-np.inf))
    return _Verdict(
        best=best,
        over_chance=float(fit[best]) - chance,
        over_others=float(fit[best]) - of_others,
        over_mirrored=float(fit[best]) - of_mirrored,
        mirrored_over_chance=of_mirrored - chance,
        n_discs=float(match.inlier[best] @ has_disc[squares[best]]),
        n_squares=len(looks),
    )


def _identify_whole(  # noqa: PLR0911 (one return for each thing that may be said)
    candidates: Candidates,
    looks: SquareLooks | None,
    lattice: CornerLattice,
    to_pixels: LatticeToPixels,
    target: Target,
) -> Placement | str:
    """Parity decides; colours confirm, and decide where parity leaves several turns."""
    right = np.flatnonzero(~candidates.mirrored)
    if target.markers and looks is None:
        return _NO_CONTRAST
    if looks is not None and len(candidates):
        verdict = _judge(candidates, looks, board_colours(target), target)
        if verdict.is_mirrored:
            return _MIRRORED
        if verdict.is_clear and verdict.best is not None:
            ids = candidates.corner_ids(verdict.best, lattice, target)
            return Placement(ids, half_turn_ambiguous=False)
        # A poor print or a strange light is no other board: errors may be larger here.
        loose = _judge(candidates, looks, board_colours(target).looser(_LOOSE), target)
        if loose.best is not None and loose.over_chance <= -loose.evidence.over_others:
            return (
                f"all corners are there, but the colours of the {len(looks)} squares looked at are "
                f"not where the target has them; is target.json that of this board?"
            )
    if not len(right):
        return no_order_fits(target)
    if len(right) > 1 and (target.markers or len(lattice.indices) < target.n_corners):
        return (
            f"nothing tells which way up the board is ({len(lattice.indices)} of "
            f"{target.n_corners} corners show); one that looks the same after half a turn must be "
            f"seen whole, one with discs in colour"
        )
    # Of equal orders take the one that stands most upright: it reads like the printed sheet.
    upright = max(right, key=lambda at: _x_rightwards(int(at), candidates, lattice, to_pixels))
    ids = candidates.corner_ids(int(upright), lattice, target)
    return Placement(ids, half_turn_ambiguous=len(right) > 1)


def _rims_show(indices: IntArray) -> bool:
    """Tell whether the outer rows of a lattice are rows, not single points beside a cut board."""
    last = indices.max(axis=0)
    return all(
        2 * np.count_nonzero(indices[:, axis] == end) > last[1 - axis]
        for axis in (0, 1)
        for end in (0, last[axis])
    )


def _x_rightwards(
    index: int, candidates: Candidates, lattice: CornerLattice, to_pixels: LatticeToPixels
) -> float:
    """How far the board's x runs to the right in the picture, pixels per square."""
    middle = lattice.indices.mean(axis=0)
    along_x = candidates.turns[index].T @ [1.0, 0.0]
    ends: FloatArray = to_pixels(np.stack([middle, middle + along_x]))
    return float(ends[1, 0] - ends[0, 0])


def no_order_fits(target: Target) -> str:
    """Say what is wrong where the corners are all there and the colours of the squares are not."""
    nx, ny = target.corners_xy
    seen = "white" if target.top_left == "black" else "black"
    if nx % 2 == 1 and nx != ny:
        return (
            f"square [0,0] is {seen} in every order of {nx}x{ny} corners: if the board is right, "
            f"the target is {ny}x{nx} (its mirror image) or the picture is mirrored"
        )
    return (
        f"the corner squares are {seen}, the target has them {target.top_left}; use a target.json "
        f'with "top_left_square": "{seen}"'
    )


def _like_target(extent: IntArray, target: Target) -> str:
    """Write the size of a lattice with its long side where the target has it."""
    long, short = max(extent.tolist()), min(extent.tolist())
    nx, ny = target.corners_xy
    return f"{long}x{short}" if nx >= ny else f"{short}x{long}"


def _smallest_radius(target: Target) -> float:
    return min(marker.diameter_m for marker in target.markers) / 2 / max(target.square_m)
