"""Rigid motions, named ``a_from_b``: ``x_a = a_from_b.apply(x_b)``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["Pose", "cross_matrix"]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rotation followed by a translation.

    Parameters
    ----------
    rotation : (3, 3) float, unitless
        Proper rotation matrix.
    trans_m : (3,) float, metres

    Notes
    -----
    A small change is written (omega, tau): ``x -> exp(omega) R x + t + tau``, omega in radians.
    Rotation and translation change apart, so that tau is the change of the position and its
    covariance can be read without knowing the rotation.
    """

    rotation: FloatArray
    trans_m: FloatArray

    def __post_init__(self) -> None:
        rotation = checked(self.rotation, (3, 3), "rotation")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or (
            np.linalg.det(rotation) < 0
        ):
            raise ValueError("rotation: not a proper rotation matrix (R R' = 1, det = +1)")
        object.__setattr__(self, "rotation", frozen(rotation))
        object.__setattr__(self, "trans_m", frozen(checked(self.trans_m, (3,), "trans_m")))

    @classmethod
    def identity(cls) -> Self:
        """Return the motion that leaves everything in place."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_rotvec(cls, rotvec_rad: ArrayLike, trans_m: ArrayLike) -> Self:
        """Build from a rotation vector (axis times angle, radians) and a translation (metres)."""
        rotvec = np.array(rotvec_rad, dtype=np.float64)
        return cls(Rotation.from_rotvec(rotvec).as_matrix(), np.asarray(trans_m))

    @property
    def rotvec_rad(self) -> FloatArray:
        """Axis times angle, shape (3,), radians, angle in [0, pi]."""
        vector: FloatArray = Rotation.from_matrix(self.rotation.copy()).as_rotvec()
        return vector

    def apply(self, points: FloatArray) -> FloatArray:
        """Move points of shape (..., 3), metres."""
        return points @ self.rotation.T + self.trans_m

    def inverse(self) -> Self:
        """Return ``b_from_a`` of this ``a_from_b``."""
        return type(self)(self.rotation.T, -self.rotation.T @ self.trans_m)

    def __matmul__(self, b_from_c: Self) -> Self:
        """Compose: ``a_from_c = a_from_b @ b_from_c``."""
        return type(self)(
            _orthonormal(self.rotation @ b_from_c.rotation), self.apply(b_from_c.trans_m)
        )

    def perturbed(self, step: FloatArray) -> Self:
        """Apply a small change (omega, tau), shape (6,): radians, then metres."""
        turn = Rotation.from_rotvec(np.array(step[:3])).as_matrix()
        return type(self)(_orthonormal(turn @ self.rotation), self.trans_m + step[3:])

    @staticmethod
    def mean(poses: Sequence["Pose"]) -> "Pose":
        """Return the chordal mean rotation with the mean translation."""
        rotations = Rotation.from_matrix(np.stack([pose.rotation for pose in poses]))
        trans_m = np.mean([pose.trans_m for pose in poses], axis=0)
        return Pose(rotations.mean().as_matrix(), trans_m)


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """Return [v]x of shape (..., 3, 3), so that ``cross_matrix(v) @ w == cross(v, w)``."""
    result = np.zeros((*vectors.shape, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., c, b] = vectors[..., a]
        result[..., b, c] = -vectors[..., a]
    return result


def _orthonormal(rotation: FloatArray) -> FloatArray:
    """Remove the rounding that long products collect (nearest rotation, by SVD)."""
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ vt)
