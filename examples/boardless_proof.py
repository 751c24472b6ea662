"""Do two cameras agree about your own scene? Match its pixels, compare their colours.

    python examples/boardless_proof.py [RIG.json LEFT RIGHT LEFT_PICTURE RIGHT_PICTURE]

The scene needs no board. Both pictures are rectified and matched; CIEDE2000 between matched pixels
is printed before and after the correction. Without arguments a simulated scene is used, and the
stereo pair opencv_aloe of the test data, which has no calibration: only its matching is shown.
"""

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from stereo_depth import depth_range_px, disparities, read_rectified

import calichrome as cc
from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz
from calichrome.colorimetry.encoding import linearise
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.pose import Pose

BLUR_PX = 2.0  # noise and a mismatch of a pixel are not what is asked for
SRGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)  # IEC 61966-2-1


def matched_difference(left: UInt8Array, right: UInt8Array, disparity_px: FloatArray) -> FloatArray:
    """Return CIEDE2000 between matched pixels of rectified sRGB pictures, (n,)."""
    y, x = np.nonzero(np.isfinite(disparity_px))
    other = np.round(x - disparity_px[y, x]).astype(int)
    inside = (other >= 0) & (other < left.shape[1])
    y, x, other = y[inside], x[inside], other[inside]
    told = left[y, x].any(axis=1) & right[y, other].any(axis=1)  # black: beyond a picture's edge
    labs = [
        lab_from_xyz(linearise(soft[y[told], column[told]] / 255.0, "srgb") @ SRGB_TO_XYZ.T)
        for soft, column in (
            (cv2.GaussianBlur(left, (0, 0), BLUR_PX), x),
            (cv2.GaussianBlur(right, (0, 0), BLUR_PX), other),
        )
    ]
    return delta_e_2000(*labs)


def prove(rig: cc.Rig, cameras: tuple[str, str], paths: tuple[Path, Path]) -> None:
    """Print the difference of matched pixels, before and after the correction."""
    pair, left, right = read_rectified(rig, cameras, paths)
    _, raw_left, raw_right = read_rectified(rig, cameras, paths, "none")
    board_m = np.median([placed.ref_from_board.trans_m[2] for placed in rig.frames.values()])
    disparity_px = disparities(left, right, *depth_range_px(pair, board_m / 2, 6 * board_m))
    for when, pictures in (("before", (raw_left, raw_right)), ("after", (left, right))):
        difference = matched_difference(*pictures, disparity_px)
        print(f"{when}: {np.median(difference):.2f} dE2000 (median of {len(difference)} pixels)")


def show_aloe(folder: Path) -> None:
    """Match a pair that is rectified already, and of which no calibration is known."""
    paths = [folder / "opencv_aloe" / name for name in ("aloeL.jpg", "aloeR.jpg")]
    if not all(path.is_file() for path in paths):
        print(f"opencv_aloe: not in {folder}, left out; set CALICHROME_DATA")
        return
    left, right = (
        cv2.cvtColor(cv2.pyrDown(cv2.imread(str(path))), cv2.COLOR_BGR2RGB) for path in paths
    )
    difference = matched_difference(left, right, disparities(left, right, 128, 8))
    print(f"opencv_aloe, as it is: {np.median(difference):.2f} dE2000 ({len(difference)} pixels)")


def simulate(folder: Path) -> tuple[cc.Rig, tuple[str, str], tuple[Path, Path]]:
    """Calibrate a simulated pair, then take the board away."""
    from simulated import STEREO, stereo_rig, stereo_scene

    from calichrome.imaging import write_picture
    from calichrome.synthetic import Renderer, picture

    rig, _ = stereo_rig(folder)
    behind = Pose(np.eye(3), np.array([0, 0, -50.0]))
    scene = replace(stereo_scene(), world_from_board={"scene": behind})
    renderer = Renderer(scene)
    paths = (folder / "left.png", folder / "right.png")
    for camera_id, path in zip(STEREO, paths, strict=True):
        write_picture(path, picture(renderer, camera_id, "scene"))
    return rig, STEREO, paths


def main() -> None:
    """Prove it on what the command line names, or on a simulation."""
    if len(sys.argv) == 6:
        rig, cameras = cc.load_rig(Path(sys.argv[1])), (sys.argv[2], sys.argv[3])
        prove(rig, cameras, (Path(sys.argv[4]), Path(sys.argv[5])))
        return
    with tempfile.TemporaryDirectory() as name:
        prove(*simulate(Path(name)))
    show_aloe(Path(os.environ.get("CALICHROME_DATA", "../shared/data")))


if __name__ == "__main__":
    main()
