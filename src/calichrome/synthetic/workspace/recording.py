"""A watched workspace on disk: the recording that calibrates its cameras and the one to observe."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calichrome.core.files import writing_folder
from calichrome.imaging.files import write_picture
from calichrome.synthetic.recording import recording_toml, write_recording
from calichrome.synthetic.workspace.render import WorkspaceRenderer
from calichrome.synthetic.workspace.scene import Workspace
from calichrome.synthetic.workspace.truth import workspace_truth, write_workspace_truth

__all__ = ["write_workspace", "write_workspace_recording"]

Progress = Callable[[str, int, int], None]


def write_workspace(workspace: Workspace, folder: Path, progress: Progress | None = None) -> None:
    """Write ``folder/calibration``, the cameras' views of the board, and ``folder/workspace``.

    Parameters
    ----------
    folder
        Must not exist, or be empty.
    progress
        Called with what is done, the number of pictures done and in all.

    Raises
    ------
    OutputError
        If the folder holds something or cannot be written.
    """
    with writing_folder(folder) as temporary:
        write_recording(
            workspace.scene,
            temporary / "calibration",
            None if progress is None else lambda done, total: progress("board", done, total),
        )
        write_workspace_recording(workspace, temporary / "workspace", progress)


def write_workspace_recording(
    workspace: Workspace,
    folder: Path,
    progress: Progress | None = None,
    *,
    jpeg_quality: int | None = None,
) -> None:
    """Render what the cameras see of the balls into ``folder/<camera>/<frame>.png``.

    Beside the pictures stand ``timestamps.csv``, ``recording.toml`` and ``truth.json``. The folder
    appears when all of it is there, or not at all.

    Parameters
    ----------
    folder
        Must not exist, or be empty.
    progress
        Called with what is done, the number of pictures done and in all.
    jpeg_quality
        Store JPEG of this quality, 0..100, instead of PNG.

    Raises
    ------
    OutputError
        If the folder holds something or cannot be written.
    """
    frames: list[tuple[str, int | None]] = [(name, None) for name in workspace.background_ids]
    frames += [(name, index) for index, name in enumerate(workspace.frame_ids)]
    cameras = workspace.scene.cameras
    suffix, quality = (".png", 95) if jpeg_quality is None else (".jpg", jpeg_quality)
    with writing_folder(folder) as temporary:
        seen = {}
        for number, camera in enumerate(cameras):
            renderer = WorkspaceRenderer(workspace)  # one camera's backdrop at a time is kept
            shares = np.zeros((workspace.n_frames, len(workspace.balls)))
            for done, (frame_id, index) in enumerate(frames):
                pixels, found = renderer.picture(camera.camera_id, frame_id, index)
                path = temporary / camera.camera_id / f"{frame_id}{suffix}"
                write_picture(path, pixels, jpeg_quality=quality)
                if index is not None:
                    shares[index] = found
                if progress is not None:
                    progress(
                        "workspace", number * len(frames) + done + 1, len(cameras) * len(frames)
                    )
            seen[camera.camera_id] = shares
        _write_times(workspace, temporary / "timestamps.csv")
        (temporary / "recording.toml").write_text(recording_toml(cameras), encoding="utf-8")
        write_workspace_truth(workspace_truth(workspace, seen), temporary / "truth.json")


def _write_times(workspace: Workspace, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["camera", "frame", "time_s"])
        for camera in workspace.scene.cameras:
            for frame_id, time_s in zip(workspace.frame_ids, workspace.times_s, strict=True):
                writer.writerow([camera.camera_id, frame_id, f"{time_s:.6f}"])
