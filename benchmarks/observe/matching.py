"""Which track is which ball: assignment in each frame, and what changes over time.

A track and a ball belong together in a frame if they are assigned to each other by the smallest
sum of squared distances among those nearer than a gate. As in the CLEAR MOT measures, a pair of
the frame before stays together while it is inside the gate.
"""

from dataclasses import dataclass

import numpy as np
from benchmarks.observe.tables import Tracks
from scipy.optimize import linear_sum_assignment

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.synthetic.workspace import WorkspaceTruth

__all__ = ["Matching", "match"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matching:
    """Tracks held against the truth.

    Parameters
    ----------
    ball_of_row : (n,) int
        Of each row of tracks.csv; -1: no ball is near.
    visible : (n_frames, n_balls) bool
        Whether two cameras or more see at least half of the ball.
    track_of_ball : (n_frames, n_balls) int
        -1: none.
    """

    ball_of_row: IntArray
    visible: BoolArray
    track_of_ball: IntArray

    @property
    def n_swaps(self) -> int:
        """How often a track goes over from one ball to another."""
        swaps = 0
        for track in np.unique(self.track_of_ball[self.track_of_ball >= 0]):
            frames, balls = np.nonzero(self.track_of_ball == track)
            swaps += int((np.diff(balls[np.argsort(frames)]) != 0).sum())
        return swaps

    @property
    def n_fragments(self) -> int:
        """How many tracks there are of a ball beyond its first, summed over balls."""
        return sum(
            max(len(np.unique(column[column >= 0])) - 1, 0) for column in self.track_of_ball.T
        )

    @property
    def missed(self) -> float:
        """Share of visible balls without a track."""
        return float((self.track_of_ball[self.visible] < 0).mean())

    @property
    def n_false(self) -> int:
        """Rows of tracks that are near no ball."""
        return int((self.ball_of_row < 0).sum())


def match(tracks: Tracks, truth: WorkspaceTruth, positions_ref: FloatArray) -> Matching:
    """Assign tracks to balls.

    Parameters
    ----------
    positions_ref : (n_frames, n_balls, 3) float, metres
        True positions. The gate is each ball's diameter: nearer, two balls cannot be.
    """
    n_frames, n_balls = positions_ref.shape[:2]
    gates_m = 2 * np.array([ball.radius_m for ball in truth.balls])
    seen = np.stack([np.stack(list(ball.seen.values())) for ball in truth.balls], axis=-1)
    ball_of_row = np.full(len(tracks.frame), -1)
    track_of_ball = np.full((n_frames, n_balls), -1)
    previous = np.full(n_balls, -1)
    for frame in range(n_frames):
        rows = np.flatnonzero(tracks.frame == frame)
        apart = np.linalg.norm(tracks.positions_ref[rows, None] - positions_ref[frame], axis=-1)
        cost = np.where(apart <= gates_m, (apart / gates_m) ** 2, 10.0)
        # A pair of before costs less than any new one.
        stays = (tracks.track[rows, None] == previous) & (apart <= gates_m)
        cost -= 2.0 * stays
        for row, ball in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, ball] < 5:
                ball_of_row[rows[row]] = ball
                track_of_ball[frame, ball] = tracks.track[rows[row]]
        found = track_of_ball[frame]
        previous = np.where(found >= 0, found, previous)
    return Matching(
        ball_of_row=ball_of_row,
        visible=(seen >= 0.5).sum(axis=0) >= 2,
        track_of_ball=track_of_ball,
    )
