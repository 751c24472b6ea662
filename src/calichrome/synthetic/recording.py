"""A synthetic recording on disk: pictures, what a user would know, and the truth beside it."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calichrome.core.files import writing_folder
from calichrome.imaging.files import write_picture
from calichrome.synthetic.render import Renderer
from calichrome.synthetic.scene import Scene, SceneCamera, image_rng
from calichrome.synthetic.sensor import develop, stored
from calichrome.synthetic.truth import truth_of, write_truth
from calichrome.target import target_to_json

__all__ = ["picture", "recording_toml", "write_recording"]

_JPEG_QUALITY = 95

Progress = Callable[[int, int], None]


def picture(
    renderer: Renderer, camera_id: str, frame_id: str
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the numbers that a camera stores of one frame, (H, W, 3)."""
    scene = renderer.scene
    camera = scene.camera(camera_id)
    rng = image_rng(scene.seed, "noise", camera_id, frame_id)
    return stored(develop(renderer.electrons(camera_id, frame_id), camera, rng), camera)


def write_recording(scene: Scene, folder: Path, progress: Progress | None = None) -> None:
    """Render a scene into ``folder/<camera>/<frame>.png`` or ``.jpg``.

    Beside the pictures stand ``target.json`` and ``recording.toml``, which say what a user would
    know, and ``truth.json``. The folder appears when all of it is there, or not at all.

    Parameters
    ----------
    folder
        Must not exist, or be empty.
    progress
        Called with the number of pictures done and in all.

    Raises
    ------
    OutputError
        If the folder holds something or cannot be written.
    """
    total = len(scene.cameras) * len(scene.world_from_board)
    with writing_folder(folder) as temporary:
        renderer = Renderer(scene)
        done = 0
        for camera in scene.cameras:
            for frame_id in scene.world_from_board:
                name = f"{frame_id}{_suffix(scene, camera, frame_id)}"
                pixels = picture(renderer, camera.camera_id, frame_id)
                path = temporary / camera.camera_id / name
                write_picture(path, pixels, jpeg_quality=_JPEG_QUALITY)
                done += 1
                if progress is not None:
                    progress(done, total)
        described = json.dumps(target_to_json(scene.target), indent=1, ensure_ascii=False)
        (temporary / "target.json").write_text(described + "\n", encoding="utf-8")
        (temporary / "recording.toml").write_text(recording_toml(scene.cameras), encoding="utf-8")
        write_truth(truth_of(scene), temporary / "truth.json")


def _suffix(scene: Scene, camera: SceneCamera, frame_id: str) -> str:
    return ".jpg" if camera.bits == 8 and frame_id in scene.jpeg_frames else ".png"


def recording_toml(cameras: Iterable[SceneCamera]) -> str:
    """Return what a user would know of the cameras' files."""
    entries = [
        # json writes strings as TOML reads them
        f"[cameras.{json.dumps(camera.camera_id)}]\n"
        f"encoding = {json.dumps(camera.encoding)}\n"
        f"bits = {camera.bits}\n"
        for camera in cameras
    ]
    return "\n".join(entries)
