"""Cameras that take pictures now, through OpenCV."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from calichrome.errors import RecordingError
from calichrome.imaging.image import Pixels

__all__ = ["CameraDevice", "CvCamera", "Setting"]

_SETTINGS = {
    "exposure": (cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE),
    "gain": (None, cv2.CAP_PROP_GAIN),  # its automatic goes with that of the exposure
    "white balance": (cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_WB_TEMPERATURE),
    "focus": (cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_FOCUS),
}
_MANUAL_EXPOSURE = {"V4L2": 1.0}  # V4L2_EXPOSURE_MANUAL; with other backends 0 is manual
_STEP = 0.02  # share by which drivers round a value to steps of theirs; a choice
_FRAMES_TO_SETTLE = 30  # a second in which the automatics find their values; a choice


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting of a camera.

    Parameters
    ----------
    name
        "exposure", "gain", "white balance" or "focus".
    value
        As read back, in the units of the driver.
    locked
        Whether its automatic is off and its value can be set.
    """

    name: str
    value: float
    locked: bool


class CameraDevice(Protocol):
    """A camera that is open; one thread at a time uses it."""

    def lock(self) -> tuple[Setting, ...]:
        """Turn every automatic off, keeping the values that it has found; read back."""
        ...

    def settings(self) -> Mapping[str, float]:
        """Read the present values by name."""
        ...

    def grab(self) -> bool:
        """Wait for the next frame and keep it, undecoded; False: there will be none."""
        ...

    def retrieve(self) -> Pixels | None:
        """Decode the frame that was kept, (H, W, 3) RGB or (H, W) grey."""
        ...

    def release(self) -> None:
        """Close."""
        ...


class CvCamera:
    """A camera opened by ``cv2.VideoCapture``.

    Parameters
    ----------
    source
        Number of the camera, or what OpenCV opens by name: a device file, the address of a stream,
        a video.
    size_wh
        Width and height to ask for, pixels; None: as the camera offers first.

    Raises
    ------
    RecordingError
        If it cannot be opened, or gives pictures of another size.
    """

    def __init__(self, source: int | str, size_wh: tuple[int, int] | None = None) -> None:
        # what OpenCV would print about cameras that are not there, we say in our own words
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(source)
        if not self._capture.isOpened():
            self._capture.release()
            raise RecordingError(
                f"camera {source} cannot be opened; check that it is plugged in, that no other "
                f"program uses it, and that you may read it"
            )
        # a queue of frames that nobody fetched would hand out the past
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size_wh is not None:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_wh[0])
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_wh[1])
            given = tuple(
                round(self._capture.get(side))
                for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            )
            if given != size_wh:
                self._capture.release()
                raise RecordingError(
                    f"camera {source} gives {given[0]}x{given[1]} instead of "
                    f"{size_wh[0]}x{size_wh[1]}; ask with --size for one that it has"
                )

    def lock(self) -> tuple[Setting, ...]:
        """Let the automatics settle, turn them off, write back what they found, and read it."""
        for _ in range(_FRAMES_TO_SETTLE):
            if not self.grab():
                break
        found = self.settings()
        return tuple(self._locked(name, value) for name, value in found.items())

    def _locked(self, name: str, value: float) -> Setting:
        automatic, own = _SETTINGS[name]
        locked = True
        if automatic is not None:
            manual = 0.0
            if automatic == cv2.CAP_PROP_AUTO_EXPOSURE:
                manual = _MANUAL_EXPOSURE.get(self._capture.getBackendName(), 0.0)
            locked = self._capture.set(automatic, manual) and self._capture.get(automatic) == manual
        # a True of `set` promises nothing: some drivers take a value and keep their own
        locked = self._capture.set(own, value) and locked
        after = float(self._capture.get(own))
        return Setting(name, after, bool(locked and math.isclose(after, value, rel_tol=_STEP)))

    def settings(self) -> Mapping[str, float]:
        """Read the present values by name."""
        return {name: float(self._capture.get(own)) for name, (_, own) in _SETTINGS.items()}

    def grab(self) -> bool:
        """Wait for the next frame and keep it, undecoded; False: there will be none."""
        return bool(self._capture.grab())

    def retrieve(self) -> Pixels | None:
        """Decode the frame that was kept, (H, W, 3) RGB or (H, W) grey."""
        there, frame = self._capture.retrieve()
        if not there:
            return None
        return np.asarray(frame[:, :, ::-1] if frame.ndim == 3 else frame)

    def release(self) -> None:
        """Close."""
        self._capture.release()
