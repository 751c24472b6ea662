"""What all cameras saw, packed so that views can be computed many at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.geometry.lenses import Lens

__all__ = ["Chunk", "Observations", "ObservedView", "SharedFrames"]

_CHUNK_CORNERS = (
    6000  # their Jacobian (1.5 MB) stays in the cache; set on the problems of benchmarks/solver
)
_LEAST_FILL = 0.75  # of a chunk whose views differ in length; a choice


@dataclass(frozen=True, slots=True, eq=False)
class ObservedView:
    """One camera's view of the board in one frame.

    Parameters
    ----------
    camera, frame
        Positions in the lists of a `BundleState`.
    corner_ids : (N,) int
        Rows of the board's points.
    pixels : (N, 2) float, pixels
    whitening : (N, 2, 2) float, 1/pixels, or None
        W with W'W = inverse covariance of a corner; None: one pixel, both ways.
    """

    camera: int
    frame: int
    corner_ids: IntArray
    pixels: FloatArray
    whitening: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Views of cameras of one lens model, filled up to equal length.

    Parameters
    ----------
    views : (V,) int
        Rows of `Observations.camera` and `frame`.
    lengths : (V,) int
        Corners of each view; what follows repeats the first corner at weight 0.
    corner_ids : (V, N) int
    pixels : (V, 2, N) float
    whitening : (V, 2, 2, N) float or None
        None: every corner counts with weight 1.
    """

    model: type[Lens]
    views: IntArray
    lengths: IntArray
    corner_ids: IntArray
    pixels: FloatArray
    whitening: FloatArray | None

    @property
    def filled(self) -> BoolArray:
        """Which places hold a corner, (V, N)."""
        return np.asarray(np.arange(self.corner_ids.shape[1]) < self.lengths[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class SharedFrames:
    """The frames that two cameras share (or that one sees): rows of their views, in step."""

    cameras: tuple[int, int]
    first: IntArray
    second: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """All views, sorted by frame and then by camera.

    Parameters
    ----------
    points_board : (n, 3) float, metres
    camera, frame : (V,) int
        Of each view.
    order : (V,) int
        Position of each view in the list that was packed.
    chunks
        The corners.
    shared
        For every two cameras with a common frame, and every camera with itself.
    n_cameras, n_frames
        Cameras and frames without a view count, too.
    n_corners
        That carry weight.
    """

    points_board: FloatArray
    camera: IntArray
    frame: IntArray
    order: IntArray
    chunks: tuple[Chunk, ...]
    shared: tuple[SharedFrames, ...]
    n_cameras: int
    n_frames: int
    n_corners: int

    @classmethod
    def pack(
        cls,
        views: Sequence[ObservedView],
        points_board: FloatArray,
        models: Sequence[type[Lens]],
        n_frames: int,
    ) -> "Observations":
        """Sort and stack `views`; `models` are the lens models by camera.

        Raises
        ------
        ValueError
            If a camera has two views of one frame, a view has no corner, or one that the board has
            not or that is not finite.
        """
        camera = np.array([view.camera for view in views], dtype=np.int64)
        frame = np.array([view.frame for view in views], dtype=np.int64)
        order = np.lexsort((camera, frame))
        ordered = [views[position] for position in order]
        return cls(
            points_board=points_board,
            camera=camera[order],
            frame=frame[order],
            order=order,
            chunks=tuple(_chunks(ordered, models, len(points_board))),
            shared=tuple(_shared(camera[order], frame[order], len(models), n_frames)),
            n_cameras=len(models),
            n_frames=n_frames,
            n_corners=sum(len(view.pixels) for view in views),
        )

    def weighted(self, whitening: Sequence[FloatArray]) -> "Observations":
        """Return the same corners with other whitenings, (V, 2, 2, N) by chunk; 0 leaves out."""
        n_corners = sum(int((item != 0).any(axis=(1, 2)).sum()) for item in whitening)
        chunks = tuple(
            replace(chunk, whitening=item)
            for chunk, item in zip(self.chunks, whitening, strict=True)
        )
        return replace(self, chunks=chunks, n_corners=n_corners)

    def unwhitened(self, weights: FloatArray) -> "Observations":
        """Weigh all corners of a camera alike: by `weights`, (C,), 1/pixels."""
        return self.weighted(
            [
                np.eye(2)[None, :, :, None]
                * (weights[self.camera[chunk.views]][:, None] * chunk.filled)[:, None, None]
                for chunk in self.chunks
            ]
        )

    def thinned(self, n_points: int) -> "Observations":
        """Keep about `n_points` corners of each longer view: enough for a first look.

        They are drawn, not counted off: every k-th corner of a lattice may be one line of it.
        """
        chunks = []
        for chunk in self.chunks:
            n_places = chunk.corner_ids.shape[1]
            drawn = np.sort(np.random.default_rng(0).permutation(n_places)[:n_points])
            chunks.append(
                replace(
                    chunk,
                    lengths=(drawn < chunk.lengths[:, None]).sum(axis=1),
                    corner_ids=chunk.corner_ids[:, drawn],
                    pixels=np.take(chunk.pixels, drawn, axis=2),
                    whitening=None
                    if chunk.whitening is None
                    else np.take(chunk.whitening, drawn, axis=3),
                )
            )
        n_corners = sum(int(chunk.lengths.sum()) for chunk in chunks)
        return replace(self, chunks=tuple(chunks), n_corners=n_corners)

    def by_view(self, values: Sequence[FloatArray]) -> list[FloatArray]:
        """Cut arrays (V, ..., N) by chunk into (N, ...) by view, in the order that was packed."""
        parts: list[FloatArray] = [np.empty(0)] * len(self.camera)
        for chunk, array in zip(self.chunks, values, strict=True):
            for row, (view, length) in enumerate(zip(chunk.views, chunk.lengths, strict=True)):
                parts[self.order[view]] = np.moveaxis(array[row], -1, 0)[:length]
        return parts


def _shared(
    camera: IntArray, frame: IntArray, n_cameras: int, n_frames: int
) -> Iterator[SharedFrames]:
    row = np.full((n_cameras, n_frames), -1)
    row[camera, frame] = np.arange(len(camera))
    if (row >= 0).sum() != len(camera):
        raise ValueError("views: a camera has two views of one frame")
    for first in range(n_cameras):
        seen = np.flatnonzero(row[first] >= 0)
        for second in range(first, n_cameras):
            both = seen[row[second, seen] >= 0]
            if len(both):
                yield SharedFrames((first, second), row[first, both], row[second, both])


def _chunks(
    views: Sequence[ObservedView], models: Sequence[type[Lens]], n_points: int
) -> Iterator[Chunk]:
    """Group views of one lens model and of similar length."""
    for view in views:
        if not len(view.pixels):
            raise ValueError(f"view of camera {view.camera}, frame {view.frame}: has no corner")
    for model in dict.fromkeys(models):
        rows = [row for row, view in enumerate(views) if models[view.camera] is model]
        rows.sort(key=lambda row: (-len(views[row].pixels), row))
        group: list[int] = []
        for row in rows:
            if group:
                longest = len(views[group[0]].pixels)
                full = (len(group) + 1) * longest > _CHUNK_CORNERS
                if full or len(views[row].pixels) < _LEAST_FILL * longest:
                    yield _stack(group, views, model, n_points)
                    group = []
            group.append(row)
        if group:
            yield _stack(group, views, model, n_points)


def _stack(
    rows: Sequence[int], views: Sequence[ObservedView], model: type[Lens], n_points: int
) -> Chunk:
    lengths = np.array([len(views[row].pixels) for row in rows])
    longest = int(lengths.max())
    ids = np.empty((len(rows), longest), dtype=np.int64)
    pixels = np.empty((len(rows), 2, longest))
    plain = all(views[row].whitening is None for row in rows) and (lengths == longest).all()
    whitening = None if plain else np.zeros((len(rows), 2, 2, longest))
    for place, row in enumerate(rows):
        view, length = views[row], lengths[place]
        ids[place, :length], ids[place, length:] = view.corner_ids, view.corner_ids[0]
        pixels[place, :, :length] = view.pixels.T
        pixels[place, :, length:] = view.pixels[0][:, None]
        if whitening is not None:
            own = np.eye(2)[None] if view.whitening is None else view.whitening
            whitening[place, :, :, :length] = own.transpose(1, 2, 0)
    wrong = ((ids < 0) | (ids >= n_points)).any(axis=1) | ~np.isfinite(pixels).all(axis=(1, 2))
    if wrong.any():
        view = views[rows[int(wrong.argmax())]]
        raise ValueError(
            f"view of camera {view.camera}, frame {view.frame}: a corner that the board of "
            f"{n_points} points has not, or a pixel that is not finite"
        )
    return Chunk(model, np.array(rows), lengths, ids, pixels, whitening)
