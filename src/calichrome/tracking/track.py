"""One object over time, as the cameras saw it."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.tracking.motion import Gaussian
from calichrome.tracking.regions import Region
from calichrome.tracking.surface_colour import SurfaceColour, mean_colour

__all__ = ["Sighting", "Step", "Track"]

_KEPT = 1000  # latest looks that the size and the colour of an object stand on
_SIZE_SIGMA = 0.10  # of the logarithm of the radius, before enough looks have told it
_LEAST_SIZE_SIGMA = 0.02  # an edge has no better place
_ENOUGH = 10  # looks
_WHOLE = 3.0  # sigmas by which a whole object may differ from its usual size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """An object in one camera at one instant.

    Parameters
    ----------
    centre_px, cov_px2, half_angle_rad, box, colour
        Of its region.
    log_radius
        Logarithm of the radius in metres that it seems to have; nan: cut off by the border.
    used : bool
        It is whole and alone, so that its centre counts for the place.
    """

    centre_px: FloatArray
    cov_px2: FloatArray
    half_angle_rad: float
    box: tuple[int, int, int, int]
    colour: SurfaceColour | None
    log_radius: float
    used: bool

    @classmethod
    def of(cls, region: Region, log_radius: float, *, used: bool) -> "Sighting":
        """Keep of a region what a track needs; its pixels are let go."""
        return cls(
            centre_px=region.centre_px,
            cov_px2=region.cov_px2,
            half_angle_rad=region.half_angle_rad,
            box=region.box,
            colour=region.colour,
            # at the border nobody knows how large it is
            log_radius=log_radius if region.whole else np.nan,
            used=used,
        )

    def in_light(self, factor: float) -> "Sighting":
        """Return the sighting with the light on the object divided by a factor."""
        return self if self.colour is None else replace(self, colour=self.colour.in_light(factor))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """An object at one instant.

    Parameters
    ----------
    frame
        Name of the instant.
    time_s
        When.
    state
        What the filter knew, with this instant's regions and none of later ones.
    sightings : camera -> Sighting
        Empty where it was hidden from all cameras.
    """

    frame: str
    time_s: float
    state: Gaussian
    sightings: Mapping[str, Sighting]


@dataclass(slots=True, kw_only=True, eq=False)
class Track:
    """One object over time; `Tracker.update` adds to it.

    Parameters
    ----------
    number
        Its name.
    steps
        One for each instant from its first to the last at which it was alive.
    confirmed
        It was seen often enough to count.
    lab_d65 : (3,) float
        Usual colour; nan: not known.
    log_radius, size_sigma
        Usual logarithm of its radius in metres, and how much that varies from look to look.
    """

    number: int
    steps: list[Step] = field(default_factory=list)
    confirmed: bool = False
    lab_d65: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    log_radius: float = np.nan
    size_sigma: float = _SIZE_SIGMA
    _sizes: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _labs: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=_KEPT))

    @property
    def state(self) -> Gaussian:
        """What is known of it now."""
        return self.steps[-1].state

    @property
    def n_seen(self) -> int:
        """Number of instants at which a camera saw it."""
        return sum(bool(step.sightings) for step in self.steps)

    @property
    def n_views(self) -> int:
        """Number of cameras that saw it last."""
        return len(self.steps[-1].sightings)

    def is_whole(self, log_radius: float) -> bool:
        """Tell whether a look at it, of this logarithm of the radius, shows all of it alone."""
        off = abs(log_radius - self.log_radius) if np.isfinite(self.log_radius) else 0.0
        return bool(np.isfinite(log_radius) and off <= _WHOLE * self.size_sigma)

    def learn(self, sightings: Iterable[Sighting]) -> None:
        """Remember how large it looked and what colour it had."""
        looks = list(sightings)
        self._sizes.extend(item.log_radius for item in looks if np.isfinite(item.log_radius))
        colours = [item.colour for item in looks if item.used and item.colour is not None]
        if self._sizes:
            middle, sigma = _densest_half(np.array(self._sizes))
            self.log_radius = middle
            if len(self._sizes) >= _ENOUGH:
                self.size_sigma = max(_LEAST_SIZE_SIGMA, sigma)
        if colours:
            self._labs.append(mean_colour(colours))
            self.lab_d65 = np.asarray(np.median(np.stack(self._labs), axis=0))


def _densest_half(values: FloatArray) -> tuple[float, float]:
    """Middle and standard deviation of the half of the values that lie nearest together.

    What is partly hidden looks smaller and what is merged larger; of up to half the looks that does
    no harm. A normal distribution holds half of itself within 1.349 sigma.

    References
    ----------
    .. [1] P. J. Rousseeuw, A. M. Leroy, "Robust Regression and Outlier Detection", 1987, sec. 4.2
       (the shortest half).
    """
    ordered = np.sort(values)
    n_half = len(ordered) // 2 + 1
    widths = ordered[n_half - 1 :] - ordered[: len(ordered) - n_half + 1]
    start = int(widths.argmin())
    return float(ordered[start : start + n_half].mean()), float(widths[start]) / 1.349
