"""``observe`` as its user meets it: two balls before a grey wall, three cameras without colour."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from tracking_scenes import SIZE_WH as WHOLE_WH
from tracking_scenes import camera_covariance, lissajous, ring

from calichrome.core.arrays import UInt8Array
from calichrome.rig import Evidence, save_rig

Cli = Callable[..., Any]
Refused = Callable[..., str]

_SCALE = 0.5
_SIZE_WH = (WHOLE_WH[0] // 2, WHOLE_WH[1] // 2)
_FRAMES, _EMPTY = 8, 4
_COLUMNS = "time_s,frame,track,x,y,z,sxx,sxy,sxz,syy,syz,szz,vx,vy,vz,L,a,b,cameras,class,dx,dy,dz"


def _wall(rng: np.random.Generator) -> UInt8Array:
    noisy = rng.normal(120, 2, (_SIZE_WH[1], _SIZE_WH[0], 3))
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


@pytest.fixture(scope="session")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rig.json, rig.npz and the recording of two balls; do not change it."""
    folder = tmp_path_factory.mktemp("watched")
    rng = np.random.default_rng(11)
    rig = ring(3, scale=_SCALE)
    evidence = Evidence(
        camera=(), frame=(), corner=np.empty(0, dtype=np.int64), pixels=np.empty((0, 2)),
        residuals_px=np.empty((0, 2)), cov_px=np.empty((0, 3)), inlier=np.empty(0, dtype=bool),
        lens_cov={}, pose_cov={}, joint=camera_covariance(rig, focal_px=0.1),
    )  # fmt: skip
    save_rig(rig, evidence, folder / "rig.json")
    balls = lissajous(2, _FRAMES, rng)
    points = rig.world_from_ref.inverse().apply(balls.positions)
    lines = ["camera,frame,time_s"]
    for camera_id, camera in rig.cameras.items():
        place = folder / "recording" / camera_id
        place.mkdir(parents=True)
        for index in range(_EMPTY):
            cv2.imwrite(str(place / f"background{index}.png"), _wall(rng))
        for frame in range(_FRAMES):
            picture = _wall(rng)
            pixels = camera.project(points[frame])
            depth = np.linalg.norm(camera.cam_from_ref.apply(points[frame]), axis=1)
            for ball, colour in enumerate([(40, 60, 200), (200, 90, 30)]):
                radius = camera.lens.fx * balls.radius_m[ball] / depth[ball]
                centre = tuple(int(value) for value in np.rint(pixels[ball] * 16))
                cv2.circle(picture, centre, round(radius * 16), colour, -1, cv2.LINE_AA, 4)
            cv2.imwrite(str(place / f"{frame:03d}.png"), picture)
            lines.append(f"{camera_id},{frame:03d},{balls.times_s[frame]:.6f}")
    (folder / "recording" / "timestamps.csv").write_text("\n".join(lines) + "\n")
    truth = {"positions": balls.positions.tolist(), "radius_m": balls.radius_m.tolist()}
    (folder / "truth.json").write_text(json.dumps(truth))
    return folder


@pytest.fixture
def own(watched: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(watched, tmp_path / "watched"))


def _observe(cli: Cli, folder: Path, output: Path, *words: str | Path) -> Any:  # noqa: ANN401
    outcome = cli(
        "observe", folder / "rig.json", folder / "recording", "-o", output, "--json", *words
    )
    assert outcome.code == 0, outcome.err
    return outcome.json


def _codes(found: dict[str, Any]) -> list[str]:
    return [item["code"] for item in found["findings"]]


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_tracks_are_where_the_balls_are(cli: Cli, watched: Path, tmp_path: Path) -> None:
    found = _observe(
        cli, watched, tmp_path / "tracks.csv", "--distances", tmp_path / "distances.csv",
        "--sightings", tmp_path / "sightings.csv",
    )  # fmt: skip
    assert len(found["tracks"]) == 2
    assert (found["born"], found["lost"]) == (0, 0)
    text = (tmp_path / "tracks.csv").read_text()
    assert text.splitlines()[0] == _COLUMNS
    truth = json.loads((watched / "truth.json").read_text())
    for row in _rows(tmp_path / "tracks.csv"):
        place = np.array([float(row[axis]) for axis in "xyz"])
        apart = np.linalg.norm(np.array(truth["positions"])[int(row["frame"])] - place, axis=1)
        ball = int(apart.argmin())
        assert apart[ball] < 3e-3  # half a pixel there
        # boxes of whole pixels about balls of 9 px: a pixel on either side is a fifth
        assert float(row["dx"]) == pytest.approx(2 * truth["radius_m"][ball], rel=0.25)
        assert float(row["sxx"]) > 0
        assert row["cameras"].split() == ["cam0", "cam1", "cam2"]
        assert row["L"] == ""
    (first, *_) = _rows(tmp_path / "distances.csv")
    assert 0 < float(first["lower_95"]) < float(first["distance"])
    assert 0 < float(first["gap_lower_95"]) < float(first["lower_95"])
    assert {row["camera"] for row in _rows(tmp_path / "sightings.csv")} == {"cam0", "cam1", "cam2"}


def test_overlay_plot_and_classes(cli: Cli, watched: Path, tmp_path: Path) -> None:
    namer = tmp_path / "namer.py"
    namer.write_text(
        "def name(crop, lab, size):\n"
        "    assert crop.ndim == 3 and lab.shape == (3,) and size.shape == (3,)\n"
        "    return 'red' if crop.mean(axis=(0, 1))[0] > crop.mean(axis=(0, 1))[2] else 'blue'\n"
    )
    _observe(
        cli, watched, tmp_path / "tracks.csv", "--overlay", tmp_path / "overlay",
        "--plot", tmp_path / "plot.png", "--classify", f"{namer}:name",
    )  # fmt: skip
    assert {row["class"] for row in _rows(tmp_path / "tracks.csv")} == {"red", "blue"}
    assert cv2.imread(str(tmp_path / "plot.png")) is not None
    with av.open(str(tmp_path / "overlay" / "cam1.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == _FRAMES


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--plot", "tracks.xyz"], "--plot draws .png, .pdf or .svg"),
        (["--classify", "{}/broken.py:name"], "NameError"),
        (["--classify", "{}/number.py:name"], "is no function"),
    ],
)
def test_said_before_the_work(
    cli: Cli, watched: Path, tmp_path: Path, words: list[str], says: str
) -> None:
    (tmp_path / "broken.py").write_text("name = nobody\n")
    (tmp_path / "number.py").write_text("name = 3\n")
    words = [word.format(tmp_path) for word in words]
    output = tmp_path / "t.csv"
    outcome = cli("observe", watched / "rig.json", watched / "recording", "-o", output, *words)
    assert outcome.code == 1
    assert says in outcome.err
    assert not output.exists()


def test_videos_with_their_background(cli: Cli, watched: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    (folder / "background").mkdir(parents=True)
    for camera in ("cam0", "cam1", "cam2"):
        for name, place in (("background*", folder / "background"), ("0*", folder)):
            with av.open(str(place / f"{camera}.mp4"), "w") as container:
                stream = container.add_stream("libx264", rate=30, options={"crf": "4"})
                stream.width, stream.height = _SIZE_WH
                stream.pix_fmt = "yuv444p"
                for path in sorted((watched / "recording" / camera).glob(f"{name}.png")):
                    picture = np.asarray(cv2.imread(str(path)), dtype=np.uint8)
                    frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
    outcome = cli(
        "observe", watched / "rig.json", folder, "-o", tmp_path / "t.csv", "--fps", "30", "--json"
    )
    assert outcome.code == 0, outcome.err
    assert len(outcome.json["tracks"]) == 2


# --- what cannot be -------------------------------------------------------------------------------


def test_no_empty_scene(refused: Refused, own: Path) -> None:
    for path in (own / "recording").rglob("background*.png"):
        path.unlink()
    refused(
        "observe", own / "rig.json", own / "recording", "-o", own / "t.csv",
        says=["camera cam0", "empty scene", "background0000.png", "--background FIRST:LAST"],
    )  # fmt: skip


def test_one_camera_alone(refused: Refused, own: Path) -> None:
    for camera in ("cam1", "cam2"):
        shutil.rmtree(own / "recording" / camera)
    refused(
        "observe", own / "rig.json", own / "recording", "-o", own / "t.csv", says=["two cameras"]
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--background", "3"], "FIRST:LAST"),
        (["--background", "3:99"], "frames 0 to 7"),
        (["--fps", "0"], "above 0"),
        (["--classify", "nothing"], "module:function"),
        (["--classify", "no_such_module:name"], "cannot be imported"),
    ],
)
def test_wrong_options(refused: Refused, own: Path, words: list[str], says: str) -> None:
    refused("observe", own / "rig.json", own / "recording", "-o", own / "t.csv", *words,
            says=[says])  # fmt: skip


def test_a_classifier_that_fails(cli: Cli, own: Path) -> None:
    (own / "bad.py").write_text("def name(crop, lab, size):\n    raise RuntimeError('no idea')\n")
    outcome = cli(
        "observe", own / "rig.json", own / "recording", "-o", own / "t.csv",
        "--classify", f"{own / 'bad.py'}:name",
    )  # fmt: skip
    assert outcome.code == 1
    assert "no idea" in outcome.err
    assert not (own / "t.csv").exists()


def test_pictures_of_another_size(cli: Cli, own: Path) -> None:
    path = own / "recording" / "cam1" / "background0.png"
    cv2.imwrite(str(path), np.zeros((240, 320, 3), dtype=np.uint8))
    outcome = cli("observe", own / "rig.json", own / "recording", "-o", own / "t.csv")
    assert outcome.code == 1
    assert "320x240" in outcome.err


def test_a_camera_and_frames_may_be_missing(cli: Cli, own: Path) -> None:
    shutil.rmtree(own / "recording" / "cam2")
    (own / "recording" / "cam1" / "004.png").write_bytes(b"no picture")
    found = _observe(cli, own, own / "t.csv")
    assert len(found["tracks"]) == 2
    assert "unreadable_frame" in _codes(found)


# --- findings -------------------------------------------------------------------------------------


def test_time_unknown_fires(cli: Cli, own: Path) -> None:
    (own / "recording" / "timestamps.csv").unlink()
    found = _observe(cli, own, own / "t.csv")
    assert "time_unknown" in _codes(found)
    assert _rows(own / "t.csv")[-1]["time_s"] == f"{_FRAMES - 1:.6f}"


def test_time_unknown_does_not_fire_with_fps(cli: Cli, own: Path) -> None:
    (own / "recording" / "timestamps.csv").unlink()
    found = _observe(cli, own, own / "t.csv", "--fps", "10")
    assert "time_unknown" not in _codes(found)
    assert _rows(own / "t.csv")[-1]["time_s"] == "0.700000"


def test_frames_apart_fires(cli: Cli, own: Path) -> None:
    stamps = own / "recording" / "timestamps.csv"
    lines = stamps.read_text().splitlines()
    shifted = [
        f"cam1,{frame},{float(time) + 0.012:.6f}" if camera == "cam1" else line
        for line in lines[1:]
        for camera, frame, time in [line.split(",")]
    ]
    stamps.write_text("\n".join([lines[0], *shifted]) + "\n")
    found = _observe(cli, own, own / "t.csv")
    assert "frames_apart" in _codes(found)


def test_frames_apart_does_not_fire(cli: Cli, watched: Path, tmp_path: Path) -> None:
    assert "frames_apart" not in _codes(_observe(cli, watched, tmp_path / "t.csv"))


def test_calibration_taken_as_exact_fires(cli: Cli, own: Path) -> None:
    (own / "rig.npz").unlink()
    assert "calibration_taken_as_exact" in _codes(_observe(cli, own, own / "t.csv"))


def test_calibration_taken_as_exact_does_not_fire(cli: Cli, watched: Path, tmp_path: Path) -> None:
    found = _observe(cli, watched, tmp_path / "t.csv")
    assert "calibration_taken_as_exact" not in _codes(found)
    assert "colour_not_calibrated" in _codes(found)  # these cameras have no colour
