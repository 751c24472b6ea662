"""Everything that was seen: camera x frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from calichrome.observations.board_view import BoardView

__all__ = ["Dataset"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dataset:
    """Views of one target by several cameras.

    Parameters
    ----------
    sizes_wh
        camera id -> width and height of its pictures, pixels.
    views
        camera id -> frame id -> view. Equal frame ids are one instant.
    sums
        (camera id, frame id) -> SHA-256 of the picture file, where there is one.
    exposures
        (camera id, frame id) -> what EXIF says of exposure, gain and white balance.
    """

    sizes_wh: Mapping[str, tuple[int, int]]
    views: Mapping[str, Mapping[str, BoardView]]
    sums: Mapping[tuple[str, str], str] = field(default_factory=dict)
    exposures: Mapping[tuple[str, str], Mapping[str, float]] = field(default_factory=dict)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera ids."""
        return tuple(self.views)

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames that at least one camera sees, in order of first appearance."""
        return tuple(dict.fromkeys(frame for views in self.views.values() for frame in views))

    def shared_frames(self, camera_a: str, camera_b: str) -> tuple[str, ...]:
        """Frames that both cameras see."""
        return tuple(frame for frame in self.views[camera_a] if frame in self.views[camera_b])

    def with_views(self, views: Mapping[str, Mapping[str, BoardView]]) -> "Dataset":
        """Return the same recording with other views."""
        return replace(self, views=views)

    def without_frames(self, frames: frozenset[str]) -> "Dataset":
        """Leave some frames out."""
        return self.with_views(
            {
                camera: {frame: view for frame, view in views.items() if frame not in frames}
                for camera, views in self.views.items()
            }
        )
