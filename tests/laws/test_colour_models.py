"""What every colour model promises, on what measured cameras make of a ColorChecker."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from colour.characterisation import (
    matrix_augmented_Cheung2004,
    polynomial_expansion_Finlayson2015,
)

from calichrome.colour.families import fit_model, leave_one_out, needed_colours
from calichrome.colour.model import ColourModel, TermModel
from calichrome.colour.models import MODELS, root_polynomial
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.core.arrays import FloatArray, IntArray

PairsOf = Callable[..., ColourPairs]

_CAMERAS = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
_NOISE = 0.01  # so that no promise is kept by the data alone
_TERM_MODELS = {name: model for name, model in MODELS.items() if issubclass(model, TermModel)}
_FITTED = [name for name, model in MODELS.items() if model.MIN_COLOURS > 0]
_SAFE = [name for name, model in MODELS.items() if model.HOMOGENEOUS and model.WHITE_EXACT]
_FREE = [name for name in _FITTED if name in _TERM_MODELS and not _TERM_MODELS[name].N_SHRUNK]

every_model = pytest.mark.parametrize("name", MODELS)
every_camera = pytest.mark.parametrize("camera", _CAMERAS)


@pytest.fixture(scope="module")
def fitted(checker_pairs: PairsOf) -> Callable[[str, str], tuple[ColourModel, ColourPairs]]:
    """Models fitted to noisy patches, by name and camera, and these."""

    @cache
    def model(name: str, camera: str) -> tuple[ColourModel, ColourPairs]:
        pairs = checker_pairs(camera, _NOISE)
        return fit_model(name, pairs), pairs

    return model


Fitted = Callable[[str, str], tuple[ColourModel, ColourPairs]]


def _reread(model: ColourModel) -> ColourModel:
    return MODELS[model.MODEL].from_json(json.loads(json.dumps(model.to_json())))


def _numeric_jacobian(model: ColourModel, rgb: FloatArray, step: float) -> FloatArray:
    columns = [
        (model.apply(rgb + step * axis) - model.apply(rgb - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    return np.stack(columns, axis=-1)


def _off(a: FloatArray, b: FloatArray) -> float:
    return float(np.abs(a - b).max())


@every_camera
@every_model
def test_jacobian_is_the_slope(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    model, _ = fitted(name, camera)
    rgb = rng.uniform(0.02, 1, (60, 3))
    expected = _numeric_jacobian(model, rgb, 1e-6)
    # rounding leaves 1e-9 of it; what is itself numeric has a wider step than this test's
    tolerance = 1e-7 if name in _TERM_MODELS else 1e-6
    assert _off(model.jacobian(rgb), expected) < tolerance * np.abs(expected).max()
    picture = rgb.reshape(5, 4, 3, 3)
    assert model.apply(picture).shape == (5, 4, 3, 3)
    assert model.jacobian(picture).shape == (5, 4, 3, 3, 3)


@every_camera
@every_model
def test_exposure_stays_one_exactly_where_claimed(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    model, _ = fitted(name, camera)
    rgb = rng.uniform(0.02, 0.9, (60, 3))
    here = model.apply(rgb)
    off = max(_off(model.apply(k * rgb) / k, here) for k in (0.1, 0.25, 4.0, 10.0))
    if model.HOMOGENEOUS:
        assert off < 1e-12 * np.abs(model.jacobian(rgb)).max()
    else:
        assert off > 1e-3


@every_camera
@every_model
def test_white_is_exact_exactly_where_claimed(name: str, camera: str, fitted: Fitted) -> None:
    model, pairs = fitted(name, camera)
    for read in (model, _reread(model)):
        off = _off(read.apply(pairs.white_rgb), pairs.white_xyz)
        assert off < 1e-12 if model.WHITE_EXACT else off > 1e-3


@every_camera
@every_model
def test_models_survive_their_file(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    model, _ = fitted(name, camera)
    assert name == model.MODEL
    read, rgb = _reread(model), rng.uniform(-0.1, 1.2, (500, 3))
    assert read.to_json() == model.to_json()
    assert read.n_free == model.n_free
    # the plain matrix is written without the whites it was fitted about: one more rounding
    assert _off(read.apply(rgb), model.apply(rgb)) < 1e-14 * np.abs(model.apply(rgb)).max()


@every_camera
@pytest.mark.parametrize("name", ["thin-plate-exact", "tetrahedral"])
def test_interpolating_models_meet_every_disc(name: str, camera: str, fitted: Fitted) -> None:
    model, pairs = fitted(name, camera)
    assert _off(model.apply(pairs.rgb), pairs.xyz) < 1e-11
    again, twice = fit_model(name, replace(pairs, xyz=pairs.xyz[::-1].copy())), pairs.xyz[::-1]
    assert _off(again.apply(pairs.rgb), twice) < 1e-11  # whatever they are to become


@every_camera
@every_model
def test_every_colour_has_a_value_and_a_slope(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    """The cube, its faces, edges and corners, black, what is over white and below black."""
    model, pairs = fitted(name, camera)
    colours = rng.uniform(-0.5, 2.5, (100_000, 3))
    colours[:5_000] *= rng.integers(0, 2, (5_000, 3))
    colours[5_000:10_000] = np.clip(colours[5_000:10_000], 0, 1)
    colours[10_000:15_000] *= 1e-12
    colours[15_000:20_000] = colours[15_000:20_000, :1]  # greys, balanced
    colours[0], colours[1] = 0.0, -1.0
    rgb = colours * pairs.white_rgb
    assert np.isfinite(model.apply(rgb)).all()
    assert np.isfinite(model.jacobian(rgb)).all()


@every_camera
@pytest.mark.parametrize("name", [name for name in _TERM_MODELS if MODELS[name].HOMOGENEOUS])
def test_slopes_do_not_grow_towards_black(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    """Roots have infinite slopes at 0; a slope of degree 0 is the same at any exposure."""
    model, _ = fitted(name, camera)
    rgb = rng.uniform(0, 1, (500, 3)) * rng.integers(0, 2, (500, 3))
    rgb[:3] = np.eye(3)
    here = model.jacobian(rgb)
    for share in (1e-3, 1e-9):
        assert _off(model.jacobian(share * rgb), here) < 1e-9 * np.abs(here).max()


@every_camera
@pytest.mark.parametrize("name", _SAFE)
def test_greys_stay_grey(name: str, camera: str, fitted: Fitted) -> None:
    """White exact and exposure kept: every grey follows, and brighter ones are brighter."""
    model, pairs = fitted(name, camera)
    levels = np.linspace(0, 1.5, 300)[:, None]
    assert _off(model.apply(levels * pairs.white_rgb), levels * pairs.white_xyz) < 1e-12


@every_model
def test_greys_rise(name: str, checker_pairs: PairsOf) -> None:
    """Without noise they do under every model, at a camera that suits it."""
    pairs = checker_pairs(_CAMERAS[0])
    greys = np.linspace(0, 1.25, 300)[:, None] * pairs.white_rgb
    assert (np.diff(fit_model(name, pairs).apply(greys), axis=0) > 0).all()


@pytest.mark.parametrize("name", _FITTED)
def test_too_few_colours_are_refused(name: str, checker_pairs: PairsOf) -> None:
    pairs, least = checker_pairs(_CAMERAS[0], _NOISE), MODELS[name].MIN_COLOURS
    row = np.random.default_rng(3).permutation(len(pairs))  # not the skins first
    with pytest.raises(ValueError, match=rf"{name} needs {least} colours, got {least - 1}"):
        fit_model(name, pairs[row < least - 1])
    enough = fit_model(name, pairs[row < least])
    assert np.isfinite(enough.apply(pairs.rgb)).all()
    spare = pairs[row < needed_colours(name)]
    assert np.isfinite(leave_one_out(name, spare)).all()


def test_unknown_names_are_refused(checker_pairs: PairsOf) -> None:
    with pytest.raises(ValueError, match="colour model 'magic' is unknown; choose from white-bal"):
        fit_model("magic", checker_pairs(_CAMERAS[0]))


def _in_order(pairs: ColourPairs, order: IntArray) -> ColourPairs:
    rows = ("rgb", "xyz", "rgb_cov", "xyz_cov", "weights", "whitening")
    return replace(pairs, **{name: getattr(pairs, name)[order] for name in rows})


@every_camera
@every_model
def test_the_order_of_discs_means_nothing(
    name: str, camera: str, fitted: Fitted, rng: np.random.Generator
) -> None:
    model, pairs = fitted(name, camera)
    shuffled = fit_model(name, _in_order(pairs, rng.permutation(len(pairs))))
    rgb = rng.uniform(0, 1, (200, 3)) * pairs.white_rgb
    expected = model.apply(rgb)
    # 20 free terms of a ColorChecker have a condition number of 1e8: half the digits go
    assert _off(shuffled.apply(rgb), expected) < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("n_terms", [7, 10, 11, 20])
def test_terms_of_cheung_are_the_published(n_terms: int, rng: np.random.Generator) -> None:
    balanced = rng.uniform(0, 1, (50, 3))
    published = matrix_augmented_Cheung2004(balanced, n_terms)
    terms = _TERM_MODELS[f"cheung-{n_terms}"].terms(balanced)
    assert terms.shape == published.shape
    order = [int(np.abs(terms.T - column).max(axis=1).argmin()) for column in published.T]
    assert sorted(order) == list(range(n_terms))
    np.testing.assert_allclose(terms[:, order], published, atol=1e-15)


@pytest.mark.parametrize(("name", "degree"), [("root-polynomial-2", 2), ("root-polynomial-3", 3)])
def test_roots_span_the_published(
    name: str, degree: int, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Without the lift at 0, which the published ones lack, the same models in another basis."""
    monkeypatch.setattr(root_polynomial, "LIFT", 1e-12)
    balanced = rng.uniform(0.05, 1, (80, 3))
    published = polynomial_expansion_Finlayson2015(balanced, degree, root_polynomial_expansion=True)
    terms = _TERM_MODELS[name].terms(balanced)
    assert terms.shape == published.shape
    for wanted, basis in ((published, terms), (terms, published)):
        coefficients, *_ = np.linalg.lstsq(basis, wanted, rcond=None)
        np.testing.assert_allclose(basis @ coefficients, wanted, atol=1e-9)


def _whitened(pairs: ColourPairs, model: type[TermModel]) -> tuple[FloatArray, FloatArray]:
    """Rows and right side of the least squares that a fit is, written out."""
    terms = model.terms(pairs.balanced)
    wanted = pairs.relative - (pairs.balanced[:, 1:2] if model.WHITE_EXACT else 0.0)
    factor = np.swapaxes(np.linalg.cholesky(pairs.whitening), 1, 2)
    rows = np.einsum("nk,nij->nikj", terms, factor).reshape(3 * len(pairs), -1)
    return rows, np.einsum("nij,nj->ni", factor, wanted).ravel()


@every_camera
@pytest.mark.parametrize("name", _FREE)
def test_fits_are_weighted_least_squares(name: str, camera: str, checker_pairs: PairsOf) -> None:
    pairs = checker_pairs(camera, _NOISE)
    model = _TERM_MODELS[name]
    solution, *_ = np.linalg.lstsq(*_whitened(pairs, model), rcond=None)
    coefficients = np.asarray(solution, dtype=np.float64).reshape(-1, 3)
    expected = model(pairs.white_rgb, pairs.white_xyz, coefficients)
    found, _ = fit_terms(model, pairs)
    # XYZ; near black a hundred-thousandth is a hundredth of a dE
    assert _off(found.apply(pairs.rgb), expected.apply(pairs.rgb)) < 1e-7


@every_camera
@pytest.mark.parametrize("name", _FREE)
def test_equal_weights_give_plain_least_squares(
    name: str, camera: str, checker_pairs: PairsOf
) -> None:
    """What the published methods do."""
    noisy = checker_pairs(camera, _NOISE)
    pairs = replace(noisy, whitening=np.broadcast_to(4 * np.eye(3), (len(noisy), 3, 3)))
    model = _TERM_MODELS[name]
    base = pairs.balanced[:, 1:2] if model.WHITE_EXACT else 0.0
    terms = model.terms(pairs.balanced)
    coefficients, *_ = np.linalg.lstsq(terms, pairs.relative - base, rcond=None)
    found, _ = fit_terms(model, pairs)
    expected = (base + terms @ coefficients) * pairs.white_xyz
    assert _off(found.apply(pairs.rgb), expected) < 1e-7
