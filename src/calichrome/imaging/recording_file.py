"""recording.toml: what could also be said on the command line, under the same names."""

import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calichrome.errors import RecordingError

__all__ = ["CameraEntry", "EncodingChoice", "RecordingFile", "read_recording_file"]

EncodingChoice = Literal["srgb", "linear", "gamma2.2", "rec709", "unknown"]


class _Closed(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CameraEntry(_Closed):
    """``[cameras.<id>]``: what is known of one camera."""

    encoding: EncodingChoice | None = None
    bits: int | None = Field(default=None, ge=8, le=16)
    lens: Literal["brown-conrady", "rational", "kannala-brandt"] | None = None
    fixed: dict[str, float] = Field(default_factory=dict)


class RecordingFile(_Closed):
    """The whole file; everything is optional."""

    pattern: str | None = None
    target: str | None = None
    square: str | None = None
    encoding: EncodingChoice | None = None
    bits: int | None = Field(default=None, ge=8, le=16)
    lens: Literal["brown-conrady", "rational", "kannala-brandt"] | None = None
    reference_camera: str | None = None
    cameras: dict[str, CameraEntry] = Field(default_factory=dict)

    def camera(self, camera_id: str) -> CameraEntry:
        """Return what holds for one camera: its own entry over the general one."""
        own = self.cameras.get(camera_id, CameraEntry())
        return CameraEntry(
            encoding=own.encoding or self.encoding,
            bits=own.bits or self.bits,
            lens=own.lens or self.lens,
            fixed=own.fixed,
        )


def read_recording_file(path: Path) -> RecordingFile:
    """Read recording.toml; a missing file says nothing.

    Raises
    ------
    RecordingError
        If it is not TOML, or holds an unknown key or an impossible value.
    """
    if not path.is_file():
        return RecordingFile()
    try:
        if path.stat().st_size > 1_000_000:
            raise RecordingError(f"{path}: is larger than 1 MB, which no recording.toml is")
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return RecordingFile.model_validate(data)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"{path}: cannot be read as TOML ({error}); repair it") from error
    except ValidationError as error:
        raise RecordingError(f"{path}: {_problem(error)}") from error


def _problem(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] != "extra_forbidden":
        return f"{where}: {first['msg']}; correct it"
    in_camera = first["loc"][0] == "cameras" and len(first["loc"]) > 1
    known = CameraEntry.model_fields if in_camera else RecordingFile.model_fields
    return f"unknown key {where}; known are {', '.join(known)}"
