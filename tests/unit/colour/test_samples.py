"""Discs over their views."""

import numpy as np
import pytest

from calichrome.colour.samples import ColourSamples, collect_samples, disc_means
from calichrome.core.arrays import FloatArray
from calichrome.observations import BoardView, DiscSamples

_LIGHT = np.array([0.5, 0.6, 0.4])


def _view(level: float, rgb: FloatArray, *, white_known: bool = True) -> BoardView:
    """Discs `rgb` (relative to white) in light of `level`."""
    n = len(rgb)
    white = np.broadcast_to(level * _LIGHT, (n, 3)) if white_known else np.full((n, 3), np.nan)
    discs = DiscSamples(
        marker_ids=np.arange(n),
        centres_px=np.stack([np.arange(n) * 10.0, np.arange(n) % 3 * 7.0], axis=1),
        mean_rgb=rgb * level * _LIGHT,
        median_rgb=rgb * level * _LIGHT,
        cov_rgb=np.zeros((n, 3, 3)),
        n_px=np.full(n, 50),
        clipped=np.zeros(n),
        white_rgb=np.array(white),
        black_rgb=np.zeros((n, 3)),
    )
    return BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)), discs=discs)


def _collected(views: dict[str, BoardView]) -> ColourSamples:
    samples = collect_samples(views)
    assert samples is not None
    return samples


def test_light_is_divided_out(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.05, 0.9, (8, 3))
    samples = _collected({str(level): _view(level, rgb) for level in (0.5, 1.0, 1.6)})
    np.testing.assert_allclose(samples.reference_light_rgb, _LIGHT)  # the median view
    mean_rgb, n_views, n_rejected = disc_means(samples, 9)
    np.testing.assert_allclose(mean_rgb[:8], rgb * _LIGHT, rtol=1e-12)
    assert np.isnan(mean_rgb[8]).all()
    assert n_views.tolist() == [3] * 8 + [0]
    assert n_rejected == 0


def test_a_highlight_in_one_view_is_left_out(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.1, 0.6, (8, 3))
    shiny = rgb.copy()
    shiny[4] += 0.3
    views = {str(i): _view(1.0, rgb + rng.normal(0, 0.002, rgb.shape)) for i in range(6)}
    samples = _collected({**views, "shiny": _view(1.0, shiny)})
    mean_rgb, n_views, n_rejected = disc_means(samples, 8)
    assert n_rejected == 1
    assert n_views.tolist() == [7, 7, 7, 7, 6, 7, 7, 7]
    np.testing.assert_allclose(mean_rgb[4], rgb[4] * _LIGHT, atol=0.003)  # 3 sigma of six


def test_views_without_light_do_not_count(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.1, 0.6, (8, 3))
    dark = _view(1.0, rgb, white_known=False)
    samples = _collected({"lit": _view(1.0, rgb), "dark": dark})
    assert samples.usable.tolist() == [True] * 8 + [False] * 8
    assert collect_samples({"dark": dark}) is None


def test_no_discs_are_no_samples() -> None:
    empty = BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)))
    assert collect_samples({"0": empty}) is None
    assert collect_samples({}) is None


@pytest.mark.parametrize("share", [0.01, 1.0])
def test_clipped_discs_do_not_count(share: float, rng: np.random.Generator) -> None:
    samples = _collected({"0": _view(1.0, rng.uniform(0.1, 0.6, (8, 3)))})
    samples.clipped[2] = share
    assert np.flatnonzero(~samples.usable).tolist() == [2]
