"""From pairs to a rig: every camera on its best path to the reference camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.errors import DisconnectedRigError, SolveError
from calichrome.geometry.pairs import PairSolution, covariance_of_errors

__all__ = ["RigGraph", "UncertainPose", "connect_cameras"]

MIN_SHARED = 3
"""A pair with fewer shared views has no redundancy to show that one of them is wrong; it is used
only where nothing else connects."""


@dataclass(frozen=True, slots=True, eq=False)
class UncertainPose:
    """A motion and the errors in it.

    Parameters
    ----------
    pose
        The motion.
    errors : camera, frame -> (6, k) float, or None
        How its (omega, tau), rad and m, answer to independent unit errors: of the corners of a
        camera in a frame, and of its lens (frame None). None if unknown.

    Notes
    -----
    The two steps of a path through a camera share its lens, and a wrong lens moves the camera the
    same way in both: in a chain most of it cancels. Taken as independent, the sigma of the last
    of five cameras is 1.2 to 1.9 times too large (measured).
    """

    pose: Pose
    errors: Mapping[tuple[str, str | None], FloatArray] | None

    @property
    def cov(self) -> FloatArray | None:
        """Covariance of (omega, tau), (6, 6)."""
        return None if self.errors is None else covariance_of_errors(self.errors.values())

    def inverse(self) -> Self:
        """Invert; first order."""
        rotation_t = self.pose.rotation.T
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = jacobian[3:, 3:] = -rotation_t
        jacobian[3:, :3] = -rotation_t @ cross_matrix(self.pose.trans_m)
        errors = None
        if self.errors is not None:
            errors = {source: jacobian @ response for source, response in self.errors.items()}
        return type(self)(self.pose.inverse(), errors)

    def __matmul__(self, b_from_c: Self) -> Self:
        """Compose; first order."""
        rotation = self.pose.rotation
        by_first = np.eye(6)
        by_first[3:, :3] = -cross_matrix(rotation @ b_from_c.pose.trans_m)
        by_second = np.kron(np.eye(2), rotation)
        pose = self.pose @ b_from_c.pose
        if self.errors is None or b_from_c.errors is None:
            return type(self)(pose, None)
        errors = {source: by_first @ response for source, response in self.errors.items()}
        for source, response in b_from_c.errors.items():
            errors[source] = errors.get(source, 0.0) + by_second @ response
        return type(self)(pose, errors)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigGraph:
    """Where every camera is.

    Parameters
    ----------
    reference
        The camera whose frame is ref.
    cams_from_ref
        By camera id.
    paths
        By camera id: the cameras from the reference to it, both included.
    """

    reference: str
    cams_from_ref: Mapping[str, UncertainPose]
    paths: Mapping[str, tuple[str, ...]]


def connect_cameras(
    cameras: Sequence[str],
    pairs: Mapping[tuple[str, str], PairSolution],
    reference: str | None = None,
) -> RigGraph:
    """Chain pairs along the paths of the lowest sum of their `rms_px`.

    Parameters
    ----------
    cameras
        All camera ids.
    pairs
        (a, b) -> solution.
    reference
        Reference camera; None: the one with the least total path error.

    Raises
    ------
    DisconnectedRigError
        If some cameras are not connected, naming the groups.
    SolveError
        If `reference` is not a camera.

    References
    ----------
    .. [1] E. W. Dijkstra, "A Note on Two Problems in Connexion with Graphs", 1959; the choice of
       weight is that of Kapusi et al., 2010, section 3.
    """
    if reference is not None and reference not in cameras:
        raise SolveError(
            f"reference camera {reference} is not among {', '.join(cameras)}; correct the name"
        )
    index = {camera: position for position, camera in enumerate(cameras)}
    weights = np.zeros((len(cameras), len(cameras)))
    total = sum(pair.rms_px for pair in pairs.values()) + 1.0
    for (a, b), pair in pairs.items():
        weak = total if pair.n_shared < MIN_SHARED else 0.0  # dearer than any strong path
        weights[index[a], index[b]] = max(pair.rms_px, 1e-9) + weak  # 0 would mean no edge
    graph = csr_array(weights)
    n_groups, labels = connected_components(graph, directed=False)
    if n_groups > 1:
        raise DisconnectedRigError(
            [[cam for cam in cameras if labels[index[cam]] == group] for group in range(n_groups)]
        )
    distances, predecessors = dijkstra(graph, directed=False, return_predecessors=True)
    root = int(np.argmin(distances.sum(axis=1))) if reference is None else index[reference]
    cams_from_ref: dict[str, UncertainPose] = {}
    paths: dict[str, tuple[str, ...]] = {}
    for camera in cameras:
        path = [index[camera]]
        while path[-1] != root:
            path.append(int(predecessors[root, path[-1]]))
        names = tuple(cameras[position] for position in reversed(path))
        motion = UncertainPose(Pose.identity(), {})
        for previous, following in pairwise(names):
            motion = _step(pairs, previous, following) @ motion
        cams_from_ref[camera], paths[camera] = motion, names
    return RigGraph(reference=cameras[root], cams_from_ref=cams_from_ref, paths=paths)


def _step(
    pairs: Mapping[tuple[str, str], PairSolution], previous: str, following: str
) -> UncertainPose:
    forward = (previous, following) in pairs
    names = (previous, following) if forward else (following, previous)
    pair = pairs[names]
    errors = None
    if pair.errors is not None:
        errors = {(names[side], frame): part for (side, frame), part in pair.errors.items()}
    motion = UncertainPose(pair.b_from_a, errors)
    return motion if forward else motion.inverse()
