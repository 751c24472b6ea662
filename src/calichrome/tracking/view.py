"""A camera of the rig as tracking needs it: rays of its pixels, projection with its doubts."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.lenses import Lens
from calichrome.rig import CameraCovariance, Rig

__all__ = ["PixelRays", "View", "Viewed", "views_of"]


@dataclass(frozen=True, slots=True, eq=False)
class PixelRays:
    """What each pixel looks at.

    Parameters
    ----------
    directions : (H, W, 3) float32
        Unit vectors in the camera frame; zero where the lens has no ray.
    solid_angle_sr : (H, W) float32
        Of each pixel.
    """

    directions: NDArray[np.float32]
    solid_angle_sr: NDArray[np.float32]

    @classmethod
    def through(cls, lens: Lens, size_wh: tuple[int, int]) -> "PixelRays":
        """Unproject every pixel once."""
        columns, rows = np.meshgrid(np.arange(-1, size_wh[0] + 1), np.arange(-1, size_wh[1] + 1))
        rays = lens.unproject(np.stack([columns, rows], axis=-1).astype(np.float64))
        with np.errstate(invalid="ignore"):
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        across = (rays[1:-1, 2:] - rays[1:-1, :-2]) / 2
        down = (rays[2:, 1:-1] - rays[:-2, 1:-1]) / 2
        area = np.linalg.norm(np.cross(across, down), axis=-1)
        inner = rays[1:-1, 1:-1]
        seen = np.isfinite(area) & np.isfinite(inner).all(axis=-1)
        return cls(
            directions=np.where(seen[..., None], inner, 0).astype(np.float32),
            solid_angle_sr=np.where(seen, area, 0).astype(np.float32),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Viewed:
    """Points as one camera sees them; nan where it does not.

    Parameters
    ----------
    pixels : (N, 2) float
    d_points : (N, 2, 3) float
        By the points in ref.
    d_camera : (N, 2, P) float
        By the lens and the pose of the camera, in the order of `CameraCovariance.of`.
    distance_m : (N,) float
        From the camera.
    """

    pixels: FloatArray
    d_points: FloatArray
    d_camera: FloatArray
    distance_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One camera.

    Parameters
    ----------
    camera
        Its id.
    lens, cam_from_ref, size_wh
        From the rig.
    cov : (P, P) float or None
        Of its own parameters; None: exact.
    """

    camera: str
    lens: Lens
    cam_from_ref: Pose
    size_wh: tuple[int, int]
    cov: FloatArray | None = None

    @property
    def n_parameters(self) -> int:
        """Lens and pose."""
        return len(self.lens.NAMES) + 6

    @property
    def centre_ref(self) -> FloatArray:
        """Where it stands, (3,), metres."""
        return self.cam_from_ref.inverse().trans_m

    def look(self, points_ref: FloatArray) -> Viewed:
        """Project points (N, 3) with derivatives."""
        turned = points_ref @ self.cam_from_ref.rotation.T
        points_cam = turned + self.cam_from_ref.trans_m
        seen = self.lens.sees(points_cam)
        safe = np.where(seen[:, None], points_cam, [0.0, 0.0, 1.0])
        pixels, d_lens, d_points = self.lens.project_with_jacobians(safe)
        d_camera = np.concatenate([d_lens, -d_points @ cross_matrix(turned), d_points], axis=2)
        pixels[~seen] = np.nan
        return Viewed(
            pixels,
            d_points @ self.cam_from_ref.rotation,
            d_camera,
            np.linalg.norm(points_cam, axis=1),
        )

    def holds(self, pixels: FloatArray, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Tell which pixels (N, 2) lie inside the picture, `margin_px` from its border."""
        low, high = margin_px, np.array(self.size_wh) - 1 - margin_px
        with np.errstate(invalid="ignore"):
            return np.asarray(((pixels >= low) & (pixels <= high)).all(axis=1))


def views_of(rig: Rig, covariance: CameraCovariance | None) -> Mapping[str, View]:
    """Return all cameras of a rig, with what is known of their errors."""
    return {
        name: View(
            camera=name,
            lens=camera.lens,
            cam_from_ref=camera.cam_from_ref,
            size_wh=camera.size_wh,
            cov=None if covariance is None else covariance.of(name),
        )
        for name, camera in rig.cameras.items()
    }
