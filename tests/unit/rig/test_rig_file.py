"""rig.json: read as written, refused when damaged, and null where nothing was estimated."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calichrome.colorimetry.encoding import ToneCurve
from calichrome.colour.models.linear import Linear
from calichrome.colour.shading import Vignetting
from calichrome.core.findings import finding
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError, OutputError
from calichrome.geometry.lenses import BrownConrady
from calichrome.rig import (
    FORMAT_VERSION,
    Camera,
    CameraColour,
    Evidence,
    Pair,
    PlacedFrame,
    Rig,
    load_rig,
    rig_to_json,
    save_rig,
)
from calichrome.rig.evidence import CameraCovariance, load_evidence
from calichrome.target import Target, target_from_json, target_to_json

_LENS = BrownConrady(fx=610.1, fy=602.2, cx=322.3, cy=238.4, k1=-0.2, k2=0.08, p1=1e-3, k3=-0.01)
_VIGNETTING = Vignetting(
    centre_px=np.array([322.3, 238.4]),
    half_diagonal_px=400.5,
    coefficients=np.array([[-0.4, 0.05, 0.01, 1e-3, -2e-3]] * 3) * [[1.0], [1.1], [0.9]],
    covariance=np.broadcast_to(np.diag([1e-4, 1e-5, 1e-6, 1e-6, 1e-6]), (3, 5, 5)),
    covered_radius=0.85,
)


@pytest.fixture
def rig(standard_target: Target) -> Rig:
    colour = CameraColour(
        model=Linear.from_matrix(np.array([[0.5, 0.3, 0.2], [0.2, 0.7, 0.1], [0.0, 0.1, 0.9]])),
        encoding="srgb",
        white_rgb=np.array([0.7, 0.8, 0.6]),
        delta_e_2000={
            "fit_mean": 0.9, "held_out_mean": 1.1, "held_out_p95": 2.5, "uncertainty_p95": None,
        },
        candidates=(
            {"model": "linear", "why_not": None, "n_free": 9, "gain": 1.25, "ns_per_pixel": 31.5},
            {"model": "cheung-20", "why_not": "changes by 3.10 dE with exposure", "gain": None},
        ),
    )  # fmt: skip
    left = Camera(
        size_wh=(640, 480),
        lens=_LENS,
        lens_sigma={**dict.fromkeys(_LENS.NAMES, 0.1), "p2": None},
        cam_from_ref=Pose.identity(),
        sigma_rad=np.zeros(3),
        sigma_m=np.zeros(3),
        n_views=12,
        n_corners=648,
        rms_px=0.21,
        held_out_rms_px=0.25,
        colour=colour,
        vignetting=_VIGNETTING,
    )
    right = Camera(
        size_wh=(800, 600),
        lens=_LENS,
        lens_sigma=dict.fromkeys(_LENS.NAMES),
        cam_from_ref=Pose.from_rotvec([0.01, 0.3, -0.02], [-0.2, 0.01, 0.03]),
        sigma_rad=None,
        sigma_m=None,
        n_views=3,
        n_corners=162,
        rms_px=0.31,
    )
    return Rig(
        target=target_from_json(target_to_json(standard_target)),  # its file rounds the colours
        reference_camera="left",
        cameras={"left": left, "right": right},
        pairs=(Pair(("left", "right"), 3, 0.3),),
        frames={"01": PlacedFrame(Pose.from_rotvec([0.2, 0, 0], [0, 0, 0.7]), ("left", "right"))},
        findings=(finding("few_views", "camera right: 3 views", camera="right", views=3),),
        inter_camera_delta_e_2000={"mean": 0.5, "p95": 1.5, "held_out_mean": 0.8},
    )


def test_what_is_saved_is_loaded(rig: Rig, tmp_path: Path) -> None:
    save_rig(rig, None, tmp_path / "rig.json")
    read = load_rig(tmp_path / "rig.json")
    # floats are written with all their digits
    assert rig_to_json(read) == rig_to_json(rig) == json.loads((tmp_path / "rig.json").read_text())
    assert read.trustworthy
    assert dict(read.findings[0].data) == {"camera": "right", "views": 3}


def test_a_loaded_rig_projects_alike(rig: Rig, tmp_path: Path, rng: np.random.Generator) -> None:
    save_rig(rig, None, tmp_path / "rig.json")
    read = load_rig(str(tmp_path / "rig.json"))
    points_ref = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 1], (20, 3))
    rgb = rng.uniform(0, 1, (20, 3))
    for name, camera in rig.cameras.items():
        pixels = camera.project(points_ref)
        np.testing.assert_array_equal(read.cameras[name].project(points_ref), pixels)
        np.testing.assert_array_equal(
            read.cameras[name].unproject(pixels), camera.unproject(pixels)
        )
    before, after = rig.cameras["left"].colour, read.cameras["left"].colour
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.xyz_from_rgb(rgb), before.xyz_from_rgb(rgb))
    # a time would make the file another one each time
    kept = [{k: v for k, v in item.items() if k != "ns_per_pixel"} for item in before.candidates]
    assert [dict(item) for item in after.candidates] == kept
    fall_off, pixels = read.cameras["left"].vignetting, rng.uniform(0, 640, (20, 2))
    assert fall_off is not None
    np.testing.assert_array_equal(fall_off.gain(pixels), _VIGNETTING.gain(pixels))
    np.testing.assert_array_equal(fall_off.sigma(pixels), _VIGNETTING.sigma(pixels))


def test_an_estimated_curve_is_kept(rig: Rig, tmp_path: Path) -> None:
    stored = np.linspace(0, 1, 12)
    curve = ToneCurve.from_table(stored, stored[:, None] ** [2.2, 2.0, 1.8])
    left = rig.cameras["left"]
    assert left.colour is not None
    bent = replace(left, colour=replace(left.colour, encoding=curve))
    save_rig(replace(rig, cameras={**rig.cameras, "left": bent}), None, tmp_path / "rig.json")
    read = load_rig(tmp_path / "rig.json").cameras["left"].colour
    assert read is not None
    assert isinstance(read.encoding, ToneCurve)
    np.testing.assert_array_equal(read.encoding.linear, curve.linear)
    np.testing.assert_array_equal(read.encoding.sigma, curve.sigma)


def test_what_was_not_estimated_is_null(rig: Rig, tmp_path: Path) -> None:
    save_rig(rig, None, tmp_path / "rig.json")
    cameras = json.loads((tmp_path / "rig.json").read_text())["cameras"]
    assert cameras["left"]["lens"]["sigma"]["p2"] is None
    assert cameras["left"]["lens"]["sigma"]["fx"] == 0.1
    right = cameras["right"]
    assert set(right["lens"]["sigma"].values()) == {None}
    assert right["cam_from_ref"]["sigma_rad"] is None
    assert right["cam_from_ref"]["sigma_m"] is None
    assert right["held_out_rms_px"] is None
    assert right["colour"] is None
    assert right["vignetting"] is None
    read = load_rig(tmp_path / "rig.json").cameras["right"]
    assert read.sigma_m is None
    assert read.lens_sigma["fx"] is None
    assert read.vignetting is None


def test_a_critical_finding_is_distrust(rig: Rig) -> None:
    data = rig_to_json(rig)
    assert data["trustworthy"] is True
    doubted = Rig(
        target=rig.target,
        reference_camera=rig.reference_camera,
        cameras=rig.cameras,
        pairs=rig.pairs,
        frames=rig.frames,
        findings=(*rig.findings, finding("unsynchronised", "left and right disagree")),
    )
    assert rig_to_json(doubted)["trustworthy"] is False


def _damaged(rig: Rig, tmp_path: Path, *steps: str | int, value: Any) -> Path:  # noqa: ANN401
    """Write rig.json with one value replaced, or removed if it is `...`."""
    data = rig_to_json(rig)
    inner: Any = data
    for step in steps[:-1]:
        inner = inner[step]
    if value is ...:
        del inner[steps[-1]]
    else:
        inner[steps[-1]] = value
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(data))
    return path


@pytest.mark.parametrize(
    ("steps", "value", "reason"),
    [
        (("format",), "other", "is not a rig file"),
        (("format",), ..., "is not a rig file"),
        (("format_version",), FORMAT_VERSION + 1, "format_version 2, this release reads 1 to 1"),
        (("format_version",), 0, "format_version 0"),
        (("format_version",), "1", "format_version '1'"),
        (("cameras", "left", "rms_px"), ..., "cameras.left.rms_px: Field required"),
        (("cameras", "left", "rms_px"), "much", "cameras.left.rms_px"),
        (("cameras", "left", "rms_px"), float("nan"), "holds NaN"),
        (("cameras", "left", "size_wh"), [640], "cameras.left.size_wh"),
        (("cameras", "left", "lens", "model"), "fisheye", "lens model fisheye is not known"),
        (("cameras", "left", "lens", "fx"), ..., "lacks .fx."),
        (("cameras", "left", "lens", "fx"), "wide", "wide"),
        (("cameras", "left", "colour", "model"), "magic", "colour model magic is not known"),
        (("cameras", "left", "colour", "parameters"), {}, "lacks .matrix."),
        (("cameras", "left", "colour", "parameters"), {"matrix": [[1, 2]]}, "matrix"),
        (("cameras", "left", "colour", "encoding", "name"), "log", "encoding.name"),
        (("cameras", "left", "vignetting", "covered_radius"), ..., "lacks .covered_radius."),
        (("cameras", "left", "vignetting", "covered_radius"), 0.0, "must be positive"),
        (("cameras", "left", "vignetting", "coefficients"), [[1.0] * 5], "coefficients"),
        (("cameras", "left", "cam_from_ref", "rotation"), (2 * np.eye(3)).tolist(), "rotation"),
        (("cameras", "left", "cam_from_ref", "rotation"), [[1, 0, 0]], "rotation"),
        (("reference_camera",), "middle", "reference_camera middle"),
        (("target", "squares"), [2, 2], "squares"),
        (("target",), ..., "target"),
        (("frames", "01", "ref_from_board"), None, "frames.01.ref_from_board"),
        (("findings", 0, "severity"), "fatal", "findings.0.severity"),
    ],
)
def test_damage_is_named(
    steps: tuple[str | int, ...], value: object, reason: str, rig: Rig, tmp_path: Path
) -> None:
    path = _damaged(rig, tmp_path, *steps, value=value)
    with pytest.raises(FileFormatError, match=reason) as caught:
        load_rig(path)
    assert "rig.json" in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 100_000, '{"format": NaN'])
def test_what_is_no_rig_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"rig\.json: is not"):
        load_rig(tmp_path / "rig.json")


def test_other_bytes_and_no_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(FileFormatError, match="not valid JSON"):
        load_rig(tmp_path / "rig.json")
    with pytest.raises(FileFormatError, match="cannot be read"):
        load_rig(tmp_path / "absent.json")


def test_keys_of_later_tools_do_not_disturb(rig: Rig, tmp_path: Path) -> None:
    path = _damaged(rig, tmp_path, "cameras", "left", "serial_number", value="0815")
    assert rig_to_json(load_rig(path)) == rig_to_json(rig)


def _evidence(*, joint: bool = True) -> Evidence:
    parameters = (*_LENS.NAMES, *(f"{kind}_{axis}" for kind in ("omega", "tau") for axis in "xyz"))
    names = [(camera, name) for camera in ("left", "right") for name in parameters] + [("", "uu")]
    return Evidence(
        camera=("left", "right"),
        frame=("01", "01"),
        corner=np.array([0, 5]),
        pixels=np.array([[1.5, 2.5], [3.5, 4.5]]),
        residuals_px=np.array([[0.1, -0.1], [0.2, 0.3]]),
        cov_px=np.array([[0.01, 0.0, 0.02], [np.nan, np.nan, np.nan]]),
        inlier=np.array([True, False]),
        lens_cov={"left": np.eye(9)},
        pose_cov={"right": 2 * np.eye(6)},
        joint=CameraCovariance(
            camera=tuple(camera for camera, _ in names),
            parameter=tuple(name for _, name in names),
            matrix=np.diag(np.arange(31.0)) + 0.5,
        )
        if joint
        else None,
        sums={("left", "01"): "ab" * 32},
    )


@pytest.mark.parametrize("joint", [True, False])
def test_evidence_is_loaded_as_saved(*, joint: bool, rig: Rig, tmp_path: Path) -> None:
    saved = _evidence(joint=joint)
    save_rig(rig, saved, tmp_path / "rig.json")
    read = load_evidence(tmp_path / "rig.npz")
    assert (read.camera, read.frame, read.sums) == (saved.camera, saved.frame, saved.sums)
    for name in ("corner", "pixels", "residuals_px", "cov_px", "inlier"):
        np.testing.assert_array_equal(getattr(read, name), getattr(saved, name))
    assert read.inlier.dtype == bool
    for kind in ("lens_cov", "pose_cov"):
        before, after = getattr(saved, kind), getattr(read, kind)
        assert set(after) == set(before)
        for camera, cov in before.items():
            np.testing.assert_array_equal(after[camera], cov)
    if saved.joint is None:
        assert read.joint is None
        return
    assert read.joint is not None
    assert (read.joint.camera, read.joint.parameter) == (saved.joint.camera, saved.joint.parameter)
    np.testing.assert_array_equal(read.joint.matrix, saved.joint.matrix)


def test_joint_covariance_is_read_by_camera() -> None:
    joint = _evidence().joint
    assert joint is not None
    # the matrix holds 0..30 on its diagonal and a half everywhere
    np.testing.assert_array_equal(np.diag(joint.lens("left")), np.arange(9) + 0.5)
    np.testing.assert_array_equal(np.diag(joint.pose("right")), np.arange(24, 30) + 0.5)
    turned = joint.of("right", "left")
    np.testing.assert_array_equal(np.diag(turned), np.r_[15:30, 0:15] + 0.5)
    np.testing.assert_array_equal(turned[:15, 15:], 0.5)


def test_evidence_lies_beside_and_needs_no_pickle(rig: Rig, tmp_path: Path) -> None:
    save_rig(rig, _evidence(), tmp_path / "rig.json")
    with np.load(tmp_path / "rig.npz", allow_pickle=False) as arrays:
        assert arrays["camera"].tolist() == ["left", "right"]
        np.testing.assert_array_equal(arrays["pixels"], _evidence().pixels)
        np.testing.assert_array_equal(arrays["lens_cov/left"], np.eye(9))
        np.testing.assert_array_equal(arrays["pose_cov/right"], 2 * np.eye(6))
        assert arrays["joint_cov"].shape == (31, 31)
        assert arrays["joint_camera"].tolist().count("right") == 15
        assert arrays["sums"].tolist() == [["left", "01", "ab" * 32]]


def _rewritten(rig: Rig, folder: Path, name: str, values: object) -> Path:
    """Write rig.npz with one array replaced, or removed if it is `...`."""
    save_rig(rig, _evidence(), folder / "rig.json")
    with np.load(folder / "rig.npz", allow_pickle=False) as stored:
        arrays: dict[str, Any] = {key: stored[key] for key in stored.files}
    if values is ...:
        del arrays[name]
    else:
        arrays[name] = values
    np.savez(folder / "rig.npz", **arrays)
    return folder / "rig.npz"


@pytest.mark.parametrize("name", ["camera", "pixels", "cov_px", "inlier", "sums", "joint_camera"])
def test_evidence_of_an_older_release_is_refused(name: str, rig: Rig, tmp_path: Path) -> None:
    path = _rewritten(rig, tmp_path, name, ...)
    with pytest.raises(FileFormatError, match=rf"rig\.npz: lacks '{name}'.*calibrate again"):
        load_evidence(path)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sums", np.array([["left", "01"]])),
        ("camera", np.array([object()], dtype=object)),
    ],
)
def test_evidence_of_another_shape_is_refused(
    name: str, values: object, rig: Rig, tmp_path: Path
) -> None:
    path = _rewritten(rig, tmp_path, name, values)
    with pytest.raises(FileFormatError, match=r"rig\.npz: is damaged"):
        load_evidence(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_evidence_cut_short_is_refused(share: float, rig: Rig, tmp_path: Path) -> None:
    save_rig(rig, _evidence(), tmp_path / "rig.json")
    path = tmp_path / "rig.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FileFormatError, match=r"rig\.npz: is damaged"):
        load_evidence(path)


@pytest.mark.parametrize("place", [28, 250, 1826, 2149])
def test_a_changed_byte_is_found(place: int, rig: Rig, tmp_path: Path) -> None:
    """Each leaves another kind of damage: the archive's own sums must be looked at first."""
    save_rig(rig, _evidence(), tmp_path / "rig.json")
    path = tmp_path / "rig.npz"
    data = bytearray(path.read_bytes())
    data[place] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"rig\.npz: is damaged"):
        load_evidence(path)


def test_absent_evidence_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"cannot be read.*beside the rig"):
        load_evidence(tmp_path / "rig.npz")
    (tmp_path / "rig.npz").write_text("no archive")
    with pytest.raises(FileFormatError, match="is damaged"):
        load_evidence(tmp_path / "rig.npz")


@pytest.mark.parametrize("there", ["rig.json", "rig.npz"])
def test_neither_file_is_overwritten(there: str, rig: Rig, tmp_path: Path) -> None:
    (tmp_path / there).write_text("mine")
    with pytest.raises(OutputError, match="--force"):
        save_rig(rig, _evidence(), tmp_path / "rig.json")
    assert [item.name for item in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "mine"
    save_rig(rig, _evidence(), tmp_path / "rig.json", force=True)
    assert load_rig(tmp_path / "rig.json").reference_camera == "left"
