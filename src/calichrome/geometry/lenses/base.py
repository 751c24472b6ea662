"""What every lens model can do."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["Lens"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens(ABC):
    """A map from rays to pixels with named parameters: focal lengths and principal point in pixels.

    Pixel (0, 0) is the centre of the top-left pixel; camera x right, y down, z forward. Parameters
    of the distortion follow in the order of `NAMES`.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    MODEL: ClassVar[str]
    NAMES: ClassVar[tuple[str, ...]]
    OPTIONAL: ClassVar[tuple[tuple[str, ...], ...]]
    """Groups of parameters that are freed only where the data support them."""

    @classmethod
    def start(cls, size_wh: tuple[int, int], focal_px: float) -> Self:
        """Return the lens without distortion whose axis meets the middle of the picture."""
        width, height = size_wh
        return cls(fx=focal_px, fy=focal_px, cx=(width - 1) / 2, cy=(height - 1) / 2)

    @classmethod
    def from_parameters(cls, parameters: FloatArray) -> Self:
        """Build from values in the order of `NAMES`."""
        return cls(**{k: float(v) for k, v in zip(cls.NAMES, parameters, strict=True)})

    @property
    def parameters(self) -> FloatArray:
        """Values in the order of `NAMES`."""
        return np.array([getattr(self, name) for name in self.NAMES], dtype=np.float64)

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return {name: getattr(self, name) for name in self.NAMES}

    @property
    def matrix(self) -> FloatArray:
        """The pinhole matrix K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    @abstractmethod
    def max_angle_rad(self) -> float:
        """Angle from the axis below which every ray has a pixel of its own."""

    def sees(self, points_cam: FloatArray) -> BoolArray:
        """Tell which points (..., 3) have a pixel of their own, shape (...,).

        `project` may give others a place in the picture that belongs to these.
        """
        points = np.asarray(points_cam)
        angle = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
        return np.asarray((angle < self.max_angle_rad) & (points != 0).any(axis=-1))

    def project(self, points_cam: FloatArray) -> FloatArray:
        """Project points (..., 3), metres, to pixels (..., 2); nan where there is no image."""
        points = np.asarray(points_cam, dtype=np.float64)
        pixels = self.project_views(self.parameters[None], points.reshape(1, -1, 3).swapaxes(1, 2))
        return np.asarray(pixels[0].T.reshape(*points.shape[:-1], 2))

    @classmethod
    def project_views(cls, parameters: FloatArray, points_cam: FloatArray) -> FloatArray:
        """Project points (V, 3, N) of V views by lenses (V, P) to pixels (V, 2, N)."""
        p = parameters.T[:, :, None]
        return np.asarray((p[:2] * cls._image(p, points_cam) + p[2:4]).transpose(1, 0, 2))

    def project_with_jacobians(
        self, points_cam: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pixels (N, 2), d_pixels_d_parameters (N, 2, P), d_pixels_d_points (N, 2, 3)."""
        n_parameters, n_points = len(self.NAMES), len(points_cam)
        jacobian = np.empty((1, n_parameters + 3, 2, n_points))
        pixels = self.project_block(
            self.parameters[None],
            np.ascontiguousarray(points_cam.T)[None],
            jacobian[:, :n_parameters],
            jacobian[:, n_parameters:],
        )
        by_point = jacobian[0].transpose(2, 1, 0)
        return pixels[0].T, by_point[:, :, :n_parameters], by_point[:, :, n_parameters:]

    @classmethod
    @abstractmethod
    def project_block(
        cls,
        parameters: FloatArray,
        points_cam: FloatArray,
        d_parameters: FloatArray,
        d_points: FloatArray,
    ) -> FloatArray:
        """Project V views of N points each, with all derivatives: the inner loop of the solver.

        Parameters
        ----------
        parameters : (V, P) float
            Of each view's lens, in the order of `NAMES`.
        points_cam : (V, 3, N) float, metres
            Each in the frame of its camera.
        d_parameters : (V, P, 2, N) float, out
            Derivatives of the pixels by the parameters; all of it is written.
        d_points : (V, 3, 2, N) float, out
            Derivatives of the pixels by the points; all of it is written.

        Returns
        -------
        (V, 2, N) float, pixels
            nan where there is no image; the derivatives there mean nothing.
        """

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Return rays (..., 3) through pixels (..., 2); nan where no ray below `max_angle_rad` is.

        Only the direction of a ray has a meaning. It has z = 1 where the model ends at 90 degrees,
        else unit length.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        image = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        image = np.where(np.isfinite(image).all(axis=-1, keepdims=True), image, np.nan)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # a step from a fold or towards a far pixel may be infinite; it is not taken
            rays = self._rays(image.reshape(-1, 2).T)
        return rays.T.reshape(*pixels.shape[:-1], 3)

    @classmethod
    @abstractmethod
    def _image(cls, p: FloatArray, points_cam: FloatArray) -> FloatArray:
        """Image (2, V, N) at focal length 1 of points (V, 3, N) for parameters (P, V, 1)."""

    @abstractmethod
    def _rays(self, image: FloatArray) -> FloatArray:
        """Rays (3, N) whose image at focal length 1 is `image` (2, N), or nan."""
