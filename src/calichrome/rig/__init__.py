"""The result: a rig in memory, as rig.json, and its evidence as rig.npz."""

from calichrome.rig.evidence import CameraCovariance, Evidence, load_evidence
from calichrome.rig.file import FORMAT_VERSION, load_rig, rig_to_json, save_rig
from calichrome.rig.model import BoardWarp, Camera, CameraColour, Pair, PlacedFrame, Rig

__all__ = [
    "FORMAT_VERSION",
    "BoardWarp",
    "Camera",
    "CameraColour",
    "CameraCovariance",
    "Evidence",
    "Pair",
    "PlacedFrame",
    "Rig",
    "load_evidence",
    "load_rig",
    "rig_to_json",
    "save_rig",
]
