"""Videos: the right frame, its right colours, frames worth looking at, and what is one instant."""

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.video.stream import VideoStream

from calichrome.core.arrays import UInt8Array
from calichrome.errors import RecordingError
from calichrome.imaging import Image, Recording, Unreadable, choose_frames, open_recording, pyav
from calichrome.imaging.recording_times import read_timestamps
from calichrome.imaging.video import grey_frames, open_video, read_frame
from calichrome.imaging.yuv import rgb_of_frame

WH = (320, 240)
N_FRAMES = 40
Frames = Callable[[int], UInt8Array]


def _write(
    path: Path, frames: Frames, n_frames: int = N_FRAMES, codec: str = "mpeg4", color_trc: int = 2
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options={"g": "12"})
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = WH
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.bit_rate = 4_000_000
        stream.codec_context.color_trc = color_trc
        for index in range(n_frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frames(index), "rgb24")))
        container.mux(stream.encode())
    return path


def _numbered(index: int) -> UInt8Array:
    """A picture that holds its number as a grey level, 4 per frame."""
    pixels = np.full((*WH[::-1], 3), 60, dtype=np.uint8)
    pixels[:, :160] = 40 + 4 * index
    return pixels


def _number_in(image: Image | Unreadable) -> int:
    assert isinstance(image, Image), image
    return round((float(np.median(image.pixels[50:200, 20:140])) - 40) / 4)


# one frame


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.mp4", "mpeg4"), ("a.mkv", "mpeg4"), ("a.avi", "mpeg4"), ("a.avi", "mjpeg"),
     ("a.mpg", "mpeg2video"), ("a.mov", "mjpeg")],
)  # fmt: skip
def test_any_frame_is_found_by_its_number(tmp_path: Path, name: str, codec: str) -> None:
    video = open_video(_write(tmp_path / name, _numbered, codec=codec), max_megapixels=200)
    assert video.n_frames == N_FRAMES
    assert video.size_wh == WH
    asked = [0, N_FRAMES - 1, 20, 21, 19, 5, 30, 1]
    assert [_number_in(read_frame(video, index)) for index in asked] == asked
    assert [index for index, _ in grey_frames(video)] == list(range(N_FRAMES))


# Kr, Kb of ITU-R BT.709, BT.601 and BT.2020, by the code of the matrix in ITU-T H.273
@pytest.mark.parametrize(
    ("matrix", "kr", "kb"), [(1, 0.2126, 0.0722), (5, 0.299, 0.114), (9, 0.2627, 0.0593)]
)
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("layout", ["yuv420p", "yuv444p", "yuv420p10le"])
def test_colours_follow_matrix_and_range(
    matrix: int,
    kr: float,
    kb: float,
    full: bool,  # noqa: FBT001
    layout: str,
) -> None:
    deep = layout.endswith("10le")
    codes = np.array([100, 110, 140]) * (4 if deep else 1)
    frame = av.VideoFrame(64, 48, layout)
    for plane, code in zip(frame.planes, codes, strict=True):
        kind = np.uint16 if deep else np.uint8
        plane.update(np.full(plane.buffer_size // kind().itemsize, code, kind).tobytes())
    frame.colorspace, frame.color_range = matrix, 2 if full else 1
    pixels = rgb_of_frame(frame)[20, 20].astype(float)

    y, cb, cr = np.array([100, 110, 140]) - np.array([0 if full else 16, 128, 128])
    y, cb, cr = y / (255 if full else 219), cb / (255 if full else 224), cr / (255 if full else 224)
    if deep and full:  # the 10-bit code of 100 is 400 of 1023, not 100 of 255
        y, cb, cr = (part * 4 * 255 / 1023 for part in (y, cb, cr))
    red, blue = y + 2 * (1 - kr) * cr, y + 2 * (1 - kb) * cb
    green = (y - kr * red - kb * blue) / (1 - kr - kb)
    scale = 65535 if deep else 255
    # one code of 8 bits, two of 10
    expected = np.array([red, green, blue]) * scale
    assert pixels == pytest.approx(expected, abs=130 if deep else 1)


def test_white_of_ten_bits_is_full_scale() -> None:
    frame = av.VideoFrame(64, 48, "yuv420p10le")
    for plane, code in zip(frame.planes, (940, 512, 512), strict=True):
        plane.update(np.full(plane.buffer_size // 2, code, np.uint16).tobytes())
    assert (rgb_of_frame(frame) == 65535).all()


@pytest.mark.parametrize(("code", "encoding"), [(2, "rec709"), (1, "rec709"), (13, "srgb")])
def test_the_transfer_function_is_read(tmp_path: Path, code: int, encoding: str) -> None:
    path = _write(tmp_path / "a.mkv", _numbered, 3, color_trc=code)
    video = open_video(path, max_megapixels=200)
    image = read_frame(video, 1)
    assert isinstance(image, Image)
    assert (video.encoding, image.encoding, image.bits) == (encoding, encoding, 8)
    stated = read_frame(video, 1, encoding="linear")
    assert isinstance(stated, Image)
    assert stated.encoding == "linear"


def test_sums_name_file_and_frame(tmp_path: Path) -> None:
    _write(tmp_path / "cam0.mp4", _numbered, 3)
    recording = open_recording(tmp_path)
    sums = [recording.content_sum("cam0", frame) for frame in ("0", "1")]
    assert sums[0] != sums[1]
    for frame, expected in zip(("0", "1"), sums, strict=True):
        image = recording.read("cam0", frame)
        assert isinstance(image, Image)
        assert image.sha256 == expected


def test_pictures_are_summed_as_files(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((5, 6), np.uint8))
    recording = open_recording(tmp_path)
    content = (tmp_path / "1.png").read_bytes()
    assert recording.content_sum("cam0", "1") == hashlib.sha256(content).hexdigest()
    assert recording.read_size("cam0") == (6, 5)


def test_a_cut_off_video_gives_what_it_holds(tmp_path: Path) -> None:
    path = _write(tmp_path / "cam0.mkv", _numbered)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    video = open_video(path, max_megapixels=200)
    good = [index for index, _ in grey_frames(video)]
    assert 5 < len(good) < N_FRAMES
    assert _number_in(read_frame(video, good[3])) == good[3]


def test_what_is_no_video_is_said(tmp_path: Path) -> None:
    bad = tmp_path / "cam0.mp4"
    bad.write_bytes(b"no video at all" * 100)
    with pytest.raises(RecordingError, match="cannot be read as a video"):
        open_recording(tmp_path)
    bad.unlink()
    _write(tmp_path / "cam0.mkv", _numbered, 3)
    with pytest.raises(RecordingError, match="max-megapixels"):
        open_recording(tmp_path, max_megapixels=0.01)
    _write(tmp_path / "cam0.mkv", _numbered, 3, color_trc=16)  # PQ
    with pytest.raises(RecordingError, match="transfer function"):
        open_recording(tmp_path)


def test_without_pyav_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path / "cam0.mp4", _numbered, 3)
    monkeypatch.setitem(sys.modules, "av", None)
    pyav.av.cache_clear()
    with pytest.raises(RecordingError, match=r"calichrome\[video\]"):
        open_recording(tmp_path)


# the frames of a recording


def test_videos_are_cameras_and_numbers_frames(tmp_path: Path) -> None:
    for name in ("left.mp4", "right.avi", "background/left.mp4"):
        _write(tmp_path / name, _numbered, 4)
    recording = open_recording(tmp_path)
    assert recording.cameras == ("left", "right")
    assert list(recording.files["left"]) == ["0", "1", "2", "3"]
    assert recording.n_pictures == 8
    assert recording.read_size("right") == WH
    assert _number_in(recording.read("right", "3")) == 3
    assert "left, right" in recording.reading
    assert open_recording(tmp_path, cameras=("right",)).cameras == ("right",)
    assert choose_frames(recording, 80) is recording


@pytest.mark.parametrize(
    ("names", "pattern", "says"),
    [
        (["a.mp4", "b/1.png"], None, "holds videos (like a.mp4) and pictures (like b/1.png)"),
        (["a/b.mp4"], None, "deeper than RECORDING/<camera>.mp4"),
        (["a.mp4", "a.avi"], None, "are both camera a"),
        (["a.mp4"], "{camera}_{frame}", "leave out --pattern"),
    ],
)
def test_unclear_folders_are_refused(
    tmp_path: Path, names: list[str], pattern: str | None, says: str
) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(RecordingError) as refused:
        open_recording(tmp_path, pattern=pattern)
    assert says in str(refused.value)


# timestamps.csv

CALISCOPE = "sync_index,cam_id,frame_index,frame_time\n"


def _stamps(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "timestamps.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_caliscope_rows_count_frames(tmp_path: Path) -> None:
    """frame_index begins at 26, the video at 0; cam 1 missed the instant 27."""
    rows = "26,1,26,0.11\n26,0,26,0.1\n27,0,27,0.2\n28,1,27,0.31\n28,0,28,0.3\n"
    table = read_timestamps(_stamps(tmp_path, CALISCOPE + rows), {"cam_0": 3, "cam_1": 2})
    assert table.numbers == {"cam_0": {"26": 0, "27": 1, "28": 2}, "cam_1": {"26": 0, "28": 1}}
    assert table.times_s["cam_1"]["28"] == 0.31
    assert "sync_index" in table.reading


@pytest.mark.parametrize("names", [("cam_0", "cam_1"), ("port_0", "port_1"), ("0", "1")])
def test_videos_are_found_by_cam_id(tmp_path: Path, names: tuple[str, str]) -> None:
    path = _stamps(tmp_path, CALISCOPE + "5,0,0,0\n5,1,0,0\n5,2,0,0\n")
    table = read_timestamps(path, dict.fromkeys(names, 1))
    assert table.numbers == {name: {"5": 0} for name in names}


def test_unequal_lengths_are_mentioned(tmp_path: Path) -> None:
    path = _stamps(tmp_path, CALISCOPE + "5,0,0,0\n6,0,1,0.1\n7,0,2,0.2\n")
    table = read_timestamps(path, {"cam_0": 2})
    assert table.numbers == {"cam_0": {"5": 0, "6": 1}}
    assert "cam_0 has 2 frames and 3 rows" in table.reading


def test_own_timestamps_give_times(tmp_path: Path) -> None:
    path = _stamps(tmp_path, "camera,frame,time_s\nleft,0,0.5\nleft,1,0.54\n")
    table = read_timestamps(path, {"left": 3})
    assert list(table.numbers["left"]) == ["0", "1", "2"]
    assert table.times_s == {"left": {"0": 0.5, "1": 0.54}}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,port\n1,2\n", "wanted are camera, frame, time_s, or caliscope's sync_index, cam_id"),
        ("", "wanted are camera, frame, time_s"),
        ("camera,frame,time_s\nright,0,1\n", "no video of camera right"),
        ("camera,frame,time_s\ncam_0,9,1\n", "has the frames 0 to 2, not 9"),
        ("camera,frame,time_s\ncam_0,0,soon\n", "time_s 'soon' is no number"),
        ("camera,frame,time_s\ncam_0,0,1\ncam_0,0,2\n", "stands twice"),
        ("camera,frame,time_s\ncam_0,0\n", "line 2: wrong number of cells"),
        (CALISCOPE + "5,7,0,0\n", "not clear which cam_id (7) is the video cam_0"),
        (CALISCOPE + "5,0,0,0\n5,0,1,0\n", "sync_index 5 of cam_id 0 stands twice"),
        (CALISCOPE + "five,0,0,0\n", "sync_index 'five' is no number"),
    ],
)
def test_other_timestamps_are_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(RecordingError) as refused:
        read_timestamps(_stamps(tmp_path, text), {"cam_0": 3})
    assert says in str(refused.value)


def test_instants_of_the_real_recording(data: Path) -> None:
    recording = open_recording(data / "caliscope_charuco_4cam")
    assert recording.cameras == ("cam_0", "cam_1", "cam_2", "cam_3")
    for camera in recording.cameras:
        numbers = recording.videos.table.numbers[camera]
        assert [numbers[frame] for frame in ("26", "27", "136")] == [0, 1, 110]


# which frames


def _room_with_board(index: int) -> UInt8Array:
    """A cluttered room; a board in frames 10..29 at a new place every second frame, blurred in
    odd ones, where it also moves."""
    rng = np.random.default_rng(5)
    room = cv2.GaussianBlur(rng.uniform(40, 200, WH[::-1]), (0, 0), 6)
    room = 100 + 3 * (room - 120)
    if 10 <= index < 30:
        squares = np.indices((6, 8)).sum(axis=0) % 2 * 200.0 + 20
        board = np.pad(np.kron(squares, np.ones((12, 12))), 8, constant_values=230)
        step, moving = divmod(index - 10, 2)
        if moving:
            board = cv2.blur(board, (9, 9))
        x, y = 10 + (step * 53) % 180, 10 + (step * 37) % 120
        room[y : y + board.shape[0], x : x + board.shape[1]] = board
    return np.repeat(np.clip(room, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _empty_room(index: int) -> UInt8Array:
    del index
    return _room_with_board(0)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("filmed")
    _write(folder / "a.mp4", _room_with_board)
    _write(folder / "b.mp4", _empty_room)
    return open_recording(folder)


def test_sharp_different_frames_with_a_board_are_chosen(filmed: Recording) -> None:
    chosen = choose_frames(filmed, 8)
    assert list(chosen.files["a"]) == list(chosen.files["b"])  # one choice for all cameras
    numbers = [int(frame) for frame in chosen.files["a"]]
    assert len(numbers) == 8
    assert all(10 <= number < 30 and number % 2 == 0 for number in numbers)
    assert "8 of 40 frames" in chosen.reading


def test_twins_are_not_chosen(tmp_path: Path) -> None:
    _write(tmp_path / "a.mp4", _empty_room, codec="mpeg4")
    chosen = choose_frames(open_recording(tmp_path), 8)
    assert 1 <= len(chosen.files["a"]) < 8


def test_the_choice_is_reported_as_it_goes(filmed: Recording) -> None:
    seen: list[tuple[str, int, int]] = []
    choose_frames(filmed, 8, progress=lambda *step: seen.append(step))
    assert seen[-1] == ("choosing frames", 80, 80)
    assert [done for _, done, _ in seen] == sorted(done for _, done, _ in seen)


def test_a_choice_of_none_is_a_mistake(filmed: Recording) -> None:
    with pytest.raises(RecordingError, match="--max-frames 0: give 1 or more"):
        choose_frames(filmed, 0)
