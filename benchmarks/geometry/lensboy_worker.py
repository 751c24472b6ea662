"""Runs in lensboy's own environment: python lensboy_worker.py GIVEN.npz MADE.npy.

Knows nothing of calichrome. A row of MADE is fx fy cx cy k1 k2 p1 p2 k3, nan where lensboy failed.
"""

import importlib
import sys

import numpy as np


def main(given: str, made: str) -> None:
    """Calibrate every recording of `given`."""
    lensboy = importlib.import_module("lensboy")
    importlib.import_module("lensboy._logging").disable_logs()
    with np.load(given) as data:
        corners, recordings, size_wh = data["corners"], data["pixels"], data["size_wh"]
    config = lensboy.OpenCVConfig(image_width=int(size_wh[0]), image_height=int(size_wh[1]))
    ids = np.arange(len(corners))
    rows: list[list[float]] = []
    for recording in recordings:
        frames = [lensboy.Frame(ids, pixels) for pixels in recording]
        try:
            lens = lensboy.calibrate_camera(corners, frames, config).camera_model
        except (ValueError, RuntimeError):
            rows.append([float("nan")] * 9)
            continue
        rows.append([lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion_coeffs[:5]])
    np.save(made, np.array(rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
