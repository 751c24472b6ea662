"""rig.json: versioned, checked on the way in, whole or absent on the way out."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calichrome._version import __version__
from calichrome.colorimetry.encoding import ToneCurve
from calichrome.colour.models import MODELS
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.files import refuse_existing, writing_file
from calichrome.core.findings import Finding, Severity
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError, TargetError
from calichrome.geometry.lenses import LENSES
from calichrome.rig.evidence import Evidence
from calichrome.rig.model import BoardWarp, Camera, CameraColour, Pair, PlacedFrame, Rig
from calichrome.target import target_from_json, target_to_json

__all__ = ["FORMAT_VERSION", "RigFile", "load_rig", "rig_to_json", "save_rig"]

FORMAT_VERSION = 1
_MAX_BYTES = 200_000_000
PictureSide = Annotated[int, Field(ge=1, le=100_000)]
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]


class _Base(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _PoseFile(_Base):
    rotation: Matrix
    translation_m: Triple


class _CamFromRefFile(_PoseFile):
    sigma_rad: Triple | None
    sigma_m: Triple | None
    cov_m: Matrix | None = None


class _LensFile(_Base):
    model: str
    sigma: dict[str, float | None]


class _EncodingFile(_Base):
    name: Literal["linear", "srgb", "gamma2.2", "rec709"] | None
    bits: int | None = Field(default=None, ge=8, le=16)
    curve: dict[str, Any] | None = None


class _WhiteFile(_Base):
    rgb: Triple


class _DeltaEFile(_Base):
    fit_mean: float
    held_out_mean: float
    held_out_p95: float
    uncertainty_p95: float | None = None


class _ColourFile(_Base):
    model: str
    encoding: _EncodingFile
    parameters: dict[str, Any]
    white: _WhiteFile
    delta_e_2000: _DeltaEFile
    candidates: list[dict[str, Any]] = Field(default_factory=list)


class _SigmaFile(_Base):
    rms: float
    max: float


class _WarpFile(_Base):
    sigma: dict[str, float | None]


class _CameraFile(_Base):
    size_wh: tuple[PictureSide, PictureSide]
    time_offset_s: float = 0.0
    lens: _LensFile
    cam_from_ref: _CamFromRefFile
    n_views: int
    n_corners: int
    rms_px: float
    held_out_rms_px: float | None
    projection_sigma_px: _SigmaFile | None = None
    halves_ratio: float | None = None
    vignetting: dict[str, Any] | None = None
    colour: _ColourFile | None


class _PairFile(_Base):
    cameras: tuple[str, str]
    shared_views: int
    rms_px: float


class _FrameFile(_Base):
    ref_from_board: _PoseFile
    cameras: list[str]


class _FindingFile(_Base):
    code: str
    severity: Severity
    text: str


class _InterCameraFile(_Base):
    mean: float
    p95: float
    held_out_mean: float | None = None


class RigFile(_Base):
    """The content of rig.json; its JSON Schema is shipped as rig/schema/rig-1.json."""

    format: Literal["calichrome.rig"]
    format_version: Literal[1]
    generator: str
    reference_camera: str
    world_from_ref: _PoseFile
    trustworthy: bool
    findings: list[_FindingFile]
    target: dict[str, Any]
    cameras: dict[str, _CameraFile]
    pairs: list[_PairFile]
    inter_camera_delta_e_2000: _InterCameraFile | None
    frames: dict[str, _FrameFile]


def save_rig(rig: Rig, evidence: Evidence | None, path: Path, *, force: bool = False) -> None:
    """Write rig.json and, beside it, rig.npz with the evidence.

    Raises
    ------
    OutputError
        If one of them exists (without `force`) or cannot be written.
    """
    beside = path.with_suffix(".npz")
    refuse_existing(path, force=force)
    if evidence is not None:
        with writing_file(beside, force=force) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **evidence.arrays())
    with writing_file(path, force=force) as temporary:
        temporary.write_text(json.dumps(rig_to_json(rig), indent=1) + "\n", encoding="utf-8")


def load_rig(path: Path | str) -> Rig:
    """Read rig.json of this or any older release.

    Raises
    ------
    FileFormatError
        If it is missing, damaged, or newer than this release.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{path}: is larger than 200 MB, which no rig file is")
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: is not valid JSON ({error}); calibrate again") from error
    version = data.get("format_version") if isinstance(data, dict) else None
    if not isinstance(data, dict) or data.get("format") != "calichrome.rig":
        raise FileFormatError(f"{path}: is not a rig file; give the rig.json of `calibrate`")
    if version != FORMAT_VERSION:
        raise FileFormatError(
            f"{path}: format_version {version!r}, this release reads 1 to {FORMAT_VERSION}"
        )
    try:
        return _rig_from_file(RigFile.model_validate(data), data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise FileFormatError(f"{path}: {where}: {first['msg']}") from error
    except KeyError as error:
        raise FileFormatError(f"{path}: lacks {error}") from error
    except (TypeError, ValueError, TargetError, FileFormatError) as error:
        raise FileFormatError(f"{path}: {error}") from error


def _refuse_constant(name: str) -> float:
    raise ValueError(f"holds {name}, which is not a number that can be used")


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """Return the content of rig.json."""
    return {
        "format": "calichrome.rig",
        "format_version": FORMAT_VERSION,
        "generator": f"calichrome {__version__}",
        "reference_camera": rig.reference_camera,
        "world_from_ref": _pose_to_json(rig.world_from_ref),
        "trustworthy": rig.trustworthy,
        "findings": [
            {**item.data, "code": item.code, "severity": item.severity, "text": item.text}
            for item in rig.findings
        ],
        "target": {
            **target_to_json(rig.target),
            "warp": None
            if rig.warp is None
            else {**rig.warp.values, "sigma": dict(rig.warp.sigma)},
        },
        "cameras": {name: _camera_to_json(camera) for name, camera in rig.cameras.items()},
        "pairs": [
            {"cameras": list(p.cameras), "shared_views": p.shared_views, "rms_px": p.rms_px}
            for p in rig.pairs
        ],
        "inter_camera_delta_e_2000": (
            None if rig.inter_camera_delta_e_2000 is None else dict(rig.inter_camera_delta_e_2000)
        ),
        "frames": {
            name: {
                "ref_from_board": _pose_to_json(frame.ref_from_board),
                "cameras": list(frame.cameras),
            }
            for name, frame in rig.frames.items()
        },
    }


def _pose_to_json(pose: Pose) -> dict[str, Any]:
    return {"rotation": pose.rotation.tolist(), "translation_m": pose.trans_m.tolist()}


def _camera_to_json(camera: Camera) -> dict[str, Any]:
    colour = camera.colour
    return {
        "size_wh": list(camera.size_wh),
        "time_offset_s": 0.0,
        "lens": {
            "model": camera.lens.MODEL,
            **camera.lens.as_dict(),
            "sigma": dict(camera.lens_sigma),
        },
        "cam_from_ref": {
            **_pose_to_json(camera.cam_from_ref),
            "sigma_rad": _listed(camera.sigma_rad),
            "sigma_m": _listed(camera.sigma_m),
            "cov_m": None if camera.cov_m is None else camera.cov_m.tolist(),
        },
        "n_views": camera.n_views,
        "n_corners": camera.n_corners,
        "rms_px": camera.rms_px,
        "held_out_rms_px": camera.held_out_rms_px,
        "projection_sigma_px": None
        if camera.projection_sigma_px is None
        else dict(zip(("rms", "max"), camera.projection_sigma_px, strict=True)),
        "halves_ratio": camera.halves_ratio,
        "vignetting": None if camera.vignetting is None else camera.vignetting.to_json(),
        "colour": None
        if colour is None
        else {
            "model": colour.model.MODEL,
            "encoding": _encoding_to_json(colour),
            "parameters": colour.model.to_json(),
            "white": {"rgb": colour.white_rgb.tolist()},
            "delta_e_2000": dict(colour.delta_e_2000),
            "candidates": [
                # a time is not the same twice, and the same recording gives the same file
                {name: value for name, value in item.items() if name != "ns_per_pixel"}
                for item in colour.candidates
            ],
        },
    }


def _encoding_to_json(colour: CameraColour) -> dict[str, Any]:
    if isinstance(colour.encoding, ToneCurve):
        return {"name": None, "bits": colour.bits, "curve": colour.encoding.to_json()}
    return {"name": colour.encoding, "bits": colour.bits}


def _listed(values: FloatArray | None) -> list[float] | None:
    return None if values is None else [float(value) for value in values]


def _pose(file: _PoseFile) -> Pose:
    return Pose(np.array(file.rotation), np.array(file.translation_m))


def _rig_from_file(file: RigFile, data: dict[str, Any]) -> Rig:
    if file.reference_camera not in file.cameras:
        raise FileFormatError(f"reference_camera {file.reference_camera} is not among the cameras")
    target_data = {key: value for key, value in data["target"].items() if key != "warp"}
    inter = file.inter_camera_delta_e_2000
    return Rig(
        target=target_from_json(target_data),
        reference_camera=file.reference_camera,
        cameras={name: _camera(camera) for name, camera in file.cameras.items()},
        pairs=tuple(Pair(p.cameras, p.shared_views, p.rms_px) for p in file.pairs),
        frames={
            name: PlacedFrame(_pose(frame.ref_from_board), tuple(frame.cameras))
            for name, frame in file.frames.items()
        },
        findings=tuple(
            Finding(code=f.code, severity=f.severity, text=f.text, data=f.model_extra or {})
            for f in file.findings
        ),
        inter_camera_delta_e_2000=None
        if inter is None
        else {"mean": inter.mean, "p95": inter.p95, "held_out_mean": inter.held_out_mean},
        world_from_ref=_pose(file.world_from_ref),
        warp=_warp(data["target"].get("warp")),
    )


def _warp(data: dict[str, Any] | None) -> BoardWarp | None:
    if data is None:
        return None
    file = _WarpFile.model_validate(data)
    values = file.model_extra or {}
    return BoardWarp({name: float(values[name]) for name in file.sigma}, file.sigma)


def _camera(file: _CameraFile) -> Camera:
    lens_type = LENSES.get(file.lens.model)
    if lens_type is None:
        raise FileFormatError(f"lens model {file.lens.model} is not known to this release")
    values = file.lens.model_extra or {}
    lens = lens_type.from_parameters(np.array([float(values[name]) for name in lens_type.NAMES]))
    pose = file.cam_from_ref
    return Camera(
        size_wh=file.size_wh,
        lens=lens,
        lens_sigma=file.lens.sigma,
        cam_from_ref=_pose(pose),
        sigma_rad=None if pose.sigma_rad is None else np.array(pose.sigma_rad),
        sigma_m=None if pose.sigma_m is None else np.array(pose.sigma_m),
        cov_m=None if pose.cov_m is None else np.array(pose.cov_m),
        n_views=file.n_views,
        n_corners=file.n_corners,
        rms_px=file.rms_px,
        held_out_rms_px=file.held_out_rms_px,
        projection_sigma_px=None
        if file.projection_sigma_px is None
        else (file.projection_sigma_px.rms, file.projection_sigma_px.max),
        halves_ratio=file.halves_ratio,
        vignetting=None if file.vignetting is None else Vignetting.from_json(file.vignetting),
        colour=None if file.colour is None else _colour(file.colour),
    )


def _colour(file: _ColourFile) -> CameraColour:
    if file.model not in MODELS:
        raise FileFormatError(f"colour model {file.model} is not known to this release")
    return CameraColour(
        model=MODELS[file.model].from_json(file.parameters),
        encoding=file.encoding.name
        if file.encoding.curve is None
        else ToneCurve.from_json(file.encoding.curve),
        bits=file.encoding.bits,
        white_rgb=np.array(file.white.rgb),
        delta_e_2000={
            "fit_mean": file.delta_e_2000.fit_mean,
            "held_out_mean": file.delta_e_2000.held_out_mean,
            "held_out_p95": file.delta_e_2000.held_out_p95,
            "uncertainty_p95": file.delta_e_2000.uncertainty_p95,
        },
        candidates=tuple(file.candidates),
    )
