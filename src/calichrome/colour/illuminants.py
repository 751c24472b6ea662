"""Frames of a recording that were taken in another light than the rest.

Discs are read relative to the white beside them, so a frame at another exposure or white balance
gives the same colours. Another spectrum does not: it turns disc colours against each other, by
nearly a matrix that keeps white.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calichrome.colour.nested import compare_nested, white_keeping_matrix, white_keeping_terms
from calichrome.colour.samples import FEWEST_PX, ColourSamples, collect_samples
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.findings import Finding, finding
from calichrome.observations import Dataset

__all__ = ["OtherLight", "leave_out_other_light", "other_light"]

_CHANCE = 1e-3  # of a false alarm in one recording
_TIMES, _LEAST = 4.0, 0.05
"""Changes that put a frame out: as a multiple of the median frame's, and at least; as shares of the
discs' deviations from grey. Of 480 simulated views under lamps of two colours one passed, of a
board that was turned out of the lamp's light (5.1 times the median; the others up to 3.7); A, D65
or FL2 alone in one frame gave 6 times or more. 0.05 is about 1 dE2000."""
_NOISE = (0.01, 0.02)
"""Standard deviation of a disc over its white: of white (gloss, stray light), and of the disc; what
the fits allow, too. Only their ratio counts."""
_FEWEST_DISCS = 8  # a frame with fewer says too little: twelve numbers are fitted to it
_FEWEST_FRAMES = 3  # of two frames neither is the odd one
_ROUNDS = 3  # of finding the frames that agree: the second seldom changes anything


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherLight:
    """A frame in another light.

    Parameters
    ----------
    chance
        How often the scatter of the discs alone does as much, smallest over the cameras and times
        the number of frames.
    change
        Root mean square change of the discs as a share of their deviations from grey, largest over
        the cameras.
    cameras
        Those that show it.
    """

    frame: str
    chance: float
    change: float
    cameras: tuple[str, ...]


def leave_out_other_light(dataset: Dataset) -> tuple[Dataset, tuple[Finding, ...]]:
    """Take the discs out of frames in another light; their corners stay.

    Parameters
    ----------
    dataset
        Discs measured with the encoding removed.
    """
    samples = {
        camera: item
        for camera, views in dataset.views.items()
        if (item := collect_samples(views)) is not None
    }
    odd = other_light(samples)
    if not odd:
        return dataset, ()
    views = {
        camera: {
            frame: replace(view, discs=None) if frame in odd else view
            for frame, view in own.items()
        }
        for camera, own in dataset.views.items()
    }
    return dataset.with_views(views), tuple(_told(item, samples) for item in odd.values())


def other_light(samples: Mapping[str, ColourSamples]) -> dict[str, OtherLight]:
    """Find frames in which discs differ from their usual colours by a matrix that keeps white.

    Parameters
    ----------
    samples
        By camera.

    Returns
    -------
    frame -> OtherLight
        Never more than half of the frames of a camera.

    Notes
    -----
    A lamp that is nearer in some frames than in others changes the mixture with other light a
    little in each, and more for sensors whose channels overlap: a frame is odd where it changes by
    much more than the others of its camera do. Gains of the channels, gloss and stray light are
    fitted beside the matrix and count for nothing.
    """
    found: dict[str, OtherLight] = {}
    for camera, item in samples.items():
        changes = _changes(item)
        if len(changes) < _FEWEST_FRAMES:
            continue
        limit = max(_LEAST, _TIMES * float(np.median([change for change, _ in changes.values()])))
        for frame, (change, own_chance) in changes.items():
            chance = min(1.0, own_chance * len(changes))
            if change <= limit or chance >= _CHANCE or _is_smeared(item, frame):
                continue
            before = found.get(frame)
            found[frame] = OtherLight(
                frame=frame,
                chance=chance if before is None else min(chance, before.chance),
                change=change if before is None else max(change, before.change),
                cameras=(camera,) if before is None else (*before.cameras, camera),
            )
    return found


def _changes(samples: ColourSamples) -> dict[str, tuple[float, float]]:
    """By how much the discs of each frame changed, and how often chance does as much."""
    usable = samples.usable
    counts = np.bincount(samples.view[usable], minlength=len(samples.frame_ids))
    views = np.flatnonzero(counts >= _FEWEST_DISCS)
    if len(views) < _FEWEST_FRAMES:
        return {}
    balanced = samples.rgb / samples.light_rgb
    agreeing = np.isin(samples.view, views)
    changes: dict[int, tuple[float, float]] = {}
    for _ in range(_ROUNDS):
        usual = _usual(balanced, samples.marker_ids, usable & agreeing)
        told = usable & np.isfinite(usual[samples.marker_ids]).all(axis=1)
        changes = {
            int(view): _change(balanced[mine], usual[samples.marker_ids[mine]])
            for view in views
            if (mine := told & (samples.view == view)).sum() >= _FEWEST_DISCS
        }
        limit = max(_LEAST, _TIMES * float(np.median([change for change, _ in changes.values()])))
        kept = [view for view, (change, _) in changes.items() if change <= limit]
        agreeing = np.isin(samples.view, kept)
    return {samples.frame_ids[view]: item for view, item in changes.items()}


def _is_smeared(samples: ColourSamples, frame: str) -> bool:
    """Whether discs are so small that demosaicing and JPEG may change them as a lamp would."""
    mine = samples.usable & (samples.view == samples.frame_ids.index(frame))
    return bool(np.median(samples.n_px[mine]) < FEWEST_PX)


def _usual(balanced: FloatArray, marker_ids: IntArray, used: BoolArray) -> FloatArray:
    """Median of each disc over frames, (n_markers, 3); nan where no frame shows it."""
    usual = np.full((int(marker_ids.max()) + 1, 3), np.nan)
    for marker in np.unique(marker_ids[used]):
        usual[marker] = np.median(balanced[used & (marker_ids == marker)], axis=0)
    return usual


def _change(balanced: FloatArray, usual: FloatArray) -> tuple[float, float]:
    weights = 1 / (_NOISE[0] + _NOISE[1] * np.abs(usual))
    gains = usual[:, :, None] * np.eye(3)
    offsets = np.broadcast_to(np.eye(3), gains.shape)
    fit = compare_nested(
        (balanced - usual) * weights,
        np.concatenate([gains, offsets], axis=2) * weights[:, :, None],
        white_keeping_terms(usual) * weights[:, :, None],
    )
    moved = usual @ (white_keeping_matrix(fit.extra) - np.eye(3)).T
    from_grey = usual - usual.mean(axis=1, keepdims=True)
    return float(np.linalg.norm(moved) / max(float(np.linalg.norm(from_grey)), 1e-12)), fit.chance


def _told(item: OtherLight, samples: Mapping[str, ColourSamples]) -> Finding:
    others = [
        camera for camera, own in samples.items()
        if item.frame in own.frame_ids and camera not in item.cameras
    ]  # fmt: skip
    which = f"camera{'s' if len(item.cameras) > 1 else ''} {', '.join(item.cameras)}"
    cause = (
        f"but not in {', '.join(others)}: a camera changed its colour processing, or the light its "
        f"spectrum"
        if others
        else "so the light had another spectrum"
    )
    return finding(
        "illuminant_changes",
        f"Frame {item.frame}: the discs have other colours over their white than in the other "
        f"frames (by {item.change:.0%}) in {which}, {cause}. Its colours were left out. Keep the "
        f"lamps as they are, shut out daylight, turn off automatic colour.",
        frame=item.frame, cameras=list(item.cameras), change=item.change, chance=item.chance,
    )  # fmt: skip
