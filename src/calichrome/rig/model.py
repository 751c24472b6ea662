"""The calibrated rig, as code uses it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.model import ColourModel
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import Lens
from calichrome.geometry.triangulation import TriangulatedPoints, triangulate
from calichrome.rig.evidence import CameraCovariance
from calichrome.target import Target

__all__ = ["BoardWarp", "Camera", "CameraColour", "Pair", "PlacedFrame", "Rig"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraColour:
    """From the numbers of a camera to the colours of the target.

    Parameters
    ----------
    model
        Linear RGB to XYZ under D65, once the fall-off of the lens is divided out
        (`Camera.vignetting`).
    encoding
        How the camera's files store light, a curve of its own where it was estimated; None if no
        picture was seen (calibrated from corners): then each file is read by its depth.
    bits
        Significant bits of integer pixels, where stated.
    white_rgb : (3,) float
        Linear camera value of the target's white squares in the reference light.
    delta_e_2000
        fit_mean, held_out_mean, held_out_p95 against the target; uncertainty_p95: what noise and
        print tolerance let a disc be off by in 95 of 100 cases, mean over discs, None if that was
        not estimated.
    candidates
        Every model that was tried, with its numbers and why it lost; `ns_per_pixel`, the time that
        numpy takes to apply it, is not kept in files.
    """

    model: ColourModel
    encoding: EncodingName | ToneCurve | None
    white_rgb: FloatArray
    delta_e_2000: Mapping[str, float | None]
    bits: int | None = None
    candidates: tuple[Mapping[str, object], ...] = ()

    def xyz_from_rgb(self, rgb: FloatArray) -> FloatArray:
        """XYZ under D65, Y = 1 for the perfect diffuser, of linear RGB (..., 3), 0..1."""
        return self.model.apply(np.asarray(rgb, dtype=np.float64))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """One calibrated camera.

    Parameters
    ----------
    size_wh
        Pixels.
    lens, lens_sigma
        Parameters and their standard deviations by name; a sigma is None if not estimated.
    cam_from_ref
        Where the camera is.
    sigma_rad, sigma_m : (3,) float or None
        Standard deviations of its (omega, tau); zero for the reference camera.
    cov_m : (3, 3) float or None
        Covariance of the translation, whose diagonal `sigma_m` is the root of.
    n_views, n_corners
        What the lens stands on.
    projection_sigma_px
        Root mean square and largest sigma of projection over the picture, after the best rotation
        of the camera; None if not estimated.
    rms_px, held_out_rms_px
        Errors on the frames used, and on frames left out.
    colour
        None if colour was not calibrated.
    halves_ratio
        By how much more than their covariances say two halves of the frames differ, in projection;
        None if that was not told.
    vignetting
        Share of light that reaches each pixel; None if it was not told from the lamps'.
    """

    size_wh: tuple[int, int]
    lens: Lens
    lens_sigma: Mapping[str, float | None]
    cam_from_ref: Pose
    sigma_rad: FloatArray | None
    sigma_m: FloatArray | None
    n_views: int
    n_corners: int
    rms_px: float
    held_out_rms_px: float | None = None
    cov_m: FloatArray | None = None
    colour: CameraColour | None = None
    projection_sigma_px: tuple[float, float] | None = None
    halves_ratio: float | None = None
    vignetting: Vignetting | None = None

    def project(self, points_ref: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) in ref, metres; nan behind the camera."""
        return self.lens.project(self.cam_from_ref.apply(np.asarray(points_ref)))

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Rays (N, 3) in the camera frame, whose length means nothing; nan: the lens has none."""
        return self.lens.unproject(np.asarray(pixels))


@dataclass(frozen=True, slots=True)
class Pair:
    """Two cameras that share views."""

    cameras: tuple[str, str]
    shared_views: int
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFrame:
    """Where the board was, and which cameras saw it."""

    ref_from_board: Pose
    cameras: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class BoardWarp:
    """How the board differs from a flat one.

    Parameters
    ----------
    values, sigma
        By term: bow terms in metres of sagitta, "aspect" unitless; see docs/formulation.md.
    """

    values: Mapping[str, float]
    sigma: Mapping[str, float | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Cameras that share one space and one colour."""

    target: Target
    reference_camera: str
    cameras: Mapping[str, Camera]
    pairs: tuple[Pair, ...]
    frames: Mapping[str, PlacedFrame]
    findings: tuple[Finding, ...] = ()
    inter_camera_delta_e_2000: Mapping[str, float | None] | None = None
    world_from_ref: Pose = field(default_factory=Pose.identity)
    warp: BoardWarp | None = None

    @property
    def trustworthy(self) -> bool:
        """Whether there is no critical finding."""
        return not any(item.severity == "critical" for item in self.findings)

    def triangulate(
        self,
        pixels: Mapping[str, ArrayLike],
        *,
        cov_px2: ArrayLike | None = None,
        covariance: CameraCovariance | None = None,
    ) -> TriangulatedPoints:
        """Find points from their pixels in two cameras or more.

        Parameters
        ----------
        pixels
            camera -> (N, 2) float, pixels, of the same N points; nan where not seen.
        cov_px2 : (..., 2, 2) float, pixels squared
            Of each position, to be broadcast to (N, C, 2, 2); None: as noisy as the corners that
            each camera was calibrated with.
        covariance
            `Evidence.joint`, so that the doubts of the calibration count; None: it is exact.

        Returns
        -------
        TriangulatedPoints
            In ref.
        """
        cameras = [self.cameras[camera] for camera in pixels]
        if cov_px2 is None:
            cov_px2 = np.stack([np.eye(2) * camera.rms_px**2 / 2 for camera in cameras])
        return triangulate(
            np.stack([np.asarray(own, dtype=np.float64) for own in pixels.values()], axis=1),
            [camera.lens for camera in cameras],
            [camera.cam_from_ref for camera in cameras],
            cov_px2=cov_px2,
            cameras_cov=None if covariance is None else covariance.of(*pixels),
        )
