"""The result: a rig in memory and as rig.json."""

from calichrome.rig.file import FORMAT_VERSION, load_rig, rig_to_json, save_rig
from calichrome.rig.model import Camera, CameraColour, Evidence, Pair, PlacedFrame, Rig

__all__ = [
    "FORMAT_VERSION",
    "Camera",
    "CameraColour",
    "Evidence",
    "Pair",
    "PlacedFrame",
    "Rig",
    "load_rig",
    "rig_to_json",
    "save_rig",
]
