"""A .cube read by colour-science gives the colours of the model that was baked."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from colour import LUT3D
from colour.algebra import table_interpolation_tetrahedral
from colour.io import read_LUT_IridasCube

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.encoding import EncodingName, ToneCurve, encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB
from calichrome.colour.families import fit_model
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import CalichromeError
from calichrome.export.cube import CubeSpace, bake_cube, cube_text
from calichrome.geometry.lenses import BrownConrady
from calichrome.rig import Camera, CameraColour

PairsOf = Callable[..., ColourPairs]
CameraOf = Callable[..., Camera]

_SENSOR = "Nikon 5100 (NPL)"


@pytest.fixture
def camera_of(checker_pairs: PairsOf) -> CameraOf:
    """A camera with a colour model fitted to a ColorChecker."""

    def camera(
        model: str = "root-polynomial-2-white",
        encoding: EncodingName | ToneCurve | None = "srgb",
        sensor: str = _SENSOR,
    ) -> Camera:
        pairs = checker_pairs(sensor, 0.01)
        colour = CameraColour(
            model=fit_model(model, pairs),
            encoding=encoding,
            white_rgb=pairs.white_rgb,
            delta_e_2000={"fit_mean": 1.0, "held_out_mean": 1.0, "held_out_p95": 2.0},
        )
        lens = BrownConrady.start((640, 480), 600)
        return Camera(
            size_wh=(640, 480),
            lens=lens,
            lens_sigma=dict.fromkeys(lens.NAMES),
            cam_from_ref=Pose.identity(),
            sigma_rad=None,
            sigma_m=None,
            n_views=12,
            n_corners=600,
            rms_px=0.1,
            colour=colour,
        )

    return camera


def _read(text: str, folder: Path) -> LUT3D:
    path = folder / "camera.cube"
    path.write_text(text, encoding="utf-8")
    table = read_LUT_IridasCube(str(path))
    assert isinstance(table, LUT3D)
    return table


def _in_gamut(camera: Camera, stored: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stored values whose colours sRGB holds, and these colours."""
    assert camera.colour is not None
    assert camera.colour.encoding is not None
    xyz = camera.colour.xyz_from_rgb(linearise(stored, camera.colour.encoding))
    rgb = xyz @ RGB_FROM_XYZ["srgb"].T
    shown = ((rgb >= 0) & (rgb <= 1)).all(axis=1)
    return stored[shown], xyz[shown]


@pytest.mark.parametrize("size", [33, 65])
def test_another_reader_finds_the_colours(
    size: int, camera_of: CameraOf, tmp_path: Path, rng: np.random.Generator
) -> None:
    """65 nodes keep what they promise; 33 miss it, which is why they are not the default."""
    camera = camera_of()
    cube = bake_cube(camera, size)
    table = _read(cube_text(cube, "cam0", vignetting=False), tmp_path)
    assert table.size == size
    stored, xyz = _in_gamut(camera, rng.uniform(0, 1, (20_000, 3)))
    shown = table.apply(stored, interpolator=table_interpolation_tetrahedral)
    found = linearise(np.clip(shown, 0, 1), "srgb") @ XYZ_FROM_RGB["srgb"].T
    errors = delta_e_2000_xyz(found, xyz)
    # the file says so itself, from colours of its own: a tenth apart is chance
    assert errors.mean() == pytest.approx(cube.delta_e_mean, rel=0.1)
    assert np.quantile(errors, 0.95) == pytest.approx(cube.delta_e_p95, rel=0.1)
    assert (errors.mean() < 0.1) == (size == 65)


@pytest.mark.parametrize("space", ["srgb", "display-p3", "linear-srgb", "xyz-d65"])
def test_nodes_are_the_model(
    space: CubeSpace, camera_of: CameraOf, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Red changes fastest, and nothing is clipped."""
    camera = camera_of("linear")
    assert camera.colour is not None
    cube = bake_cube(camera, 9, space)
    table = _read(cube_text(cube, "cam0", vignetting=True), tmp_path)
    at = rng.integers(0, 9, (50, 3))
    xyz = camera.colour.xyz_from_rgb(linearise(at / 8, "srgb"))
    expected = xyz
    if space != "xyz-d65":
        expected = xyz @ RGB_FROM_XYZ["display-p3" if space == "display-p3" else "srgb"].T
    if space in ("srgb", "display-p3"):
        expected = encode(expected, "srgb")
    # seven decimals are written
    np.testing.assert_allclose(table.table[tuple(at.T)], expected, atol=1e-7)
    if space == "srgb":
        assert cube.nodes.min() < 0


@pytest.mark.parametrize("model", MODELS)
def test_every_model_can_be_baked(model: str, camera_of: CameraOf) -> None:
    cube = bake_cube(camera_of(model), 5)
    assert np.isfinite(cube.nodes).all()


def test_a_tone_curve_is_baked_in(camera_of: CameraOf) -> None:
    """A curve that happens to be that of sRGB makes the table of sRGB."""
    steps = np.arange(4096) / 4095
    curve = ToneCurve.from_table(steps, linearise(steps, "srgb"))
    estimated = bake_cube(camera_of(encoding=curve), 33)
    known = bake_cube(camera_of(), 33)
    # its 256 entries are joined by straight lines
    np.testing.assert_allclose(estimated.nodes, known.nodes, atol=2e-3)
    assert "tone curve" in cube_text(estimated, "cam0", vignetting=False)


def test_the_comment_says_what_the_input_is(camera_of: CameraOf) -> None:
    text = cube_text(bake_cube(camera_of(), 3), 'a"b', vignetting=True)
    comments = "\n".join(line for line in text.splitlines() if line.startswith("#"))
    assert "srgb-encoded" in comments
    assert "0..1 of full scale" in comments
    assert "fall-off is not in this table" in comments
    assert text.startswith('TITLE "a\'b to srgb"\n')


def test_linear_values_are_not_tabulated_for_an_encoded_output(camera_of: CameraOf) -> None:
    linear = camera_of(encoding="linear")
    with pytest.raises(CalichromeError, match="--input srgb"):
        bake_cube(linear, 65)
    assert bake_cube(linear, 33, "linear-srgb").delta_e_mean < 0.1
    stated = bake_cube(linear, 33, stated="srgb")
    np.testing.assert_array_equal(stated.nodes, bake_cube(camera_of(), 33).nodes)


def test_what_cannot_be_baked_is_refused(camera_of: CameraOf) -> None:
    with pytest.raises(CalichromeError, match="no colour calibration"):
        bake_cube(replace(camera_of(), colour=None))
    with pytest.raises(CalichromeError, match="--size 1:"):
        bake_cube(camera_of(), 1)
    with pytest.raises(CalichromeError, match="--input srgb"):
        bake_cube(camera_of(encoding=None))
