"""Metric depth from a calibrated pair: rectify, match (OpenCV's SGBM), write a coloured PLY.

    python examples/stereo_depth.py [RIG.json LEFT RIGHT LEFT_PICTURE RIGHT_PICTURE OUT.ply]

Without arguments a simulated pair is calibrated, and the depth of its board held against the truth.
"""

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

import calichrome as cc
from calichrome.apply import FrameFormat, OutputSpace, rectifying_map
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.files import writing_file
from calichrome.errors import RecordingError
from calichrome.geometry.rectification import Rectification, rectify_pair
from calichrome.imaging import Unreadable

BLOCK_PX = 5


def read_rectified(
    rig: cc.Rig, cameras: tuple[str, str], paths: tuple[Path, Path], space: OutputSpace = "srgb"
) -> tuple[Rectification, UInt8Array, UInt8Array]:
    """Return how the pair is rectified, and both pictures, (H, W, 3) RGB."""
    left, right = (rig.cameras[camera_id] for camera_id in cameras)
    b_from_a = right.cam_from_ref @ left.cam_from_ref.inverse()
    pair = rectify_pair(left.lens, right.lens, b_from_a, left.size_wh, right.size_wh)
    pictures = []
    for camera, side, path in ((left, pair.a, paths[0]), (right, pair.b, paths[1])):
        image = cc.read_image(path)
        if isinstance(image, Unreadable):
            raise RecordingError(f"{path}: {image.reason}")
        matrix = side.projection[:, :3]
        source_map = rectifying_map(camera.lens, side.rect_from_cam, matrix, pair.size_wh)
        corrector = cc.Corrector(camera, space, source_map, frames=FrameFormat.of(image))
        pictures.append(corrector.apply(image.pixels).astype(np.uint8, copy=False))
    return pair, pictures[0], pictures[1]


def disparities(
    left: UInt8Array, right: UInt8Array, nearest_px: float, farthest_px: float
) -> FloatArray:
    """Match rectified pictures of a left and a right camera; nan where nothing matches."""
    first = int(np.floor(farthest_px))
    count = 16 * int(np.ceil((nearest_px - first + 1) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=first,
        numDisparities=count,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (left, right)]
    found = matcher.compute(*grey) / 16.0
    return np.where(found < first, np.nan, found)


def cloud(pair: Rectification, disparity_px: FloatArray) -> FloatArray:
    """Points (H, W, 3) in the first rectified camera, metres; nan where nothing matched."""
    y, x = np.mgrid[: disparity_px.shape[0], : disparity_px.shape[1]]
    known = np.stack([x, y, disparity_px, np.ones_like(disparity_px)], axis=-1)
    points = known @ pair.disparity_to_depth.T
    return np.asarray(points[..., :3] / points[..., 3:])


def write_ply(path: Path, points: FloatArray, colours: UInt8Array) -> int:
    """Write the finite points with their sRGB colours; return how many."""
    told = np.isfinite(points).all(axis=-1)
    rows = np.empty(int(told.sum()), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = points[told], colours[told]
    names = [f"property float {axis}" for axis in "xyz"]
    names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *names]
    with writing_file(path, force=True) as temporary:
        temporary.write_bytes("\n".join([*head, "end_header\n"]).encode() + rows.tobytes())
    return len(rows)


def depth_range_px(pair: Rectification, nearest_m: float, farthest_m: float) -> tuple[float, float]:
    """Return the disparities of two depths."""
    scale = pair.focal_px * pair.baseline_m
    if scale <= 0:
        raise RecordingError("the first camera must be the left one; exchange the two")
    return scale / nearest_m, scale / farthest_m


def main() -> None:
    """Reconstruct what the command line names, or a simulation."""
    if len(sys.argv) == 7:
        rig, cameras = cc.load_rig(Path(sys.argv[1])), (sys.argv[2], sys.argv[3])
        paths, output = (Path(sys.argv[4]), Path(sys.argv[5])), Path(sys.argv[6])
        pair, left, right = read_rectified(rig, cameras, paths)
        nearest_px, farthest_px = depth_range_px(pair, 0.3, 10.0)
        points = cloud(pair, disparities(left, right, nearest_px, farthest_px))
        print(f"{write_ply(output, points, left)} points in {output}")
        return
    from simulated import STEREO, stereo_rig

    with tempfile.TemporaryDirectory() as name:
        rig, recording = stereo_rig(Path(name))
        frame_id, placed = next(item for item in rig.frames.items() if len(item[1].cameras) == 2)
        paths = (
            recording / STEREO[0] / f"{frame_id}.png",
            recording / STEREO[1] / f"{frame_id}.png",
        )
        pair, left, right = read_rectified(rig, STEREO, paths)
        middle_m = float(placed.ref_from_board.trans_m[2])
        points = cloud(
            pair, disparities(left, right, *depth_range_px(pair, middle_m / 2, 4 * middle_m))
        )
        n_points = write_ply(Path(name) / "scene.ply", points, left)
        error_mm = board_error_mm(rig, pair, points, frame_id)
        print(f"{n_points} points; those on the board are {error_mm:.1f} mm off its plane (median)")


def board_error_mm(rig: cc.Rig, pair: Rectification, points: FloatArray, frame_id: str) -> float:
    """Return the median distance of points from the board's plane, where the board is seen."""
    camera = rig.cameras["pair1-left"]
    rect_from_board = camera.cam_from_ref @ rig.frames[frame_id].ref_from_board
    corners = rect_from_board.apply(rig.target.corners_board) @ pair.a.rect_from_cam.T
    pixels = (corners / corners[:, 2:]) @ pair.a.projection[:, :3].T
    hull = cv2.convexHull(pixels[:, :2].astype(np.float32)).astype(np.int32)
    inside = np.zeros(points.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, hull, 1)
    normal = pair.a.rect_from_cam @ rect_from_board.rotation[:, 2]
    apart = (points[inside > 0] - corners[0]) @ normal
    return float(1e3 * np.nanmedian(np.abs(apart)))


if __name__ == "__main__":
    main()
