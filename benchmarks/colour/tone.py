"""Tone curve unknown: pictures of our board as a camera stores them, through the detector.

A shot is everything a method may use, and the test in the same stored values. The light is D50, in
which chromacal has its references; the lamps of `calichrome.synthetic` light the board unevenly,
and lens and flare are those of its scenes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from benchmarks.colour.card import CARD_LEVEL, card_means, card_picture, chromacal
from benchmarks.colour.looks import SRGB, Look, random_curve, random_webcam
from benchmarks.colour.peers import NotRunError, affine_of_coded, root_polynomial_2
from benchmarks.colour.problems import ColourProblem, ColourSet, problems
from benchmarks.colour.scoring import Apply, Errors, errors
from benchmarks.colour.spectra import (
    WAVELENGTHS_NM,
    colour_science,
    illuminant,
    known_cameras,
    observer,
)
from benchmarks.geometry.tables import NOT_RUN, Bar, print_table
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, frozen
from calichrome.detection import detect_board
from calichrome.imaging import Image
from calichrome.observations import BoardView, NotFound
from calichrome.synthetic import Renderer, Scene, exposed, random_scene
from calichrome.synthetic.scene import image_rng
from calichrome.synthetic.sensor import develop
from calichrome.target import Target, colour_checker_palette, design_target

__all__ = ["Studio", "ToneMethod", "ToneShot", "print_tone"]

_LIGHT = "D50"
_SRGB, _CURVE, _WEBCAM = "sRGB", "random curve", "random webcam"
_LIMITS = {_SRGB: 1.25, _CURVE: 1.25, _WEBCAM: 2.0}
"""Bars on the mean: chromacal has 1.7 on a card with the sRGB curve; a webcam may be doubted."""

_SIZE_WH = (1280, 960)
_SCENE_WAVELENGTHS_NM = frozen(np.arange(380, 781, 5))
_TABLE_CODES = 1024  # of the known curve turned round: a quarter of an 8-bit step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToneShot:
    """Pictures of the board by one camera, values as stored, 0..1 of full scale.

    Parameters
    ----------
    views
        By frame. ``discs`` holds stored values: `mean_rgb`, `white_rgb`, `black_rgb`, and the
        covariance and clipped share of these.
    target
        The board.
    train_xyz : (n_markers, 3) float
        What each marker is under the light, Y = 1 for the perfect diffuser.
    paper_xyz, ink_xyz, white_xyz : (3,) float
        The white and the black squares, and the light itself, on the same scale.
    reference_white : (3,) float
        Stored value of the white squares in the light of the test: their median over all discs.
    test
        t190 as large even surfaces in that light, stored but not rounded.
    look
        What was done to the pictures: for rows that are told it, not for others.
    """

    camera: str
    views: Mapping[str, BoardView]
    target: Target
    train_xyz: FloatArray
    paper_xyz: FloatArray
    ink_xyz: FloatArray
    white_xyz: FloatArray
    reference_white: FloatArray
    test: ColourSet
    look: Look


ToneMethod = Callable[[ToneShot], Apply | None]
"""A way from a shot to a map of stored values (n, 3) to XYZ (n, 3) under the light; None where the
method says that the encoding is doubtful."""


@dataclass(frozen=True, slots=True, eq=False)
class Studio:
    """The board before one camera: linear pictures, from which every look is made.

    Parameters
    ----------
    linear
        Pictures by frame, (H, W, 3), noise and mosaic included, white-balanced, not cut.
    reference_white : (3,) float
        Linear value of the white squares: their median over all discs.
    """

    problem: ColourProblem
    scene: Scene
    linear: Mapping[str, FloatArray]
    surfaces: FloatArray
    reference_white: FloatArray

    @classmethod
    def set_up(cls, problem: ColourProblem, n_views: int, seed: int) -> "Studio":
        """Render the board in `n_views` poses; `seed` is that of poses, lens and noise."""
        scene = _scene(problem, n_views, seed)
        (camera,) = scene.cameras
        renderer = Renderer(scene)
        linear = {
            frame: develop(
                renderer.electrons(camera.camera_id, frame),
                camera,
                image_rng(seed, "noise", camera.camera_id, frame),
            )
            for frame in scene.world_from_board
        }
        inside = np.isin(_SCENE_WAVELENGTHS_NM, WAVELENGTHS_NM)
        views = _detected(linear, scene.target, lambda rgb: rgb.astype(np.float32))
        return cls(
            problem=problem,
            scene=scene,
            linear=linear,
            surfaces=renderer.palette.surfaces[:, inside],
            reference_white=_median_white(views),
        )

    def shot(self, look: Look) -> ToneShot:
        """Store the pictures with a look and detect the board in them."""
        weights = observer() * illuminant(self.problem.light)[:, None]
        to_xyz = weights / weights[:, 1].sum()
        sensitivity = known_cameras()[self.problem.camera]
        to_rgb = sensitivity * illuminant(self.problem.light)[:, None]
        to_rgb = to_rgb / to_rgb.sum(axis=0)
        paper_xyz, ink_xyz, *markers_xyz = self.surfaces @ to_xyz
        level = self.reference_white / (self.surfaces[0] @ to_rgb)
        test = self.problem.tests["t190"]
        return ToneShot(
            camera=self.problem.camera,
            views=_detected(self.linear, self.scene.target, look.of_picture),
            target=self.scene.target,
            train_xyz=np.array(markers_xyz),
            paper_xyz=paper_xyz,
            ink_xyz=ink_xyz,
            white_xyz=self.problem.white_xyz,
            reference_white=look.of_even(self.reference_white),
            test=ColourSet(look.of_even(test.rgb * level), test.xyz),
            look=look,
        )


def _scene(problem: ColourProblem, n_views: int, seed: int) -> Scene:
    """Put the problem's camera and light into a scene of one camera."""
    colour = colour_science()
    values = np.zeros((len(_SCENE_WAVELENGTHS_NM), 3))
    values[np.isin(_SCENE_WAVELENGTHS_NM, WAVELENGTHS_NM)] = known_cameras()[problem.camera]
    name = f"benchmark: {problem.camera}"
    # where synthetic scenes look up a sensor by name
    colour.MSDS_CAMERA_SENSITIVITIES[name] = colour.characterisation.RGB_CameraSensitivities(
        values, _SCENE_WAVELENGTHS_NM
    )
    target = design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=colour_checker_palette())
    scene = random_scene(target, 1, n_views, _SIZE_WH, seed)
    (camera,) = scene.cameras
    return exposed(
        replace(
            scene,
            cameras=(
                replace(
                    camera,
                    sensor=replace(camera.sensor, sensitivity=name),
                    white_balance=(1.0, 1.0, 1.0),
                ),
            ),
            lights=tuple(replace(light, spectrum=problem.light) for light in scene.lights),
            ambients=tuple(replace(light, spectrum=problem.light) for light in scene.ambients),
        )
    )


def _detected(
    linear: Mapping[str, FloatArray],
    target: Target,
    stored: Callable[[FloatArray], NDArray[np.uint8] | NDArray[np.float32]],
) -> dict[str, BoardView]:
    """Detect the board with stored values taken as they are."""
    views = {}
    for frame, rgb in linear.items():
        image = Image(pixels=stored(rgb), encoding="linear", bits=8)
        view = detect_board(image, target)
        if not isinstance(view, NotFound):
            views[frame] = view
    return views


def _median_white(views: Mapping[str, BoardView]) -> FloatArray:
    """Median level of the white squares beside all discs, (3,)."""
    whites = [view.discs.white_rgb for view in views.values() if view.discs is not None]
    return np.asarray(np.nanmedian(np.concatenate(whites), axis=0))


def curve_known(shot: ToneShot) -> Apply:
    """Root-polynomial 2 of colour-science, told the curve: what is left if nothing is estimated.

    Discs are divided by the white beside them and averaged over views by their pixels.
    """
    codes = np.linspace(0, 1, _TABLE_CODES)
    stored = shot.look.curve(codes)

    def linear(values: FloatArray) -> FloatArray:
        return np.interp(values, stored, codes)

    total, n_px = np.zeros((len(shot.train_xyz), 3)), np.zeros(len(shot.train_xyz))
    for view in shot.views.values():
        discs = view.discs
        if discs is None:
            continue
        good = (discs.clipped == 0) & np.isfinite(discs.white_rgb).all(axis=1)
        share = linear(discs.mean_rgb[good]) / linear(discs.white_rgb[good])
        np.add.at(total, discs.marker_ids[good], discs.n_px[good, None] * share)
        np.add.at(n_px, discs.marker_ids[good], discs.n_px[good])
    seen = n_px > 0
    rgb = total[seen] / n_px[seen, None]
    apply = root_polynomial_2(rgb, shot.train_xyz[seen], shot.white_xyz)
    return lambda values: apply(linear(values) / linear(shot.reference_white))


def _card_errors(studio: Studio, look: Look, python: Path | None) -> dict[str, FloatArray | None]:
    """Errors of those who read the card, on t190 in the light of the card."""
    problem = studio.problem
    picture = card_picture(problem, look, np.random.default_rng(0))
    means, white_xyz, t190 = card_means(picture), problem.white_xyz, problem.tests["t190"]
    test = ColourSet(look.of_even(CARD_LEVEL * t190.rgb), t190.xyz)
    affine = affine_of_coded(means, problem.train.xyz, white_xyz)
    readers: Mapping[str, Callable[[], Apply]] = {
        "chromacal, from the card": lambda: chromacal(python, picture),
        "PlantCV's way, from the card": lambda: affine,
    }
    found: dict[str, FloatArray | None] = {}
    for name, reader in readers.items():
        try:
            found[name] = errors(reader(), test, white_xyz)
        except NotRunError:
            found[name] = None
    return found


def print_tone(
    methods: Mapping[str, ToneMethod], python: Path | None, n_looks: int, n_views: int = 6
) -> list[Bar]:
    """Print errors on t190 by look: sRGB, random curves, random webcams.

    Parameters
    ----------
    methods
        Those that estimate: each is held against the bars.
    python
        Interpreter of an environment with chromacal; None: not run.
    n_looks
        Random curves and webcams, each before each camera.
    n_views
        Pictures of the board in a shot.
    """
    studios = [
        Studio.set_up(problem, n_views, seed)
        for seed, problem in enumerate(problems(every=False, lights=(_LIGHT,)))
    ]
    rngs = [np.random.default_rng([1, draw]) for draw in range(n_looks)]
    groups: dict[str, list[Look]] = {
        _SRGB: [SRGB],
        _CURVE: [
            Look(name=f"curve {draw}", curve=random_curve(rng)) for draw, rng in enumerate(rngs)
        ],
        _WEBCAM: [random_webcam(rng, draw) for draw, rng in enumerate(rngs)],
    }
    every = {"curve known, colour-science root-polynomial 2": curve_known, **methods}
    cells: dict[str, list[str]] = {}
    bars = []
    for group, looks in groups.items():
        collected: dict[str, list[FloatArray | None]] = {}
        for studio in studios:
            for look in looks:
                shot = studio.shot(look)
                for name, method in every.items():
                    apply = method(shot)
                    values = None if apply is None else errors(apply, shot.test, shot.white_xyz)
                    collected.setdefault(name, []).append(values)
                for name, values in _card_errors(studio, look, python).items():
                    collected.setdefault(name, []).append(values)
        for name, parts in collected.items():
            text, joined = _summary(parts, estimates=name in methods)
            cells.setdefault(name, []).append(text)
            if joined is not None and name in methods:
                bars.append(Bar(f"{name}, {group}, t190", joined.mean, high=_LIMITS[group]))
    print(
        f"\ntone curve unknown, 8 bit, {_LIGHT}: {len(studios)} cameras, {n_views} views, "
        f"{n_looks} curves and webcams for each"
    )
    print_table(["method", *groups], [[name, *row] for name, row in cells.items()])
    return bars


def _summary(parts: Sequence[FloatArray | None], *, estimates: bool) -> tuple[str, Errors | None]:
    """Mean / 95 % over the shots that were not refused, and how many were."""
    kept = [part for part in parts if part is not None]
    if not kept:
        return (f"{len(parts)} doubtful" if estimates else NOT_RUN), None
    joined = Errors(np.concatenate(kept))
    refused = len(parts) - len(kept)
    note = f", {refused} of {len(parts)} {'doubtful' if estimates else NOT_RUN}" if refused else ""
    return f"{joined}{note}", joined
