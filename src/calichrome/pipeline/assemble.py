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


def assemble_rig(
    solved: RigSolution,
    target: Target,
    held_out: Mapping[str, float | None],
    colours: Mapping[str, ColourSolution],
    encodings: Mapping[str, EncodingName],
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
    encodings
        By camera.
    findings
        All of them.
    """
    cameras = {
        camera: _camera(
            camera, solved, target, held_out[camera], colours.get(camera), encodings[camera]
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
    colour: ColourSolution | None,
    encoding: EncodingName,
) -> Camera:
    solution = solved.cameras[camera]
    cov = solution.lens_cov
    sigmas = None if cov is None else np.sqrt(np.diag(cov))
    names = solution.lens.NAMES
    place = solved.graph.cams_from_ref[camera]
    sigma_rad, sigma_m = _pose_sigmas(place, scale_known=target.square_size_measured)
    return Camera(
        size_wh=solved.dataset.sizes_wh[camera],
        lens=solution.lens,
        lens_sigma={
            name: None if sigmas is None else float(sigmas[index])
            for index, name in enumerate(names)
        },
        cam_from_ref=place.pose,
        sigma_rad=sigma_rad,
        sigma_m=sigma_m,
        n_views=len(solution.cams_from_board),
        n_corners=sum(len(part) for part in solution.residuals_px),
        rms_px=solution.rms_px,
        held_out_rms_px=held_out,
        colour=None if colour is None else _camera_colour(colour, encoding),
    )


def _pose_sigmas(
    place: UncertainPose, *, scale_known: bool
) -> tuple[FloatArray | None, FloatArray | None]:
    if place.cov is None:
        return None, None
    variance = np.diag(place.cov).copy()
    if not scale_known:
        variance[3:] += (_SCALE_SIGMA * place.pose.trans_m) ** 2
    sigmas = np.sqrt(variance)
    return sigmas[:3], sigmas[3:]


def _camera_colour(solution: ColourSolution, encoding: EncodingName) -> CameraColour:
    held_out = solution.held_out_delta_e[np.isfinite(solution.held_out_delta_e)]
    return CameraColour(
        model=solution.model,
        encoding=encoding,
        white_rgb=solution.white_rgb,
        delta_e_2000={
            "fit_mean": float(np.nanmean(solution.fit_delta_e)),
            "held_out_mean": float(held_out.mean()),
            "held_out_p95": float(np.quantile(held_out, 0.95)),
        },
    )


def gather_evidence(solved: RigSolution) -> Evidence:
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
            camera: item.cov
            for camera, item in solved.graph.cams_from_ref.items()
            if item.cov is not None
        },
        sums=solved.dataset.sums,
    )
