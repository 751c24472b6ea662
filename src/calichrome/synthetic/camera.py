"""Cameras of a scene that take pictures now, for what records from real ones."""

import time
from collections.abc import Mapping

from calichrome.imaging.devices import Setting
from calichrome.imaging.image import Pixels
from calichrome.synthetic.recording import picture
from calichrome.synthetic.render import Renderer

__all__ = ["SyntheticCamera"]

_FRAME_S = 1 / 30
_SETTINGS = {"exposure": 156.0, "gain": 0.0, "white balance": 4600.0, "focus": 0.0}


class SyntheticCamera:
    """One camera of a scene, as a `CameraDevice`.

    Each picture that is retrieved shows the next pose of the board, as if a person moved it between
    the shots: cameras of one scene that are retrieved alike show it in the same place.

    Parameters
    ----------
    renderer
        Of the scene; its cameras may share it.
    camera_id
        One of the scene.
    """

    def __init__(self, renderer: Renderer, camera_id: str) -> None:
        self._renderer, self._camera_id = renderer, camera_id
        self._frames = tuple(renderer.scene.world_from_board)
        self._n_retrieved = 0

    def lock(self) -> tuple[Setting, ...]:
        """Return settings that are locked from the start."""
        return tuple(Setting(name, value, locked=True) for name, value in _SETTINGS.items())

    def settings(self) -> Mapping[str, float]:
        """Return the present values by name."""
        return _SETTINGS

    def grab(self) -> bool:
        """Wait as long as a frame of a camera takes."""
        now = time.monotonic()
        time.sleep(_FRAME_S - now % _FRAME_S)
        return True

    def retrieve(self) -> Pixels:
        """Render the next pose; after the last comes the first."""
        frame = self._frames[self._n_retrieved % len(self._frames)]
        self._n_retrieved += 1
        return picture(self._renderer, self._camera_id, frame)

    def release(self) -> None:
        """Do nothing: there is nothing to close."""
