"""What was solved, put together as the rig that others read."""

from collections.abc import Mapping, Sequence

import numpy as np

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.rig_fit import ColourSolution, between_cameras
from calichrome.colour.selection import Candidate
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding
from calichrome.core.pose import Pose
from calichrome.geometry.halves import Halves
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rig_solution import RigSolution, rms_px
from calichrome.geometry.uncertainty import projection_sigma_px
from calichrome.observations import BoardView
from calichrome.rig import (
    BoardWarp,
    Camera,
    CameraColour,
    CameraCovariance,
    Evidence,
    Pair,
    PlacedFrame,
    Rig,
)
from calichrome.target import Target

__all__ = ["assemble_rig", "gather_evidence"]

_SCALE_SIGMA = 0.005  # relative: what a printer driver's "fit to page" leaves unnoticed


def assemble_rig(  # noqa: PLR0917 (one argument for each part that was solved)
    solved: RigSolution,
    target: Target,
    held_out: Mapping[str, float | None],
    colours: Mapping[str, ColourSolution],
    encodings: Mapping[str, EncodingName | ToneCurve | None],
    bits: Mapping[str, int | None],
    vignettings: Mapping[str, Vignetting],
    findings: Sequence[Finding],
    world_from_ref: Pose,
    halves: Halves | None = None,
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
    vignettings
        By camera; cameras whose fall-off was not told are absent.
    findings
        All of them.
    world_from_ref
        The world's frame.
    halves
        Halves of the frames, if they were compared.
    """
    cameras = {
        camera: _camera(
            camera,
            solved,
            target,
            held_out[camera],
            _camera_colour(colours.get(camera), encodings[camera], bits[camera]),
            None if halves is None else halves.ratio(camera),
            vignettings.get(camera),
        )
        for camera in solved.lenses
    }
    differences = between_cameras(colours)
    return Rig(
        target=target,
        reference_camera=solved.reference,
        cameras=cameras,
        pairs=tuple(
            Pair(names, pair.n_shared, pair.rms_px) for names, pair in solved.pairs.items()
        ),
        frames={
            frame: PlacedFrame(place, solved.cameras_of(frame))
            for frame, place in solved.ref_from_boards.items()
        },
        findings=tuple(findings),
        inter_camera_delta_e_2000=None
        if len(differences) == 0
        else {
            "mean": float(differences.mean()),
            "p95": float(np.quantile(differences, 0.95)),
            "held_out_mean": float(between_cameras(colours, held_out=True).mean()),
        },
        world_from_ref=world_from_ref,
        warp=_warp(solved),
    )


def _camera(  # noqa: PLR0917 (all that is known of a camera)
    camera: str,
    solved: RigSolution,
    target: Target,
    held_out: float | None,
    colour: CameraColour | None,
    halves_ratio: float | None,
    vignetting: Vignetting | None,
) -> Camera:
    lens, cov = solved.lenses[camera], solved.lens_cov[camera]
    size_wh = solved.dataset.sizes_wh[camera]
    sigmas = None if cov is None else np.sqrt(np.diag(cov))
    place = solved.cams_from_ref[camera]
    pose_cov = _pose_cov(place, solved.pose_cov[camera], scale_known=target.square_size_measured)
    pose_sigmas = None if pose_cov is None else np.sqrt(np.diag(pose_cov))
    residuals = solved.camera_residuals(camera)
    return Camera(
        size_wh=size_wh,
        lens=lens,
        lens_sigma={
            name: None if sigmas is None else float(sigmas[index])
            for index, name in enumerate(lens.NAMES)
        },
        cam_from_ref=place,
        sigma_rad=None if pose_sigmas is None else pose_sigmas[:3],
        sigma_m=None if pose_sigmas is None else pose_sigmas[3:],
        cov_m=None if pose_cov is None else pose_cov[3:, 3:],
        n_views=len(solved.dataset.views[camera]),
        n_corners=len(residuals),
        rms_px=rms_px(residuals),
        held_out_rms_px=held_out,
        projection_sigma_px=None if cov is None else _projection_sigma(lens, cov, size_wh),
        halves_ratio=halves_ratio,
        vignetting=vignetting,
        colour=colour,
    )


def _projection_sigma(lens: Lens, cov: FloatArray, size_wh: tuple[int, int]) -> tuple[float, float]:
    sigma = projection_sigma_px(lens, cov, size_wh)
    return float(np.sqrt(np.nanmean(sigma**2))), float(np.nanmax(sigma))


def _warp(solved: RigSolution) -> BoardWarp | None:
    if solved.shape is None or solved.shape_held or len(solved.shape) == 0:
        return None
    names = solved.shape.names
    sigma: list[float | None] = [None] * len(names)
    if solved.joint is not None:
        rows = solved.joint.shape
        sigma = [float(value) for value in np.sqrt(np.diag(solved.joint.matrix)[rows])]
    return BoardWarp(
        dict(zip(names, map(float, solved.shape_parameters), strict=True)),
        dict(zip(names, sigma, strict=True)),
    )


def _pose_cov(place: Pose, cov: FloatArray | None, *, scale_known: bool) -> FloatArray | None:
    """Covariance of (omega, tau); an unverified scale stretches all lengths by one factor."""
    if cov is None:
        return None
    cov = cov.copy()
    if not scale_known:
        cov[3:, 3:] += _SCALE_SIGMA**2 * np.outer(place.trans_m, place.trans_m)
    return cov


def _camera_colour(
    solution: ColourSolution | None, encoding: EncodingName | ToneCurve | None, bits: int | None
) -> CameraColour | None:
    if solution is None:
        return None
    held_out = solution.held_out_delta_e[np.isfinite(solution.held_out_delta_e)]
    uncertainty = solution.uncertainty_delta_e[np.isfinite(solution.uncertainty_delta_e)]
    return CameraColour(
        model=solution.model,
        encoding=encoding,
        bits=bits,
        white_rgb=solution.white_rgb,
        delta_e_2000={
            "fit_mean": float(np.nanmean(solution.fit_delta_e)),
            "held_out_mean": float(held_out.mean()),
            "held_out_p95": float(np.quantile(held_out, 0.95)),
            "uncertainty_p95": float(uncertainty.mean()) if len(uncertainty) else None,
        },
        candidates=tuple(_candidate(item) for item in solution.candidates),
    )


def _candidate(item: Candidate) -> dict[str, object]:
    """One row of rig.json's table of models; null where a model had too few colours."""
    row: dict[str, object] = {"model": item.name, "why_not": item.why_not or None}
    stability = item.stability
    if item.model is None or stability is None:
        return row
    return row | {
        "n_free": item.model.n_free,
        "solver": item.solver,
        "fit_mean": float(item.fit_delta_e.mean()),
        "left_out_mean": item.mean,
        "left_out_p95": float(np.quantile(item.left_out_delta_e, 0.95)),
        "exposure_delta_e": stability.exposure_delta_e,
        "gain": stability.gain if np.isfinite(stability.gain) else None,
        "white_delta_e": stability.white_delta_e,
        "grey_monotone": stability.grey_monotone,
        "hue_reversals": stability.hue_reversals,
        "farthest": stability.farthest,
        "ns_per_pixel": item.ns_per_pixel,
    }


def gather_evidence(solved: RigSolution, target: Target) -> Evidence:
    """Return the arrays of rig.npz."""
    rows = [
        (camera, frame, view)
        for camera, views in solved.dataset.views.items()
        for frame, view in views.items()
    ]
    return Evidence(
        camera=tuple(camera for camera, _, view in rows for _ in view.corner_ids),
        frame=tuple(frame for _, frame, view in rows for _ in view.corner_ids),
        corner=np.concatenate([view.corner_ids for _, _, view in rows]),
        pixels=np.concatenate([view.corners_px for _, _, view in rows]),
        residuals_px=np.concatenate([solved.residuals_px[row[:2]] for row in rows]),
        cov_px=np.concatenate([_stated(view) for _, _, view in rows]),
        inlier=np.concatenate([solved.inliers[row[:2]] for row in rows]),
        lens_cov={camera: cov for camera, cov in solved.lens_cov.items() if cov is not None},
        pose_cov={
            camera: cov
            for camera, place in solved.cams_from_ref.items()
            if (
                cov := _pose_cov(
                    place, solved.pose_cov[camera], scale_known=target.square_size_measured
                )
            )
            is not None
        },
        joint=_joint(solved),
        sums=solved.dataset.sums,
    )


def _stated(view: BoardView) -> FloatArray:
    """Covariances of a view's corners, (N, 3): xx, xy, yy; nan where none was stated."""
    if view.cov_px is None:
        return np.full((len(view.corner_ids), 3), np.nan)
    return view.cov_px[:, [0, 0, 1], [0, 1, 1]]


def _joint(solved: RigSolution) -> CameraCovariance | None:
    if solved.joint is None:
        return None
    moves = [f"{kind}_{axis}" for kind in ("omega", "tau") for axis in "xyz"]
    camera: list[str] = []
    parameter: list[str] = []
    for name, lens in solved.lenses.items():
        parameter += [*lens.NAMES, *moves]
        camera += [name] * (len(lens.NAMES) + 6)
    rows = np.concatenate([*solved.joint.columns.values(), solved.joint.shape])
    if solved.shape is not None:
        parameter += solved.shape.names
        camera += [""] * len(solved.shape)
    return CameraCovariance(
        camera=tuple(camera),
        parameter=tuple(parameter),
        matrix=solved.joint.matrix[np.ix_(rows, rows)],
    )
