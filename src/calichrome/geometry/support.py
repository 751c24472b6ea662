"""Which optional parameters the data support.

A parameter that the views hardly show makes every prediction outside them wild. Whether they show
it is a question of where the corners lie, not of what they say: it is answered from the Hessian,
before the solution, so that no result decides what is estimated (a test of significance would make
the stated covariance too small).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.geometry.bundle import BundleEquations, BundleState, Free, Observations
from calichrome.geometry.bundle.blocks import ViewBlocks, view_blocks
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.uncertainty import projection_sigma_px

__all__ = ["Support", "supported"]

_DEARER = 1.5
_BEARABLE = 1e-3
"""A group is held if freeing it raises the sigma of projection, root mean square over the picture,
by more than half *and* beyond a thousandth of the picture's width. Choices; with boards up to the
borders k3, p1 and p2 cost 1.0 to 1.1 from four views on, the bow 1.1 to 1.3 (scenes of
benchmarks/geometry). Held terms that are not 0 in truth are an error that no sigma shows, so what
is bearable is freed."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """What to free.

    Parameters
    ----------
    free
        Everything that the data support.
    held
        camera position -> names of optional lens parameters that stay as they are.
    shape_held
        Whether the board stays flat for want of data.
    aspect_held
        Whether its squares stay square for want of data.
    """

    free: Free
    held: Mapping[int, tuple[str, ...]]
    shape_held: bool
    aspect_held: bool


def supported(
    observations: Observations,
    state: BundleState,
    allowed: Free,
    sizes_wh: tuple[tuple[int, int], ...],
    noise_px: FloatArray,
) -> Support:
    """Free the optional groups of every lens, then bow and aspect, as far as they cost little.

    Parameters
    ----------
    observations, state
        What was seen, and a state near the solution.
    allowed
        All that may move at all.
    sizes_wh
        Of each camera, pixels.
    noise_px : (C,) float
        Of the corners of each camera, about.
    """
    observations = observations.unwhitened(1 / noise_px)
    blocks = view_blocks(observations, state)
    lenses = allowed.lenses.copy()
    groups = []
    for camera, model in enumerate(state.models):
        for group in model.OPTIONAL:
            columns = [model.NAMES.index(name) for name in group]
            if allowed.lenses[camera, columns].any():
                groups.append((camera, columns))
                lenses[camera, columns] = False
    free = replace(allowed, lenses=lenses, shape=np.zeros_like(allowed.shape))
    measure = _Measure(observations, state, blocks, sizes_wh)
    sigma = measure.sigmas(free)
    held: dict[int, tuple[str, ...]] = {}
    for camera, columns in groups:
        lenses = free.lenses.copy()
        lenses[camera, columns] = allowed.lenses[camera, columns]
        more = replace(free, lenses=lenses)
        raised = measure.sigmas(more)
        if measure.bearable(sigma, raised)[camera]:
            free, sigma = more, raised
        else:
            names = tuple(state.models[camera].NAMES[column] for column in columns)
            held[camera] = (*held.get(camera, ()), *names)
    held_parts = [False, False]
    is_bow = np.array([name in BOW_TERMS for name in state.shape.names], dtype=bool)
    for kind, part in enumerate((is_bow, ~is_bow)):
        if not (allowed.shape & part).any():
            continue
        more = replace(free, shape=free.shape | (allowed.shape & part))
        raised = measure.sigmas(more)
        if measure.bearable(sigma, raised).all():
            free, sigma = more, raised
        else:
            held_parts[kind] = True
    return Support(free, held, *held_parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Measure:
    observations: Observations
    state: BundleState
    blocks: ViewBlocks
    sizes_wh: tuple[tuple[int, int], ...]

    def bearable(self, before: FloatArray, after: FloatArray) -> BoolArray:
        """Which cameras lose little."""
        widths = np.array([max(size) for size in self.sizes_wh])
        little = (after <= _DEARER * before) | (after <= _BEARABLE * widths)
        return np.asarray(little & np.isfinite(after))

    def sigmas(self, free: Free) -> FloatArray:
        """Sigma of projection of each camera over its picture, pixels; inf where open."""
        equations = BundleEquations(self.observations, self.state, free, self.blocks)
        covariance = equations.covariance()
        n_cameras, n_lens = self.state.lens_parameters.shape
        if covariance is None:
            return np.full(n_cameras, np.inf)
        sigmas = []
        for camera, lens in enumerate(self.state.lenses):
            first = camera * (n_lens + 6)
            own = slice(first, first + len(lens.NAMES))
            values = projection_sigma_px(lens, covariance[own, own], self.sizes_wh[camera])
            sigmas.append(float(np.sqrt(np.nanmean(values**2))))
        return np.array(sigmas)
