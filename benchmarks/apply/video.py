"""Two videos corrected end to end by the command, on the machine as it is.

The sources are made here: a textured scene that moves, with the noise of a sensor, so that decoding
and encoding cost what they cost with a camera's videos. Correction is everything at once: lens,
fall-off, root-polynomial colours.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.colour.families import fit_model
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import UInt8Array
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import BT709, StreamFormat, VideoSettings, VideoWriter
from calichrome.rig import Camera, CameraColour, Rig, save_rig
from calichrome.target import chessboard

_SIZE_WH = (1920, 1080)
_FPS = 30
_N_SCENES = 24  # frames that differ; further apart than x264 looks back
_NOISE = 4.0  # sigma in levels of 255: a camera indoors
_SHIFT_PX = 3  # per frame
_BARS_FPS = {"veryfast": 12.0, "ultrafast": 22.0}
_BAR_CORRECT_MS = 25.0
_BAR_MEMORY_MB = 1024.0
_CAMERAS = ("left", "right")


def main() -> None:
    """Make the sources if they are missing, correct them with each preset, print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120, help="length of each video")
    parser.add_argument("--presets", default=",".join(_BARS_FPS))
    parser.add_argument("--folder", type=Path, help="keeps the sources for another run")
    arguments = parser.parse_args()
    n_frames = round(arguments.seconds * _FPS)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        recording = folder / f"recording-{n_frames}"
        _make_recording(recording, n_frames)
        save_rig(_rig(), None, folder / "rig.json", force=True)
        print(f"2 videos of {n_frames} frames, {_SIZE_WH[0]}x{_SIZE_WH[1]}, {os.cpu_count()} cores")
        for preset in arguments.presets.split(","):
            _run(folder, recording, preset)


def _run(folder: Path, recording: Path, preset: str) -> None:
    words = ["correct", str(folder / "rig.json"), str(recording), "-o", str(folder / "out")]
    options = ["--undistort", "--preset", preset, "--json", "--force"]
    command = [sys.executable, "-m", "calichrome.cli.main", *words, *options]
    load = os.getloadavg()[0]
    start = time.monotonic()
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603
    wall_s = time.monotonic() - start
    result = json.loads(done.stdout)
    videos = result["videos"].values()
    n_frames = sum(video["frames"] for video in videos)
    cpu_s = {
        what: sum(video["cpu_s"][what] for video in videos)
        for what in ("decode", "convert", "correct", "encode")
    }
    total_s = sum(cpu_s.values())
    # of the largest child so far, in kB: runs of all presets hold the same frames
    memory_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    per_camera = n_frames / len(videos) / wall_s
    correct_ms = cpu_s["correct"] / n_frames * 1e3
    shares = ", ".join(
        f"{what} {spent / total_s:.0%} ({spent / n_frames * 1e3:.1f} ms)"
        for what, spent in cpu_s.items()
    )
    bar = f" (bar {_BARS_FPS[preset]:g})" if preset in _BARS_FPS else ""
    print(f"{preset}, load before {load:.1f}, kernel {result['kernel']}")
    print(f"  frames/s per camera, end to end  {per_camera:.1f}{bar}")
    print(f"  frames/s of both together        {n_frames / wall_s:.1f}")
    print(f"  CPU time per frame               {total_s / n_frames * 1e3:.1f} ms: {shares}")
    print(f"  correct, CPU ms per frame        {correct_ms:.1f} (bar {_BAR_CORRECT_MS:g})")
    print(f"  peak memory, MB                  {memory_mb:.0f} (bar {_BAR_MEMORY_MB:g})")


def _make_recording(folder: Path, n_frames: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    form = StreamFormat(
        time_base=Fraction(1, _FPS), rate=Fraction(_FPS), primaries=1, transfer=1, matrix=BT709
    )
    for seed, name in enumerate(_CAMERAS):
        path = folder / f"{name}.mp4"
        if path.exists():
            continue
        scenes = _scenes(np.random.default_rng(seed))
        unfinished = path.with_suffix(".part")
        writer = VideoWriter(unfinished, _SIZE_WH, form, VideoSettings(crf=20))
        frames = [writer.frame(scene, 0) for scene in scenes]
        for stamp in range(n_frames):
            frame = frames[stamp % _N_SCENES]
            frame.pts = stamp
            writer.write(frame)
        writer.close()
        unfinished.rename(path)


def _scenes(rng: np.random.Generator) -> list[UInt8Array]:
    """Draw a plane with texture at all scales, moved sideways, each time with its own noise."""
    width, height = _SIZE_WH
    wide = width + _N_SCENES * _SHIFT_PX
    plane = np.full((height, wide, 3), 110, np.float32)
    for cells in (6, 24, 96, 384, 960):
        shape = cells * height // wide + 1, cells
        detail = rng.normal(0, 1, (*shape, 1)) + 0.3 * rng.normal(0, 1, (*shape, 3))
        detail *= 40 / cells**0.4
        plane += cv2.resize(
            detail.astype(np.float32), (wide, height), interpolation=cv2.INTER_CUBIC
        )
    return [
        np.clip(
            plane[:, _SHIFT_PX * index : _SHIFT_PX * index + width]
            + _NOISE * rng.standard_normal((height, width, 3), dtype=np.float32),
            0,
            255,
        ).astype(np.uint8)
        for index in range(_N_SCENES)
    ]


def _rig() -> Rig:
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0.05, 0.9, (24, 1)) * rng.uniform(0.4, 1, (24, 3)) * D65
    xyz = np.concatenate([xyz, np.geomspace(0.03, 0.9, 6)[:, None] * D65])
    mixed = np.array([[1.3, -0.2, -0.1], [-0.2, 1.3, -0.1], [0.0, -0.1, 1.1]])
    rgb = np.maximum(xyz / D65 @ mixed.T, 0.01)
    white_rgb = np.array([0.7, 0.8, 0.65])
    pairs = ColourPairs.of(rgb / rgb[-1] * white_rgb, xyz, white_rgb=white_rgb, white_xyz=D65)
    lens = BrownConrady(fx=1500, fy=1500, cx=955, cy=545, k1=-0.28, k2=0.09, p1=1e-3, p2=-5e-4)
    camera = Camera(
        size_wh=_SIZE_WH,
        lens=lens,
        lens_sigma=dict.fromkeys(lens.NAMES),
        cam_from_ref=Pose.identity(),
        sigma_rad=None,
        sigma_m=None,
        n_views=12,
        n_corners=600,
        rms_px=0.1,
        colour=CameraColour(
            model=fit_model("root-polynomial-2", pairs),
            encoding="rec709",
            white_rgb=white_rgb,
            delta_e_2000={"fit_mean": 1.0, "held_out_mean": 1.0, "held_out_p95": 1.0},
        ),
        vignetting=Vignetting(
            centre_px=np.array([955.0, 545.0]),
            half_diagonal_px=float(np.hypot(*_SIZE_WH) / 2),
            coefficients=np.tile([-0.4, -0.1, 0.02, 0.01, -0.01], (3, 1)),
            covariance=np.zeros((3, 5, 5)),
            covered_radius=0.9,
        ),
    )
    right = replace(camera, cam_from_ref=Pose(np.eye(3), np.array([-0.1, 0, 0])))
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera=_CAMERAS[0],
        cameras=dict(zip(_CAMERAS, (camera, right), strict=True)),
        pairs=(),
        frames={},
    )


if __name__ == "__main__":
    main()
