"""What changed in the colour of calibrated cameras, told from new pictures of their board.

The white squares carry exposure, white balance and light; the discs, divided by the white beside
them, carry the rest. Both parts are explained by as little as they allow, in the order nothing,
exposure, white balance, matrix.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.model import ColourModel
from calichrome.colour.nested import (
    compare_nested,
    white_keeping_matrix,
    white_keeping_terms,
)
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.samples import ColourSamples, combine_views
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray, IntArray

__all__ = [
    "ColourChange",
    "ColourDrift",
    "ColourDrifts",
    "ExpectedDiscs",
    "KnownColour",
    "LightOnBoard",
    "find_colour_drift",
]

ColourChange = Literal["nothing", "exposure", "white balance", "matrix"]
"""Simplest first."""

_CHANCE = 1e-3  # below which a test speaks; as for geometry
_FEWEST = 8  # discs that two cameras must both see
_NOTICED = 1.5
"""dE2000 below which a change of the matrix is no finding. Unchanged cameras showed up to 1.43 in
128 simulated checks under lamps of two colours, 0.8 under one lamp."""
_LEVEL, _UNSHADED_LEVEL = 0.02, 0.1
"""Relative repeatability of one camera's white against another's, and where the fall-off of a lens
is not known. In 10 simulated recordings of matte boards 0.003; paper is not quite matte; chosen."""
_TINT, _TINT_ALONE, _UNSHADED_TINT = 0.01, 0.02, 0.01
"""The same for its colour, against another camera and alone. In these recordings, under lamps of
two colours, 0.0072 and 0.0115, the latter with tails (boards turned from the lamp)."""
_SENSORS_DIFFER = 0.3
"""Share of a change of the light's colour by which sensors disagree, standard deviation. Pairs of
51 measured sensors between D65, D50, A, FL2 and a LED: 0.1 in the median, 0.7 in one of ten. One
of two cameras that changed shows as 1.4, and must be told."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownColour:
    """What a rig says of a camera.

    Parameters
    ----------
    model
        Linear RGB, without the fall-off of the lens, to XYZ under D65.
    white_rgb : (3,) float
        Camera value of white squares in the reference light.
    vignetting
        None: it was not told.
    missed
        Mean difference, dE2000, by which its discs missed the expected ones when it was calibrated.
    """

    model: ColourModel
    white_rgb: FloatArray
    vignetting: Vignetting | None
    missed: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExpectedDiscs:
    """What the corrected discs should be.

    Parameters
    ----------
    xyz : (n_markers, 3) float
        Under D65, Y = 1 for the perfect diffuser.
    cov : (n_markers, 3, 3) float
    colour : (n_markers,) int
        Discs of one ink have one number: what is special of it they share.
    """

    xyz: FloatArray
    cov: FloatArray
    colour: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourDrift:
    """What changed of one camera.

    Parameters
    ----------
    change
        The simplest explanation that chance does not spoil.
    exposure
        Factor of its values; against the other cameras, if `alone` is false.
    balance : (3,) float
        Factors of R, G, B beyond the exposure, their product 1.
    matrix : (3, 3) float
        New balanced colours are ``matrix @ old``; white stays white.
    exposure_chance, balance_chance
        How often an unchanged camera shows as much; None: nothing to tell it by.
    matrix_chance
        How often the scatter of the discs alone shows as much. Gloss and lamps of two colours do
        more than that: half of unchanged cameras fall below 0.001, so `delta_e` must be large too.
    delta_e
        Mean difference, dE2000, that the change of the matrix makes to the discs.
    alone
        No other camera saw the same discs: exposure and light are one.
    """

    change: ColourChange
    exposure: float
    balance: FloatArray
    matrix: FloatArray
    exposure_chance: float | None
    balance_chance: float | None
    matrix_chance: float | None
    delta_e: float
    alone: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightOnBoard:
    """The light that the cameras agree on, against that of the calibration.

    Parameters
    ----------
    level
        Factor of all of it.
    balance : (3,) float
        Factors of R, G, B beyond the level, their product 1.
    unevenness
        Largest over smallest light on the board, less 1.
    """

    level: float
    balance: FloatArray
    unevenness: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourDrifts:
    """All cameras, and their light."""

    cameras: Mapping[str, ColourDrift]
    light: LightOnBoard


def find_colour_drift(
    samples: Mapping[str, ColourSamples],
    known: Mapping[str, KnownColour],
    expected: ExpectedDiscs,
) -> ColourDrifts | None:
    """Tell what changed of each camera, and of the light.

    Parameters
    ----------
    samples
        Of new pictures, by camera, collected with the vignetting that is known; those of one frame
        are of one instant.
    known
        The calibration.
    expected
        The discs.

    Returns
    -------
    ColourDrifts or None
        Of the cameras in both; None if there is none.

    Notes
    -----
    A lamp acts on all cameras alike, so exposure and white balance are those of a camera against
    the others; of two cameras either may be the one. White balance of a camera alone cannot be told
    from the colour of its light, and its exposure not at all.

    The rest is tested on discs over the white beside them: does a matrix that keeps white explain
    what gains of the channels and stray light do not? The scatter is that about the matrix, so
    nominal colours, and a model that misses them, cost power but raise no alarm. What the discs
    missed already when the camera was calibrated is no change.
    """
    cameras = [camera for camera in known if camera in samples and samples[camera].usable.any()]
    if not cameras:
        return None
    logs = {camera: _white_logs(samples[camera], known[camera]) for camera in cameras}
    common = {
        row: np.median([own[row] for own in logs.values() if row in own], axis=0)
        for row in sorted({row for own in logs.values() for row in own})
    }
    light = np.mean(list(common.values()), axis=0)
    drifts = {}
    for camera in cameras:
        others = [
            other for other in cameras
            if other != camera and len(logs[other].keys() & logs[camera].keys()) >= _FEWEST
        ]  # fmt: skip
        level, tint, level_chance, tint_chance = _white_change(
            logs, common, camera, others, samples, known, light - light.mean()
        )
        matrix, matrix_chance, delta_e = _matrix_change(samples[camera], known[camera], expected)
        change: ColourChange = "nothing"
        if level_chance is not None and level_chance < _CHANCE:
            change = "exposure"
        if tint_chance < _CHANCE:
            change = "white balance"
        is_seen = delta_e > max(_NOTICED, known[camera].missed)
        if matrix_chance is not None and matrix_chance < _CHANCE and is_seen:
            change = "matrix"
        drifts[camera] = ColourDrift(
            change=change,
            exposure=float(np.exp(level)),
            balance=np.exp(tint),
            matrix=matrix,
            exposure_chance=level_chance,
            balance_chance=tint_chance,
            matrix_chance=matrix_chance,
            delta_e=delta_e,
            alone=not others,
        )
    unevenness = [_unevenness(samples[camera], known[camera]) for camera in cameras]
    return ColourDrifts(
        cameras=drifts,
        light=LightOnBoard(
            level=float(np.exp(light.mean())),
            balance=np.exp(light - light.mean()),
            unevenness=float(np.median(unevenness)),
        ),
    )


def _gain(samples: ColourSamples, known: KnownColour) -> FloatArray:
    if known.vignetting is None or samples.centres_px is None:
        return np.ones_like(samples.rgb)
    return known.vignetting.gain(samples.centres_px)


def _white_logs(samples: ColourSamples, known: KnownColour) -> dict[tuple[str, int], FloatArray]:
    """Log of the light at each disc over that of the calibration, (3,) by frame and disc."""
    relative = samples.light_rgb / _gain(samples, known) / known.white_rgb
    return {
        (samples.frame_ids[view], int(marker)): np.log(row)
        for view, marker, row in zip(samples.view, samples.marker_ids, relative, strict=True)
        if np.isfinite(row).all() and (row > 0).all()
    }


def _white_change(  # noqa: PLR0917 (what is known of all whites)
    logs: Mapping[str, Mapping[tuple[str, int], FloatArray]],
    common: Mapping[tuple[str, int], FloatArray],
    camera: str,
    others: Sequence[str],
    samples: Mapping[str, ColourSamples],
    known: Mapping[str, KnownColour],
    light_tint: FloatArray,
) -> tuple[float, FloatArray, float | None, float]:
    """Level and tint (3,) of a camera's white, logs, and how often chance does as much."""
    own = logs[camera]
    if not others:
        log = np.mean([own[row] for row in own], axis=0)
        tint = log - log.mean()
        shaded = 0.0 if known[camera].vignetting is not None else _UNSHADED_TINT
        sigma = float(np.hypot(_TINT_ALONE, shaded))
        return 0.0, tint, None, float(chdtrc(2, tint @ tint / sigma**2))
    shared = [row for row in own if any(row in logs[other] for other in others)]
    # the median of two is their mean, half-way between: either may have changed, by all of it
    scale = np.array([2.0 if sum(row in item for item in logs.values()) == 2 else 1.0
                      for row in shared])  # fmt: skip
    rows = scale[:, None] * np.array([own[row] - common[row] for row in shared])
    log = rows.mean(axis=0)
    level, tint = float(log.mean()), log - log.mean()
    unshaded = any(known[name].vignetting is None for name in (camera, *others))
    doubt = max(_shading_sigma(samples[name], known[name]) for name in (camera, *others))
    noise = float(rows.std() / np.sqrt(len(rows)))
    sigma_level = np.sqrt(_LEVEL**2 + doubt**2 + noise**2 + (unshaded * _UNSHADED_LEVEL) ** 2)
    sigma_tint = np.sqrt(
        _TINT**2 + noise**2 + (unshaded * _UNSHADED_TINT) ** 2
        + _SENSORS_DIFFER**2 * float(light_tint @ light_tint)
    )  # fmt: skip
    return (
        level,
        tint,
        float(chdtrc(1, (level / sigma_level) ** 2)),
        float(chdtrc(2, tint @ tint / sigma_tint**2)),
    )


def _shading_sigma(samples: ColourSamples, known: KnownColour) -> float:
    if known.vignetting is None or samples.centres_px is None:
        return 0.0
    return float(np.median(known.vignetting.sigma(samples.centres_px)))


def _matrix_change(
    samples: ColourSamples, known: KnownColour, expected: ExpectedDiscs
) -> tuple[FloatArray, float | None, float]:
    """Matrix that new balanced colours are of old ones, its chance, and what it does in dE2000."""
    seen = _by_colour(samples, expected)
    if seen is None:
        return np.eye(3), None, 0.0
    balanced, cov, xyz, xyz_cov = seen
    white = known.white_rgb
    white_xyz = known.model.apply(white)
    rgb = balanced * white
    pairs = ColourPairs.of(
        rgb, xyz, white_rgb=white, white_xyz=white_xyz,
        rgb_cov=cov * np.outer(white, white), xyz_cov=xyz_cov,
    )  # fmt: skip
    # the model's slopes over white, then in units in which all colours scatter alike
    slopes = known.model.jacobian(rgb) / white_xyz[:, None] * white
    roots = np.swapaxes(np.linalg.cholesky(pairs.whitening), 1, 2)
    misses = (roots @ (pairs.relative - known.model.apply(rgb) / white_xyz)[..., None])[..., 0]
    gains = balanced[:, :, None] * np.eye(3)
    offsets = np.broadcast_to(np.eye(3), gains.shape)
    found = compare_nested(
        misses,
        roots @ slopes @ np.concatenate([gains, offsets], axis=2),
        roots @ slopes @ white_keeping_terms(balanced),
    )
    old_from_new = white_keeping_matrix(found.extra)
    before = (balanced @ old_from_new.T) * white
    moved = delta_e_2000_xyz(known.model.apply(rgb), known.model.apply(before))
    return np.asarray(np.linalg.pinv(old_from_new)), found.chance, float(moved.mean())


def _by_colour(
    samples: ColourSamples, expected: ExpectedDiscs
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Balanced colours, what they should be, and both covariances, one row an ink."""
    means = combine_views(samples, len(expected.xyz))
    light = samples.reference_light_rgb
    usable = (means.n_views > 0) & np.isfinite(expected.xyz).all(axis=1)
    rows = []
    for colour in np.unique(expected.colour[usable]):
        discs = np.flatnonzero(usable & (expected.colour == colour))
        rows.append((
            means.mean_rgb[discs].mean(axis=0) / light,
            means.cov_rgb[discs].sum(axis=0) / len(discs) ** 2 / np.outer(light, light),
            expected.xyz[discs].mean(axis=0),
            expected.cov[discs].mean(axis=0),
        ))  # fmt: skip
    if not rows:
        return None
    balanced, cov, xyz, xyz_cov = (np.array(part) for part in zip(*rows, strict=True))
    return balanced, cov, xyz, xyz_cov


def _unevenness(samples: ColourSamples, known: KnownColour) -> float:
    """Largest over smallest light on the board, less 1, in the median over frames."""
    light = (samples.light_rgb / _gain(samples, known))[:, 1]
    usable = samples.usable
    ratios = [
        float(np.ptp(light[mine]) / light[mine].min())
        for view in range(len(samples.frame_ids))
        if (mine := usable & (samples.view == view)).any()
    ]
    return float(np.median(ratios))
