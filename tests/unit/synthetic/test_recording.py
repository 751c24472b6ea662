import json
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.errors import FileFormatError, OutputError
from calichrome.synthetic import (
    Renderer,
    Scene,
    picture,
    read_truth,
    truth_of,
    write_recording,
    write_truth,
)
from calichrome.target import load_target


@pytest.fixture(scope="module")
def small(pair: Scene) -> Scene:
    """Two frames; one camera stores 16-bit linear pictures."""
    frames = dict(list(pair.world_from_board.items())[:2])
    linear = replace(pair.cameras[1], encoding="linear", bits=16)
    return replace(
        pair,
        cameras=(pair.cameras[0], linear),
        world_from_board=frames,
        jpeg_frames=frozenset(["001"]),
    )


@pytest.fixture(scope="module")
def written(small: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synthetic") / "recording"
    write_recording(small, folder)
    return folder


def test_recording_has_its_files(written: Path) -> None:
    names = {str(path.relative_to(written)) for path in written.rglob("*") if path.is_file()}
    assert names == {
        "cam0/000.png", "cam0/001.jpg", "cam1/000.png", "cam1/001.png",
        "target.json", "recording.toml", "truth.json",
    }  # fmt: skip


def test_pictures_are_what_the_sensor_stored(small: Scene, written: Path) -> None:
    renderer = Renderer(small)
    for camera_id, dtype in (("cam0", np.uint8), ("cam1", np.uint16)):
        read = cv2.imread(str(written / camera_id / "000.png"), cv2.IMREAD_UNCHANGED)
        assert read is not None
        assert read.dtype == dtype
        np.testing.assert_array_equal(read[..., ::-1], picture(renderer, camera_id, "000"))


def test_user_files_say_no_more_than_a_user_knows(small: Scene, written: Path) -> None:
    said = tomllib.loads((written / "recording.toml").read_text())
    assert said == {
        "cameras": {
            "cam0": {"encoding": "srgb", "bits": 8},
            "cam1": {"encoding": "linear", "bits": 16},
        }
    }
    assert load_target(written / "target.json").squares == small.target.squares


def test_target_file_holds_the_nominal_colours(small: Scene, tmp_path: Path) -> None:
    printed = replace(small, palette_error_lab_sd=3.0, world_from_board={}, jpeg_frames=frozenset())
    write_recording(printed, tmp_path / "r")
    nominal = load_target(tmp_path / "r" / "target.json").marker_xyz_d65
    np.testing.assert_allclose(nominal, small.target.marker_xyz_d65, atol=1e-7)
    actual = read_truth(tmp_path / "r" / "truth.json").marker_xyz_d65
    assert np.abs(actual - nominal).max() > 0.01


def test_folder_with_something_in_it_is_refused(small: Scene, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        write_recording(small, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_failure_leaves_nothing(small: Scene, tmp_path: Path) -> None:
    def stop(done: int, _total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_recording(small, tmp_path / "recording", progress=stop)
    assert not list(tmp_path.iterdir())


def test_empty_folder_is_taken_and_progress_counts(small: Scene, tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    one = replace(small, cameras=small.cameras[:1])
    write_recording(one, tmp_path, progress=lambda done, total: steps.append((done, total)))
    assert steps == [(1, 2), (2, 2)]
    assert (tmp_path / "truth.json").is_file()


def test_pictures_follow_from_the_seed_in_any_order(small: Scene) -> None:
    forwards, backwards = Renderer(small), Renderer(small)
    first = picture(forwards, "cam0", "000")
    picture(backwards, "cam1", "001")
    picture(backwards, "cam0", "001")
    np.testing.assert_array_equal(picture(backwards, "cam0", "000"), first)
    noise = picture(Renderer(replace(small, seed=small.seed + 1)), "cam0", "000")
    assert not np.array_equal(noise, first)


def test_noise_of_a_picture_differs_from_camera_to_camera(small: Scene) -> None:
    clone = replace(small.cameras[0], camera_id="clone")
    renderer = Renderer(replace(small, cameras=(small.cameras[0], clone)))
    original, other = (picture(renderer, camera, "000").astype(int) for camera in ("cam0", "clone"))
    assert (original != other).mean() > 0.3
    assert np.abs((original - other).mean()) < 0.05


def _equal(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(a, b, atol=1e-9, rtol=0)  # what the file keeps


def test_truth_survives_its_file(demo: Scene, tmp_path: Path) -> None:
    truth = truth_of(demo)
    write_truth(truth, tmp_path / "truth.json")
    again = read_truth(tmp_path / "truth.json")
    assert again.reference_camera == "pair1-left"
    assert again.seed == demo.seed
    for camera_id, camera in truth.cameras.items():
        read = again.cameras[camera_id]
        assert read.lens == camera.lens
        assert read.size_wh == camera.size_wh
        assert (read.encoding, read.bits) == (camera.encoding, camera.bits)
        assert read.white_balance == camera.white_balance
        _equal(read.cam_from_ref.rotation, camera.cam_from_ref.rotation)
        _equal(read.cam_from_world.trans_m, camera.cam_from_world.trans_m)
    for key, image in truth.images.items():
        assert again.images[key].whole == image.whole
        _equal(again.images[key].corners_px, image.corners_px)
        _equal(again.images[key].marker_centres_px, image.marker_centres_px)
    _equal(again.marker_xyz_d65, truth.marker_xyz_d65)
    _equal(again.white_xyz_d65, truth.white_xyz_d65)


def test_truth_is_consistent(demo: Scene) -> None:
    """Corners by way of the reference camera are the corners of each picture."""
    truth = truth_of(demo)
    world_from_ref = truth.cameras[truth.reference_camera].cam_from_world.inverse()
    for (camera_id, frame_id), image in truth.images.items():
        camera = truth.cameras[camera_id]
        ref_from_board = world_from_ref.inverse() @ truth.world_from_board[frame_id]
        points = (camera.cam_from_ref @ ref_from_board).apply(demo.target.corners_board)
        pixels = camera.lens.project(points)
        seen = np.isfinite(image.corners_px[:, 0])
        np.testing.assert_allclose(image.corners_px[seen], pixels[seen], atol=1e-9)
        assert seen.all() or not image.whole


@pytest.mark.parametrize(
    "text",
    [
        "{", "[]", '{"format": "other"}', '{"format": "calichrome.truth", "format_version": 7}',
        '{"format": "calichrome.truth", "format_version": 1}',
    ],
)  # fmt: skip
def test_damaged_truth_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"truth\.json"):
        read_truth(path)


def test_truth_is_strict_json(pair: Scene, tmp_path: Path) -> None:
    """Points outside a picture are null: NaN is not JSON."""
    lens = replace(pair.cameras[0].lens, cx=30.0)  # most of the view is cut off
    aside = replace(pair, cameras=(replace(pair.cameras[0], lens=lens),))
    write_truth(truth_of(aside), tmp_path / "truth.json")

    def refuse(name: str) -> float:
        raise AssertionError(name)

    data = json.loads((tmp_path / "truth.json").read_text(), parse_constant=refuse)
    assert any(None in image["corners_px"] for image in data["images"])
