"""What was seen, without pictures."""

from calichrome.observations.board_view import BoardView, DiscSamples, NotFound
from calichrome.observations.dataset import Dataset
from calichrome.observations.store import read_corners, write_observations

__all__ = [
    "BoardView",
    "Dataset",
    "DiscSamples",
    "NotFound",
    "read_corners",
    "write_observations",
]
