"""Calibrations and frames drawn at random, of every kind that a rig file can hold."""

from dataclasses import dataclass
from typing import TypeVar, get_args

import numpy as np

from calichrome.apply import (
    OUTPUT_SPACES,
    ChannelOrder,
    FrameFormat,
    OutputSpace,
    PixelType,
    SourceMap,
    rectifying_map,
    undistorting_map,
)
from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.encoding import ENCODINGS, EncodingName, ToneCurve
from calichrome.colour.families import fit_model
from calichrome.colour.model import ColourModel
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady, Lens
from calichrome.imaging import Pixels
from calichrome.rig import Camera, CameraColour

__all__ = ["Case", "colour_of", "picture", "random_camera", "random_case"]

_T = TypeVar("_T")
_TYPES: tuple[PixelType, ...] = get_args(PixelType)
_CAMERA_FROM_XYZ = np.array([[1.5, -0.3, -0.2], [-0.4, 1.4, 0.0], [0.0, -0.1, 1.0]])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A correction to build, and a frame for it."""

    camera: Camera
    space: OutputSpace
    source_map: SourceMap | None
    frames: FrameFormat
    output: PixelType | None
    frame: Pixels


def random_case(rng: np.random.Generator, model_name: str | None = None) -> Case:
    """Draw a case; `model_name` fixes the colour model."""
    size_wh = (int(rng.integers(17, 90)), int(rng.integers(13, 70)))
    dtype = _one_of(rng, _TYPES)
    space = _one_of(rng, OUTPUT_SPACES)
    order: ChannelOrder = _one_of(rng, ("rgb", "bgr") if space != "none" else ("rgb", "grey"))
    name = model_name or str(rng.choice(list(MODELS)))
    camera = random_camera(rng, size_wh, name)
    top = float(rng.choice([1023, 4095, 65535])) if dtype == "uint16" else None
    frames = FrameFormat(dtype=dtype, order=order, full_scale=top)
    stored = picture(rng, size_wh)[..., : frames.n_channels] * frames.top
    frame = stored if dtype == "float32" else np.rint(stored)
    may_choose = space not in {"xyz-d65", "none"} and rng.random() < 0.5
    return Case(
        camera=camera,
        space=space,
        source_map=_map(rng, camera.lens, size_wh),
        frames=frames,
        output=_one_of(rng, _TYPES) if may_choose else None,
        frame=np.ascontiguousarray(frame.squeeze(axis=2) if order == "grey" else frame, dtype),
    )


def _one_of(rng: np.random.Generator, values: tuple[_T, ...]) -> _T:
    return values[int(rng.integers(len(values)))]


def random_camera(rng: np.random.Generator, size_wh: tuple[int, int], name: str) -> Camera:
    """Draw a camera with a lens, a fall-off, an encoding and the named colour model."""
    width, height = size_wh
    focal = width * rng.uniform(0.6, 1.5)
    lens = BrownConrady(
        fx=focal,
        fy=focal * rng.uniform(0.98, 1.02),
        cx=width * rng.uniform(0.45, 0.55),
        cy=height * rng.uniform(0.45, 0.55),
        k1=rng.uniform(-0.35, 0.15),
        k2=rng.uniform(-0.05, 0.1),
        p1=rng.uniform(-2e-3, 2e-3),
        p2=rng.uniform(-2e-3, 2e-3),
    )
    white_rgb = rng.uniform(0.4, 0.95, 3)
    encoding: EncodingName | ToneCurve = _one_of(rng, tuple(ENCODINGS))
    if rng.random() < 0.2:
        stored = np.linspace(0, 1, 20)
        encoding = ToneCurve.from_table(stored, stored[:, None] ** rng.uniform(1.6, 2.6, 3))
    return Camera(
        size_wh=size_wh,
        lens=lens,
        lens_sigma=dict.fromkeys(lens.NAMES),
        cam_from_ref=Pose.identity(),
        sigma_rad=None,
        sigma_m=None,
        n_views=12,
        n_corners=600,
        rms_px=0.1,
        vignetting=_vignetting(rng, size_wh) if rng.random() < 0.7 else None,
        colour=CameraColour(
            model=_model(rng, name, white_rgb),
            encoding=encoding,
            white_rgb=white_rgb,
            delta_e_2000={"fit_mean": None, "held_out_mean": None, "held_out_p95": None},
        ),
    )


def colour_of(camera: Camera) -> CameraColour:
    """Return the colour of a camera that has one."""
    if camera.colour is None:
        raise ValueError("camera: has no colour")
    return camera.colour


def picture(rng: np.random.Generator, size_wh: tuple[int, int]) -> FloatArray:
    """Draw shades, edges, saturated patches and noise, (H, W, 3), 0..1."""
    width, height = size_wh
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    shades = [
        np.sin((x * rng.uniform(2, 9) + y * rng.uniform(2, 9)) / width + rng.uniform(0, 6))
        for _ in range(3)
    ]
    values = 0.45 + 0.4 * np.stack(shades, axis=-1)
    for _ in range(12):
        left, top = rng.integers(0, width), rng.integers(0, height)
        right, low = left + rng.integers(1, width), top + rng.integers(1, height)
        values[top:low, left:right] = rng.uniform(0, 1, 3) ** 2 * rng.choice([0, 1, 1, 1], 3)
    noise = rng.normal(0, 0.03, values.shape)
    noise[: height // 4] = rng.uniform(-1, 1, (height // 4, width, 3))  # nothing but noise
    return np.clip(values + noise, 0, 1)


def _map(rng: np.random.Generator, lens: Lens, size_wh: tuple[int, int]) -> SourceMap | None:
    kind = rng.integers(3)
    if kind == 0:
        return None
    if kind == 1:
        return undistorting_map(lens, size_wh)
    turn = Pose.from_rotvec(rng.normal(0, 0.1, 3), np.zeros(3)).rotation
    out_wh = (int(rng.integers(5, 100)), int(rng.integers(5, 80)))
    matrix = lens.matrix.copy()
    matrix[:2, 2] = (np.array(out_wh) - 1) / 2
    return rectifying_map(lens, turn, matrix, out_wh)


def _vignetting(rng: np.random.Generator, size_wh: tuple[int, int]) -> Vignetting:
    radial = np.array([-0.4, -0.1, 0.03]) * rng.uniform(0, 1.2)
    coefficients = np.tile([*radial, *rng.uniform(-0.05, 0.05, 2)], (3, 1))
    return Vignetting(
        centre_px=np.array(size_wh) * rng.uniform(0.45, 0.55, 2),
        half_diagonal_px=float(np.hypot(*size_wh) / 2),
        coefficients=coefficients * rng.uniform(0.9, 1.1, (3, 1)),
        covariance=np.zeros((3, 5, 5)),
        covered_radius=rng.uniform(0.7, 1.1),
    )


def _model(rng: np.random.Generator, name: str, white_rgb: FloatArray) -> ColourModel:
    """Fit a model to 24 colours and six greys of a camera that is almost, not quite, linear."""
    xyz = rng.uniform(0.02, 0.95, (24, 1)) * rng.uniform(0.2, 1, (24, 3)) * D65
    xyz = np.concatenate([xyz, np.geomspace(0.03, 0.9, 6)[:, None] * D65])
    balanced = xyz / D65 @ (_CAMERA_FROM_XYZ + rng.normal(0, 0.05, (3, 3))).T
    balanced /= balanced[-1] / 0.9
    bent = np.maximum(balanced, 1e-3) * (1 + rng.normal(0, 0.05, balanced.shape))
    bent[24:] = balanced[24:]
    pairs = ColourPairs.of(bent * white_rgb, xyz, white_rgb=white_rgb, white_xyz=D65)
    return fit_model(name, pairs)
