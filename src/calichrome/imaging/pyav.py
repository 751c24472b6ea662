"""PyAV, an optional package, imported where a video is met."""

from functools import cache
from types import ModuleType

from calichrome.errors import RecordingError

__all__ = ["av"]


@cache
def av() -> ModuleType:
    """Return the module.

    Raises
    ------
    RecordingError
        If it is not installed.
    """
    try:
        import av as module
    except ImportError as error:
        raise RecordingError(
            "reading videos needs PyAV, which is not installed; add it with pip install "
            '"calichrome[video]", or extract the frames as PNG'
        ) from error
    return module
