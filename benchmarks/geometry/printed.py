"""How much of real residuals the print makes: python -m benchmarks.geometry.printed RIG.json...

Each corner of a print is displaced a little, the same way in every view. With p those displacements
(along x and y of the board), R their Hessian and g their gradient once cameras, boards and bow have
taken up what they can, independent displacements of variance v and corner noise of factor f give

    E g'g = f tr R + v tr R^2        E chi^2 = f nu + v tr R        (nu: redundancy)

two equations for f and v. What is stated, chi^2 / nu times the inverse Hessian C of the cameras,
takes both for noise; the error has the covariance f C + v M M', with M the response to p.
`docs/uncertainty.md` says why it matters.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks.geometry.tables import print_table
from benchmarks.geometry.views import with_print

from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import inverse_of_scaled
from calichrome.geometry.bundle import (
    BoardShape,
    BundleEquations,
    BundleState,
    Free,
    Observations,
    ObservedView,
    solve_bundle,
)
from calichrome.geometry.bundle.blocks import chunk_residuals, view_blocks, whiten
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.bundle.noise import view_noise
from calichrome.geometry.uncertainty import picture_grid, projection_covariances
from calichrome.rig import Evidence, Rig, load_evidence, load_rig

__all__ = ["Moments", "main", "moments"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moments:
    """What the print does to a solved bundle.

    Parameters
    ----------
    variance_m2
        Of a displacement, per axis.
    share
        Of the squared residuals.
    stated, true : (A, A) float
        Covariance of the free camera-side unknowns, poses as left perturbations: as a solver
        states it, and with the print apart from the noise.
    """

    variance_m2: float
    share: float
    stated: FloatArray
    true: FloatArray


def moments(observations: Observations, state: BundleState, free: Free, n_corners: int) -> Moments:
    """Tell print errors from noise.

    Parameters
    ----------
    observations, state, free
        Of a solved bundle: `state` is its minimum.
    n_corners
        Of the board.
    """
    shape = with_print(state.shape, n_corners)
    n_print = 2 * n_corners
    parameters = np.concatenate([state.shape_parameters, np.zeros(n_print)])
    wide = BundleState.build(
        state.lenses, state.cams_from_ref, state.ref_from_boards, shape, parameters
    )
    everything = Free(
        lenses=free.lenses,
        cameras=free.cameras,
        shape=np.concatenate([free.shape, np.ones(n_print, dtype=bool)]),
    )
    blocks = view_blocks(observations, wide)
    reduced = BundleEquations(observations, wide, everything, blocks).reduced_hessian()
    if reduced is None:
        raise ValueError("a frame fixes no pose")
    solved, printed = slice(0, -n_print), slice(-n_print, None)
    covariance = inverse_of_scaled(reduced[solved, solved])
    if covariance is None:
        raise ValueError("the views leave a direction open")
    coupling = reduced[solved, printed]
    hessian = reduced[printed, printed] - coupling.T @ covariance @ coupling
    gradient = blocks.products[:, -1 - n_print : -1, -1].sum(axis=0)
    n_unknowns = len(covariance) + 6 * len(np.unique(observations.frame))
    redundancy = 2 * observations.n_corners - n_unknowns
    trace, square = float(np.trace(hessian)), float((hessian**2).sum())
    chi_square = 2 * blocks.cost
    equations = np.array([[trace, square], [redundancy, trace]])
    factor, variance = np.linalg.solve(equations, [float(gradient @ gradient), chi_square])
    response = covariance @ coupling
    return Moments(
        variance_m2=float(variance),
        share=float(variance) * trace / chi_square,
        stated=chi_square / redundancy * covariance,
        true=factor * covariance + variance * response @ response.T,
    )


def _bundle(rig: Rig, evidence: Evidence) -> tuple[Observations, BundleState]:
    """Pack the believed corners of a rig, whitened as stated, and its solution."""
    cameras = list(rig.cameras)
    frames = list(rig.frames)
    camera, frame = np.array(evidence.camera), np.array(evidence.frame)
    views = []
    for row, name in enumerate(cameras):
        for column, place in enumerate(frames):
            own = (camera == name) & (frame == place) & evidence.inlier
            if name in rig.frames[place].cameras and own.any():
                whitening = _whitening(evidence.cov_px[own])
                corners = evidence.corner[own], evidence.pixels[own]
                views.append(ObservedView(row, column, *corners, whitening))
    points = rig.target.corners_board
    state = BundleState.build(
        [rig.cameras[name].lens for name in cameras],
        [rig.cameras[name].cam_from_ref for name in cameras],
        [rig.frames[place].ref_from_board for place in frames],
        BoardShape.bowed(points, len(BOW_TERMS)),
    )
    return Observations.pack(views, points, state.models, len(frames)), state


def _whitening(cov_px: FloatArray) -> FloatArray | None:
    if not np.isfinite(cov_px).all():
        return None
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov_px[:, [[0, 1], [1, 2]]])))


def _solved(rig: Rig, evidence: Evidence) -> tuple[Observations, BundleState, Free]:
    """Solve once more, then once with the noise of each camera."""
    observations, state = _bundle(rig, evidence)
    free = Free.everything(state, list(rig.cameras).index(rig.reference_camera))
    for _ in range(2):
        state = solve_bundle(observations, state, free).state
        observations = _by_noise(observations, state, free)
    return observations, solve_bundle(observations, state, free).state, free


def _by_noise(observations: Observations, state: BundleState, free: Free) -> Observations:
    whitenings = [
        np.eye(2)[None, :, :, None] * chunk.filled[:, None, None]
        if chunk.whitening is None
        else chunk.whitening
        for chunk in observations.chunks
    ]
    lengths = [
        np.linalg.norm(whiten(item, rows), axis=1)
        for item, rows in zip(whitenings, chunk_residuals(observations, state), strict=True)
    ]
    kept = [chunk.filled for chunk in observations.chunks]
    noise = view_noise(observations, lengths, kept, free, views_differ=False)
    return observations.weighted(
        [
            item / noise[chunk.views][:, None, None, None]
            for chunk, item in zip(observations.chunks, whitenings, strict=True)
        ]
    )


def _ratios(rig: Rig, found: Moments, free: Free) -> tuple[float, float, float]:
    """Error over stated sigma: median parameter, worst projection, worst distance to `ref`."""
    every = np.sqrt(np.diag(found.true) / np.diag(found.stated))
    rows = np.full(len(free.mask), -1)
    rows[free.mask] = np.arange(len(found.stated))
    n_own = free.lenses.shape[1] + 6
    projections, distances = [], []
    for index, camera in enumerate(rig.cameras.values()):
        first = index * n_own
        own = rows[first : first + len(camera.lens.NAMES)]
        grid = picture_grid(camera.size_wh)
        projections.append(
            [np.trace(projection_covariances(camera.lens, cov[np.ix_(own, own)], grid).sum(axis=0))
             for cov in (found.true, found.stated)]
        )  # fmt: skip
        if free.cameras[index]:
            place = rows[first + n_own - 3 : first + n_own]
            along = camera.cam_from_ref.trans_m
            distances.append(
                [along @ cov[np.ix_(place, place)] @ along for cov in (found.true, found.stated)]
            )
    worst = [max(float(np.sqrt(a / b)) for a, b in part) for part in (projections, distances)]
    return float(np.median(every)), worst[0], worst[1]


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", type=Path, nargs="+", help="rig.json with its rig.npz beside it")
    rows = []
    for path in parser.parse_args(argv).rigs:
        rig, evidence = load_rig(path), load_evidence(path.with_suffix(".npz"))
        observations, state, free = _solved(rig, evidence)
        found = moments(observations, state, free, rig.target.n_corners)
        sigma_m = float(np.sign(found.variance_m2) * np.sqrt(abs(found.variance_m2)))
        ratios = [f"{ratio:.2f}" for ratio in _ratios(rig, found, free)]
        share = sigma_m / float(rig.target.square_m[0])
        rows.append(
            (path.stem, f"{len(rig.frames)}", f"{100 * share:.2f} %", f"{found.share:.2f}", *ratios)
        )
    print_table(_HEAD, rows)


_HEAD = (
    "rig", "frames", "sigma of a printed corner, of the square", "share of squared residuals",
    "error / stated: median parameter", "worst projection", "worst distance to ref",
)  # fmt: skip


if __name__ == "__main__":
    main()
