"""Which pinhole camera corrected pictures have, from what a user says."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calichrome.apply import SourceMap, rectifying_map
from calichrome.errors import CalichromeError, FileFormatError
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rectified_area import ValidArea
from calichrome.geometry.undistortion import Pinhole, undistorted_pinhole
from calichrome.imaging import MAX_MEGAPIXELS
from calichrome.rig import Rig

__all__ = ["NewView", "cameras_json", "new_pinhole", "source_map_of"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NewView:
    """What the corrected pictures show; nothing said: what the recorded ones do.

    Parameters
    ----------
    undistort
        Remove the distortion of the lens, keeping size and K.
    valid_area
        Remove it and choose K: "all" of the picture is seen, or no border ("valid").
    keep_size
        With `valid_area`: the size stays and the scale is chosen, else the other way round.
    new_camera
        Remove it and take the pinhole of this camera of the rig, or of this file.
    """

    undistort: bool = False
    valid_area: ValidArea | None = None
    keep_size: bool = False
    new_camera: str | None = None

    def __post_init__(self) -> None:
        if self.new_camera is not None and self.valid_area is not None:
            raise CalichromeError(
                "--valid-area and --new-camera both choose the size and K of the output; give one"
            )
        if self.keep_size and self.valid_area is None:
            raise CalichromeError(
                "--keep-size chooses the scale of --valid-area; add --valid-area all or valid"
            )

    @property
    def keeps_pixel_shape(self) -> bool:
        """Whether pixels are as wide and high as recorded."""
        return self.valid_area is None and self.new_camera is None


class _PinholeFile(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    size_wh: tuple[int, int]
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float


def new_pinhole(view: NewView, rig: Rig, camera_id: str) -> Pinhole | None:
    """Return the pinhole that a camera's pictures shall have; None: they stay as they are.

    Raises
    ------
    CalichromeError
        If a file cannot be read or the pictures would be too large.
    SolveError
        If no area without a border exists.
    """
    camera = rig.cameras[camera_id]
    if view.new_camera is not None:
        pinhole = _named_pinhole(view.new_camera, rig)
    elif view.valid_area is not None:
        pinhole = undistorted_pinhole(
            camera.lens, camera.size_wh, view.valid_area, keep_size=view.keep_size
        )
    elif view.undistort:
        pinhole = _pinhole_of(camera.lens, camera.size_wh)
    else:
        return None
    width, height = pinhole.size_wh
    if min(width, height) < 1 or width * height > MAX_MEGAPIXELS * 1e6:
        raise CalichromeError(
            f"camera {camera_id}: the new pictures would be {width}x{height}; give --keep-size, or "
            f"another --new-camera"
        )
    return pinhole


def _named_pinhole(name: str, rig: Rig) -> Pinhole:
    if name in rig.cameras:
        return _pinhole_of(rig.cameras[name].lens, rig.cameras[name].size_wh)
    path = Path(name)
    if not path.is_file():
        raise CalichromeError(
            f"--new-camera {name}: is neither a camera of the rig ({', '.join(rig.cameras)}) nor a "
            f"file"
        )
    try:
        stored = _PinholeFile.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise FileFormatError(
            f"{path}: {where + ': ' if where else ''}{first['msg']}; wanted is "
            f'{{"size_wh": [w, h], "fx": .., "fy": .., "cx": .., "cy": ..}} in pixels'
        ) from error
    return Pinhole(**stored.model_dump())


def _pinhole_of(lens: Lens, size_wh: tuple[int, int]) -> Pinhole:
    return Pinhole(size_wh=size_wh, fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy)


def source_map_of(lens: Lens, pinhole: Pinhole | None) -> SourceMap | None:
    """Return where each pixel of the pinhole's picture comes from."""
    if pinhole is None:
        return None
    return rectifying_map(lens, np.eye(3), pinhole.matrix, pinhole.size_wh)


def cameras_json(pinholes: Mapping[str, Pinhole]) -> str:
    """Return cameras.json: the cameras that corrected pictures have."""
    data = {
        "format": "calichrome.cameras",
        "format_version": 1,
        "cameras": {name: asdict(pinhole) for name, pinhole in pinholes.items()},
    }
    return json.dumps(data, indent=1) + "\n"
