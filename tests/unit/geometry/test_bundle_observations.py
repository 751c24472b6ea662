"""Views packed into chunks are the same views."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import BoardShape, BundleState, Observations, ObservedView
from calichrome.geometry.bundle.blocks import view_blocks
from calichrome.geometry.lenses import BrownConrady, KannalaBrandt, Lens

_X, _Y = np.meshgrid(np.arange(12) * 0.03, np.arange(9) * 0.03)
_BOARD = np.stack([_X.ravel(), _Y.ravel(), np.zeros(108)], axis=1)
_MODELS: tuple[type[Lens], ...] = (BrownConrady, KannalaBrandt, BrownConrady)
_N_FRAMES = 40


def _views(rng: np.random.Generator, *, whiten: bool = True) -> list[ObservedView]:
    """Of 1 to 108 corners, in no order; camera 2 has none, and frame 7 neither."""
    views = []
    for camera, frame in rng.permutation([(c, f) for c in (0, 1) for f in range(_N_FRAMES)]):
        if frame == 7:
            continue
        n_corners = int(rng.choice([1, 5, 30, 60, 107, 108]))
        whitening = rng.normal(size=(n_corners, 2, 2)) if whiten and frame % 2 else None
        pixels = rng.uniform(0, 600, (n_corners, 2))
        ids = np.sort(rng.permutation(108)[:n_corners])
        views.append(ObservedView(int(camera), int(frame), ids, pixels, whitening))
    return views


def _pack(views: list[ObservedView]) -> Observations:
    return Observations.pack(views, _BOARD, _MODELS, _N_FRAMES)


def _state(rng: np.random.Generator) -> BundleState:
    return BundleState.build(
        [model.start((640, 480), 500) for model in _MODELS],
        [Pose.from_rotvec(rng.normal(0, 0.1, 3), rng.normal(0, 0.02, 3)) for _ in _MODELS],
        [
            Pose.from_rotvec(rng.normal(0, 0.3, 3), [-0.15, -0.1, rng.uniform(0.5, 1)])
            for _ in range(_N_FRAMES)
        ],
        BoardShape.bowed(_BOARD, 2),
    )


@pytest.mark.parametrize("whiten", [False, True])
def test_views_come_back_as_they_were_packed(*, whiten: bool, rng: np.random.Generator) -> None:
    views = _views(rng, whiten=whiten)
    observations = _pack(views)
    chunks = observations.chunks
    pixels = observations.by_view([chunk.pixels for chunk in chunks])
    ids = observations.by_view([chunk.corner_ids[:, None].astype(float) for chunk in chunks])
    identity = np.eye(2)[None, :, :, None]
    whitening = observations.by_view(
        [
            np.broadcast_to(identity, (*chunk.views.shape, 2, 2, chunk.corner_ids.shape[1]))
            if chunk.whitening is None
            else chunk.whitening
            for chunk in chunks
        ]
    )
    for view, *found in zip(views, pixels, ids, whitening, strict=True):
        np.testing.assert_array_equal(found[0], view.pixels)
        np.testing.assert_array_equal(found[1][:, 0], view.corner_ids)
        expected = np.eye(2) if view.whitening is None else view.whitening
        np.testing.assert_array_equal(found[2], np.broadcast_to(expected, found[2].shape))
    assert observations.n_corners == sum(len(view.pixels) for view in views)
    assert (observations.n_cameras, observations.n_frames) == (3, _N_FRAMES)


def test_chunks_hold_every_view_once_and_hardly_anything_else(rng: np.random.Generator) -> None:
    views = _views(rng)
    observations = _pack(views)
    rows = np.concatenate([chunk.views for chunk in observations.chunks])
    assert sorted(rows) == list(range(len(views)))
    for chunk in observations.chunks:
        assert {_MODELS[camera] for camera in observations.camera[chunk.views]} == {chunk.model}
        np.testing.assert_array_equal(chunk.filled.sum(axis=1), chunk.lengths)
        assert chunk.filled.mean() >= 0.75  # else a long view makes many short ones expensive
        if chunk.whitening is None:
            assert chunk.filled.all()
        else:
            assert not chunk.whitening.transpose(0, 3, 1, 2)[~chunk.filled].any()


def test_views_are_sorted_by_frame_then_camera(rng: np.random.Generator) -> None:
    views = _views(rng)
    observations = _pack(views)
    keys = list(zip(observations.frame, observations.camera, strict=True))
    assert keys == sorted(keys)
    assert keys == [(views[i].frame, views[i].camera) for i in observations.order]


def test_shared_frames_are_all_pairs_of_views_of_a_frame(rng: np.random.Generator) -> None:
    observations = _pack(_views(rng))
    found = [
        (int(a), int(b))
        for pair in observations.shared
        for a, b in zip(pair.first, pair.second, strict=True)
    ]
    for pair in observations.shared:
        assert set(observations.camera[pair.first]) == {pair.cameras[0]}
        assert set(observations.camera[pair.second]) == {pair.cameras[1]}
        np.testing.assert_array_equal(
            observations.frame[pair.first], observations.frame[pair.second]
        )
    n_in_frame = np.unique(observations.frame, return_counts=True)[1]
    expected = sum(len(list(combinations_with_replacement(range(n), 2))) for n in n_in_frame)
    assert len(found) == len(set(found)) == expected


def test_two_views_of_one_frame_by_one_camera_are_refused(rng: np.random.Generator) -> None:
    views = _views(rng)
    with pytest.raises(ValueError, match="a camera has two views of one frame"):
        _pack([*views, views[3]])


def test_the_order_of_views_does_not_matter(rng: np.random.Generator) -> None:
    views, state = _views(rng), _state(rng)
    blocks = [view_blocks(_pack(some), state) for some in (views, views[::-1])]
    np.testing.assert_allclose(blocks[0].products, blocks[1].products, rtol=1e-12)
    assert blocks[0].cost == pytest.approx(blocks[1].cost, rel=1e-12)


@pytest.mark.parametrize("huber", [None, 20.0])
def test_a_corner_of_no_weight_is_a_corner_left_out(
    huber: float | None, rng: np.random.Generator
) -> None:
    views, state = [view for view in _views(rng) if len(view.pixels) > 1], _state(rng)
    keeps = [rng.uniform(size=len(view.pixels)) < 0.8 for view in views]
    for keep in keeps:
        keep[0] = True
    whole = _pack(views)
    places = [np.zeros(chunk.corner_ids.shape, dtype=bool) for chunk in whole.chunks]
    rows = {int(view): (i, r) for i, c in enumerate(whole.chunks) for r, view in enumerate(c.views)}
    for row, position in enumerate(whole.order):
        chunk, place = rows[row]
        places[chunk][place, : len(keeps[position])] = keeps[position]
    weighted = whole.weighted(
        [
            _whitening(chunk.whitening, keep)
            for chunk, keep in zip(whole.chunks, places, strict=True)
        ]
    )
    fewer = [
        replace(
            view,
            corner_ids=view.corner_ids[keep],
            pixels=view.pixels[keep],
            whitening=None if view.whitening is None else view.whitening[keep],
        )
        for view, keep in zip(views, keeps, strict=True)
    ]
    found, expected = view_blocks(weighted, state, huber), view_blocks(_pack(fewer), state, huber)
    size = np.abs(expected.products).max(axis=0)
    np.testing.assert_allclose(
        found.products, expected.products, rtol=1e-9, atol=1e-12 * size.max()
    )
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    assert weighted.n_corners == sum(int(keep.sum()) for keep in keeps)


def _whitening(stated: FloatArray | None, keep: FloatArray) -> FloatArray:
    own = np.eye(2)[None, :, :, None] if stated is None else stated
    return np.asarray(own * keep[:, None, None])


def test_thinning_keeps_corners_of_every_view(rng: np.random.Generator) -> None:
    views = _views(rng)
    observations = _pack(views)
    thin = observations.thinned(20)
    pixels = thin.by_view([chunk.pixels for chunk in thin.chunks])
    for view, found in zip(views, pixels, strict=True):
        known = {tuple(row) for row in view.pixels}
        assert {tuple(row) for row in found} <= known
        assert len(found) >= min(len(view.pixels), 15)  # 20, of which a quarter may be filled up
    assert thin.n_corners == sum(len(found) for found in pixels)
