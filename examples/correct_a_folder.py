"""Correct all pictures of a folder: equal colours, no lens distortion.

    python examples/correct_a_folder.py RIG.json RECORDING OUTPUT

Without arguments a simulated stereo pair is calibrated and corrected in a temporary folder.
"""

import sys
import tempfile
from pathlib import Path

import calichrome as cc
from calichrome.apply import FrameFormat, undistorting_map
from calichrome.imaging import Unreadable, write_picture


def correct_folder(rig: cc.Rig, folder: Path, output: Path) -> int:
    """Write OUTPUT/<camera>/<frame>.png for every picture; return how many."""
    recording = cc.open_recording(folder)
    written = 0
    for camera_id, frames in recording.files.items():
        camera = rig.cameras[camera_id]
        source_map = undistorting_map(camera.lens, camera.size_wh)
        correctors: dict[FrameFormat, cc.Corrector] = {}  # compiled once for each kind of file
        for frame_id in frames:
            image = recording.read(camera_id, frame_id)
            if isinstance(image, Unreadable):
                print(f"{camera_id}/{frame_id}: {image.reason}")
                continue
            frames_are = FrameFormat.of(image)
            if frames_are not in correctors:
                correctors[frames_are] = cc.Corrector(camera, "srgb", source_map, frames=frames_are)
            corrected = correctors[frames_are].apply(image.pixels)
            write_picture(output / camera_id / f"{frame_id}.png", corrected)
            written += 1
    return written


def main() -> None:
    """Correct what the command line names, or a simulation."""
    if len(sys.argv) == 4:
        rig_path, recording, output = map(Path, sys.argv[1:])
        print(f"{correct_folder(cc.load_rig(rig_path), recording, output)} pictures in {output}")
        return
    from simulated import stereo_rig

    with tempfile.TemporaryDirectory() as name:
        rig, recording = stereo_rig(Path(name))
        print(f"{correct_folder(rig, recording, Path(name) / 'corrected')} pictures corrected")


if __name__ == "__main__":
    main()
