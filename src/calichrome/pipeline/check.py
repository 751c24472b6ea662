"""A rig against new pictures of its board."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.errors import DetectionError, RecordingError
from calichrome.imaging import MAX_MEGAPIXELS, Recording, Unreadable, open_recording
from calichrome.observations import Dataset
from calichrome.pipeline.detect import (
    DetectionSettings,
    Progress,
    detect_recording,
    find_target,
    silent,
)
from calichrome.pipeline.tone import read_again
from calichrome.rig import Evidence, Rig
from calichrome.rig.check import Check, check_dataset

__all__ = ["check_recording", "read_as_calibrated"]

_STORED: EncodingName = "srgb"  # as what files are read before a curve of their own is applied


def check_recording(
    rig: Rig,
    evidence: Evidence | None,
    folder: Path,
    *,
    target: str | None = None,
    pattern: str | None = None,
    max_megapixels: float = MAX_MEGAPIXELS,
    detecting: DetectionSettings | None = None,
    progress: Progress = silent,
) -> Check:
    """Look for the board in new pictures, and compare.

    Parameters
    ----------
    rig, evidence
        The calibration.
    folder
        Pictures of the cameras, laid out as for `calibrate`; where every camera has one picture,
        its name does not matter.
    target
        Of the new pictures; default: that of the rig.
    pattern, max_megapixels, detecting, progress
        As for `calibrate`.

    Raises
    ------
    RecordingError
        If no camera of the rig is there, or its pictures have another size.
    DetectionError
        If none of them shows the board.
    """
    recording = open_recording(
        folder, pattern=pattern, max_megapixels=max_megapixels, synchronous=False
    )
    common = [camera for camera in rig.cameras if camera in recording.cameras]
    unknown = tuple(camera for camera in recording.cameras if camera not in rig.cameras)
    if not common:
        raise RecordingError(
            f"{folder}: has the cameras {', '.join(recording.cameras)}, the rig "
            f"{', '.join(rig.cameras)}; name folders or --pattern as in the calibration"
        )
    recording = replace(recording, files={camera: recording.files[camera] for camera in common})
    _check_sizes(rig, recording)
    recording = read_as_calibrated(rig, recording)
    board = rig.target if target is None else find_target(recording, target, None)
    if board.corners_xy != rig.target.corners_xy:
        raise RecordingError(
            f"the rig was calibrated with a board of {_by(rig.target.corners_xy)} corners; check "
            f"it with the same board, not one of {_by(board.corners_xy)}"
        )
    detection = detect_recording(recording, board, settings=detecting, progress=progress)
    dataset = _linearised(rig, recording, detection.dataset)
    if not any(dataset.views.values()):
        reasons = [reason for _, _, reason in detection.rejected]
        why = max(set(reasons), key=reasons.count)
        raise DetectionError(f"{folder}: no picture shows the board (most often: {why})")
    if all(len(recording.files[camera]) == 1 for camera in common):
        dataset = dataset.with_views(
            {
                camera: dict.fromkeys(["the picture"], *own.values()) if own else {}
                for camera, own in dataset.views.items()
            }
        )
    checked = check_dataset(rig, evidence, dataset, board)
    return replace(checked, unknown=unknown)


def _by(numbers: Sequence[int]) -> str:
    return "x".join(map(str, numbers))


def read_as_calibrated(rig: Rig, recording: Recording) -> Recording:
    """Read pictures with the encoding of the rig where the new recording does not state one."""
    entries = dict(recording.settings.cameras)
    for camera in recording.cameras:
        colour, entry = rig.cameras[camera].colour, recording.entry(camera)
        if colour is None or entry.encoding not in {None, "unknown"}:
            continue
        name = _STORED if isinstance(colour.encoding, ToneCurve) else colour.encoding
        entries[camera] = entry.model_copy(
            update={"encoding": name, "bits": entry.bits or colour.bits}
        )
    return replace(recording, settings=recording.settings.model_copy(update={"cameras": entries}))


def _linearised(rig: Rig, recording: Recording, dataset: Dataset) -> Dataset:
    """Remove the estimated tone curves of the rig."""
    views = dict(dataset.views)
    for camera, own in views.items():
        colour = rig.cameras[camera].colour
        if colour is None or not isinstance(colour.encoding, ToneCurve):
            continue
        if recording.entry(camera).encoding == _STORED:
            views[camera] = {
                frame: replace(view, discs=read_again(view.discs, _STORED, colour.encoding))
                for frame, view in own.items()
            }
    return dataset.with_views(views)


def _check_sizes(rig: Rig, recording: Recording) -> None:
    for camera in recording.cameras:
        size_wh = recording.read_size(camera)
        if not isinstance(size_wh, Unreadable) and size_wh != rig.cameras[camera].size_wh:
            raise RecordingError(
                f"camera {camera}: its pictures have {_by(size_wh)} pixels, the rig was calibrated "
                f"at {_by(rig.cameras[camera].size_wh)}; a lens belongs to one size, so record at "
                f"that size or calibrate again"
            )
