"""Calibrate camera rigs in geometry and colour from one printed board and one recording.

The names below are the public ones; nothing heavy is imported before it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from calichrome._version import __version__

if TYPE_CHECKING:
    from calichrome.apply import Corrector
    from calichrome.core.pose import Pose
    from calichrome.detection import detect_board
    from calichrome.errors import CalichromeError
    from calichrome.imaging import Image, open_recording, read_image
    from calichrome.observations import BoardView, Dataset, NotFound
    from calichrome.pipeline.calibrate import CalibrationSettings, calibrate, calibrate_dataset
    from calichrome.rig import Rig, load_rig, save_rig
    from calichrome.target import Target, chessboard, load_target

_HOMES = {
    "BoardView": "calichrome.observations",
    "CalibrationSettings": "calichrome.pipeline.calibrate",
    "CalichromeError": "calichrome.errors",
    "Corrector": "calichrome.apply",
    "Dataset": "calichrome.observations",
    "Image": "calichrome.imaging",
    "NotFound": "calichrome.observations",
    "Pose": "calichrome.core.pose",
    "Rig": "calichrome.rig",
    "Target": "calichrome.target",
    "calibrate": "calichrome.pipeline.calibrate",
    "calibrate_dataset": "calichrome.pipeline.calibrate",
    "chessboard": "calichrome.target",
    "detect_board": "calichrome.detection",
    "load_rig": "calichrome.rig",
    "load_target": "calichrome.target",
    "open_recording": "calichrome.imaging",
    "read_image": "calichrome.imaging",
    "save_rig": "calichrome.rig",
}

__all__ = [
    "BoardView",
    "CalibrationSettings",
    "CalichromeError",
    "Corrector",
    "Dataset",
    "Image",
    "NotFound",
    "Pose",
    "Rig",
    "Target",
    "__version__",
    "calibrate",
    "calibrate_dataset",
    "chessboard",
    "detect_board",
    "load_rig",
    "load_target",
    "open_recording",
    "read_image",
    "save_rig",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
