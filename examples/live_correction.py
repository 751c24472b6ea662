"""Correct a live camera: one corrector, one output array, nothing allocated per frame.

    python examples/live_correction.py [RIG.json CAMERA]

The camera is synthetic, frames of noise in rotation; put `cv2.VideoCapture.read` in its place.
Without a rig a simulated one is calibrated first.
"""

import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import numpy as np

import calichrome as cc
from calichrome.apply import FrameFormat, undistorting_map
from calichrome.core.arrays import UInt8Array
from calichrome.rig import Camera

N_FRAMES = 100


def synthetic_camera(size_wh: tuple[int, int]) -> Iterator[UInt8Array]:
    """Yield frames in the order of channels that OpenCV gives: blue, green, red."""
    width, height = size_wh
    rng = np.random.default_rng(0)
    return cycle([rng.integers(0, 256, (height, width, 3), dtype=np.uint8) for _ in range(4)])


def correct_live(camera: Camera) -> None:
    """Correct frames as fast as they come, and say how fast that is."""
    corrector = cc.Corrector(
        camera,
        "srgb",
        undistorting_map(camera.lens, camera.size_wh),
        frames=FrameFormat(dtype="uint8", order="bgr"),
    )
    out = np.empty(corrector.output_shape, corrector.output_dtype)
    frames = islice(synthetic_camera(camera.size_wh), N_FRAMES)
    start, start_cpu = time.perf_counter(), time.process_time()
    for frame in frames:
        corrector.apply(frame, out)  # show or send `out` here
    wall_s, cpu_s = time.perf_counter() - start, time.process_time() - start_cpu
    print(
        f"{camera.size_wh[0]}x{camera.size_wh[1]}, {corrector.kernel} kernel: "
        f"{N_FRAMES / wall_s:.0f} fps, {1e3 * cpu_s / N_FRAMES:.1f} ms of CPU time per frame"
    )


def main() -> None:
    """Correct the camera of a rig, or a simulated one."""
    if len(sys.argv) == 3:
        correct_live(cc.load_rig(Path(sys.argv[1])).cameras[sys.argv[2]])
        return
    from simulated import STEREO, stereo_rig

    with tempfile.TemporaryDirectory() as name:
        rig, _ = stereo_rig(Path(name))
    correct_live(rig.cameras[STEREO[0]])


if __name__ == "__main__":
    main()
