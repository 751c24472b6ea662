"""Videos corrected and rectified: colours, tags, times, and what is left when something fails."""

import json
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from calichrome.apply import OutputSpace
from calichrome.cli.main import main
from calichrome.colour.models.linear import Linear
from calichrome.core.arrays import UInt8Array
from calichrome.errors import CalichromeError, InterruptedOutputError, RecordingError
from calichrome.imaging import (
    Image,
    Pixels,
    StreamFormat,
    VideoSettings,
    VideoWriter,
    open_recording,
    open_video,
    pyav,
    read_frame,
    stream_format,
    timed_frames,
    write_picture,
)
from calichrome.pipeline.correct import correct
from calichrome.pipeline.new_view import NewView
from calichrome.pipeline.rectify import rectify
from calichrome.pipeline.stages import ahead
from calichrome.rig import Rig, save_rig

_SIZE_WH = (96, 64)
_FORM = StreamFormat(
    time_base=Fraction(1, 30), rate=Fraction(30), primaries=1, transfer=13, matrix=1
)
_BEST = VideoSettings(crf=1)


@pytest.fixture
def rig(rig: Rig) -> Rig:
    """The cameras see 96x64 pixels, sRGB-encoded, and swap their channels a little."""
    matrix = np.array([[0.50, 0.30, 0.18], [0.24, 0.70, 0.06], [0.02, 0.12, 0.98]])
    cameras = {}
    for name, camera in rig.cameras.items():
        assert camera.colour is not None
        colour = replace(camera.colour, model=Linear.from_matrix(matrix), encoding="srgb")
        lens = replace(camera.lens, fx=90.0, fy=90.0, cx=47.5, cy=31.5)
        cameras[name] = replace(camera, size_wh=_SIZE_WH, colour=colour, lens=lens)
    return replace(rig, cameras=cameras)


def _patches(size_wh: tuple[int, int] = _SIZE_WH) -> UInt8Array:
    """Flat colours of 16x16 px."""
    colours = np.random.default_rng(7).integers(40, 210, (8, 8, 3), dtype=np.uint8)
    return colours.repeat(16, axis=0).repeat(16, axis=1)[: size_wh[1], : size_wh[0]]


def _write(
    path: Path,
    pixels: Pixels,
    n_frames: int = 12,
    form: StreamFormat = _FORM,
    stamps: list[int] | None = None,
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = VideoWriter(path, (pixels.shape[1], pixels.shape[0]), form, _BEST)
    for stamp in range(n_frames) if stamps is None else stamps:
        writer.write(writer.frame(pixels, stamp))
    writer.close()
    return path


def _frame(path: Path, index: int = 5) -> Pixels:
    image = read_frame(open_video(path, max_megapixels=1), index)
    assert isinstance(image, Image)
    return image.pixels


def _middles(pixels: Pixels) -> Pixels:
    return pixels[8::16, 8::16].astype(float)


@pytest.mark.parametrize("depth", [8, 10])
def test_videos_have_the_colours_of_pictures(rig: Rig, tmp_path: Path, depth: int) -> None:
    form = replace(_FORM, is_deep=depth == 10)
    pixels = _patches().astype(np.uint16) * 257 if depth == 10 else _patches()
    for name in ("left", "right"):
        _write(tmp_path / "in" / f"{name}.mp4", pixels, form=form)
    still = _frame(tmp_path / "in" / "left.mp4")  # as it was stored
    assert still.dtype == (np.uint16 if depth == 10 else np.uint8)
    write_picture(tmp_path / "pictures" / "left" / "1.png", still)
    done = correct(rig, tmp_path / "in", tmp_path / "out", settings=_BEST)
    assert done.written == (tmp_path / "out" / "left.mp4", tmp_path / "out" / "right.mp4")
    (picture,) = correct(rig, tmp_path / "pictures", tmp_path / "out-pictures").written
    stored = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    scale = 65535 / 1023 if depth == 10 else 1
    error = _middles(_frame(done.written[0])) - _middles(stored[..., ::-1])
    # rounding of Y, Cb, Cr (2.3 codes, see test_yuv) and the quantisation of x264
    assert np.abs(error).max() <= 4 * scale
    assert np.abs(error.mean(axis=(0, 1))).max() <= 0.7 * scale


@pytest.mark.parametrize(("space", "primaries"), [("srgb", 1), ("display-p3", 12)])
def test_tags_say_what_the_pixels_are(
    rig: Rig, tmp_path: Path, space: OutputSpace, primaries: int
) -> None:
    source = replace(_FORM, transfer=1, matrix=6, primaries=6, full_range=True)
    _write(tmp_path / "left.mp4", _patches(), form=source)
    (path,) = correct(rig, tmp_path / "left.mp4", tmp_path / "out", space=space).written
    form = stream_format(open_video(path, max_megapixels=1))
    assert (form.primaries, form.transfer, form.matrix) == (primaries, 13, 1)
    assert not form.full_range


@pytest.mark.parametrize("is_deep", [False, True])
@pytest.mark.parametrize("matrix", [1, 2, 6, 9])
def test_without_colour_everything_is_carried_over(
    rig: Rig,
    tmp_path: Path,
    is_deep: bool,  # noqa: FBT001
    matrix: int,
) -> None:
    source = StreamFormat(
        time_base=Fraction(1, 90_000),
        rate=Fraction(30),
        pixel_aspect=Fraction(4, 3),
        primaries=9,
        transfer=14,
        matrix=matrix,
        full_range=True,
        is_deep=is_deep,
    )
    stamps = [100, 3100, 6100, 15_100, 16_600, 30_000]
    pixels = _patches().astype(np.uint16) * 257 if is_deep else _patches()
    path = _write(tmp_path / "left.mp4", pixels, form=source, stamps=stamps)
    (written,) = correct(
        rig, path, tmp_path / "out", space="none", view=NewView(undistort=True), settings=_BEST
    ).written
    before, after = (open_video(item, max_megapixels=1) for item in (path, written))
    # the mean rate of irregular times depends on the duration of the last frame, which is not said
    assert replace(stream_format(after), rate=stream_format(before).rate) == stream_format(before)
    assert [timed.stamp for timed in timed_frames(after)] == stamps
    error = _middles(_frame(written, 4)) - _middles(_frame(path, 4))
    assert np.abs(error).max() <= 4 * (65535 / 1023 if is_deep else 1)


def test_new_pixels_are_square(rig: Rig, tmp_path: Path) -> None:
    path = _write(
        tmp_path / "left.mp4", _patches(), form=replace(_FORM, pixel_aspect=Fraction(4, 3))
    )
    view = NewView(valid_area="all")
    (written,) = correct(rig, path, tmp_path / "out", view=view).written
    assert stream_format(open_video(written, max_megapixels=1)).pixel_aspect == 1
    pinhole = json.loads((tmp_path / "out" / "cameras.json").read_text())["cameras"]["left"]
    assert open_video(written, max_megapixels=1).size_wh == tuple(pinhole["size_wh"])


def test_odd_sizes(rig: Rig, tmp_path: Path) -> None:
    cameras = {name: replace(item, size_wh=(95, 63)) for name, item in rig.cameras.items()}
    path = _write(tmp_path / "left.mp4", _patches((95, 63)))
    (written,) = correct(replace(rig, cameras=cameras), path, tmp_path / "out").written
    assert open_video(written, max_megapixels=1).size_wh == (95, 63)


def test_videos_and_pictures_together(rig: Rig, tmp_path: Path) -> None:
    _write(tmp_path / "in" / "left.mp4", _patches())
    write_picture(tmp_path / "in" / "right" / "a.png", _patches())
    (tmp_path / "in" / "timestamps.csv").write_text("camera,frame,time_s\nleft,3,0.1\n")
    done = correct(rig, tmp_path / "in", tmp_path / "out")
    assert set(done.written) == {
        tmp_path / "out" / "left.mp4",
        tmp_path / "out" / "right" / "a.png",
    }
    text = (tmp_path / "out" / "timestamps.csv").read_text()
    assert text == (tmp_path / "in" / "timestamps.csv").read_text()
    write_picture(tmp_path / "in" / "left" / "a.png", _patches())
    with pytest.raises(RecordingError, match="left has pictures and a video"):
        correct(rig, tmp_path / "in", tmp_path / "again")


def test_whose_video_it_is(rig: Rig, tmp_path: Path) -> None:
    path = _write(tmp_path / "in" / "clip.mp4", _patches())
    with pytest.raises(RecordingError, match="--camera"):
        correct(rig, path, tmp_path / "a")
    for source in (path, path.parent):
        out = tmp_path / f"out-{source.stem}"
        assert correct(rig, source, out, camera="right").written == (out / "right.mp4",)


def test_times_follow_their_camera(rig: Rig, tmp_path: Path) -> None:
    """The rows of a corrected video bear its new name, and those of other cameras stay behind."""
    _write(tmp_path / "in" / "clip.mp4", _patches())
    stamps = tmp_path / "in" / "timestamps.csv"
    stamps.write_text("camera,frame,time_s\nclip,3,0.1\n")
    correct(rig, tmp_path / "in", tmp_path / "out", camera="right")
    assert (tmp_path / "out" / stamps.name).read_text() == "camera,frame,time_s\nright,3,0.1\n"
    assert open_recording(tmp_path / "out").cameras == ("right",)
    for name in ("left", "right", "third"):
        _write(tmp_path / "three" / f"{name}.mp4", _patches())
    table = "camera,frame,time_s\nleft,3,0.1\nthird,3,0.2\nright,3,0.3\n"
    (tmp_path / "three" / stamps.name).write_text(table)
    rectify(rig, ("left", "right"), tmp_path / "three", tmp_path / "pair")
    text = (tmp_path / "pair" / stamps.name).read_text()
    assert text == "camera,frame,time_s\nleft,3,0.1\nright,3,0.3\n"


def test_rectified_videos(rig: Rig, tmp_path: Path) -> None:
    """A spot at 1 m lies on one row of both, as far apart as baseline and focal length say."""
    for name, column in (("left", 60), ("right", 51)):  # 90 px * 0.1 m / 1 m
        pixels = np.full((64, 96, 3), 30, np.uint8)
        pixels[28:32, column - 2 : column + 2] = 220
        _write(tmp_path / "in" / f"{name}.mp4", pixels)
    done = rectify(
        rig,
        ("left", "right"),
        tmp_path / "in",
        tmp_path / "out",
        sheet=tmp_path / "sheet.png",
        settings=_BEST,
    )
    assert {name: item.n_frames for name, item in done.videos.items()} == {"left": 12, "right": 12}
    assert (tmp_path / "out" / "rectification.json").is_file()
    assert (tmp_path / "sheet.png").is_file()
    spots = []
    for name in ("left", "right"):
        light = np.maximum(_frame(tmp_path / "out" / f"{name}.mp4")[..., 1].astype(float) - 90, 0)
        y, x = np.indices(light.shape)
        spots.append([(x * light).sum() / light.sum(), (y * light).sum() / light.sum()])
    assert spots[0][1] == pytest.approx(spots[1][1], abs=0.2)
    focal = done.rectification.focal_px
    assert spots[0][0] - spots[1][0] == pytest.approx(focal * 0.1, abs=0.3)


def test_damaged_frames_keep_their_place(rig: Rig, tmp_path: Path) -> None:
    """Frame n of several cameras stays one instant."""
    path = tmp_path / "left.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = *_SIZE_WH, "yuvj420p"
        packets = [
            packet
            for index in range(12)
            for packet in stream.encode(
                av.VideoFrame.from_ndarray(np.full((64, 96, 3), 20 * index, np.uint8), "rgb24")
            )
        ]
        packets += stream.encode()
        for number, packet in enumerate(packets):
            if number == 4:
                broken = av.Packet(b"\x00" * 100)
                broken.pts, broken.dts, broken.time_base = packet.pts, packet.dts, packet.time_base
                broken.stream = stream
                container.mux(broken)
            else:
                container.mux(packet)
    video = open_video(path, max_megapixels=1)
    assert video.n_frames == 12
    stamps = [timed.stamp for timed in timed_frames(video)]
    assert stamps == list(video.timestamps or ())
    done = correct(rig, path, tmp_path / "out", space="none", settings=_BEST)
    outcome = done.videos["left"]
    assert (outcome.n_frames, outcome.n_expected, outcome.n_stand_ins) == (12, 12, 1)
    levels = [_frame(done.written[0], index).mean() for index in (3, 4, 5, 6)]
    assert levels == pytest.approx([60, 100, 100, 120], abs=3)  # 4 shows what 5 does


# Ctrl-C


@pytest.mark.parametrize("at", [("left", 30), ("right", 2)])
def test_interrupted_videos_can_be_played(rig: Rig, tmp_path: Path, at: tuple[str, int]) -> None:
    for name in ("left", "right"):
        _write(tmp_path / "in" / f"{name}.mp4", _patches(), n_frames=100)

    def progress(what: str, done: int, total: int) -> None:
        assert total == 100
        if (what, done) == (f"correcting {at[0]}", at[1]):
            raise KeyboardInterrupt

    with pytest.raises(InterruptedOutputError, match=rf"{at[0]}\.partial\.mp4 with") as stop:
        correct(rig, tmp_path / "in", tmp_path / "out", progress=progress)
    names = ["left.partial.mp4"] if at[0] == "left" else ["left.mp4", "right.partial.mp4"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    counts = [
        len(list(timed_frames(open_video(tmp_path / "out" / name, max_megapixels=1))))
        for name in names
    ]
    assert counts[:-1] == [100] * (len(names) - 1)
    assert at[1] <= counts[-1] < 100  # and those that were on their way
    assert f" {counts[-1]} of 100 frames" in str(stop.value)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_interrupted_before_the_first_frame(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _write(tmp_path / "in" / "left.mp4", _patches())

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("calichrome.pipeline.correct_video.ahead", interrupt)
    with pytest.raises(KeyboardInterrupt):
        correct(rig, tmp_path / "in", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def test_failures_leave_nothing(rig: Rig, tmp_path: Path) -> None:
    for name, size_wh in (("left", _SIZE_WH), ("right", (64, 48))):
        _write(tmp_path / "in" / f"{name}.mp4", _patches(size_wh))
    with pytest.raises(CalichromeError, match=r"right\.mp4.*64x48.*calibrated at 96x64"):
        correct(rig, tmp_path / "in", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


# few frames on their way


def test_stages_keep_order_and_depth() -> None:
    """Whatever is slow: no more items are begun than the depth allows."""
    pulled: list[int] = []
    lock = threading.Lock()

    def items() -> Iterator[int]:
        for item in range(40):
            with lock:
                pulled.append(item)
            yield item

    def double(item: int) -> int:
        time.sleep(0.002 * (item % 3))
        return 2 * item

    with ThreadPoolExecutor(3) as first, ThreadPoolExecutor(1) as second:
        stage = ahead(first, double, items(), 4)
        for count, result in enumerate(ahead(second, double, stage, 2)):
            assert result == 4 * count
            assert len(pulled) <= count + 1 + 4 + 2


# what is refused


@pytest.mark.parametrize("space", ["linear-srgb", "xyz-d65"])
def test_linear_light_is_refused(rig: Rig, tmp_path: Path, space: OutputSpace) -> None:
    path = _write(tmp_path / "left.mp4", _patches())
    with pytest.raises(RecordingError, match="linear light"):
        correct(rig, path, tmp_path / "out", space=space)


def test_grey_videos_need_no_colour(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "left.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = *_SIZE_WH, "gray"
        for index in range(8):
            grey = np.full((64, 96), 20 * index, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, "gray")))
        container.mux(stream.encode())
    with pytest.raises(CalichromeError, match=r"left\.mkv: the picture is grey; use --colour none"):
        correct(rig, path, tmp_path / "out")
    (written,) = correct(rig, path, tmp_path / "out", space="none", settings=_BEST).written
    assert np.abs(_frame(written) - _frame(path)[..., None].astype(float)).max() <= 3


def test_without_pyav(rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _write(tmp_path / "left.mp4", _patches())
    monkeypatch.setitem(sys.modules, "av", None)
    pyav.av.cache_clear()
    with pytest.raises(RecordingError, match=r"calichrome\[video\]"):
        correct(rig, path, tmp_path / "out")


# the command


def test_command(rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("left", "right"):
        _write(tmp_path / "in" / f"{name}.mp4", _patches())
    save_rig(rig, None, tmp_path / "rig.json")
    words = ["correct", str(tmp_path / "rig.json"), str(tmp_path / "in"), "-o"]
    assert main([*words, str(tmp_path / "a"), "--preset", "ultrafast", "--crf", "30"]) == 0
    said = capsys.readouterr().out
    assert "Wrote 2 videos" in said
    assert "left.mp4: 12 frames" in said
    for what in ("decode", "convert", "correct", "encode"):
        assert f"{what} " in said
    assert (
        main([*words, str(tmp_path / "b"), "--json", "--valid-area", "valid", "--keep-size"]) == 0
    )
    stored = json.loads(capsys.readouterr().out)["videos"]["right"]
    assert (stored["file"], stored["frames"]) == ("right.mp4", 12)
    assert sum(stored["cpu_s"].values()) > 0
    pair = ["rectify", *words[1:], str(tmp_path / "c"), "--pair", "left,right", "--crf", "20"]
    assert main(pair) == 0
    assert "rectified videos" in capsys.readouterr().out
    assert main([*words, str(tmp_path / "d"), "--crf", "99"]) == 1
