"""Recordings with known truth, for tests and demonstrations; nothing that solves may import it."""

from calichrome.synthetic.camera import SyntheticCamera
from calichrome.synthetic.exposure import exposed
from calichrome.synthetic.poses import PoseRules, hold_board
from calichrome.synthetic.recording import picture, write_recording
from calichrome.synthetic.render import Renderer, render_frame
from calichrome.synthetic.scene import (
    Ambient,
    Light,
    Panel,
    Scene,
    SceneCamera,
    SceneError,
    SceneSensor,
)
from calichrome.synthetic.setups import SENSORS, demo_scene, random_scene
from calichrome.synthetic.truth import (
    CameraTruth,
    ImageTruth,
    Truth,
    read_truth,
    truth_of,
    write_truth,
)

__all__ = [
    "SENSORS",
    "Ambient",
    "CameraTruth",
    "ImageTruth",
    "Light",
    "Panel",
    "PoseRules",
    "Renderer",
    "Scene",
    "SceneCamera",
    "SceneError",
    "SceneSensor",
    "SyntheticCamera",
    "Truth",
    "demo_scene",
    "exposed",
    "hold_board",
    "picture",
    "random_scene",
    "read_truth",
    "render_frame",
    "truth_of",
    "write_recording",
    "write_truth",
]
