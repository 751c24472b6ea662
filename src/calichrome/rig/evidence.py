"""rig.npz: what a rig was computed from, so that it can be solved again, compared and checked."""

import struct
import tokenize
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.errors import FileFormatError

__all__ = ["CameraCovariance", "Evidence", "load_evidence"]

_MAX_BYTES = 2_000_000_000
_DAMAGED = (
    ValueError, TypeError, AttributeError, KeyError, IndexError, EOFError, SyntaxError, MemoryError,
    OverflowError, RuntimeError, BadZipFile, zlib.error, struct.error,
    tokenize.TokenError,
)  # fmt: skip
"""What zipfile and numpy raise on archives with flipped bytes (each byte of one was tried)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCovariance:
    """Covariance of all cameras together.

    Parameters
    ----------
    camera, parameter : n names
        What each row is: a lens parameter by its name, "omega_x" to "omega_z" (rad) and "tau_x" to
        "tau_z" (m) of cam_from_ref as `Pose.perturbed` defines them; camera "" for the board's
        shape.
    matrix : (n, n) float
        Zero where a parameter is fixed.
    """

    camera: tuple[str, ...]
    parameter: tuple[str, ...]
    matrix: FloatArray

    def of(self, *cameras: str) -> FloatArray:
        """Joint covariance of some cameras: of each in turn its lens, omega and tau."""
        rows = [row for name in cameras for row, own in enumerate(self.camera) if own == name]
        return np.asarray(self.matrix[np.ix_(rows, rows)])

    def lens(self, camera: str) -> FloatArray:
        """Of one lens, (P, P)."""
        return self.of(camera)[:-6, :-6]

    def pose(self, camera: str) -> FloatArray:
        """Of one cam_from_ref, (6, 6)."""
        return self.of(camera)[-6:, -6:]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """The arrays of rig.npz, one row a corner.

    Parameters
    ----------
    camera, frame : (M,) str
    corner : (M,) int
    pixels, residuals_px : (M, 2) float
        Residuals at the solution, projected minus observed.
    cov_px : (M, 3) float
        xx, xy, yy of each corner as stated by the detector; nan where it was not.
    inlier : (M,) bool
        Which corners were believed.
    lens_cov : camera -> (P, P) float
    pose_cov : camera -> (6, 6) float
        With the doubt about the board's scale, if its size was not measured.
    joint : CameraCovariance or None
        All cameras together, the board's scale taken as exact.
    sums : (camera, frame) -> SHA-256 of the picture file
    """

    camera: tuple[str, ...]
    frame: tuple[str, ...]
    corner: IntArray
    pixels: FloatArray
    residuals_px: FloatArray
    cov_px: FloatArray
    inlier: BoolArray
    lens_cov: Mapping[str, FloatArray]
    pose_cov: Mapping[str, FloatArray]
    joint: CameraCovariance | None = None
    sums: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def arrays(self) -> dict[str, Any]:
        """Return what is written."""
        joint = {}
        if self.joint is not None:
            joint = {
                "joint_camera": np.array(self.joint.camera),
                "joint_parameter": np.array(self.joint.parameter),
                "joint_cov": self.joint.matrix,
            }
        return {
            "camera": np.array(self.camera),
            "frame": np.array(self.frame),
            "corner": self.corner,
            "pixels": self.pixels,
            "residuals_px": self.residuals_px,
            "cov_px": self.cov_px,
            "inlier": self.inlier,
            **{f"lens_cov/{camera}": cov for camera, cov in self.lens_cov.items()},
            **{f"pose_cov/{camera}": cov for camera, cov in self.pose_cov.items()},
            **joint,
            "sums": np.array([[*key, value] for key, value in self.sums.items()]).reshape(-1, 3),
        }


def load_evidence(path: Path) -> Evidence:
    """Read rig.npz.

    Raises
    ------
    FileFormatError
        If it is missing, damaged, or written by a release that kept less.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{path}: is larger than 2 GB, which no evidence is")
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            data = {name: stored[name] for name in stored.files}
    except OSError as error:
        raise FileFormatError(
            f"{path}: cannot be read ({error.strerror or error}); the evidence lies beside the rig"
        ) from error
    except _DAMAGED as error:
        raise FileFormatError(f"{path}: is damaged ({error}); calibrate again") from error
    try:
        return _from_arrays(data)
    except KeyError as error:
        raise FileFormatError(
            f"{path}: lacks {error}; it was written by an older release, calibrate again"
        ) from error
    except (ValueError, TypeError) as error:
        raise FileFormatError(f"{path}: is damaged ({error}); calibrate again") from error


def _from_arrays(data: Mapping[str, Any]) -> Evidence:
    def by_camera(kind: str) -> dict[str, FloatArray]:
        return {
            name.removeprefix(kind): values
            for name, values in data.items()
            if name.startswith(kind)
        }

    joint = None
    if "joint_cov" in data:
        joint = CameraCovariance(
            camera=tuple(map(str, data["joint_camera"])),
            parameter=tuple(map(str, data["joint_parameter"])),
            matrix=data["joint_cov"],
        )
    return Evidence(
        camera=tuple(map(str, data["camera"])),
        frame=tuple(map(str, data["frame"])),
        corner=data["corner"],
        pixels=data["pixels"],
        residuals_px=data["residuals_px"],
        cov_px=data["cov_px"],
        inlier=data["inlier"],
        lens_cov=by_camera("lens_cov/"),
        pose_cov=by_camera("pose_cov/"),
        joint=joint,
        sums={(str(camera), str(frame)): str(value) for camera, frame, value in data["sums"]},
    )
