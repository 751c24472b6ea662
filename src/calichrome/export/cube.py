"""A camera's colours as a 3-D table: the .cube that grading programs, OCIO and ffmpeg read."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.encoding import EncodingName, encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.errors import CalichromeError
from calichrome.rig import Camera

__all__ = ["Cube", "CubeSpace", "bake_cube", "cube_text"]

CubeSpace = Literal["srgb", "display-p3", "linear-srgb", "xyz-d65"]

_LABELS: dict[CubeSpace, str] = {
    "srgb": "sRGB, D65, encoded (IEC 61966-2-1)",
    "display-p3": "Display P3, D65, encoded (transfer function of sRGB)",
    "linear-srgb": "linear light, primaries of sRGB, D65",
    "xyz-d65": "CIE XYZ under D65, Y = 1 for the perfect diffuser",
}
_ENCODED = ("srgb", "display-p3")  # both store the sRGB transfer function
_SIZES = range(2, 130)  # beyond, no program that is known reads it, and the file passes 60 MB
_N_JUDGED = 200_000  # random inputs; of a camera that mixes its channels 1 % make colours of sRGB
_COARSE_P95 = 1.0  # dE2000, choice: about what is just visible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cube:
    """A table of output colours on a grid of input colours.

    Parameters
    ----------
    nodes : (size, size, size, 3) float
        By blue, green, red of the input, 0..1 in equal steps. Not clipped, so that colours inside
        the gamut are right up to its border.
    space
        Of the output.
    input_name
        What the inputs are, in words.
    delta_e_mean, delta_e_p95
        CIEDE2000 that tetrahedral interpolation costs, over random inputs whose output is in gamut.
    """

    nodes: FloatArray
    space: CubeSpace
    input_name: str
    delta_e_mean: float
    delta_e_p95: float

    @property
    def size(self) -> int:
        """Nodes along each axis."""
        return len(self.nodes)

    def doubts(self, camera_id: str) -> tuple[Finding, ...]:
        """Say so if the table is too coarse for the camera."""
        if self.delta_e_p95 <= _COARSE_P95:
            return ()
        text = (
            f"Camera {camera_id}: between the nodes of a table of {self.size} colours are off by "
            f"{self.delta_e_mean:.2f} dE2000 on average, 5 % by more than {self.delta_e_p95:.2f}: "
            f"too coarse for how strongly this camera's channels are mixed. Use `correct`, which "
            f"evaluates the model itself{', or --size 65' if self.size < 65 else ''}."
        )
        return (
            finding(
                "coarse_table", text, camera=camera_id, size=self.size,
                mean=self.delta_e_mean, p95=self.delta_e_p95,
            ),
        )  # fmt: skip


def bake_cube(
    camera: Camera,
    size: int = 65,
    space: CubeSpace = "srgb",
    stated: EncodingName | None = None,
) -> Cube:
    """Tabulate the colour model of a camera, without the fall-off of its lens.

    Parameters
    ----------
    camera
        From a rig, with colour.
    size
        Nodes along each axis.
    space
        Of the output.
    stated
        How the inputs will be encoded; None: as the camera stores them.

    Raises
    ------
    CalichromeError
        If the camera has no colour calibration or no known encoding, or if linear inputs are to be
        tabulated for an encoded output: 65 equal steps of linear light leave the dark colours off
        by 2 dE2000, 33 steps by 16.
    """
    colour = camera.colour
    if colour is None:
        raise CalichromeError("it has no colour calibration; calibrate with the colour target")
    if size not in _SIZES:
        raise CalichromeError(f"--size {size}: a .cube has {_SIZES.start} to {_SIZES.stop - 1}")
    curve = stated or colour.encoding
    if curve is None:
        raise CalichromeError(
            "it was calibrated from corners, so how its files store light is unknown; state it "
            "with --input srgb (or gamma2.2, rec709, linear)"
        )
    if curve == "linear" and space in _ENCODED:
        raise CalichromeError(
            "its values are linear light, of which equal steps are too coarse in the dark for an "
            "encoded output; encode the pictures and say so with --input srgb (or gamma2.2, "
            "rec709), or export a linear output with --colour linear-srgb"
        )
    steps = np.arange(size) / (size - 1)
    blue, green, red = np.meshgrid(steps, steps, steps, indexing="ij")
    grid = np.stack([red, green, blue], axis=-1)
    nodes = _stored(colour.xyz_from_rgb(linearise(grid, curve)), space)
    inputs = np.random.default_rng(0).uniform(0, 1, (_N_JUDGED, 3))
    exact = colour.xyz_from_rgb(linearise(inputs, curve))
    rgb = exact @ RGB_FROM_XYZ[_gamut(space)].T
    shown = ((rgb >= 0) & (rgb <= 1)).all(axis=1)
    errors = delta_e_2000_xyz(_xyz(_interpolated(nodes, inputs[shown]), space), exact[shown])
    name = (
        f"{curve}-encoded" if isinstance(curve, str) else "with the tone curve found by calibrate"
    )
    return Cube(
        nodes=nodes,
        space=space,
        input_name="linear light" if curve == "linear" else name,
        delta_e_mean=float(errors.mean()),
        delta_e_p95=float(np.quantile(errors, 0.95)),
    )


def cube_text(cube: Cube, camera_id: str, *, vignetting: bool) -> str:
    """Return the file.

    Parameters
    ----------
    cube
        The table.
    camera_id
        For title and comment.
    vignetting
        Whether the rig knows the fall-off of this camera's lens, which no table of colours holds.

    References
    ----------
    .. [1] Adobe, "Cube LUT Specification", version 1.0, 2013: red changes fastest.
    """
    name = camera_id.encode("ascii", "replace").decode().replace('"', "'")
    fall_off = (
        "the lens's fall-off is not in this table: divide linear values by it first, or expect "
        "darker corners"
        if vignetting
        else "no fall-off of the lens is known"
    )
    lines = [
        f'TITLE "{name} to {cube.space}"',
        f"# input: RGB of camera {name}, {cube.input_name}, full range, 0..1 of full scale",
        "# exposure, white balance and light as in the calibration",
        f"# output: {_LABELS[cube.space]}; nodes are not clipped",
        f"# {fall_off}",
        f"# cost of tetrahedral interpolation: {cube.delta_e_mean:.3f} dE2000 on average",
        f"# 95 % of the colours of the output are off by less than {cube.delta_e_p95:.3f} dE2000",
        f"LUT_3D_SIZE {cube.size}",
        "DOMAIN_MIN 0.0 0.0 0.0",
        "DOMAIN_MAX 1.0 1.0 1.0",
    ]
    rows = [f"{r:.7f} {g:.7f} {b:.7f}" for r, g, b in cube.nodes.reshape(-1, 3).tolist()]
    return "\n".join([*lines, *rows]) + "\n"


def _gamut(space: CubeSpace) -> str:
    return "display-p3" if space == "display-p3" else "srgb"


def _stored(xyz: FloatArray, space: CubeSpace) -> FloatArray:
    if space == "xyz-d65":
        return xyz
    rgb = xyz @ RGB_FROM_XYZ[_gamut(space)].T
    return encode(rgb, "srgb") if space in _ENCODED else rgb


def _xyz(stored: FloatArray, space: CubeSpace) -> FloatArray:
    if space == "xyz-d65":
        return stored
    rgb = linearise(np.clip(stored, 0, 1), "srgb") if space in _ENCODED else stored
    return np.asarray(rgb @ XYZ_FROM_RGB[_gamut(space)].T)


def _interpolated(nodes: FloatArray, stored: FloatArray) -> FloatArray:
    """Interpolate in the tetrahedron whose edges follow the channels from large to small rest."""
    place = stored * (len(nodes) - 1)
    at = np.minimum(place.astype(np.int64), len(nodes) - 2)
    rest = place - at
    order = np.argsort(-rest, axis=1)
    rows = np.arange(len(stored))
    value = before = nodes[at[:, 2], at[:, 1], at[:, 0]]
    for channel in order.T:
        at[rows, channel] += 1
        after = nodes[at[:, 2], at[:, 1], at[:, 0]]
        value = value + rest[rows, channel, None] * (after - before)
        before = after
    return value
