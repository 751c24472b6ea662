"""A rig against new views of its board: whether a camera moved, a lens or the colour changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.colour.drift import ColourDrifts
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.geometry.bundle import BoardShape, ObservedView
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.camera_start import place_views
from calichrome.geometry.drift import Drift, KnownRig, find_drift
from calichrome.geometry.drift_equations import Change
from calichrome.geometry.rig_solve import observed_view
from calichrome.geometry.rig_start import half_turned
from calichrome.observations import Dataset
from calichrome.rig.check_colour import check_colour, judge_colour_drift
from calichrome.rig.evidence import Evidence
from calichrome.rig.model import Rig
from calichrome.target import Target

__all__ = ["Check", "check_dataset"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Check:
    """What new pictures say of a rig.

    Parameters
    ----------
    drift
        By camera.
    absent
        Cameras of the rig that have no picture, or none that shows the board.
    unknown
        Cameras of the recording that the rig does not have.
    frames
        How many were looked at.
    with_covariance
        False: the calibration was taken as exact, since its evidence is not there.
    findings
        What changed.
    colour
        What changed in colour; None if rig or pictures tell none.
    """

    drift: Drift
    absent: tuple[str, ...]
    unknown: tuple[str, ...]
    frames: int
    with_covariance: bool
    findings: tuple[Finding, ...]
    colour: ColourDrifts | None = None

    @property
    def unchanged(self) -> bool:
        """Whether every camera is as it was; its light may have changed."""
        return all(item.severity == "note" for item in self.findings)


def check_dataset(
    rig: Rig, evidence: Evidence | None, dataset: Dataset, target: Target | None = None
) -> Check:
    """Compare a rig with new observations of its board.

    Parameters
    ----------
    rig, evidence
        The calibration; without evidence it is taken as exact.
    dataset
        Of cameras of the rig; those of one frame are of one instant.
    target
        The board; default: that of the rig.
    """
    target = target or rig.target
    noise = None if evidence is None else _stated_noise(rig, evidence)
    if any(view.cov_px is None for own in dataset.views.values() for view in own.values()):
        noise = None
    known = _known(rig, evidence, target, noise)
    views = {
        camera: {
            frame: observed_view(view if noise is not None else replace(view, cov_px=None))
            for frame, view in own.items()
        }
        for camera, own in dataset.views.items()
        if own
    }
    if len(target.symmetries) > 1:
        views = _turned_alike(views, dataset, known)
    drift = find_drift(known, views)
    colour = check_colour(rig, dataset, target)
    return Check(
        drift=drift,
        absent=tuple(camera for camera in rig.cameras if camera not in drift.cameras),
        unknown=(),
        frames=len(dataset.frames),
        with_covariance=known.cov is not None,
        findings=(*_findings(drift), *judge_colour_drift(colour)),
        colour=colour,
    )


def _stated_noise(rig: Rig, evidence: Evidence) -> dict[str, float] | None:
    """By what residuals exceed their stated covariance, by camera; None where none was stated.

    Each residual square is worth one, less its share of the unknowns: six for a board among all
    corners of its frame, a lens among those of its camera.
    """
    if not np.isfinite(evidence.cov_px).all():
        return None
    cov = evidence.cov_px[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    whitened = np.linalg.solve(np.linalg.cholesky(cov), evidence.residuals_px[:, :, None])
    squares = np.where(evidence.inlier, (whitened[:, :, 0] ** 2).sum(axis=1), 0.0)
    frames, of_frame = np.unique(np.array(evidence.frame), return_inverse=True)
    in_frame = np.bincount(of_frame, evidence.inlier, len(frames))
    camera_of = np.array(evidence.camera)
    noise = {}
    for camera, item in rig.cameras.items():
        own = (camera_of == camera) & evidence.inlier
        redundancy = 2 * own.sum() - (6 / in_frame[of_frame[own]]).sum() - len(item.lens.NAMES)
        noise[camera] = float(np.sqrt(squares[own].sum() / max(float(redundancy), 1.0)))
    return noise


def _known(
    rig: Rig, evidence: Evidence | None, target: Target, noise: Mapping[str, float] | None
) -> KnownRig:
    corners = target.corners_board
    shape = BoardShape.flat(corners)
    parameters = np.zeros(0)
    if rig.warp is not None:
        names = rig.warp.values
        n_bows = sum(name in BOW_TERMS for name in names)
        shape = BoardShape.bowed(corners, n_bows, aspect=len(names) > n_bows)
        parameters = np.array([names.get(name, 0.0) for name in shape.names])
    return KnownRig(
        lenses={camera: item.lens for camera, item in rig.cameras.items()},
        cams_from_ref={camera: item.cam_from_ref for camera, item in rig.cameras.items()},
        noise=noise or {camera: item.rms_px / np.sqrt(2) for camera, item in rig.cameras.items()},
        corners_board=corners,
        shape=shape,
        shape_parameters=parameters,
        cov=None if evidence is None else _covariance(rig, evidence, len(shape)),
    )


def _covariance(rig: Rig, evidence: Evidence, n_shape: int) -> FloatArray | None:
    if evidence.joint is None:
        return None
    found = evidence.joint.of(*rig.cameras, "")
    kept = sum(len(item.lens.NAMES) + 6 for item in rig.cameras.values()) + n_shape
    return found[:kept, :kept]


def _turned_alike(
    views: Mapping[str, Mapping[str, ObservedView]], dataset: Dataset, known: KnownRig
) -> dict[str, dict[str, ObservedView]]:
    """Count the corners of a board that looks alike half turned from one end in all cameras.

    The first camera of a frame decides; another is turned if its view of the board then is nearer,
    by angle, to where the rig expects it.
    """
    points = known.shape.displaced(known.corners_board, known.shape_parameters)
    turned = {camera: dict(own) for camera, own in views.items()}
    for frame in dataset.frames:
        ref_from_board = None
        for camera, own in turned.items():
            if frame not in own:
                continue
            ways = [own[frame], half_turned(own[frame], len(points))]
            places = [
                place_views([way], points, known.lenses[camera])[0].cams_from_board[0]
                for way in ways
            ]
            cam_from_ref, best = known.cams_from_ref[camera], 0
            if ref_from_board is not None:
                expected = cam_from_ref.rotation @ ref_from_board.rotation
                best = int(np.argmax([np.sum(expected * place.rotation) for place in places]))
            else:
                ref_from_board = cam_from_ref.inverse() @ places[0]
            if dataset.views[camera][frame].half_turn_ambiguous:
                own[frame] = ways[best]
    return turned


def _findings(drift: Drift) -> list[Finding]:
    found = []
    for camera, item in drift.cameras.items():
        if item.has_moved and item.moved is not None:
            moved = item.moved
            found.append(
                finding(
                    "camera_drift",
                    f"Camera {camera} moved by {moved.distance_m * 1e3:.2g} mm and turned by "
                    f"{np.degrees(moved.angle_rad):.2g} degrees against the others"
                    f"{_or(item.moved_or)}. Calibrate again.",
                    camera=camera, moved_m=moved.distance_m, turned_rad=moved.angle_rad,
                    chance=item.moved_chance, alternatives=[_words(way) for way in item.moved_or],
                )
            )  # fmt: skip
        if item.has_lens_changed and item.lens is not None:
            focal, cx, cy = item.lens.values
            found.append(
                finding(
                    "lens_drift",
                    f"Camera {camera}: its focal length changed by {focal:+.2%}, its principal "
                    f"point by ({cx:+.1f}, {cy:+.1f}) px{_or(item.lens_or)}. Calibrate again.",
                    camera=camera, focal_share=float(focal), cx_px=float(cx), cy_px=float(cy),
                    chance=item.lens_chance, alternatives=[_words(way) for way in item.lens_or],
                )
            )  # fmt: skip
        if not item.fits:
            found.append(
                finding(
                    "lens_drift",
                    f"Camera {camera}: whatever it moved, its corners miss by {item.misfit:.1f} "
                    f"times what they did in the calibration. Its lens was changed or refocused, "
                    f"or the board is bent, or the picture blurred.",
                    camera=camera, misfit=item.misfit,
                )
            )  # fmt: skip
    return found


def _or(others: Sequence[Change]) -> str:
    """Say what else explains the pictures."""
    return f" (or: {', '.join(map(_words, others))})" if others else ""


def _words(change: Change) -> str:
    kind, camera = change
    return f"{camera} moved" if kind == "place" else f"the lens of {camera} changed"
