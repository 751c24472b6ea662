"""What a synthetic recording is made of: cameras, lights, things in view, board poses.

World frame: x right, y down, z forward as seen from the rig, metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal
from zlib import crc32

import numpy as np

from calichrome.core.arrays import FloatArray, checked, frozen
from calichrome.core.pose import Pose
from calichrome.errors import CalichromeError
from calichrome.geometry.lenses import BrownConrady
from calichrome.target import Target

__all__ = [
    "Ambient",
    "Light",
    "Panel",
    "Scene",
    "SceneCamera",
    "SceneError",
    "SceneSensor",
    "cosine_vignetting",
    "faces",
    "image_rng",
    "irradiance",
    "white_margin_m",
]

StoredEncoding = Literal["srgb", "linear"]
Triple = tuple[float, float, float]

_MIN_PSF_SIGMA_PX = 0.3  # below it 4 x 4 samples per pixel cannot carry the edge without aliasing


class SceneError(CalichromeError):
    """The scene that was asked for cannot be built."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A lamp that falls off with the square of the distance and with two cosines.

    Parameters
    ----------
    spectrum
        Name of a CIE illuminant, as in `calichrome.colorimetry.reference.illuminant`.
    power
        Luminous irradiance at 1 m on the axis (arbitrary unit shared by all lights of a scene).
    centre_world, axis_world : (3,) float
        Where it is, metres, and which way it shines, unitless.
    radius_m
        Of the face that shines: how soft its shadows are. Its light falls off as from the centre.
    """

    spectrum: str
    power: float
    centre_world: Triple
    axis_world: Triple
    radius_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambient:
    """Light from everywhere: the same irradiance on every surface."""

    spectrum: str
    irradiance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """A flat textured rectangle of the surroundings.

    Parameters
    ----------
    world_from_panel
        Its centre and directions; z points away from the cameras, as for the board.
    half_size_m : (2,) float
        Half of its width and height, metres.
    reflectance : (81,) float, 0..1
    texture_contrast
        Standard deviation of the reflectance's relative variation.
    texture_m
        Size of the coarsest grain, metres.
    """

    world_from_panel: Pose
    half_size_m: tuple[float, float]
    reflectance: FloatArray
    texture_contrast: float = 0.0
    texture_m: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "reflectance", frozen(checked(self.reflectance, (81,), "panel")))


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSensor:
    """How light becomes numbers.

    Parameters
    ----------
    sensitivity
        Name of a camera in `calichrome.colorimetry.reference.camera_sensitivities`.
    full_well_e, read_noise_e
        Electrons that fill a pixel; standard deviation of reading it.
    adc_bits
        Bits of the converter; None for no quantisation.
    mosaic
        One colour per pixel (RGGB) and demosaicing, or all three measured.
    noise
        False leaves out shot and read noise.
    """

    sensitivity: str
    full_well_e: float = 14_000.0
    read_noise_e: float = 6.0
    adc_bits: int | None = 12
    mosaic: bool = True
    noise: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneCamera:
    """One camera, with everything that stands between the scene and its files.

    Parameters
    ----------
    psf_sigma_px
        Standard deviation of the Gaussian point spread of lens and blur filter; the square pixel
        widens it further.
    vignetting_power
        The image is darkened by cos(angle to the axis) to this power; 4 is the natural law.
    flare
        Share of the mean image that stray light adds everywhere.
    exposure_e
        Electrons per unit of camera radiance.
    white_balance : (3,) float
        Gains of R, G, B, applied to the linear picture.
    encoding, bits
        What the files hold: sRGB-encoded or linear numbers of 8 or 16 bits.
    """

    camera_id: str
    size_wh: tuple[int, int]
    lens: BrownConrady
    cam_from_world: Pose
    sensor: SceneSensor
    psf_sigma_px: float = 0.65
    vignetting_power: float = 1.6
    flare: float = 0.003
    exposure_e: float = 10_000.0
    white_balance: Triple = (1.0, 1.0, 1.0)
    encoding: StoredEncoding = "srgb"
    bits: Literal[8, 16] = 8

    def __post_init__(self) -> None:
        if self.psf_sigma_px < _MIN_PSF_SIGMA_PX:
            raise ValueError(
                f"psf_sigma_px={self.psf_sigma_px}: must be {_MIN_PSF_SIGMA_PX} or more"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A recording before it is rendered.

    Parameters
    ----------
    target
        What its owner believes is printed.
    cameras
        The first is the reference camera of the truth.
    world_from_board
        Board pose by frame id.
    lights, ambients
        Their spectra are mixed at each point of each surface.
    panels
        The surroundings, far ones first: later ones cover earlier ones, the board covers all.
    jpeg_frames
        Frames that 8-bit cameras store as JPEG.
    palette_error_lab_sd
        Standard deviation of the printed colours about the target's, per Lab axis.
    seed
        Every random number of the scene follows from it.
    """

    target: Target
    cameras: tuple[SceneCamera, ...]
    world_from_board: Mapping[str, Pose]
    lights: tuple[Light, ...]
    ambients: tuple[Ambient, ...] = ()
    panels: tuple[Panel, ...] = ()
    jpeg_frames: frozenset[str] = field(default_factory=frozenset)
    palette_error_lab_sd: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        ids = [camera.camera_id for camera in self.cameras]
        if not ids or len(set(ids)) != len(ids):
            raise ValueError(f"cameras: their ids must be different and at least one, got {ids}")

    def camera(self, camera_id: str) -> SceneCamera:
        """Return the camera of that id."""
        for camera in self.cameras:
            if camera.camera_id == camera_id:
                return camera
        raise ValueError(f"camera_id={camera_id!r}: the scene has no such camera")

    @property
    def spectra(self) -> tuple[str, ...]:
        """Name of the spectrum of each light, then of each ambient."""
        lights = tuple(light.spectrum for light in self.lights)
        return lights + tuple(ambient.spectrum for ambient in self.ambients)


def white_margin_m(target: Target) -> float:
    """Return the white around the squares, metres; half a square where the target does not say."""
    return min(target.square_m) / 2 if target.white_margin_m is None else target.white_margin_m


def irradiance(scene: Scene, points_world: FloatArray, normal_world: FloatArray) -> FloatArray:
    """Light that falls on a surface, for each source of `Scene.spectra`.

    Parameters
    ----------
    points_world : (..., 3) float, metres
    normal_world : (..., 3) float, unitless
        Unit normal of the lit side: one, or one per point.

    Returns
    -------
    (..., n_sources) float
        Luminous irradiance in the unit of `Light.power`.
    """
    columns = []
    for light in scene.lights:
        axis = np.array(light.axis_world) / np.linalg.norm(light.axis_world)
        to_light = np.array(light.centre_world) - points_world
        squared = (to_light**2).sum(axis=-1)
        received = np.maximum((to_light * normal_world).sum(axis=-1), 0)
        emitted = np.maximum(-to_light @ axis, 0)
        columns.append(light.power * received * emitted / squared**2)
    shape = points_world.shape[:-1]
    columns += [np.full(shape, ambient.irradiance) for ambient in scene.ambients]
    return np.stack(columns, axis=-1) if columns else np.zeros((*shape, 0))


def cosine_vignetting(camera: SceneCamera, rays_cam: FloatArray) -> FloatArray:
    """Return the share of light that reaches the image along rays (..., 3) with z = 1."""
    squared = (rays_cam[..., :2] ** 2).sum(axis=-1)
    return np.asarray((1 + squared) ** (-camera.vignetting_power / 2))


def faces(camera: SceneCamera, world_from_board: Pose) -> bool:
    """Whether a camera stands before the printed side of a board, not behind it."""
    return bool((camera.cam_from_world @ world_from_board).inverse().trans_m[2] < 0)


def image_rng(seed: int, *names: str) -> np.random.Generator:
    """Return the random numbers of one image: the same in whatever order images are made."""
    key = tuple(crc32(name.encode()) for name in names)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
