"""Cameras of OpenCV: what they promise, what they do, and a real backend."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calichrome.errors import RecordingError
from calichrome.imaging.devices import CvCamera

_AUTOMATIC = {
    "exposure": cv2.CAP_PROP_AUTO_EXPOSURE,
    "white balance": cv2.CAP_PROP_AUTO_WB,
    "focus": cv2.CAP_PROP_AUTOFOCUS,
}
_OWN = {
    "exposure": cv2.CAP_PROP_EXPOSURE,
    "gain": cv2.CAP_PROP_GAIN,
    "white balance": cv2.CAP_PROP_WB_TEMPERATURE,
    "focus": cv2.CAP_PROP_FOCUS,
}


class FakeCapture:
    """A camera as the documentation of cv2.VideoCapture describes it.

    `set` of what it does not have returns False, `get` of it -1; an automatic that is on moves its
    value with every frame; `ignored` are settings of which `set` says True and does nothing.
    """

    def __init__(
        self,
        *,
        lacks: tuple[str, ...] = (),
        ignored: tuple[str, ...] = (),
        sizes: tuple[tuple[int, int], ...] = ((640, 480), (1280, 720)),
        backend: str = "V4L2",
        n_frames: int = 1000,
    ) -> None:
        self._lacked = {
            table[name] for name in lacks for table in (_AUTOMATIC, _OWN) if name in table
        }
        self._ignored = {_AUTOMATIC.get(name, _OWN[name]) for name in ignored}
        self._sizes, self._backend, self._left = sizes, backend, n_frames
        self._on = 3.0 if backend == "V4L2" else 1.0
        self._manual = 1.0 if backend == "V4L2" else 0.0
        self.values: dict[int, float] = {
            **dict.fromkeys(_AUTOMATIC.values(), 1.0),
            cv2.CAP_PROP_AUTO_EXPOSURE: self._on,
            cv2.CAP_PROP_EXPOSURE: 150.0,
            cv2.CAP_PROP_GAIN: 12.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
            cv2.CAP_PROP_FOCUS: 30.0,
            cv2.CAP_PROP_FRAME_WIDTH: sizes[0][0],
            cv2.CAP_PROP_FRAME_HEIGHT: sizes[0][1],
        }
        self.released = False

    def isOpened(self) -> bool:  # noqa: N802 (as OpenCV names it)
        return True

    def getBackendName(self) -> str:  # noqa: N802
        return self._backend

    def set(self, number: int, value: float) -> bool:
        if number in self._lacked:
            return False
        if number in self._ignored:
            return True
        self.values[number] = float(value)
        wanted = self.values[cv2.CAP_PROP_FRAME_WIDTH], self.values[cv2.CAP_PROP_FRAME_HEIGHT]
        if number == cv2.CAP_PROP_FRAME_HEIGHT and wanted not in self._sizes:
            width, height = self._sizes[0]  # drivers take the nearest that they have
            self.values[cv2.CAP_PROP_FRAME_WIDTH] = width
            self.values[cv2.CAP_PROP_FRAME_HEIGHT] = height
        return True

    def get(self, number: int) -> float:
        return -1.0 if number in self._lacked else self.values[number]

    def grab(self) -> bool:
        self._left -= 1
        if self.values[cv2.CAP_PROP_AUTO_EXPOSURE] != self._manual:
            self.values[cv2.CAP_PROP_EXPOSURE] *= 1.05
        return self._left >= 0

    def retrieve(self) -> tuple[bool, Any]:
        blue = np.zeros((480, 640, 3), np.uint8)
        blue[..., 0] = 200
        return (True, blue) if self._left >= 0 else (False, None)

    def release(self) -> None:
        self.released = True


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Any:  # noqa: ANN401 (a function of keywords)
    def camera(size_wh: tuple[int, int] | None = None, **how: Any) -> tuple[CvCamera, FakeCapture]:  # noqa: ANN401
        fake = FakeCapture(**how)
        monkeypatch.setattr(cv2, "VideoCapture", lambda _source: fake)
        return CvCamera(0, size_wh), fake

    return camera


@pytest.mark.parametrize("backend", ["V4L2", "MSMF"])
def test_every_automatic_is_turned_off_at_what_it_found(opened: Any, backend: str) -> None:  # noqa: ANN401
    camera, fake = opened(backend=backend)
    settings = {item.name: item for item in camera.lock()}
    assert all(item.locked for item in settings.values())
    assert fake.values[cv2.CAP_PROP_AUTO_EXPOSURE] == (1.0 if backend == "V4L2" else 0.0)
    assert fake.values[cv2.CAP_PROP_AUTO_WB] == fake.values[cv2.CAP_PROP_AUTOFOCUS] == 0
    # the automatic was given a second: it moved 30 times
    assert settings["exposure"].value == pytest.approx(150 * 1.05**30)
    for _ in range(10):
        camera.grab()
    assert camera.settings()["exposure"] == settings["exposure"].value
    assert settings["white balance"].value == 4600


@pytest.mark.parametrize("how", ["lacks", "ignored"])
@pytest.mark.parametrize("name", ["exposure", "white balance", "focus"])
def test_what_is_refused_is_told(opened: Any, name: str, how: str) -> None:  # noqa: ANN401
    """A `set` that returns False, and one that returns True and does nothing."""
    camera, _ = opened(**{how: (name,)})
    assert [item.name for item in camera.lock() if not item.locked] == [name]


def test_a_size_that_is_not_given_is_refused(opened: Any) -> None:  # noqa: ANN401
    camera, fake = opened((1280, 720))
    assert fake.values[cv2.CAP_PROP_FRAME_WIDTH] == 1280
    camera.release()
    assert fake.released
    with pytest.raises(RecordingError, match="gives 640x480 instead of 1920x1080"):
        opened((1920, 1080))


def test_pictures_are_rgb_until_there_are_none(opened: Any) -> None:  # noqa: ANN401
    camera, _ = opened(n_frames=1)
    assert camera.grab()
    picture = camera.retrieve()
    assert picture is not None
    np.testing.assert_array_equal(picture[0, 0], [0, 0, 200])
    assert not camera.grab()
    assert camera.retrieve() is None


def test_a_camera_that_is_not_there(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RecordingError, match="camera 97 cannot be opened"):
        CvCamera(97)
    assert capfd.readouterr().err == ""


def test_a_video_through_a_real_backend(tmp_path: Path) -> None:
    """Frames come in their order; a file has no settings, and says so."""
    path = tmp_path / "three.avi"
    fourcc = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), fourcc, 30, (64, 48))
    assert writer.isOpened()
    for level in (50, 120, 190):
        writer.write(np.full((48, 64, 3), (0, 0, level), np.uint8))
    writer.release()
    camera = CvCamera(str(path), (64, 48))
    reds = []
    while camera.grab():
        picture = camera.retrieve()
        assert picture is not None
        assert picture.shape == (48, 64, 3)
        reds.append(float(picture[..., 0].mean()))
    assert camera.retrieve() is None
    np.testing.assert_allclose(reds, [50, 120, 190], atol=4)  # JPEG
    assert not any(item.locked for item in camera.lock())
    camera.release()
