"""Stated uncertainties of colour against what fresh noise does."""

from collections.abc import Callable

import numpy as np
import pytest

from calichrome.colorimetry.description import DESCRIPTION_SPACES, DescriptionSpace, difference
from calichrome.colorimetry.difference import xyz_per_lab
from calichrome.colour.model import TermModel
from calichrome.colour.models import MODELS
from calichrome.colour.models.linear import LinearWhite
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.colour.uncertainty import bound_95, flattening, propagate
from calichrome.core.arrays import FloatArray
from calichrome.synthetic.spectra import random_reflectance

PairsOf = Callable[..., ColourPairs]
See = Callable[[str, FloatArray], FloatArray]

_CAMERA = "Nikon 5100 (NPL)"
_FREE = ((_CAMERA, "linear-white"), ("bells", "root-polynomial-2"))
_CAMERAS = (_CAMERA, "Sigma SDMerill (NPL)", "bells")
_DRAWS = 2000
_NOISE, _PRINT_SD = 0.004, 0.5  # of a channel; in L, a and b


class _Lottery:
    """The same chart again and again, with fresh noise of the camera and of the print."""

    def __init__(self, like: ColourPairs, noise: float, print_sd: float) -> None:
        self._like, self._noise = like, noise
        self._slopes = print_sd * xyz_per_lab(like.xyz, like.white_xyz)
        self._rgb_cov = (noise * like.rgb)[:, :, None] ** 2 * np.eye(3)
        self._xyz_cov = self._slopes @ np.swapaxes(self._slopes, 1, 2)
        self.clean = self._pairs(like.rgb, like.xyz)

    def draw(self, rng: np.random.Generator) -> ColourPairs:
        shape = self._like.rgb.shape
        steps = np.einsum("nij,nj->ni", self._slopes, rng.normal(size=shape))
        return self._pairs(
            self._like.rgb * rng.normal(1, self._noise, shape), self._like.xyz + steps
        )

    def _pairs(self, rgb: FloatArray, xyz: FloatArray) -> ColourPairs:
        like = self._like
        return ColourPairs.of(
            rgb, xyz, white_rgb=like.white_rgb, white_xyz=like.white_xyz,
            adopted_white=like.adopted_white, rgb_cov=self._rgb_cov, xyz_cov=self._xyz_cov,
        )  # fmt: skip


def _corrected(model: TermModel, coefficients: FloatArray, rgb: FloatArray) -> FloatArray:
    """By the model with each row of coefficients, (draws, n, 3)."""
    balanced = rgb / model.white_rgb
    base = balanced[:, 1:2] if model.WHITE_EXACT else 0.0
    terms = model.terms(balanced)
    return np.asarray(
        (base + terms @ coefficients.reshape(-1, terms.shape[1], 3)) * model.white_xyz
    )


def _unseen(camera: str, see: See) -> FloatArray:
    rng = np.random.default_rng(8)
    return see(camera, np.array([random_reflectance(rng) for _ in range(60)]))


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "name"), _FREE)
def test_bounds_hold_in_95_of_100_cases(
    camera: str, name: str, checker_pairs: PairsOf, see: See, rng: np.random.Generator
) -> None:
    """Colours that were not on the chart, by fits to fresh noise."""
    model = MODELS[name]
    assert issubclass(model, TermModel)
    lottery = _Lottery(checker_pairs(camera), _NOISE, _PRINT_SD)
    fitted, solved = fit_terms(model, lottery.clean)
    stated = propagate(fitted, solved, lottery.clean)
    fits = [fit_terms(model, lottery.draw(rng))[0].coefficients.ravel() for _ in range(_DRAWS)]
    coefficients = np.array(fits)
    rgb, white = _unseen(camera, see), lottery.clean.adopted_white
    truth = fitted.apply(rgb)
    corrected = _corrected(fitted, coefficients, rgb)
    cov = stated.of_xyz(rgb)
    _hold(difference(corrected, truth, "lab2000", white), bound_95(truth, cov, white))

    # the model's error and that of a reading of 1 % noise
    readings = rgb * rng.normal(1, 0.01, corrected.shape)
    slopes = fitted.jacobian(rgb)
    read = corrected + np.einsum("nij,dnj->dni", slopes, readings - rgb)
    noisy_cov = stated.of_xyz(rgb, (0.01 * rgb)[:, :, None] ** 2 * np.eye(3))
    _hold(difference(read, truth, "lab2000", white), bound_95(truth, noisy_cov, white))

    # a standard deviation of 2000 draws is known to 1.6 %; the noise of the regressors, which
    # errors of first order leave out, is some per cent
    spread = corrected.std(axis=0) / np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    assert spread.min() > 0.9
    assert spread.max() < 1.15
    _match(np.cov(coefficients.T), stated.matrix)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "noise", "print_sd"),
    [
        ("root-polynomial-2-white", 0.01, 0.5),
        ("root-polynomial-2-white", 0.01, 3.0),
        ("root-polynomial-2-white", 0.03, 0.5),
        ("hue-plane", 0.01, 0.5),
        ("hue-plane", 0.01, 3.0),
        ("subspaces", 0.01, 0.5),
        ("root-polynomial-3-white", 0.03, 0.5),
    ],
)
def test_bounds_of_drawn_models_hold_in_95_of_100_cases(
    name: str, noise: float, print_sd: float, checker_pairs: PairsOf, see: See,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Each repetition chooses its strength and states its own bound; 2000 over three cameras.

    The bias that a pull leaves is a fixed number for one camera and one colour, so that the bound
    can hold on average over cameras and colours, not for each alone.
    """
    model = MODELS[name]
    assert issubclass(model, TermModel)
    inside = []
    for camera in _CAMERAS:
        lottery = _Lottery(checker_pairs(camera), noise, print_sd)
        rgb, white = _unseen(camera, see), lottery.clean.adopted_white
        truth = fit_terms(model, lottery.clean)[0].apply(rgb)
        for _ in range(_DRAWS // len(_CAMERAS)):
            pairs = lottery.draw(rng)
            fitted, solved = fit_terms(model, pairs)
            corrected = fitted.apply(rgb)
            bound = bound_95(corrected, propagate(fitted, solved, pairs).of_xyz(rgb), white)
            inside.append(difference(corrected, truth, "lab2000", white) <= bound)
    assert 0.93 <= np.mean(inside) <= 0.97


def test_noisy_colours_flatten_as_foretold(
    checker_pairs: PairsOf, rng: np.random.Generator
) -> None:
    """Of a camera whose channels overlap much; the mean of 400 fits is off by what is stated."""
    lottery = _Lottery(checker_pairs("Sigma SDMerill (NPL)"), 0.02, 0.0)
    exact = fit_terms(LinearWhite, lottery.clean)[0].coefficients.ravel()
    shifts, foretold = [], []
    for _ in range(400):
        pairs = lottery.draw(rng)
        fitted, solved = fit_terms(LinearWhite, pairs)
        shifts.append(fitted.coefficients.ravel() - exact)
        foretold.append(flattening(fitted, solved, pairs))
    mean, sigma = np.mean(shifts, axis=0), np.std(shifts, axis=0) / np.sqrt(len(shifts))
    assert (np.abs(mean) > 5 * sigma).any()  # there is something to foretell
    np.testing.assert_allclose(
        np.mean(foretold, axis=0), mean, atol=float(4 * sigma.max()), rtol=0.15
    )


def _hold(errors: FloatArray, bound: FloatArray) -> None:
    inside = errors <= bound
    assert 0.93 <= inside.mean() <= 0.97
    assert inside.mean(axis=0).min() > 0.90  # of every colour


def _match(sample: FloatArray, stated: FloatArray) -> None:
    """Compare covariances of parameters along every direction of theirs."""
    ratio = np.sqrt(np.diag(sample) / np.diag(stated))
    assert 0.9 < ratio.min() < ratio.max() < 1.15
    whitener = np.linalg.inv(np.linalg.cholesky(stated))
    spread = np.linalg.eigvalsh(whitener @ sample @ whitener.T)
    # 18 eigenvalues of 2000 draws scatter by 20 % themselves
    assert 0.75 < spread.min() < spread.max() < 1.35


@pytest.mark.parametrize("space", DESCRIPTION_SPACES)
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.1), (1.0, 0.0, 0.0)])
def test_the_bound_of_any_covariance(
    space: DescriptionSpace, axes: tuple[float, ...], checker_pairs: PairsOf,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Errors alike in all directions, in few, in one: 95 % in every space."""
    xyz, white = checker_pairs(_CAMERA).xyz, checker_pairs(_CAMERA).adopted_white
    turned = np.linalg.qr(rng.normal(size=(len(xyz), 3, 3)))[0]
    # small for the colour, or the metric is not that of the difference
    factor = 2e-3 * xyz[:, 1, None, None] * turned * np.array(axes)
    bound = bound_95(xyz, factor @ np.swapaxes(factor, 1, 2), white, space)
    draws = xyz + np.einsum("nij,dnj->dni", factor, rng.normal(size=(4000, len(xyz), 3)))
    inside = difference(draws, xyz, space, white) <= bound
    assert 0.94 <= inside.mean() <= 0.96
    # three unequal axes as one chi-square: not exact, nearly so
    assert inside.mean(axis=0).min() > 0.93
    assert inside.mean(axis=0).max() < 0.97


def test_more_noise_is_more_uncertain(checker_pairs: PairsOf, see: See) -> None:
    like = checker_pairs(_CAMERA)
    rgb = _unseen(_CAMERA, see)
    bounds = []
    for noise, print_sd in ((0.002, 0.5), (0.02, 0.5), (0.02, 3.0)):
        pairs = _Lottery(like, noise, print_sd).clean
        fitted, solved = fit_terms(LinearWhite, pairs)
        cov = propagate(fitted, solved, pairs).of_xyz(rgb)
        bounds.append(bound_95(fitted.apply(rgb), cov, pairs.adopted_white))
    assert (bounds[0] < bounds[1]).all()
    assert (bounds[1] < bounds[2]).all()
    exact = _Lottery(like, 0.0, 0.0).clean
    fitted, solved = fit_terms(LinearWhite, exact)
    cov = propagate(fitted, solved, exact).of_xyz(rgb)
    assert bound_95(fitted.apply(rgb), cov, exact.adopted_white).max() == pytest.approx(0, abs=1e-9)
