"""Whether stated uncertainties are true: python -m benchmarks.geometry.truth --draws 2000.

Noise is drawn again and again for one mono, one stereo and one ring of eight. The errors of all
camera parameters, of a triangulated point and of a baseline are held against the covariance that
each solve states of itself; then with 1 % gross errors on a board bent by 0.5 mm.
"""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from benchmarks.geometry import ours
from benchmarks.geometry.bound import N_CAMERA, N_LENS
from benchmarks.geometry.rigs import (
    SIGMA_PX,
    Scene,
    bent,
    observed,
)
from benchmarks.geometry.scenes import (
    mono,
    ring,
    stereo,
)
from benchmarks.geometry.tables import Bar, print_bars, print_table
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.triangulation import triangulate

__all__ = ["Sample", "bars", "draw", "main"]

SCENES: Mapping[str, Callable[[int], Scene]] = {"mono": mono, "stereo": stereo, "ring of 8": ring}
_NORMAL_95 = 1.959964
_COLUMNS = (*BrownConrady.NAMES, "omega x", "omega y", "omega z", "tau x", "tau y", "tau z")


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Errors of many draws, and what each solve said of them.

    Parameters
    ----------
    names : (P,) str
        Of the camera parameters that were free.
    n_held
        Of those that were not, but for the pose of the reference: they have errors without sigmas.
    errors, sigmas : (K, P) float
    mahalanobis : (K,) float
        e' C^-1 e of the camera parameters.
    lengths : dict
        name of a length -> errors over sigma, (K, n): coordinates of a point, or one baseline.
    """

    names: tuple[str, ...]
    n_held: int
    errors: FloatArray
    sigmas: FloatArray
    mahalanobis: FloatArray
    lengths: Mapping[str, FloatArray]


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--hard", type=int, default=500, help="draws with gross errors and bow")
    parser.add_argument("--geometry", type=int, default=0, help="seed of lenses and poses")
    parser.add_argument("--only", help="part of a scene's name")
    parser.add_argument("--verbose", action="store_true", help="print every parameter")
    options = parser.parse_args(argv)
    for name, make in SCENES.items():
        if options.only is not None and options.only not in name:
            continue
        scene = make(options.geometry)
        _report(
            name,
            draw(scene, options.draws, options.geometry),
            (0.07, 0.02),
            verbose=options.verbose,
        )
        hard = draw(bent(scene, 0.5e-3), options.hard, options.geometry, gross_share=0.01)
        _report(f"{name}, 1 % gross, 0.5 mm bow", hard, (0.15, None), verbose=options.verbose)


def _report(
    name: str, sample: Sample, tolerance: tuple[float, float | None], *, verbose: bool
) -> None:
    print(f"\n## {name}: {len(sample.errors)} draws, {len(sample.names)} free camera parameters")
    ratios = _ratios(sample)
    if verbose:
        rows = [
            (parameter, f"{ratio:.3f}", f"{bias:+.2f}")
            for parameter, ratio, bias in zip(sample.names, ratios, _biases(sample), strict=True)
        ]
        print_table(("parameter", "RMSE / sigma", "mean error / its standard error"), rows)
    print_bars(bars(sample, *tolerance))


def bars(sample: Sample, each: float, mean: float | None, widen: float = 1.0) -> list[Bar]:
    """Return the figures with their bars.

    Parameters
    ----------
    each, mean
        How far from 1 the ratio of each parameter and their mean may be; without a bar for the
        mean there is none for the rest either.
    widen
        What fewer draws multiply the ranges by.
    """
    ratios = _ratios(sample)
    n_draws, n_free = sample.errors.shape
    each *= widen
    sampling = float(1 / np.sqrt(2 * n_draws))
    low, high = int(ratios.argmin()), int(ratios.argmax())
    found = [
        Bar("camera parameters that are held at a value", sample.n_held, high=0),
        Bar(f"least RMSE / sigma ({sample.names[low]})", ratios[low], 1 - each, 1 + each, sampling),
        Bar(
            f"most RMSE / sigma ({sample.names[high]})", ratios[high], 1 - each, 1 + each, sampling
        ),
    ]
    if mean is None:
        return found
    mean *= widen
    found.append(Bar("mean RMSE / sigma", float(ratios.mean()), 1 - mean, 1 + mean))
    mahalanobis = sample.mahalanobis / n_free
    found.append(
        Bar(
            "mean Mahalanobis / degrees of freedom",
            float(mahalanobis.mean()),
            1 - 0.03 * widen,
            1 + 0.03 * widen,
            float(mahalanobis.std() / np.sqrt(n_draws)),
        )
    )
    for name, scaled in sample.lengths.items():
        covered = float((np.abs(scaled) < _NORMAL_95).mean())
        found.append(
            Bar(
                f"95 % interval of {name} covers",
                covered,
                0.95 - 0.02 * widen,
                min(0.95 + 0.02 * widen, 1.0),
                float(np.sqrt(0.95 * 0.05 / n_draws)),
            )
        )
    return found


def _ratios(sample: Sample) -> FloatArray:
    mean_square = (sample.errors**2).mean(axis=0)
    return np.asarray(np.sqrt(mean_square / (sample.sigmas**2).mean(axis=0)))


def _biases(sample: Sample) -> FloatArray:
    spread = sample.errors.std(axis=0) / np.sqrt(len(sample.errors))
    return np.asarray(sample.errors.mean(axis=0) / spread)


def draw(scene: Scene, n_draws: int, geometry: int, *, gross_share: float = 0.0) -> Sample:
    """Solve `n_draws` recordings of a scene; the first blind, the others from its solution.

    Raises
    ------
    ValueError
        If a solve has no covariance or frees other parameters than the first.
    """
    errors, sigmas, distances = [], [], []
    lengths: dict[str, list[FloatArray]] = {}
    names: tuple[str, ...] | None = None
    began = time.perf_counter()
    start: RigSolution | None = None
    for index in range(n_draws):
        recording = observed(scene, [geometry, index], gross_share=gross_share)
        solved = ours.solve(recording.dataset, scene.target, start=start)
        start = start or solved.solution
        if solved.covariance is None:
            raise ValueError(f"draw {index}: the solver states no covariance")
        free = np.diag(solved.covariance) > 0
        covariance = solved.covariance[np.ix_(free, free)]
        error = camera_errors(scene, solved)[free]
        own = tuple(np.array(parameter_names(scene))[free].tolist())
        names = own if names is None else names
        if own != names:
            raise ValueError(f"draw {index}: frees other parameters than the first")
        sigma = np.sqrt(np.diag(covariance))
        errors.append(error)
        sigmas.append(sigma)
        correlation = covariance / np.outer(sigma, sigma)
        distances.append(error / sigma @ np.linalg.solve(correlation, error / sigma))
        for name, value in _lengths(scene, solved, [geometry, index]).items():
            lengths.setdefault(name, []).append(value)
        if (index + 1) % 100 == 0:
            print(f"{index + 1} draws, {time.perf_counter() - began:.0f} s", flush=True)
    return Sample(
        names or (),
        len(parameter_names(scene)) - 6 - len(names or ()),
        np.array(errors),
        np.array(sigmas),
        np.array(distances),
        {name: np.array(values) for name, values in lengths.items()},
    )


def parameter_names(scene: Scene) -> list[str]:
    """Name the columns of a joint covariance."""
    return [f"{camera} {column}" for camera in scene.lenses for column in _COLUMNS]


def camera_errors(scene: Scene, solved: ours.Solved) -> FloatArray:
    """Solved minus true parameters of all cameras, (15 C,), poses as (omega, tau) of `Pose`."""
    parts = []
    for camera, lens in scene.lenses.items():
        true, found = scene.cams_from_ref[camera], solved.cams_from_ref[camera]
        turn = Rotation.from_matrix(found.rotation @ true.rotation.T).as_rotvec()
        parts += [
            solved.lenses[camera].parameters - lens.parameters,
            turn,
            found.trans_m - true.trans_m,
        ]
    return np.concatenate(parts)


def _lengths(scene: Scene, solved: ours.Solved, seed: Sequence[int]) -> dict[str, FloatArray]:
    """Errors over sigma of a baseline and a triangulated point, of a near and of a far pair."""
    cameras = list(scene.lenses)
    middle = len(cameras) // 2
    pairs = {(cameras[0], cameras[1]), (cameras[middle - 1], cameras[middle])} if middle else set()
    found = {}
    for pair in sorted(pairs):
        name = " and ".join(pair)
        found[f"the baseline of {name}"] = np.array([_baseline(scene, solved, pair)])
        found[f"a point seen by {name}"] = _point(scene, solved, pair, seed)
    return found


def _point(
    scene: Scene, solved: ours.Solved, pair: tuple[str, str], seed: Sequence[int]
) -> FloatArray:
    """Errors of the coordinates of a point that both cameras see over their sigmas, (3,)."""
    frame = next(frame for frame in scene.seen[pair[0]] if frame in scene.seen[pair[1]])
    point = scene.ref_from_boards[frame].apply(scene.corners_board.mean(axis=0))
    noise = np.random.default_rng([*seed, 2]).normal(0, SIGMA_PX, (2, 2))
    pixels = [
        scene.lenses[camera].project(scene.cams_from_ref[camera].apply(point)) for camera in pair
    ]
    found = triangulate(
        (np.array(pixels) + noise)[None],
        [solved.lenses[camera] for camera in pair],
        [solved.cams_from_ref[camera] for camera in pair],
        cov_px2=np.eye(2) * SIGMA_PX**2,
        cameras_cov=_of(solved, pair),
    )
    return np.asarray((found.points_ref[0] - point) / np.sqrt(np.diag(found.cov_m2[0])))


def _of(solved: ours.Solved, pair: tuple[str, str]) -> FloatArray:
    """Joint covariance of two cameras, (30, 30)."""
    if solved.solution.joint is None:
        raise ValueError("the solver states no covariance")
    return solved.solution.joint.of(*pair)


def _baseline(scene: Scene, solved: ours.Solved, pair: tuple[str, str]) -> float:
    """Error of the distance of two cameras over its sigma."""
    centres = [solved.cams_from_ref[camera].inverse().trans_m for camera in pair]
    offset = centres[1] - centres[0]
    length = float(np.linalg.norm(offset))
    slope = np.zeros((2, N_CAMERA))
    for row, camera, sign in zip(slope, pair, (-1, 1), strict=True):
        pose = solved.cams_from_ref[camera]
        # of the centre -R' t, which a step (omega, tau) moves by R' (omega x t - tau)
        by_centre = sign * offset / length @ pose.rotation.T
        row[N_LENS : N_LENS + 3] = np.cross(pose.trans_m, by_centre)
        row[N_LENS + 3 :] = -by_centre
    true = np.subtract(*(scene.cams_from_ref[camera].inverse().trans_m for camera in pair))
    sigma = float(np.sqrt(slope.ravel() @ _of(solved, pair) @ slope.ravel()))
    return (length - float(np.linalg.norm(true))) / sigma


if __name__ == "__main__":
    main()
