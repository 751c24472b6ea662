"""Black level and stray light, from black and white squares."""

import numpy as np
import pytest

from calichrome.colour.flare import measure_additive
from calichrome.core.arrays import FloatArray
from calichrome.observations import BoardView, DiscSamples
from calichrome.target import Target

_INK = np.array([0.054, 0.053, 0.052])


def _views(
    rng: np.random.Generator, level: FloatArray, veil: float, n_views: int = 12
) -> dict[str, BoardView]:
    """Boards in light that changes by a third over each and threefold between them."""
    views = {}
    for index in range(n_views):
        n = 24
        fall = np.linspace(0.8, 1.1, n)[rng.permutation(n)]
        white = rng.uniform(0.25, 0.8) * fall[:, None] * np.array([1.0, 0.9, 0.8])
        added = level + veil * white.mean(axis=0)
        black = _INK * white * rng.normal(1, 0.005, white.shape) + added
        white = white + added
        discs = DiscSamples(
            marker_ids=np.arange(n),
            centres_px=np.zeros((n, 2)),
            mean_rgb=white,
            median_rgb=white,
            cov_rgb=np.zeros((n, 3, 3)),
            n_px=np.full(n, 50),
            clipped=np.zeros(n),
            white_rgb=white,
            black_rgb=black,
        )
        views[str(index)] = BoardView(
            corner_ids=np.arange(0), corners_px=np.zeros((0, 2)), discs=discs
        )
    return views


@pytest.mark.parametrize("level", [0.0, 0.004, 0.02])
def test_black_level_is_found(
    level: float, standard_target: Target, rng: np.random.Generator
) -> None:
    true = level * np.array([1.0, 1.1, 0.9])
    additive = measure_additive(_views(rng, true, 0.0), standard_target)
    assert additive is not None
    assert (np.abs(additive.level - true) < 4 * additive.sigma_level).all()
    offset = additive.offset(np.full(3, 0.5))
    # subtracted where it is real, and not at all where it is not
    np.testing.assert_allclose(offset, true, atol=0.0 if level == 0 else 4e-4)


def test_stray_light_follows_the_mean_of_the_view(
    standard_target: Target, rng: np.random.Generator
) -> None:
    additive = measure_additive(_views(rng, np.zeros(3), 0.03), standard_target)
    assert additive is not None
    np.testing.assert_allclose(additive.veil, 0.03, atol=4 * additive.sigma_veil.max())
    white = np.array([0.5, 0.4, 0.3])
    np.testing.assert_allclose(
        additive.offset(white), 0.03 * white, rtol=0.15
    )  # of the view's own mean, 3 % brighter


def test_few_views_say_nothing(standard_target: Target, rng: np.random.Generator) -> None:
    assert measure_additive(_views(rng, np.zeros(3), 0.0, n_views=3), standard_target) is None


def test_ink_is_known_only_if_the_paper_is(
    standard_target: Target, rng: np.random.Generator
) -> None:
    additive = measure_additive(_views(rng, np.zeros(3), 0.0), standard_target)
    assert additive is not None
    assert additive.ink_known == (standard_target.paper.black_xyz_d65 is not None)
    np.testing.assert_allclose(additive.ink, _INK, rtol=0.02)
