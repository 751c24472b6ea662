"""truth.json: everything that a solve of a synthetic recording should find.

Lengths are metres, pixel (0, 0) is the centre of the top-left one, XYZ in the file has Y = 100 for
the perfect diffuser (docs/conventions.md). Points outside a picture are null there, nan here.
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
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic.scene import Scene, SceneCamera, faces, white_margin_m
from calichrome.synthetic.spectra import printed_palette
from calichrome.synthetic.visibility import project_visible, sees_whole

__all__ = [
    "CameraTruth",
    "ImageTruth",
    "Truth",
    "camera_from_json",
    "camera_to_json",
    "camera_truth",
    "read_truth",
    "read_truth_file",
    "truth_of",
    "write_truth",
]

FORMAT = "calichrome.truth"
FORMAT_VERSION = 1
_MAX_BYTES = 200_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraTruth:
    """One camera as it is.

    Parameters
    ----------
    vignetting_power
        The image is darkened by cos(angle to the axis) to this power.
    white_balance : (3,) float
        Gains that were applied to R, G, B.
    encoding, bits
        What the files hold.
    """

    size_wh: tuple[int, int]
    lens: BrownConrady
    cam_from_world: Pose
    cam_from_ref: Pose
    sensitivity: str
    psf_sigma_px: float
    vignetting_power: float
    flare: float
    white_balance: tuple[float, float, float]
    encoding: str
    bits: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageTruth:
    """One picture.

    Parameters
    ----------
    corners_px : (n_corners, 2) float, pixels
        By corner id; nan outside the picture, and on a board seen from behind.
    marker_centres_px : (n_markers, 2) float, pixels
        Images of the disc centres (not centres of their images) by marker id; nan outside.
    whole
        Whether all of the paper is in the picture.
    """

    corners_px: FloatArray
    marker_centres_px: FloatArray
    whole: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What a solve should find.

    Parameters
    ----------
    images
        By (camera_id, frame_id).
    marker_xyz_d65 : (n_markers, 3) float
        Colours that were printed, Y = 1 for the perfect diffuser.
    white_xyz_d65, black_xyz_d65 : (3,) float
        Paper and ink.
    white_margin_m
        White around the squares as rendered, metres.
    """

    reference_camera: str
    cameras: Mapping[str, CameraTruth]
    world_from_board: Mapping[str, Pose]
    images: Mapping[tuple[str, str], ImageTruth]
    marker_xyz_d65: FloatArray
    white_xyz_d65: FloatArray
    black_xyz_d65: FloatArray
    white_margin_m: float
    seed: int

    def whole_views(self, camera_id: str) -> tuple[str, ...]:
        """Return the frames in which a camera sees the whole board."""
        return tuple(
            frame for (camera, frame), image in self.images.items()
            if camera == camera_id and image.whole
        )  # fmt: skip


def truth_of(scene: Scene) -> Truth:
    """Return the truth of a scene."""
    palette = printed_palette(scene.target, scene.palette_error_lab_sd, scene.seed)
    xyz_d65 = reflectance_to_xyz_d65(palette.surfaces)
    reference = scene.cameras[0]
    return Truth(
        reference_camera=reference.camera_id,
        cameras={
            camera.camera_id: camera_truth(camera, reference.cam_from_world.inverse())
            for camera in scene.cameras
        },
        world_from_board=dict(scene.world_from_board),
        images={
            (camera.camera_id, frame_id): _image_truth(scene, camera, world_from_board)
            for camera in scene.cameras
            for frame_id, world_from_board in scene.world_from_board.items()
        },
        marker_xyz_d65=xyz_d65[2:],
        white_xyz_d65=xyz_d65[0],
        black_xyz_d65=xyz_d65[1],
        white_margin_m=white_margin_m(scene.target),
        seed=scene.seed,
    )


def camera_truth(camera: SceneCamera, world_from_ref: Pose) -> CameraTruth:
    """Return the truth of a camera."""
    return CameraTruth(
        size_wh=camera.size_wh,
        lens=camera.lens,
        cam_from_world=camera.cam_from_world,
        cam_from_ref=camera.cam_from_world @ world_from_ref,
        sensitivity=camera.sensor.sensitivity,
        psf_sigma_px=camera.psf_sigma_px,
        vignetting_power=camera.vignetting_power,
        flare=camera.flare,
        white_balance=camera.white_balance,
        encoding=camera.encoding,
        bits=camera.bits,
    )


def _image_truth(scene: Scene, camera: SceneCamera, world_from_board: Pose) -> ImageTruth:
    target = scene.target
    seen = 1.0 if faces(camera, world_from_board) else np.nan
    return ImageTruth(
        corners_px=seen * project_visible(camera, world_from_board.apply(target.corners_board)),
        marker_centres_px=seen
        * project_visible(camera, world_from_board.apply(target.marker_centres_board)),
        whole=sees_whole(scene, camera, world_from_board),
    )


def write_truth(truth: Truth, path: Path, *, force: bool = False) -> None:
    """Write truth.json, whole or not at all.

    Raises
    ------
    OutputError
        If the file exists (without `force`) or cannot be written.
    """
    text = json.dumps(_to_json(truth), indent=1, allow_nan=False)
    with writing_file(path, force=force) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_truth(path: Path) -> Truth:
    """Read truth.json.

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


def read_truth_file(path: Path, kind: str, version: int) -> dict[str, Any]:
    """Read a file of truth as JSON of the kind and version that are wanted.

    Raises
    ------
    FileFormatError
        If it is missing, damaged or of another kind.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{path}: {path.stat().st_size / 1e6:.0f} MB is no truth file")
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error}); simulate again") from error
    if not isinstance(data, dict) or data.get("format") != kind:
        raise FileFormatError(f'{path}: is no truth file (its "format" is not "{kind}")')
    if data.get("format_version") != version:
        raise FileFormatError(
            f"{path}: format_version {data.get('format_version')!r}, this release reads {version}"
        )
    return data


def _to_json(truth: Truth) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "seed": truth.seed,
        "reference_camera": truth.reference_camera,
        "target": {
            "marker_XYZ_D65": _listed(100 * truth.marker_xyz_d65),
            "white_XYZ_D65": (100 * truth.white_xyz_d65).tolist(),
            "black_XYZ_D65": (100 * truth.black_xyz_d65).tolist(),
            "white_margin_m": truth.white_margin_m,
        },
        "cameras": {
            camera_id: {
                **camera_to_json(camera),
                "whole_views": list(truth.whole_views(camera_id)),
            }
            for camera_id, camera in truth.cameras.items()
        },
        "frames": {
            frame_id: {"world_from_board": _pose_to_json(world_from_board)}
            for frame_id, world_from_board in truth.world_from_board.items()
        },
        "images": [
            {
                "camera": camera_id,
                "frame": frame_id,
                "whole": image.whole,
                "corners_px": _listed(image.corners_px),
                "marker_centres_px": _listed(image.marker_centres_px),
            }
            for (camera_id, frame_id), image in truth.images.items()
        ],
    }


def _from_json(data: Mapping[str, Any]) -> Truth:
    target = data["target"]
    return Truth(
        reference_camera=data["reference_camera"],
        cameras={key: camera_from_json(entry) for key, entry in data["cameras"].items()},
        world_from_board={
            key: _pose_from_json(entry["world_from_board"]) for key, entry in data["frames"].items()
        },
        images={
            (entry["camera"], entry["frame"]): ImageTruth(
                corners_px=_points(entry["corners_px"], 2),
                marker_centres_px=_points(entry["marker_centres_px"], 2),
                whole=bool(entry["whole"]),
            )
            for entry in data["images"]
        },
        marker_xyz_d65=_points(target["marker_XYZ_D65"], 3) / 100,
        white_xyz_d65=np.array(target["white_XYZ_D65"]) / 100,
        black_xyz_d65=np.array(target["black_XYZ_D65"]) / 100,
        white_margin_m=float(target["white_margin_m"]),
        seed=int(data["seed"]),
    )


def camera_to_json(camera: CameraTruth) -> dict[str, Any]:
    """Return a camera as its entry in the file."""
    return {
        "size_wh": list(camera.size_wh),
        "lens": {"model": camera.lens.MODEL, **camera.lens.as_dict()},
        "cam_from_world": _pose_to_json(camera.cam_from_world),
        "cam_from_ref": _pose_to_json(camera.cam_from_ref),
        "sensitivity": camera.sensitivity,
        "psf_sigma_px": camera.psf_sigma_px,
        "vignetting": {"model": "cosine-power", "power": camera.vignetting_power},
        "flare": camera.flare,
        "white_balance": list(camera.white_balance),
        "encoding": camera.encoding,
        "bits": camera.bits,
    }


def camera_from_json(entry: Mapping[str, Any]) -> CameraTruth:
    """Read a camera from its entry."""
    numbers = dict(entry["lens"])
    model = numbers.pop("model")
    if model != BrownConrady.MODEL:
        raise FileFormatError(f"truth: lens model {model} is not simulated")
    lens = BrownConrady(**numbers)
    width, height = entry["size_wh"]
    red, green, blue = entry["white_balance"]
    return CameraTruth(
        size_wh=(width, height),
        lens=lens,
        cam_from_world=_pose_from_json(entry["cam_from_world"]),
        cam_from_ref=_pose_from_json(entry["cam_from_ref"]),
        sensitivity=entry["sensitivity"],
        psf_sigma_px=entry["psf_sigma_px"],
        vignetting_power=entry["vignetting"]["power"],
        flare=entry["flare"],
        white_balance=(red, green, blue),
        encoding=entry["encoding"],
        bits=entry["bits"],
    )


def _pose_to_json(pose: Pose) -> dict[str, Any]:
    return {"rotation": pose.rotation.tolist(), "translation_m": pose.trans_m.tolist()}


def _pose_from_json(entry: Mapping[str, Any]) -> Pose:
    return Pose(np.array(entry["rotation"]), np.array(entry["translation_m"]))


def _listed(values: FloatArray) -> list[Any]:
    """Return rows of numbers, null for rows of nan; 1e-9 px and 1e-9 of XYZ are below any use."""
    rows = np.round(values, 9)
    return [row.tolist() if np.isfinite(row).all() else None for row in rows]


def _points(rows: list[list[float] | None], width: int) -> FloatArray:
    values = [[np.nan] * width if row is None else row for row in rows]
    return np.array(values, dtype=np.float64).reshape(-1, width)
