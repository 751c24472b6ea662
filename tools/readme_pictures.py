"""Render the pictures of README.md into docs/images, from what the project simulates.

Run ``make demo`` first, and for the tracks::

    calichrome simulate --scene workspace -o demo/space
    calichrome calibrate demo/space/calibration --square 80mm -o demo/space/rig.json
    cd demo/space
    calichrome observe rig.json workspace -o tracks.csv --overlay overlay --plot tracks.png
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from calichrome.apply import crop_around, picture_grid
from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import UInt8Array
from calichrome.imaging import Image, Recording, open_recording, read_image, write_picture
from calichrome.rig import Rig, load_rig

ROOT = Path(__file__).resolve().parent.parent
CAMERA = "single"
QUALITY = 88


def main() -> int:
    """Write the four pictures."""
    demo, images = ROOT / "demo", ROOT / "docs" / "images"
    images.mkdir(parents=True, exist_ok=True)
    for name in ("before-after", "rectified"):
        sheet = read_image(demo / f"{name}.png")
        assert isinstance(sheet, Image)
        write_picture(images / f"{name}.jpg", sheet.pixels, jpeg_quality=QUALITY, force=True)
    recording, rig = open_recording(demo / "recording"), load_rig(demo / "rig.json")
    frames = list(recording.files[CAMERA])
    poses = [(f"pose {frame}", shown(recording, frame)) for frame in frames[:8]]
    write_picture(images / "poses.jpg", picture_grid(poses, 4), jpeg_quality=QUALITY, force=True)
    good = next(frame for frame, placed in rig.frames.items() if CAMERA in placed.cameras)
    picture = around_board(shown(recording, good), rig, good)
    part = 2 * picture.shape[0] // 3
    mistakes = [
        ("good", picture),
        ("moved while exposing", moved(picture)),
        ("overexposed: discs clipped", overexposed(recording, rig, good)),
        ("cut off by the border", picture[:part, :part]),
    ]
    write_picture(
        images / "mistakes.jpg", picture_grid(mistakes, 4), jpeg_quality=QUALITY, force=True
    )
    if (demo / "space" / "tracks.png").exists():
        tracks = tracks_sheet(demo / "space")
        write_picture(images / "tracks.jpg", tracks, jpeg_quality=QUALITY, force=True)
    print(f"wrote {', '.join(path.name for path in sorted(images.glob('*.jpg')))}")
    return 0


def tracks_sheet(space: Path) -> UInt8Array:
    """Put two cameras with boxes and tails beside the tracks in space."""
    plot = cv2.cvtColor(cv2.imread(str(space / "tracks.png")), cv2.COLOR_BGR2RGB)
    plot = plot[:, : 48 * plot.shape[1] // 100]  # the other half is the plan
    views = []
    for path in sorted((space / "overlay").glob("*.mp4"))[:2]:
        video = cv2.VideoCapture(str(path))
        video.set(cv2.CAP_PROP_POS_FRAMES, video.get(cv2.CAP_PROP_FRAME_COUNT) // 2)
        _, frame = video.read()
        height = plot.shape[0] // 2
        width = round(frame.shape[1] * height / frame.shape[0])
        small = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
        views.append(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))
    width = min(view.shape[1] for view in views)
    column = np.concatenate([view[:, :width] for view in views])
    return np.asarray(np.concatenate([column, plot[: len(column)]], axis=1), dtype=np.uint8)


def linear(recording: Recording, frame: str) -> Image:
    """Read a picture of the demo's single camera."""
    image = recording.read(CAMERA, frame)
    assert isinstance(image, Image)
    return image


def shown(recording: Recording, frame: str, gain: float = 1.0) -> UInt8Array:
    """Return a picture as a screen shows it."""
    values = np.clip(gain * linear(recording, frame).linear(), 0, 1)
    return np.rint(encode(values, "srgb") * 255).astype(np.uint8)


def around_board(picture: UInt8Array, rig: Rig, frame: str) -> UInt8Array:
    """Cut the board out."""
    corners = rig.frames[frame].ref_from_board.apply(rig.target.corners_board)
    return crop_around(picture, rig.cameras[CAMERA].project(corners), 0.2)


def moved(picture: UInt8Array) -> UInt8Array:
    """Smear a picture along 12 pixels."""
    kernel = np.eye(12) / 12
    return np.asarray(cv2.filter2D(picture, -1, kernel))


def overexposed(recording: Recording, rig: Rig, frame: str) -> UInt8Array:
    """Expose a picture four times as long."""
    return around_board(shown(recording, frame, 4.0), rig, frame)


if __name__ == "__main__":
    sys.exit(main())
