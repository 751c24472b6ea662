"""Two calibrations of the same cameras, held against each other and against their doubts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import RecordingError
from calichrome.geometry.comparison import LensDifference, compare_lenses
from calichrome.geometry.displacement import Displacement, displacement, relative_covariance
from calichrome.rig.evidence import Evidence, load_evidence
from calichrome.rig.model import Rig

__all__ = ["CameraComparison", "Comparison", "compare_rigs", "evidence_beside"]

SIGNIFICANT = 0.0027  # beyond 3 sigma of a normal variable
_SCALE_SIGMA = 0.005  # of an unmeasured board: as `calibrate` has it
_QUANTILES = (0.1, 0.5, 0.9)  # of the boards' distances: near, middle, far; a choice


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraComparison:
    """One camera in both rigs.

    Parameters
    ----------
    far
        Projections after the best rotation: what counts for far things.
    near
        Projections after the best rotation and translation at `distances_m`; None if neither rig
        says where boards were, and no distance was given.
    distances_m
        Ranges of the points compared.
    place
        Motion against the common reference camera from the first rig to the second; None for that
        camera itself.
    """

    far: LensDifference
    near: LensDifference | None
    distances_m: tuple[float, ...]
    place: Displacement | None

    @property
    def chances(self) -> tuple[float, ...]:
        """Probabilities that chance explains each difference, as far as they are known."""
        known = [item.chance for item in (self.far, self.near, self.place) if item is not None]
        return tuple(chance for chance in known if chance is not None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Two rigs.

    Parameters
    ----------
    cameras
        Those that both have.
    reference
        Camera that places are told against.
    only_first, only_second
        Cameras that one rig has.
    with_covariance
        Whether both rigs say how sure they are.
    same_pictures
        Pictures that both were computed from: their errors are shared, and the covariances are no
        measure of the difference.
    """

    cameras: Mapping[str, CameraComparison]
    reference: str
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    with_covariance: bool
    same_pictures: int

    @property
    def limit(self) -> float:
        """Chance below which a difference is significant: 3 sigma, shared by all that are told."""
        return SIGNIFICANT / max(sum(len(item.chances) for item in self.cameras.values()), 1)

    @property
    def differing(self) -> tuple[str, ...]:
        """Cameras with a significant difference."""
        return tuple(
            camera
            for camera, item in self.cameras.items()
            if item.chances and min(item.chances) < self.limit
        )


def compare_rigs(
    first: Rig,
    second: Rig,
    *,
    evidence: tuple[Evidence | None, Evidence | None] = (None, None),
    distance_m: float | None = None,
) -> Comparison:
    """Compare the cameras that two rigs share.

    Parameters
    ----------
    first, second
        Lens models may differ.
    evidence
        Of each; without, nothing is said of significance.
    distance_m
        Where projections are compared; None: where the boards were.

    Raises
    ------
    RecordingError
        If they share no camera, or a camera has another picture size.
    """
    common = [camera for camera in first.cameras if camera in second.cameras]
    if not common:
        raise RecordingError(
            f"the rigs share no camera: the first has {', '.join(first.cameras)}, the second "
            f"{', '.join(second.cameras)}; calibrate with the same camera names"
        )
    for camera in common:
        sizes = [f"{w}x{h}" for w, h in (rig.cameras[camera].size_wh for rig in (first, second))]
        if sizes[0] != sizes[1]:
            raise RecordingError(
                f"camera {camera}: its pictures have {sizes[0]} pixels in the first rig and "
                f"{sizes[1]} in the second; a lens belongs to one size, so record both at one"
            )
    wanted = (first.reference_camera, second.reference_camera, common[0])
    reference = next(camera for camera in wanted if camera in common)
    joints = [None if item is None else item.joint for item in evidence]
    with_covariance = all(joint is not None for joint in joints)
    cameras = {}
    for camera in common:
        lenses = [rig.cameras[camera].lens for rig in (first, second)]
        covs = None
        if joints[0] is not None and joints[1] is not None:
            covs = joints[0].lens(camera), joints[1].lens(camera)
        ranges = _board_distances((first, second), camera) if distance_m is None else (distance_m,)
        size_wh = first.cameras[camera].size_wh
        cameras[camera] = CameraComparison(
            far=compare_lenses(lenses[0], lenses[1], size_wh, covs=covs),
            near=compare_lenses(lenses[0], lenses[1], size_wh, covs=covs, distances_m=ranges)
            if ranges
            else None,
            distances_m=ranges,
            place=None
            if camera == reference
            else _place((first, second), evidence, camera, reference),
        )
    sums = [set() if item is None else set(item.sums.values()) for item in evidence]
    return Comparison(
        cameras=cameras,
        reference=reference,
        only_first=tuple(camera for camera in first.cameras if camera not in common),
        only_second=tuple(camera for camera in second.cameras if camera not in common),
        with_covariance=with_covariance,
        same_pictures=len(sums[0] & sums[1]),
    )


def evidence_beside(path: Path) -> Evidence | None:
    """Return the evidence of a rig.json, or None if it is not there."""
    beside = path.with_suffix(".npz")
    return load_evidence(beside) if beside.is_file() else None


def _board_distances(rigs: Sequence[Rig], camera: str) -> tuple[float, ...]:
    """Near, middle and far distance of the board from a camera, in both rigs together."""
    found = [
        float(
            np.linalg.norm(
                (rig.cameras[camera].cam_from_ref @ frame.ref_from_board).apply(
                    rig.target.corners_board.mean(axis=0)
                )
            )
        )
        for rig in rigs
        for frame in rig.frames.values()
        if camera in frame.cameras
    ]
    return tuple(map(float, np.quantile(found, _QUANTILES))) if found else ()


def _place(
    rigs: tuple[Rig, Rig],
    evidence: tuple[Evidence | None, Evidence | None],
    camera: str,
    reference: str,
) -> Displacement:
    places, covs = [], []
    squares = [rig.target.square_m for rig in rigs]
    for rig, item in zip(rigs, evidence, strict=True):
        own, other = rig.cameras[camera].cam_from_ref, rig.cameras[reference].cam_from_ref
        places.append(own @ other.inverse())
        if item is None or item.joint is None:
            continue
        joint = item.joint.of(camera, reference)
        n_own = len(rig.cameras[camera].lens.NAMES)
        rows = np.r_[n_own : n_own + 6, len(joint) - 6 : len(joint)]
        cov = relative_covariance(own, other, joint[np.ix_(rows, rows)])
        if squares[0] != squares[1] and not rig.target.square_size_measured:
            cov = cov + _scale_doubt(places[-1].trans_m)
        covs.append(cov)
    both: FloatArray | None = covs[0] + covs[1] if len(covs) == 2 else None
    return displacement(places[0], places[1], both)


def _scale_doubt(trans_m: FloatArray) -> FloatArray:
    """Covariance of a place if the board's size is not known: all lengths stretch alike."""
    stretched = np.concatenate([np.zeros(3), _SCALE_SIGMA * trans_m])
    return np.outer(stretched, stretched)
