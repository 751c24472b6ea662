"""By how much a camera stands elsewhere, and whether chance explains it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.bundle.state import adjoint
from calichrome.geometry.comparison import root_of

__all__ = ["Displacement", "about_camera", "displacement", "relative_covariance"]


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """A small motion of a camera and its covariance.

    Parameters
    ----------
    motion : (6,) float
        (omega, tau) about the camera: cam_from_ref turned into exp(omega) cam_from_ref + tau, so
        that -tau is how far the camera's centre has moved, along its own axes. Radians, metres.
    cov : (6, 6) float or None
    """

    motion: FloatArray
    cov: FloatArray | None

    @property
    def angle_rad(self) -> float:
        """How far it was turned."""
        return float(np.linalg.norm(self.motion[:3]))

    @property
    def distance_m(self) -> float:
        """How far its centre was moved."""
        return float(np.linalg.norm(self.motion[3:]))

    @property
    def sigma_rad(self) -> float | None:
        """Standard deviation of `angle_rad`, along its axis."""
        return self._along(slice(0, 3))

    @property
    def sigma_m(self) -> float | None:
        """Standard deviation of `distance_m`, along its direction."""
        return self._along(slice(3, 6))

    @property
    def chi_square(self) -> float | None:
        """Squared length in units of the covariance, on `freedom` degrees."""
        if self.cov is None:
            return None
        answer, *_ = np.linalg.lstsq(root_of(self.cov), self.motion, rcond=None)
        return float(answer @ answer)

    @property
    def freedom(self) -> int:
        """Directions that are not certain."""
        return 0 if self.cov is None else root_of(self.cov).shape[1]

    @property
    def chance(self) -> float | None:
        """Probability of a larger `chi_square` if nothing was moved."""
        chi_square = self.chi_square
        return None if not chi_square else float(chdtrc(self.freedom, chi_square))

    def _along(self, part: slice) -> float | None:
        if self.cov is None:
            return None
        length = float(np.linalg.norm(self.motion[part]))
        cov = self.cov[part, part]
        if length == 0:
            return float(np.sqrt(np.trace(cov) / 3))
        unit = self.motion[part] / length
        return float(np.sqrt(unit @ cov @ unit))


def displacement(before: Pose, after: Pose, cov: FloatArray | None) -> Displacement:
    """Return the motion about the camera between two cam_from_ref.

    Parameters
    ----------
    before, after
        Of one camera, in one ref.
    cov : (6, 6) float or None
        Of the motion.
    """
    change = after @ before.inverse()
    turn = Rotation.from_matrix(change.rotation.copy()).as_rotvec()
    return Displacement(np.concatenate([turn, change.trans_m]), cov)


def about_camera(trans_m: FloatArray) -> FloatArray:
    """From (omega, tau) of `Pose.perturbed` to those about the camera, (6, 6).

    The position t of cam_from_ref moves by omega x t + tau.
    """
    jacobian = np.eye(6)
    jacobian[3:, :3] = cross_matrix(trans_m)
    return jacobian


def relative_covariance(cam_from_ref: Pose, other_from_ref: Pose, joint: FloatArray) -> FloatArray:
    """Covariance (6, 6), about the camera, of cam_from_other.

    Parameters
    ----------
    cam_from_ref, other_from_ref
        The two cameras.
    joint : (12, 12) float
        Covariance of the (omega, tau) of `Pose.perturbed`, of the camera and then of the other.

    Notes
    -----
    exp(a) C (exp(b) O)^-1 = exp(a) exp(-Ad b) C O^-1 with Ad that of C O^-1.
    """
    cam_from_other = cam_from_ref @ other_from_ref.inverse()
    passed = adjoint(cam_from_other.rotation, cam_from_other.trans_m)
    jacobian = np.hstack(
        [about_camera(cam_from_ref.trans_m), -passed @ about_camera(other_from_ref.trans_m)]
    )
    return np.asarray(jacobian @ joint @ jacobian.T)
