"""truth.json of a watched workspace: where every ball was, how fast, and of what colour.

Metres, seconds, the world frame of the scene; XYZ in the file has Y = 100 for the perfect diffuser.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calichrome.colorimetry.reference import reflectance_to_xyz_d65
from calichrome.core.arrays import FloatArray
from calichrome.core.files import writing_file
from calichrome.errors import FileFormatError
from calichrome.synthetic.truth import (
    CameraTruth,
    camera_from_json,
    camera_to_json,
    camera_truth,
    read_truth_file,
)
from calichrome.synthetic.workspace.scene import Workspace

__all__ = [
    "BallTruth",
    "WorkspaceTruth",
    "read_workspace_truth",
    "workspace_truth",
    "write_workspace_truth",
]

FORMAT = "calichrome.workspace-truth"
FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BallTruth:
    """One ball.

    Parameters
    ----------
    xyz_d65 : (3,) float
        Of its surface, Y = 1 for the perfect diffuser.
    positions_world, velocities_world : (n_frames, 3) float, metres, metres per second
        Of its centre.
    seen
        camera -> share of its outline that is seen in each frame, (n_frames,), 0..1.
    """

    name: str
    radius_m: float
    xyz_d65: FloatArray
    positions_world: FloatArray
    velocities_world: FloatArray
    seen: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorkspaceTruth:
    """What `observe` should find.

    Parameters
    ----------
    reference_camera
        Of the truth's own `CameraTruth.cam_from_ref`.
    cameras
        By name.
    frame_ids, times_s
        Names and times (n_frames,), seconds, of the frames.
    balls
        In the order of the scene.
    """

    reference_camera: str
    cameras: Mapping[str, CameraTruth]
    frame_ids: tuple[str, ...]
    times_s: FloatArray
    balls: tuple[BallTruth, ...]
    seed: int


def workspace_truth(workspace: Workspace, seen: Mapping[str, FloatArray]) -> WorkspaceTruth:
    """Return the truth of a workspace.

    Parameters
    ----------
    seen
        camera -> (n_frames, n_balls) float, the shares that rendering found.
    """
    cameras, times_s = workspace.scene.cameras, workspace.times_s
    world_from_ref = cameras[0].cam_from_world.inverse()
    return WorkspaceTruth(
        reference_camera=cameras[0].camera_id,
        cameras={item.camera_id: camera_truth(item, world_from_ref) for item in cameras},
        frame_ids=workspace.frame_ids,
        times_s=times_s,
        balls=tuple(
            BallTruth(
                name=ball.name,
                radius_m=ball.radius_m,
                xyz_d65=reflectance_to_xyz_d65(ball.reflectance),
                positions_world=ball.path.positions_world(times_s),
                velocities_world=ball.path.velocities_world(times_s),
                seen={camera: shares[:, index] for camera, shares in seen.items()},
            )
            for index, ball in enumerate(workspace.balls)
        ),
        seed=workspace.scene.seed,
    )


def write_workspace_truth(truth: WorkspaceTruth, path: Path, *, force: bool = False) -> None:
    """Write truth.json, whole or not at all.

    Raises
    ------
    OutputError
        If the file exists (without `force`) or cannot be written.
    """
    data = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "seed": truth.seed,
        "reference_camera": truth.reference_camera,
        "cameras": {key: camera_to_json(camera) for key, camera in truth.cameras.items()},
        "frames": list(truth.frame_ids),
        "times_s": truth.times_s.tolist(),
        "balls": [
            {
                "name": ball.name,
                "radius_m": ball.radius_m,
                "XYZ_D65": (100 * ball.xyz_d65).tolist(),
                "positions_world": ball.positions_world.tolist(),
                "velocities_world": ball.velocities_world.tolist(),
                "seen": {key: np.round(shares, 4).tolist() for key, shares in ball.seen.items()},
            }
            for ball in truth.balls
        ],
    }
    text = json.dumps(data, allow_nan=False)
    with writing_file(path, force=force) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_workspace_truth(path: Path) -> WorkspaceTruth:
    """Read truth.json of a workspace.

    Raises
    ------
    FileFormatError
        If it is missing, damaged or of another kind.
    """
    data = read_truth_file(path, FORMAT, FORMAT_VERSION)
    try:
        return _from_json(data)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: is damaged ({error!r}); simulate again") from error


def _from_json(data: Mapping[str, Any]) -> WorkspaceTruth:
    return WorkspaceTruth(
        reference_camera=data["reference_camera"],
        cameras={key: camera_from_json(entry) for key, entry in data["cameras"].items()},
        frame_ids=tuple(data["frames"]),
        times_s=np.array(data["times_s"], dtype=np.float64),
        balls=tuple(
            BallTruth(
                name=entry["name"],
                radius_m=float(entry["radius_m"]),
                xyz_d65=np.array(entry["XYZ_D65"]) / 100,
                positions_world=np.array(entry["positions_world"], dtype=np.float64),
                velocities_world=np.array(entry["velocities_world"], dtype=np.float64),
                seen={key: np.array(shares) for key, shares in entry["seen"].items()},
            )
            for entry in data["balls"]
        ),
        seed=int(data["seed"]),
    )
