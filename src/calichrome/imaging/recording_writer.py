"""A recording that grows frame by frame, and is complete after each."""

import csv
import hashlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from calichrome.core.files import check_folder
from calichrome.errors import OutputError
from calichrome.imaging.files import write_picture
from calichrome.imaging.image import Pixels

__all__ = ["SUMS", "RecordingWriter"]

SUMS = "SHA256SUMS"  # `sha256sum --check SHA256SUMS` in the recording reads it
_TIMES = "timestamps.csv"


class RecordingWriter:
    """Write ``folder/<camera>/<frame>.png``, timestamps.csv and SHA256SUMS.

    Parameters
    ----------
    folder
        Must not exist, or be empty: two recordings in one folder would be taken for one.

    Raises
    ------
    OutputError
        If the folder holds something or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(f"{folder} holds something; give a new folder with -o")
        check_folder(folder, force=True)
        self.folder = folder
        self.n_frames = 0

    def add(
        self, frame_id: str, pictures: Mapping[str, Pixels], times_s: Mapping[str, float]
    ) -> dict[str, str]:
        """Write the pictures of one instant; all of them, or none.

        Parameters
        ----------
        frame_id
            Not written before.
        pictures
            By camera: (H, W, 3) RGB or (H, W) grey, 8 or 16 bit.
        times_s
            By camera, seconds.

        Returns
        -------
        dict
            SHA-256 of each camera's file.
        """
        paths = {camera: Path(camera) / f"{frame_id}.png" for camera in pictures}
        tables = [self.folder / name for name in (SUMS, _TIMES)]
        lengths = [path.stat().st_size if path.exists() else 0 for path in tables]
        try:
            for camera, pixels in pictures.items():
                write_picture(self.folder / paths[camera], pixels)
            sums = {camera: _sum(self.folder / path) for camera, path in paths.items()}
            self._note(frame_id, paths, times_s, sums)
        except BaseException:  # Ctrl-C as well: a frame that lacks a camera is no frame
            if not self.n_frames:
                shutil.rmtree(self.folder, ignore_errors=True)
                raise
            for path in paths.values():
                (self.folder / path).unlink(missing_ok=True)
            for table, length in zip(tables, lengths, strict=True):
                os.truncate(table, length)
            raise
        self.n_frames += 1
        return sums

    def _note(
        self,
        frame_id: str,
        paths: Mapping[str, Path],
        times_s: Mapping[str, float],
        sums: Mapping[str, str],
    ) -> None:
        with (self.folder / SUMS).open("a", encoding="utf-8") as stream:
            stream.writelines(
                f"{sums[camera]}  {path.as_posix()}\n" for camera, path in paths.items()
            )
        with (self.folder / _TIMES).open("a", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            if not self.n_frames:
                writer.writerow(["camera", "frame", "time_s"])
            writer.writerows([camera, frame_id, f"{times_s[camera]:.6f}"] for camera in paths)


def _sum(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
