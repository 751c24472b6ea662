"""Whether the covariance of the corners is true: python -m benchmarks.detection.covariance.

Mean of e' C^-1 e / 2 with the detector's own C, which is 1 if C is true: by strata of blur and
noise on linear pictures of 1.2 MP, then on pictures that were encoded, compressed, demosaiced or
sharpened. The ratios say what that costs: they are to the bound of one linear grey channel.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
from benchmarks.detection.bound import corner_cells, cramer_rao
from benchmarks.detection.peers import Detection, Detector
from benchmarks.detection.scenes import Scene, random_scene
from benchmarks.detection.scoring import Score, compare, ratios, summary
from benchmarks.detection.variants import VARIANTS

from calichrome.core.arrays import FloatArray
from calichrome.detection import detect_board
from calichrome.observations import BoardView

__all__ = ["main"]

_PSF_PX = ((0.5, 0.8), (0.8, 1.1), (1.1, 1.5))
_NOISE_DN = ((1.0, 2.0), (2.0, 3.5), (3.5, 5.0))
_CLEAN = "linear 8 bit grey"
_OURS = Detector(None, "absolute")


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--corners", type=int, default=2000, help="corners of a stratum")
    parser.add_argument("--variants", default="all", help="part of a variant's name, or none")
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    print(
        "| pictures | PSF px | noise DN | views | corners | chi2 | chi2 without top 1 % | "
        "in 95 % ellipse | ratio median | ratio RMS | ratio p95 |"
    )
    print("|" + " --- |" * 11)
    for stratum, (psf_px, noise_dn) in enumerate(product(_PSF_PX, _NOISE_DN)):
        _stratum(_CLEAN, psf_px, noise_dn, options.corners, first=10_000 * (stratum + 1))
    for name in VARIANTS:
        if options.variants in {"all", name} or options.variants in name:
            _stratum(name, (0.5, 1.5), (1.0, 5.0), options.corners, first=500_000)


def _stratum(
    name: str,
    psf_px: tuple[float, float],
    noise_dn: tuple[float, float],
    n_corners: int,
    *,
    first: int,
) -> None:
    """Detect boards until there are enough corners, and print the row."""
    values: list[FloatArray] = []
    scores: list[FloatArray] = []
    n_views = n_found = 0
    seed = first
    while sum(map(len, values)) < n_corners and seed < first + n_corners // 10:
        scene = _scene(seed, psf_px, noise_dn)
        seed += 1
        if scene is None:
            continue
        score = _detected(name, scene)
        n_views += 1
        n_found += len(score.ids) > 0
        chi2 = _normalised(score)
        if chi2 is None:
            print(f"| {name} | the detector states no covariance |")
            return
        values.append(chi2)
        scores.append(ratios(score, cramer_rao(scene, corner_cells(scene))))
    found = np.concatenate(values)
    if not len(found):
        print(f"| {name} | no board found in {n_views} views |")
        return
    body = np.sort(found)[: int(0.99 * len(found))]
    inside = np.mean(found < np.log(20))  # of an exponential law, 95 %
    print(
        f"| {name} | {psf_px[0]:g}-{psf_px[1]:g} | {noise_dn[0]:g}-{noise_dn[1]:g} | "
        f"{n_found} of {n_views} | {len(found)} | {found.mean():.2f} | "
        f"{body.mean() / _BODY_MEAN:.2f} | {inside:.3f} | {' | '.join(summary(scores))} |"
    )


_BODY_MEAN = float((1 - 0.01 + 0.01 * np.log(0.01)) / 0.99)
"""Mean of the lower 99 % of an exponential law of mean 1."""


def _scene(seed: int, psf_px: tuple[float, float], noise_dn: tuple[float, float]) -> Scene | None:
    scene = random_scene(seed)
    if scene.megapixels > 1.5:
        return None
    rng = scene.rng(20)
    return replace(scene, psf_sigma_px=rng.uniform(*psf_px), noise_dn=rng.uniform(*noise_dn))


def _detected(name: str, scene: Scene) -> Score:
    view = detect_board(VARIANTS[name](scene, scene.rng(21)), scene.target)
    detection = None
    if isinstance(view, BoardView):
        detection = Detection(view.corners_px, view.corner_ids, view.cov_px)
    return compare(_OURS, detection, scene.corners_px, scene.spacing_px)


def _normalised(score: Score) -> FloatArray | None:
    """Return e' C^-1 e / 2 of the found corners; None if the detector states no C."""
    if not len(score.ids):
        return np.empty(0)
    if score.cov_px is None:
        return None
    inverse = np.linalg.inv(score.cov_px)
    return np.asarray(np.einsum("ni,nij,nj->n", score.errors_px, inverse, score.errors_px) / 2)


if __name__ == "__main__":
    main()
