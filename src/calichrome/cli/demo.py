"""``calichrome demo``: a simulated rig, calibrated from its pictures and held against its truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from calichrome.apply import Corrector, FrameFormat, before_after_sheet, crop_around
from calichrome.cli.simulate import standard_target
from calichrome.cli.terminal import Command, Flag, Output
from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.files import check_folder, writing_folder
from calichrome.errors import RecordingError
from calichrome.imaging import Image, Recording, write_picture
from calichrome.pipeline.calibrate import CalibrationSettings, run
from calichrome.pipeline.rectify import rectify
from calichrome.report.text import summary, table, with_sigma
from calichrome.rig import Camera, Rig, rig_to_json, save_rig
from calichrome.synthetic import CameraTruth, Truth, demo_scene, read_truth, write_recording

__all__ = ["Demo"]

_PAIR = ("pair1-left", "pair1-right")


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Simulate a mixed rig, calibrate it, and compare with the truth."""

    output: Annotated[Path, Output] = Path("demo")
    """Folder for the recording, rig.json and pictures."""
    seed: int = 0
    """Another seed gives another rig."""
    force: Flag = False
    """Replace an existing output folder."""

    def run(self) -> int:
        """Render, calibrate, compare, and draw."""
        if self.seed < 0:
            raise RecordingError(f"--seed {self.seed}: give 0 or more")
        check_folder(self.output, force=self.force)
        with self.progress() as progress, writing_folder(self.output, force=self.force) as folder:
            scene = demo_scene(standard_target(), self.seed)
            write_recording(
                scene, folder / "recording", lambda done, total: progress("rendering", done, total)
            )
            # The print of the demo is exact, so its size may count as measured.
            settings = CalibrationSettings(square="30mm", reference_camera=_PAIR[0])
            done = run(folder / "recording", settings, progress=progress)
            assert done.recording is not None  # noqa: S101 (it was read from a folder)
            save_rig(done.rig, done.evidence, folder / "rig.json")
            truth = read_truth(folder / "recording" / "truth.json")
            sheet = _sheet(done.rig, done.recording)
            write_picture(folder / "before-after.png", sheet)
            rectify(
                done.rig,
                _PAIR,
                folder / "recording",
                folder / "rectified",
                sheet=folder / "rectified.png",
                progress=progress,
            )
        lines = table(
            ["camera", "", "estimated", "truth", "off by sigmas"],
            [row for name in done.rig.cameras for row in _rows(name, done.rig, truth)],
        )
        lines += ["", *_colour_lines(done.rig)]
        shown = "before-after.png, rectified.png and rig.json"
        text = "\n".join([summary(done.rig), "", *lines, "", f"Wrote {shown} in {self.output}/"])
        self.show(text, rig_to_json(done.rig))
        return 0 if done.rig.trustworthy else 3


def _rows(name: str, rig: Rig, truth: Truth) -> Iterator[list[str]]:
    camera, true = rig.cameras[name], truth.cameras[name]
    for parameter in ("fx", "fy", "cx", "cy", "k1"):
        value = float(getattr(camera.lens, parameter))
        wanted = float(getattr(true.lens, parameter))
        label = name if parameter == "fx" else ""
        yield _row(label, parameter, value, camera.lens_sigma[parameter], wanted)
    if name == rig.reference_camera:
        return
    reference = truth.cameras[rig.reference_camera]
    for axis, letter in enumerate("xyz"):
        sigma = None if camera.sigma_m is None else float(camera.sigma_m[axis]) * 1e3
        value = float(camera.cam_from_ref.trans_m[axis]) * 1e3
        wanted = float(_true_cam_from_ref(true, reference)[axis]) * 1e3
        yield _row("", f"t{letter} mm", value, sigma, wanted)


def _true_cam_from_ref(true: CameraTruth, reference: CameraTruth) -> FloatArray:
    return (true.cam_from_world @ reference.cam_from_world.inverse()).trans_m


def _row(label: str, parameter: str, value: float, sigma: float | None, wanted: float) -> list[str]:
    off = "-" if not sigma else f"{(value - wanted) / sigma:+.1f}"
    digits = 2 if not sigma else max(0, 1 - int(np.floor(np.log10(sigma))))
    return [label, parameter, with_sigma(value, sigma), f"{wanted:.{digits}f}", off]


def _colour_lines(rig: Rig) -> Iterator[str]:
    """Yield how well the corrected discs of each camera meet the true colours."""
    between = rig.inter_camera_delta_e_2000
    if between is not None:
        yield f"Colour between cameras: {between['mean']:.2f} dE2000 (truth: 0)"
    errors = ", ".join(
        f"{name} {camera.colour.delta_e_2000['fit_mean']:.2f}"
        for name, camera in rig.cameras.items()
        if camera.colour is not None
    )
    yield f"Colour against the {len(rig.target.markers)} discs, dE2000: {errors}"


def _sheet(rig: Rig, recording: Recording) -> UInt8Array:
    """Show the board in all cameras in one frame, as recorded and corrected."""
    frame_id = next(
        (frame for frame, placed in rig.frames.items() if len(placed.cameras) == len(rig.cameras)),
        max(rig.frames, key=lambda frame: len(rig.frames[frame].cameras)),
    )
    columns = []
    for name in rig.frames[frame_id].cameras:
        camera = rig.cameras[name]
        image = recording.read(name, frame_id)
        assert isinstance(image, Image)  # noqa: S101 (it was read during calibration)
        before = np.rint(encode(image.linear(), "srgb") * 255).astype(np.uint8)
        after = Corrector(camera, frames=FrameFormat.of(image)).apply(image.pixels)
        after8 = (after // 257).astype(np.uint8) if after.dtype == np.uint16 else after
        corners = _corners_px(rig, camera, frame_id)
        columns.append(
            (name, crop_around(before, corners), crop_around(after8.astype(np.uint8), corners))
        )
    return before_after_sheet(columns)


def _corners_px(rig: Rig, camera: Camera, frame_id: str) -> FloatArray:
    ref_from_board = rig.frames[frame_id].ref_from_board
    return camera.project(ref_from_board.apply(rig.target.corners_board))
