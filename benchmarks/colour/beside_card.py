"""A print measured by a card beside it: python -m benchmarks.colour.beside_card [--seeds N].

A board printed with wrong colours and a ColorChecker card in the same plane, in the light of two
lamps of different spectrum, through a real sensor: mosaic, noise, blur, vignetting, stray light,
8-bit sRGB.
"""

import argparse
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from benchmarks.geometry.tables import Bar, print_bars, print_table
from scipy.spatial.transform import Rotation

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.reference import WAVELENGTHS_NM, colour_checker_spectra
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.detection.card import CARD_PLACES
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import write_picture
from calichrome.pipeline.measure_card import CardMeasurement, measure_from_card
from calichrome.synthetic import Renderer, Scene
from calichrome.synthetic.scene import (
    Ambient,
    Light,
    Panel,
    SceneCamera,
    SceneSensor,
    image_rng,
    white_margin_m,
)
from calichrome.synthetic.sensor import develop, stored
from calichrome.synthetic.setups import SENSORS
from calichrome.synthetic.truth import Truth, truth_of
from calichrome.target import Target, colour_checker_palette, design_target

__all__ = ["SIDES", "Printed", "errors", "main", "measured", "printed_scenes", "write_pictures"]

SIDES = ("right", "left", "above")
_PRINT_SD = 3.0  # of L, a and b of the print about its table
SIZE_WH = (1440, 1080)
_PITCH_M, _PATCH_M = 0.042, 0.038  # of a card of 279 x 216 mm
_RIM_M = 0.012
_FRAME = 0.035  # reflectance of what holds the patches
_TABLE = 0.3
_GAP_M = 0.015  # between card and paper
_BRIGHTEST = 0.8  # of full scale, the white of the card
_HELD_OUT = 1.5
"""Mean dE2000 that a measured disc may be off by: what the models on the ColorChecker miss surfaces
they have not seen (0.5 to 1.5 over cameras and lights)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Printed:
    """A scene for each picture, what is true in all of them, and where white is to be."""

    scenes: Mapping[str, Scene]
    truth: Truth
    level: float

    @property
    def target(self) -> Target:
        """What the owner of the board believes."""
        return next(iter(self.scenes.values())).target


def printed_scenes(
    target: Target, seed: int = 0, *, sensor: str = SENSORS[0], sides: Sequence[str] = SIDES,
    size_wh: tuple[int, int] = SIZE_WH, level: float = _BRIGHTEST,
) -> Printed:  # fmt: skip
    """Put the card at several sides of one print, in one light; white reaches `level`."""
    rng = np.random.default_rng(seed)
    lights = _lights(rng)
    scenes = {}
    for side in sides:
        turn = Rotation.from_euler("yxz", rng.uniform(-12, 12, 3), degrees=True).as_matrix()
        centre_board = np.append(_middle(target, side), 0)
        world_from_board = Pose(turn, np.array([0, 0, 1.0]) - turn @ centre_board)
        scenes[side] = Scene(
            target=target,
            cameras=(_camera(sensor, target, side, size_wh),),
            world_from_board={side: world_from_board},
            lights=lights,
            ambients=(Ambient(spectrum="D65", irradiance=0.05),),
            panels=(_table(world_from_board), *_card(target, side, world_from_board)),
            palette_error_lab_sd=_PRINT_SD,
            seed=seed,
        )
    truth = truth_of(next(iter(scenes.values())))
    return Printed(scenes=scenes, truth=truth, level=level)


def write_pictures(printed: Printed, folder: Path) -> None:
    """Render and store, one file for each side."""
    folder.mkdir(parents=True, exist_ok=True)
    for side, scene in printed.scenes.items():
        (camera,) = scene.cameras
        electrons = Renderer(scene).electrons(camera.camera_id, side)
        camera, electrons = _exposed(camera, electrons, printed.level)
        light = develop(electrons, camera, image_rng(scene.seed, "noise", side))
        write_picture(folder / f"{side}.png", stored(light, camera))


def measured(printed: Printed) -> CardMeasurement:
    """Render the pictures and measure the print in them."""
    with tempfile.TemporaryDirectory() as folder:
        write_pictures(printed, Path(folder))
        return measure_from_card(printed.target, Path(folder))


def errors(printed: Printed, xyz: FloatArray, *, level: bool = True) -> FloatArray:
    """dE2000 of discs from the truth, (n_markers,); without `level` the paper's Y is as true."""
    true = printed.truth
    scale = 1.0 if level else true.white_xyz_d65[1]
    return np.asarray(delta_e_2000_xyz(xyz * scale, true.marker_xyz_d65))


def _card_size() -> FloatArray:
    return np.array([5, 3]) * _PITCH_M + _PATCH_M + 2 * _RIM_M


def _sheet(target: Target) -> tuple[FloatArray, FloatArray]:
    """Middle and half size of the paper, board coordinates."""
    side, count = np.array(target.square_m), np.array(target.squares)
    return (count / 2 - 1) * side, count / 2 * side + white_margin_m(target)


def _card_centre(target: Target, side: str) -> FloatArray:
    middle, half = _sheet(target)
    away = half + _GAP_M + _card_size() / 2
    step = {"right": (1, 0), "left": (-1, 0), "above": (0, -1), "below": (0, 1)}[side]
    return np.asarray(middle + away * np.array(step))


def _bounds(target: Target, side: str) -> tuple[FloatArray, FloatArray]:
    (middle, half), card = _sheet(target), _card_centre(target, side)
    low = np.minimum(middle - half, card - _card_size() / 2)
    return low, np.maximum(middle + half, card + _card_size() / 2)


def _middle(target: Target, side: str) -> FloatArray:
    low, high = _bounds(target, side)
    return np.asarray((low + high) / 2)


def _camera(sensor: str, target: Target, side: str, size_wh: tuple[int, int]) -> SceneCamera:
    low, high = _bounds(target, side)
    focal = 0.85 * float((np.array(size_wh) / (high - low)).min())  # the whole of it, from 1 m
    lens = BrownConrady(
        fx=focal, fy=focal, cx=(size_wh[0] - 1) / 2, cy=(size_wh[1] - 1) / 2,
        k1=-0.12, k2=0.03, p1=0.0, p2=0.0, k3=0.0,
    )  # fmt: skip
    return SceneCamera(
        camera_id="cam0",
        size_wh=size_wh,
        lens=lens,
        cam_from_world=Pose(np.eye(3), np.zeros(3)),
        sensor=SceneSensor(sensitivity=sensor, mosaic="Sigma" not in sensor),
        white_balance=(1.0, 1.0, 1.0),
    )


def _lights(rng: np.random.Generator) -> tuple[Light, ...]:
    """Return a warm lamp at one side that falls off by tens of per cent, and a weak cold one."""
    azimuth = rng.uniform(0, 2 * np.pi)
    main = np.array([0.7 * np.cos(azimuth), 0.7 * np.sin(azimuth), rng.uniform(-0.3, 0.0)])
    other = np.array([-0.9 * np.cos(azimuth), -0.9 * np.sin(azimuth), -0.2])
    aim = np.array([0, 0, 1.0])
    return tuple(
        Light(
            spectrum=spectrum,
            power=power,
            centre_world=(float(place[0]), float(place[1]), float(place[2])),
            axis_world=(float(axis[0]), float(axis[1]), float(axis[2])),
        )
        for spectrum, power, place, axis in (
            ("LED-B4", 2.0, main, aim - main),
            ("D65", 0.5, other, aim - other),
        )
    )


def _table(world_from_board: Pose) -> Panel:
    behind = world_from_board @ Pose(np.eye(3), np.array([0.1, 0.1, 0.004]))
    return Panel(
        world_from_panel=behind,
        half_size_m=(3.0, 3.0),
        reflectance=np.full(len(WAVELENGTHS_NM), _TABLE),
        texture_contrast=0.08,
        texture_m=0.01,
    )


def _card(target: Target, side: str, world_from_board: Pose) -> Iterator[Panel]:
    centre = _card_centre(target, side)

    def panel(place: FloatArray, half: FloatArray, reflectance: FloatArray) -> Panel:
        at = world_from_board @ Pose(np.eye(3), np.append(centre + place, 0))
        return Panel(world_from_panel=at, half_size_m=(half[0], half[1]), reflectance=reflectance)

    yield panel(np.zeros(2), _card_size() / 2, np.full(len(WAVELENGTHS_NM), _FRAME))
    for place, reflectance in zip(CARD_PLACES, colour_checker_spectra().values(), strict=True):
        yield panel(place * _PITCH_M, np.full(2, _PATCH_M / 2), reflectance)


def _exposed(
    camera: SceneCamera, electrons: FloatArray, level: float
) -> tuple[SceneCamera, FloatArray]:
    """Expose and balance so that the brightest place is at `level` in every channel."""
    top = np.quantile(electrons, 0.9999, axis=(0, 1))
    red, green, blue = (float(value) for value in top.max() / top)
    gain = level * camera.sensor.full_well_e / float(top.max())
    return replace(camera, white_balance=(red, green, blue)), gain * electrons


def _scored(printed: Printed) -> tuple[list[str], list[Bar]]:
    """Return a row of the table, and what it has to keep."""
    found, truth = measured(printed), printed.truth
    by_card = found.measured
    paper_y, sigma = by_card.white_xyz_d65[1], by_card.level_sigma
    off = float(paper_y / truth.white_xyz_d65[1] - 1)
    nominal, absolute = (
        errors(printed, xyz) for xyz in (printed.target.marker_xyz_d65, by_card.xyz_d65)
    )
    discs = errors(printed, by_card.xyz_d65 / paper_y, level=False)
    white, black = (
        float(delta_e_2000_xyz(seen, true))
        for seen, true in (
            (by_card.white_xyz_d65, truth.white_xyz_d65),
            (by_card.black_xyz_d65, truth.black_xyz_d65),
        )
    )
    numbers = [nominal.mean(), discs.mean(), discs.max(), absolute.mean()]
    numbers += [by_card.sigma_delta_e.mean(), white, black]
    row = [f"{len(found.used)}", *(f"{number:.2f}" for number in numbers)]
    bars = [
        Bar("discs over the paper, dE2000", float(discs.mean()), high=_HELD_OUT),
        Bar("level, sigmas", abs(off) / sigma, high=3.0),
    ]
    return [*row, f"{off:+.2%}", f"{sigma:.2%}"], bars


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args(argv)
    target = design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=colour_checker_palette())
    rows: list[list[str]] = []
    bars: list[Bar] = []
    for sensor in SENSORS[:2]:
        for seed in range(options.seeds):
            row, of_row = _scored(printed_scenes(target, seed, sensor=sensor))
            rows.append([sensor, f"{seed}", *row])
            bars += [replace(bar, name=f"{sensor}, seed {seed}: {bar.name}") for bar in of_row]
    head = ["sensor", "seed", "pictures", "nominal", "discs", "worst", "with level", "stated"]
    print_table([*head, "paper", "black", "level", "sigma"], rows)
    print_bars(bars)


if __name__ == "__main__":
    main()
