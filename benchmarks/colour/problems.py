"""A camera under a light, what it makes of the ColorChecker, and what it is tested on."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.colour.spectra import (
    further_cameras,
    illuminant,
    known_cameras,
    observer,
    reflectances,
)

from calichrome.core.arrays import FloatArray

__all__ = [
    "LIGHTS",
    "ColourProblem",
    "ColourSet",
    "LitChart",
    "lit_chart",
    "make_problem",
    "noisy",
    "problems",
]

LIGHTS = ("D65", "A", "FL2")
"""Daylight, tungsten, and a fluorescent tube with lines."""

_TESTS = ("t190", "syn1000", "pmc30", "munsell1269")
_ROWS, _COLUMNS = 4, 6
_WHITE_BESIDE = 0.5
"""Distance of the white readings from a patch in pitches: four of them, at the rim of its
square, where the white squares round a disc begin."""


@dataclass(frozen=True, slots=True, eq=False)
class ColourSet:
    """What the camera reads and what is true.

    Parameters
    ----------
    rgb : (n, 3) float
        Linear, 1 for the perfect diffuser.
    xyz : (n, 3) float
        Under the same light, Y = 1 for the perfect diffuser.
    """

    rgb: FloatArray
    xyz: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourProblem:
    """One camera under one light; nothing is clipped.

    Parameters
    ----------
    train
        The 24 patches, as the camera reads them.
    tests
        Sets by name, always without noise: `t190`, `syn1000`, `pmc30`, and `munsell1269` on which
        constants are set.
    white_rgb : (3,) float
        Of the perfect diffuser: 1, 1, 1.
    white_xyz : (3,) float
    """

    camera: str
    light: str
    train: ColourSet
    tests: Mapping[str, ColourSet]
    white_rgb: FloatArray
    white_xyz: FloatArray


def make_problem(camera: str, sensitivity: FloatArray, light: str) -> ColourProblem:
    """Integrate all sets.

    Parameters
    ----------
    camera, light
        Names; the light is a CIE illuminant.
    sensitivity : (61, 3) float
    """
    power = illuminant(light)[:, None]
    to_rgb, to_xyz = sensitivity * power, observer() * power
    to_rgb, to_xyz = to_rgb / to_rgb.sum(axis=0), to_xyz / to_xyz[:, 1].sum()

    def seen(name: str) -> ColourSet:
        surfaces = reflectances(name)
        return ColourSet(surfaces @ to_rgb, surfaces @ to_xyz)

    return ColourProblem(
        camera=camera,
        light=light,
        train=seen("checker"),
        tests={name: seen(name) for name in _TESTS},
        white_rgb=np.ones(3),
        white_xyz=to_xyz.sum(axis=0),
    )


def problems(*, every: bool, lights: Iterable[str] = LIGHTS) -> Iterator[ColourProblem]:
    """Yield the three cameras of colour-science under each light, then, if asked, all others."""
    cameras = known_cameras() | (further_cameras() if every else {})
    lights = tuple(lights)
    for camera, sensitivity in cameras.items():
        for light in lights:
            yield make_problem(camera, sensitivity, light)


def noisy(problem: ColourProblem, share: float, rng: np.random.Generator) -> ColourProblem:
    """Multiply every channel of every training patch by 1 + N(0, share)."""
    gain = 1 + rng.normal(0, share, problem.train.rgb.shape)
    return replace(problem, train=replace(problem.train, rgb=problem.train.rgb * gain))


@dataclass(frozen=True, slots=True, eq=False)
class LitChart:
    """The chart under one lamp.

    Parameters
    ----------
    rgb, white_rgb : (24, 3) float
        Readings of the patches and of the white beside them; over all patches the light is 1 on
        average.
    """

    rgb: FloatArray
    white_rgb: FloatArray

    @property
    def even_rgb(self) -> FloatArray:
        """Patches divided by the white beside them, (24, 3)."""
        return self.rgb / self.white_rgb


def lit_chart(
    problem: ColourProblem, fall_off: float, noise: float, rng: np.random.Generator
) -> LitChart:
    """Light the chart by a lamp at one side, which one being drawn.

    Parameters
    ----------
    fall_off
        Share of the light that is lost from the near to the far end of the chart.
    noise
        Of every reading of a patch and every reading of a white, multiplicative per channel. A
        white is the mean of four readings around its patch, as on our board.

    Notes
    -----
    A point source falls off with the square of the distance, so the light is neither a plane nor
    exactly the mean of what surrounds it.
    """
    y, x = np.divmod(np.arange(_ROWS * _COLUMNS), _COLUMNS)
    places = np.stack([x, y], axis=1) - (np.array([_COLUMNS, _ROWS]) - 1) / 2
    beside = _WHITE_BESIDE * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    angle = rng.uniform(0, 2 * np.pi)
    lamp = _lamp(places, np.array([np.cos(angle), np.sin(angle)]), fall_off)
    light, white = (
        np.ones(at.shape[:-1]) if lamp is None else 1 / ((at - lamp) ** 2).sum(axis=-1)
        for at in (places, places[:, None] + beside)
    )
    patch_noise = 1 + rng.normal(0, noise, problem.train.rgb.shape)
    white_noise = 1 + rng.normal(0, noise, (*white.shape, 3))
    return LitChart(
        problem.train.rgb * patch_noise * light[:, None] / light.mean(),
        (white[..., None] * white_noise).mean(axis=1) / light.mean(),
    )


def _lamp(places: FloatArray, direction: FloatArray, fall_off: float) -> FloatArray | None:
    """Place a lamp on the line through the chart's middle, (2,); None for light from far away."""
    if fall_off == 0:
        return None
    reach = np.abs(places @ direction).max()
    ratio = np.sqrt(1 - fall_off)  # of its distances to the near and the far end
    return np.asarray(direction * reach * (1 + ratio) / (1 - ratio))
