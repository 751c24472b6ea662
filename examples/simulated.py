"""What the examples run on if they are given no data: rendered recordings and their rigs."""

from dataclasses import replace
from pathlib import Path

import calichrome as cc
from calichrome.pipeline.calibrate import CalibrationSettings, run
from calichrome.rig import save_rig
from calichrome.synthetic import Scene, demo_scene, exposed, write_recording
from calichrome.target import colour_checker_palette, design_target

STEREO = ("pair1-left", "pair1-right")


def stereo_scene() -> Scene:
    """Return two cameras side by side, with different sensors and white balances."""
    board = design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=colour_checker_palette())
    scene = demo_scene(board, n_frames=8)
    left, right = (scene.camera(camera_id) for camera_id in STEREO)
    other = scene.camera("pair2-left")
    right = replace(right, sensor=other.sensor, white_balance=(1.1, 1.0, 0.9))
    # Both cameras set their exposure and white balance anew.
    return exposed(replace(scene, cameras=(left, right)))


def calibrated(recording: Path, square: str = "30mm") -> Path:
    """Calibrate a recording; return rig.json beside it."""
    done = run(recording, CalibrationSettings(square=square))
    path = recording.parent / "rig.json"
    save_rig(done.rig, done.evidence, path)
    return path


def stereo_rig(folder: Path) -> tuple[cc.Rig, Path]:
    """Render and calibrate the stereo pair; return its rig and its recording."""
    recording = folder / "recording"
    write_recording(stereo_scene(), recording)
    return cc.load_rig(calibrated(recording)), recording
