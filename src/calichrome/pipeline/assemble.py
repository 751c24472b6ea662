"""What was solved, put together as the rig that others read."""

from collections.abc import Mapping, Sequence

import numpy as np

from calichrome.colorimetry.encoding import EncodingName
from calichrome.colour.fit import ColourSolution, between_cameras
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding
from calichrome.geometry.rig_graph import UncertainPose
from calichrome.geometry.rig_solve import RigSolution
from calichrome.rig import Camera, CameraColour, Evidence, Pair, PlacedFrame, Rig
from calichrome.target import Target

__all__ = ["assemble_rig", "gather_evidence"]

_SCALE_SIGMA = 0.005  # relative: what a printer driver's "fit to page" leaves unnoticed


def assemble_rig(  # noqa: PLR0917 (one argument for each part that was solved)
    solved: RigSolution,
    target: Target,
    held_out: Mapping[str, float | None],
    colours: Mapping[str, ColourSolution],
    encodings: Mapping[str, EncodingName | None],
    bits: Mapping[str, int | None],
    findings: Sequence[Finding],
) -> Rig:
    """Return the rig.

    Parameters
    ----------
    solved
        Geometry.
    target
        The board.
    held_out
        Held-out error by camera, pixels.
    colours
        By camera; cameras without colour are absent.
    encodings, bits
        By camera; None where no picture was seen, or nothing was stated.
    findings
        All of them.
    """
    cameras = {
        camera: _camera(
            camera,
            solved,
            target,
            held_out[camera],
            _camera_colour(colours.get(camera), encodings[camera], bits[camera]),
        )
        for camera in solved.cameras
    }
    differences = between_cameras(colours)
    return Rig(
        target=target,
        reference_camera=solved.graph.reference,
        cameras=cameras,
        pairs=tuple(
            Pair(names, pair.n_shared, pair.rms_px) for names, pair in solved.pairs.items()
        ),
        frames={
            frame: PlacedFrame(board.ref_from_board, tuple(board.residuals_px))
            for frame, board in solved.boards.items()
        },
        findings=tuple(findings),
        inter_camera_delta_e_2000=None
        if len(differences) == 0
        else {"mean": float(differences.mean()), "p95": float(np.quantile(differences, 0.95))},
    )


def _camera(
    camera: str,
    solved: RigSolution,
    target: Target,
    held_out: float | None,
    colour: CameraColour | None,
) -> Camera:
    solution = solved.cameras[camera]
    cov = solution.lens_cov
    sigmas = None if cov is None else np.sqrt(np.diag(cov))
    names = solution.lens.NAMES
    place = solved.graph.cams_from_ref[camera]
    pose_cov = _pose_cov(place, scale_known=target.square_size_measured)
    pose_sigmas = None if pose_cov is None else np.sqrt(np.diag(pose_cov))
    return Camera(
        size_wh=solved.dataset.sizes_wh[camera],
        lens=solution.lens,
        lens_sigma={
            name: None if sigmas is None else float(sigmas[index])
            for index, name in enumerate(names)
        },
        cam_from_ref=place.pose,
        sigma_rad=None if pose_sigmas is None else pose_sigmas[:3],
        sigma_m=None if pose_sigmas is None else pose_sigmas[3:],
        cov_m=None if pose_cov is None else pose_cov[3:, 3:],
        n_views=len(solution.cams_from_board),
        n_corners=sum(len(part) for part in solution.residuals_px),
        rms_px=solution.rms_px,
        held_out_rms_px=held_out,
        colour=colour,
    )


def _pose_cov(place: UncertainPose, *, scale_known: bool) -> FloatArray | None:
    """Covariance of (omega, tau); an unverified scale stretches all lengths by one factor."""
    if place.cov is None:
        return None
    cov = place.cov.copy()
    if not scale_known:
        cov[3:, 3:] += _SCALE_SIGMA**2 * np.outer(place.pose.trans_m, place.pose.trans_m)
    return cov


def _camera_colour(
    solution: ColourSolution | None, encoding: EncodingName | None, bits: int | None
) -> CameraColour | None:
    if solution is None:
        return None
    held_out = solution.held_out_delta_e[np.isfinite(solution.held_out_delta_e)]
    return CameraColour(
        model=solution.model,
        encoding=encoding,
        bits=bits,
        white_rgb=solution.white_rgb,
        delta_e_2000={
            "fit_mean": float(np.nanmean(solution.fit_delta_e)),
            "held_out_mean": float(held_out.mean()),
            "held_out_p95": float(np.quantile(held_out, 0.95)),
        },
    )


def gather_evidence(solved: RigSolution, target: Target) -> Evidence:
    """Return the arrays of rig.npz."""
    rows = [
        (camera, frame, view, solved.boards[frame].residuals_px[camera])
        for camera, views in solved.dataset.views.items()
        for frame, view in views.items()
    ]
    return Evidence(
        camera=tuple(camera for camera, _, view, _ in rows for _ in view.corner_ids),
        frame=tuple(frame for _, frame, view, _ in rows for _ in view.corner_ids),
        corner=np.concatenate([view.corner_ids for _, _, view, _ in rows]),
        pixels=np.concatenate([view.corners_px for _, _, view, _ in rows]),
        residuals_px=np.concatenate([residuals for _, _, _, residuals in rows]),
        lens_cov={
            camera: item.lens_cov
            for camera, item in solved.cameras.items()
            if item.lens_cov is not None
        },
        pose_cov={
            camera: cov
            for camera, place in solved.graph.cams_from_ref.items()
            if (cov := _pose_cov(place, scale_known=target.square_size_measured)) is not None
        },
        sums=solved.dataset.sums,
    )
