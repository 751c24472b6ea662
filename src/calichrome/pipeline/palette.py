"""What a palette is good for: how it fills colour space, and which colour models it carries."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError, Voronoi

from calichrome.colorimetry.difference import delta_e_2000_xyz, lab_from_xyz
from calichrome.colorimetry.reference import (
    camera_sensitivities,
    illuminant,
    reflectance_to_xyz_d65,
)
from calichrome.colour.families import fit_model, needed_colours
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray

__all__ = ["LARGEST_ORDER", "ModelForecast", "PaletteJudgement", "forecast_models", "judge_palette"]

_ORDERS = ("linear", "root-polynomial-2", "root-polynomial-3")
"""Models whose terms nothing but the colours fixes, by their order."""
LARGEST_ORDER = len(_ORDERS)
_HARMLESS = 1.05
"""Factor by which errors of a higher order may exceed those of the one below, as a geometric mean
over cameras and lights, for it still to count as carried; chosen. Where colours are many the orders
differ by less than simulations tell. Means over all cameras would be those of one whose channels
hardly differ: more terms harm it whatever the palette."""

_LIGHTS = ("D65", "A", "LED-B4")  # daylight, tungsten, the white LED of today's lamps
_NOISE = 0.005  # relative, per channel: a disc over some views
_DRAWS = 4  # of that noise, for each camera and light


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelForecast:
    """What to expect of a colour model.

    Parameters
    ----------
    name
        As in `--colour`.
    needed
        Different colours without which it is not fitted.
    mean, p95
        dE2000 of surfaces that it has not seen; None: the palette has too few colours.
    by_camera
        Means for each camera and light; empty likewise.
    """

    name: str
    needed: int
    mean: float | None
    p95: float | None
    by_camera: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class PaletteJudgement:
    """What a palette is good for.

    Parameters
    ----------
    n_colours
        Different ones.
    hull_volume
        Of their convex hull in Lab, cubic units; 0 if they lie in a plane.
    gap, gap_lab
        Radius of the largest ball in the hull that holds no colour, and its centre; None without a
        hull.
    models
        Simulated; empty if the colours' spectra are not known.
    order
        Highest order that the palette carries: of the free models, each predicts unseen surfaces
        as well as the one below, or better. 1 is a matrix, 2 and 3 root-polynomials; 0: not even a
        matrix can be fitted. None: not simulated.
    """

    n_colours: int
    hull_volume: float
    gap: float | None
    gap_lab: tuple[float, float, float] | None
    models: tuple[ModelForecast, ...] = ()
    order: int | None = None

    @property
    def best(self) -> ModelForecast | None:
        """The model with the smallest expected error."""
        fitted = [item for item in self.models if item.mean is not None]
        return min(fitted, key=lambda item: item.mean or 0.0, default=None)


def judge_palette(
    xyz_d65: FloatArray,
    reflectances: FloatArray | None = None,
    surfaces: FloatArray | None = None,
) -> PaletteJudgement:
    """Judge the different colours of a palette.

    Parameters
    ----------
    xyz_d65 : (n, 3) float
        Y = 1 for the perfect diffuser.
    reflectances : (n, 81) float, optional
        Of the colours; with `surfaces` models are simulated.
    surfaces : (m, 81) float, optional
        Reflectances that the models are to predict.
    """
    volume, gap, place = _fill(lab_from_xyz(np.maximum(xyz_d65, 0)))
    models: tuple[ModelForecast, ...] = ()
    if reflectances is not None and surfaces is not None:
        models = forecast_models(reflectances, surfaces)
    return PaletteJudgement(
        n_colours=len(xyz_d65),
        hull_volume=volume,
        gap=gap,
        gap_lab=place,
        models=models,
        order=_order(models) if models else None,
    )


def forecast_models(
    reflectances: FloatArray, surfaces: FloatArray, names: Sequence[str] = tuple(MODELS)
) -> tuple[ModelForecast, ...]:
    """Fit every colour model to simulated readings of discs, and try it on other surfaces.

    Parameters
    ----------
    reflectances : (n, 81) float
        Of the discs.
    surfaces : (m, 81) float
    names
        Of the models.

    Notes
    -----
    The cameras are those whose sensitivities colour-science holds, under daylight, tungsten and
    LED; targets are colours under D65, as everywhere here, so the error holds what another light
    costs.
    """
    rng = np.random.default_rng(0)
    xyz, true_xyz = reflectance_to_xyz_d65(reflectances), reflectance_to_xyz_d65(surfaces)
    fitted = [name for name in names if len(reflectances) >= needed_colours(name)]
    errors: dict[str, list[FloatArray]] = {name: [] for name in fitted}
    cameras = camera_sensitivities().values()
    for sensitivity, light, _ in product(cameras, _LIGHTS, range(_DRAWS)):
        weights = sensitivity * illuminant(light)[:, None]
        weights = weights / weights.sum(axis=0)
        rgb = reflectances @ weights
        sigma = _NOISE * rgb
        pairs = ColourPairs.of(
            rgb + rng.normal(0, sigma),
            xyz,
            white_rgb=np.ones(3),
            rgb_cov=(sigma[:, :, None] * np.eye(3)) ** 2,
        )
        for name in fitted:
            found = fit_model(name, pairs).apply(surfaces @ weights)
            errors[name].append(delta_e_2000_xyz(found, true_xyz))
    return tuple(_forecast(name, errors.get(name, []), len(surfaces)) for name in names)


def _forecast(name: str, parts: list[FloatArray], surfaces: int) -> ModelForecast:
    values = np.concatenate(parts) if parts else None
    return ModelForecast(
        name=name,
        needed=needed_colours(name),
        mean=None if values is None else float(values.mean()),
        p95=None if values is None else float(np.quantile(values, 0.95)),
        by_camera=()
        if values is None
        else tuple(float(mean) for mean in values.reshape(-1, _DRAWS, surfaces).mean(axis=(1, 2))),
    )


def _order(models: tuple[ModelForecast, ...]) -> int:
    errors = {item.name: item.by_camera for item in models}
    if not errors[_ORDERS[0]]:
        return 0
    for order, (lower, higher) in enumerate(pairwise(_ORDERS), 1):
        if not errors[higher]:
            return order
        ratio = np.exp(np.mean(np.log(errors[higher]) - np.log(errors[lower])))
        if ratio > _HARMLESS:
            return order
    return LARGEST_ORDER


def _fill(lab: FloatArray) -> tuple[float, float | None, tuple[float, float, float] | None]:
    """Volume of the hull, radius and centre of the largest empty ball with its centre in it."""
    try:
        hull = ConvexHull(lab)
    except (QhullError, ValueError):  # fewer than four colours, or all in a plane
        return 0.0, None, None
    # an empty ball is largest about a vertex of the Voronoi diagram
    centres = Voronoi(lab).vertices
    centres = centres[Delaunay(lab).find_simplex(centres) >= 0]
    if not len(centres):
        return float(hull.volume), None, None
    away = np.linalg.norm(centres[:, None] - lab, axis=-1).min(axis=1)
    light, a, b = (float(value) for value in centres[away.argmax()])
    return float(hull.volume), float(away.max()), (light, a, b)
