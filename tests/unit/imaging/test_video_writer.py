"""Videos that we write: read back by PyAV."""

import shutil
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from calichrome.core.arrays import UInt8Array
from calichrome.errors import OutputError
from calichrome.imaging import (
    Image,
    StreamFormat,
    VideoSettings,
    VideoWriter,
    open_video,
    read_frame,
    stream_format,
    timed_frames,
)

_FORM = StreamFormat(
    time_base=Fraction(1, 25), rate=Fraction(25), primaries=1, transfer=13, matrix=1
)


def _picture(index: int, size_wh: tuple[int, int] = (96, 64)) -> UInt8Array:
    pixels = np.full((size_wh[1], size_wh[0], 3), 90, np.uint8)
    pixels[:, index % size_wh[0]] = 200
    return pixels


def _write(
    path: Path,
    form: StreamFormat = _FORM,
    stamps: list[int] | None = None,
    size_wh: tuple[int, int] = (96, 64),
) -> Path:
    writer = VideoWriter(path, size_wh, form, VideoSettings())
    for index, stamp in enumerate(range(20) if stamps is None else stamps):
        picture = _picture(index, size_wh)
        stored = picture.astype(np.uint16) * 257 if form.is_deep else picture
        writer.write(writer.frame(stored, stamp))
    writer.close()
    return path


@pytest.mark.parametrize(
    "time_base", [Fraction(1, 25), Fraction(1, 1000), Fraction(1, 90_000), Fraction(1001, 30_000)]
)
@pytest.mark.parametrize("first", [0, 7])
def test_times_are_exact(
    tmp_path: Path, rng: np.random.Generator, time_base: Fraction, first: int
) -> None:
    """Of a variable frame rate, with B-frames, from whatever the first time is."""
    step = max(1, round(Fraction(1, 100) / time_base))
    steps = rng.integers(1, 9, 120) * step
    stamps = [first * step, *(int(stamp) for stamp in first * step + np.cumsum(steps))]
    form = StreamFormat(time_base=time_base, rate=Fraction(30))
    with av.open(str(_write(tmp_path / "a.mp4", form, stamps))) as container:
        frames = list(container.decode(video=0))
        assert any(frame.pict_type == av.video.frame.PictureType.B for frame in frames)
        times = [
            frame.pts * frame.time_base
            for frame in frames
            if frame.pts is not None and frame.time_base is not None
        ]
    assert times == [stamp * time_base for stamp in stamps]


def test_times_before_zero_are_moved_together(tmp_path: Path) -> None:
    stamps = [-30, -28, -10, 0, 5, 9]
    with av.open(str(_write(tmp_path / "a.mp4", stamps=stamps))) as container:
        times = [frame.time for frame in container.decode(video=0)]
    assert times == pytest.approx([(stamp + 30) / 25 for stamp in stamps])


def test_tags_depth_and_pixel_shape(tmp_path: Path) -> None:
    form = StreamFormat(
        time_base=Fraction(1, 50),
        rate=Fraction(50),
        pixel_aspect=Fraction(4, 3),
        primaries=9,
        transfer=14,
        matrix=9,
        full_range=True,
        is_deep=True,
    )
    video = open_video(_write(tmp_path / "a.mp4", form), max_megapixels=1)
    read = stream_format(video)
    for name in ("rate", "pixel_aspect", "primaries", "transfer", "matrix", "full_range"):
        assert getattr(read, name) == getattr(form, name), name
    assert read.is_deep
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].codec_context.pix_fmt == "yuv420p10le"
    image = read_frame(video, 3)
    assert isinstance(image, Image)
    assert image.bits == 16
    np.testing.assert_allclose(image.pixels[:, 20:], 90 * 257, rtol=0.01)


def test_odd_sizes_stay(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.mp4", size_wh=(97, 63))
    assert open_video(path, max_megapixels=1).size_wh == (97, 63)


def test_a_killed_run_leaves_a_video(tmp_path: Path, rng: np.random.Generator) -> None:
    """What is on the disk at any moment can be played to nearly its end."""
    writer = VideoWriter(tmp_path / "a.mp4", (96, 64), _FORM, VideoSettings())
    for index in range(200):
        noise = rng.integers(0, 256, (64, 96, 3), dtype=np.uint8)
        writer.write(writer.frame(noise, index))
    shutil.copy(tmp_path / "a.mp4", tmp_path / "killed.mp4")
    writer.close()
    video = open_video(tmp_path / "killed.mp4", max_megapixels=1)
    # a fragment is 50 frames, and x264 holds some back
    n_frames = len(list(timed_frames(video)))
    assert n_frames >= 100
    assert video.timestamps is not None
    assert video.timestamps[0] == 0


def test_a_quality_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="choose 0"):
        VideoWriter(tmp_path / "a.mp4", (96, 64), _FORM, VideoSettings(crf=52))


def test_the_disk_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot be written as H\.264"):
        _write(tmp_path / "missing" / "a.mp4")
