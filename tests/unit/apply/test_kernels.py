"""The C kernels against OpenCV with numpy, and what they do with odd frames."""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
import pytest
from benchmarks.apply.agreement import difference
from benchmarks.apply.calibrations import picture, random_camera, random_case
from numpy.typing import NDArray

from calichrome.apply import (
    OUTPUT_SPACES,
    Corrector,
    FrameFormat,
    Kernel,
    OutputSpace,
    PixelType,
    SourceMap,
    undistorting_map,
)
from calichrome.apply.correction import Correction
from calichrome.apply.native_rows import NativeRows
from calichrome.colour.models import MODELS
from calichrome.errors import CalichromeError
from calichrome.imaging import Pixels
from calichrome.kernels import native
from calichrome.rig import Camera

_TYPES: tuple[PixelType, ...] = get_args(PixelType)
_has_native = pytest.mark.skipif(native is None, reason="installed without a C compiler")


@pytest.fixture
def wide_camera(rng: np.random.Generator) -> Camera:
    """A camera with everything, and wide enough for the vector code."""
    camera = random_camera(rng, (203, 61), "root-polynomial-2-white")
    while camera.vignetting is None:
        camera = random_camera(rng, (203, 61), "root-polynomial-2-white")
    return camera


def _frame(rng: np.random.Generator, camera: Camera, dtype: PixelType = "uint8") -> Pixels:
    values = picture(rng, camera.size_wh) * FrameFormat(dtype=dtype).top
    return np.asarray(values if dtype == "float32" else np.rint(values), dtype=dtype)


@_has_native
@pytest.mark.parametrize("name", MODELS)
def test_both_kernels_agree(name: str) -> None:
    """Within 1/255 of full scale: a value between two steps may fall to either."""
    for seed in range(2):
        assert difference(random_case(np.random.default_rng([7, seed]), name)) <= 1


@_has_native
@pytest.mark.slow
def test_both_kernels_agree_on_many_calibrations() -> None:
    for seed in range(300):
        assert difference(random_case(np.random.default_rng([8, seed]))) <= 1, seed


@_has_native
@pytest.mark.parametrize("dtype", _TYPES)
@pytest.mark.parametrize("space", OUTPUT_SPACES)
def test_processors_without_vectors_give_the_same(
    wide_camera: Camera, rng: np.random.Generator, dtype: PixelType, space: OutputSpace
) -> None:
    source_map = undistorting_map(wide_camera.lens, wide_camera.size_wh)
    frames = FrameFormat(dtype=dtype)
    corrector = Corrector(wide_camera, space, source_map, frames=frames)
    frame = _frame(rng, wide_camera, dtype)
    correction: Correction = corrector._correction
    out = np.empty(corrector.output_shape, corrector.output_dtype)
    NativeRows(correction, wide=False).run(frame, out, 0, len(out))
    off = np.abs(corrector.apply(frame).astype(np.float64) - out)
    # the vectors weigh neighbours in steps of 2^-14, which is 2^-15 of full scale between black and
    # white; gain, model and the slope of 13 with which dark light is encoded may take it to 2^-9
    steps = {"uint8": 1, "uint16": 128, "float32": 2e-3}
    assert off.max() <= steps[str(out.dtype)]


@pytest.mark.parametrize("kernel", ["native", "opencv"])
@pytest.mark.parametrize("dtype", _TYPES)
@pytest.mark.parametrize("is_mapped", [True, False])
def test_views_and_threads_change_nothing(
    wide_camera: Camera,
    rng: np.random.Generator,
    kernel: Kernel,
    dtype: PixelType,
    *,
    is_mapped: bool,
) -> None:
    if kernel == "native" and native is None:
        pytest.skip("installed without a C compiler")
    source_map = undistorting_map(wide_camera.lens, wide_camera.size_wh) if is_mapped else None
    frames = FrameFormat(dtype=dtype)
    alone = Corrector(wide_camera, "srgb", source_map, frames=frames, kernel=kernel)
    shared = Corrector(wide_camera, "srgb", source_map, frames=frames, kernel=kernel, n_threads=3)
    frame = _frame(rng, wide_camera, dtype)
    expected = alone.apply(frame)
    np.testing.assert_array_equal(shared.apply(frame), expected)
    height, width = frame.shape[:2]
    larger = np.zeros((height + 7, width + 5, 3), dtype)
    roi = larger[3 : 3 + height, 2 : 2 + width]
    roi[...] = frame
    views = {
        "region": roi,
        "upside down": np.ascontiguousarray(frame[::-1])[::-1],
        "mirrored": np.ascontiguousarray(frame[:, ::-1])[:, ::-1],
        "bgr": np.ascontiguousarray(frame[..., ::-1])[..., ::-1],
        "columns first": np.asfortranarray(frame),
    }
    for name, view in views.items():
        np.testing.assert_array_equal(alone.apply(view), expected, err_msg=name)
    canvas = np.full((height + 4, width + 6, 3), 9, alone.output_dtype)
    inner = canvas[2:-2, 3:-3]
    assert alone.apply(frame, out=inner) is inner
    np.testing.assert_array_equal(inner, expected)
    canvas[2:-2, 3:-3] = 9
    assert (canvas == 9).all()  # nothing beside the region was written


def test_order_of_channels(wide_camera: Camera, rng: np.random.Generator) -> None:
    frame = _frame(rng, wide_camera)
    kernels: tuple[Literal["auto", "opencv"], ...] = ("auto", "opencv")
    for kernel in kernels:
        rgb = Corrector(wide_camera, kernel=kernel).apply(frame)
        bgr = Corrector(wide_camera, frames=FrameFormat(order="bgr"), kernel=kernel)
        np.testing.assert_array_equal(bgr.apply(frame[..., ::-1])[..., ::-1], rgb)


def _maps() -> dict[str, SourceMap]:
    x, y = np.meshgrid(np.arange(37, dtype=np.float32), np.arange(21, dtype=np.float32))
    here = np.stack([x, y], axis=-1)
    wild = np.random.default_rng(3).uniform(-1e5, 1e5, here.shape).astype(np.float32)
    holes = here.copy()
    holes[5, 7], holes[6, 8], holes[7, 9] = np.nan, np.inf, -np.inf
    return {
        "outside": here - 1e4,
        "wild": wild,
        "holes": holes,
        "last pixel": here * 0 + np.array([202, 60], np.float32),
        "one pixel": here[:1, :1],
        "one row": here[:1],
        "one column": here[:, :1],
        "larger": np.repeat(np.repeat(here, 31, axis=0), 31, axis=1) * 4,
    }


@pytest.mark.parametrize("name", _maps())
@pytest.mark.parametrize("dtype", _TYPES)
def test_maps_that_leave_the_picture(
    wide_camera: Camera, rng: np.random.Generator, name: str, dtype: PixelType
) -> None:
    source_map = _maps()[name]
    frame = _frame(rng, wide_camera, dtype)
    frames = FrameFormat(dtype=dtype)
    wanted: tuple[tuple[OutputSpace, Literal["auto", "opencv"]], ...] = (
        ("none", "auto"),
        ("none", "opencv"),
        ("srgb", "auto"),
    )
    results = [
        Corrector(wide_camera, space, source_map, frames=frames, kernel=kernel).apply(frame)
        for space, kernel in wanted
    ]
    top = frames.top
    off = np.abs(results[0].astype(np.float64) - results[1]) / top
    assert off.max() <= 1 / 255
    assert results[2].shape == (*source_map.shape[:2], 3)
    if name == "outside":
        assert (results[0] == 0).all()


def test_wrong_calls_are_refused(wide_camera: Camera, rng: np.random.Generator) -> None:
    corrector = Corrector(wide_camera)
    frame = _frame(rng, wide_camera)
    with pytest.raises(ValueError, match="expected uint8, got uint16"):
        corrector.apply(frame.astype(np.uint16))
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\) for rgb"):
        corrector.apply(frame[..., 0])
    with pytest.raises(CalichromeError, match="record at that size"):
        corrector.apply(frame[1:])
    with pytest.raises(ValueError, match="out: expected"):
        corrector.apply(frame, out=np.empty((3, 3, 3), np.uint8))
    with pytest.raises(ValueError, match="side by side"):
        corrector.apply(frame, out=np.empty((*frame.shape[:2], 6), np.uint8)[..., ::2])
    with pytest.raises(ValueError, match="shares memory"):
        corrector.apply(frame, out=frame)
    with pytest.raises(ValueError, match="n_threads"):
        Corrector(wide_camera, n_threads=0)
    with pytest.raises(ValueError, match="XYZ needs float32"):
        Corrector(wide_camera, "xyz-d65", output="uint8")
    with pytest.raises(ValueError, match="source_map"):
        Corrector(wide_camera, "none", np.zeros((4, 4), np.float32))
    for shape in ((0, 5, 2), (5, 0, 2)):
        with pytest.raises(ValueError, match="source_map"):
            Corrector(wide_camera, "srgb", np.zeros(shape, np.float32))


def test_without_a_compiler(wide_camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calichrome.apply.corrector.native", None)
    assert Corrector(wide_camera).kernel == "opencv"
    with pytest.raises(CalichromeError, match="C compiler"):
        Corrector(wide_camera, kernel="native")


@_has_native
def test_nothing_is_allocated_for_a_frame(wide_camera: Camera, rng: np.random.Generator) -> None:
    import tracemalloc

    source_map = undistorting_map(wide_camera.lens, wide_camera.size_wh)
    corrector = Corrector(wide_camera, "srgb", source_map)
    frame, out = _frame(rng, wide_camera), np.empty((61, 203, 3), np.uint8)
    corrector.apply(frame, out)
    tracemalloc.start()
    corrector.apply(frame, out)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4096  # objects of Python, no pixels


def test_light_made_up_for_follows_the_map(wide_camera: Camera) -> None:
    """The stored grid of gains against the fall-off at every pixel."""
    assert wide_camera.vignetting is not None
    plain = replace(wide_camera, vignetting=None)
    source_map = undistorting_map(wide_camera.lens, wide_camera.size_wh)
    frames = FrameFormat(dtype="float32", encoding="linear")
    flat = np.full((61, 203, 3), 0.25, np.float32)
    seen = wide_camera.vignetting.gain_map(wide_camera.size_wh).astype(np.float32) * flat
    corrected = Corrector(wide_camera, "xyz-d65", source_map, frames=frames).apply(seen)
    expected = Corrector(plain, "xyz-d65", source_map, frames=frames).apply(flat)
    limits: NDArray[np.float32] = np.array([202, 60], np.float32)
    inside = ((source_map >= 0) & (source_map <= limits)).all(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(corrected[inside], expected[inside], rtol=1e-3, atol=1e-5)
