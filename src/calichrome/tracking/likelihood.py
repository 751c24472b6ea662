"""How well a region fits an object: place, colour and size in one negative log-likelihood."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from calichrome.core.arrays import FloatArray
from calichrome.tracking.regions import Region
from calichrome.tracking.surface_colour import colour_covariance
from calichrome.tracking.view import View

__all__ = ["AssociationSettings", "RegionTable", "gate", "object_radius"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociationSettings:
    """What regions of one object may differ by.

    Parameters
    ----------
    colour_sigma_de
        Per axis of Lab, in units of CIEDE2000, of one camera against the rig.
    light_sigma
        Of the logarithm of the light on the sides of an object that two cameras see.
    silhouette_sigma_px
        Of the centre of a silhouette, beyond its noise.
    size_sigma
        Of the logarithm of an object's radius, as two cameras see it.
    false_alarm
        Share of right regions that the gate loses.
    """

    colour_sigma_de: float = 1.5
    light_sigma: float = 0.15
    silhouette_sigma_px: float = 0.5
    size_sigma: float = 0.25
    false_alarm: float = 1e-4


def gate(freedom: int, false_alarm: float) -> float:
    """Chi-square that a right one exceeds with this probability."""
    return float(chdtri(freedom, false_alarm))


@dataclass(frozen=True, slots=True, eq=False)
class RegionTable:
    """The regions of one camera at one instant, as arrays.

    Parameters
    ----------
    view
        The camera.
    regions
        R of them.
    centres_px : (R, 2) float
    cov_px2 : (R, 2, 2) float
        Noise and the bias of silhouettes.
    half_angle_rad : (R,) float
    lab : (R, 3) float
        nan where there is no colour.
    lab_cov : (R, 3, 3) float
        Noise of pixels, difference of cameras, and light.
    """

    view: View
    regions: tuple[Region, ...]
    centres_px: FloatArray
    cov_px2: FloatArray
    half_angle_rad: FloatArray
    lab: FloatArray
    lab_cov: FloatArray

    @classmethod
    def of(
        cls, view: View, regions: Sequence[Region], settings: AssociationSettings
    ) -> "RegionTable":
        """Collect regions."""
        colours = [region.colour for region in regions]
        lab = np.array(
            [np.full(3, np.nan) if c is None else c.lab_d65 for c in colours], dtype=np.float64
        ).reshape(-1, 3)
        noise = np.array(
            [np.zeros((3, 3)) if c is None else c.noise_lab for c in colours], dtype=np.float64
        ).reshape(-1, 3, 3)
        spread = colour_covariance(
            np.nan_to_num(lab, nan=50.0), settings.colour_sigma_de, settings.light_sigma
        )
        floor = settings.silhouette_sigma_px**2 * np.eye(2)
        return cls(
            view=view,
            regions=tuple(regions),
            centres_px=np.array([r.centre_px for r in regions]).reshape(-1, 2),
            cov_px2=np.array([r.cov_px2 + floor for r in regions]).reshape(-1, 2, 2),
            half_angle_rad=np.array([r.half_angle_rad for r in regions]).reshape(-1),
            lab=lab,
            lab_cov=noise + spread,
        )

    def log_radius(self, index: int, position_ref: FloatArray) -> float:
        """Logarithm of the radius of a region's object in metres, if it is there."""
        distance = np.linalg.norm(position_ref - self.view.centre_ref)
        return float(np.log(object_radius(distance, self.half_angle_rad[index])))

    def cost(
        self,
        *,
        pixels: FloatArray,
        cov_px2: FloatArray,
        lab: FloatArray,
        lab_cov: FloatArray,
        log_radius: FloatArray,
        radius_sigma: FloatArray,
        distance_m: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compare M objects with all regions.

        Parameters
        ----------
        pixels : (M, 2) float
            Where the camera should see them; nan: it does not.
        cov_px2 : (M, 2, 2) float
            Of that, without what the regions add.
        lab : (M, 3) float
            nan: not known.
        lab_cov : (M, 3, 3) float
        log_radius, radius_sigma : (M,) float
            Natural logarithm of the radius in metres; nan: not known.
        distance_m : (M,) float
            From the camera.

        Returns
        -------
        chi_square : (M, R) float
            Of place, colour and size together; infinite where not seen.
        freedom : (M, R) int
            6, less what is not known.
        cost : (M, R) float
            Twice the negative log-likelihood but for a constant.
        """
        apart = self.centres_px[None] - pixels[:, None]
        chi_square, log_det = _mahalanobis(apart, cov_px2[:, None] + self.cov_px2[None])
        freedom = np.full(chi_square.shape, 2)
        d_colour, _ = _mahalanobis(
            self.lab[None] - lab[:, None], lab_cov[:, None] + self.lab_cov[None]
        )
        known = np.isfinite(d_colour)
        chi_square = chi_square + np.where(known, d_colour, 0)
        freedom = freedom + 3 * known
        looked = np.log(object_radius(distance_m[:, None], self.half_angle_rad[None]))
        d_size = ((looked - log_radius[:, None]) / radius_sigma[:, None]) ** 2
        known = np.isfinite(d_size)
        chi_square = chi_square + np.where(known, d_size, 0)
        freedom = freedom + known
        chi_square = np.where(np.isfinite(chi_square), chi_square, np.inf)
        return chi_square, freedom, chi_square + log_det


def object_radius(distance_m: ArrayLike, half_angle_rad: FloatArray) -> FloatArray:
    """Radius (...,), metres, of a ball whose silhouette is a cone of that half angle."""
    return np.asarray(distance_m) * np.sin(np.minimum(half_angle_rad, np.pi / 2))


def _mahalanobis(difference: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared lengths in units of the covariance, and its log determinant; nan stays nan."""
    safe = np.where(np.isfinite(cov).all(axis=(-1, -2), keepdims=True), cov, np.eye(cov.shape[-1]))
    solved = np.linalg.solve(safe, np.nan_to_num(difference)[..., None])[..., 0]
    squared = (np.nan_to_num(difference) * solved).sum(axis=-1)
    missing = ~np.isfinite(difference).all(axis=-1)
    return np.where(missing, np.nan, squared), np.linalg.slogdet(safe)[1]
