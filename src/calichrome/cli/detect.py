"""``calichrome detect``."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.core.files import check_output, writing_folder
from calichrome.errors import DetectionError
from calichrome.imaging import MAX_FRAMES, MAX_MEGAPIXELS, choose_frames, open_recording
from calichrome.observations import write_observations
from calichrome.pipeline.detect import DetectionSettings, detect_recording, find_target

__all__ = ["Detect"]


@dataclass(frozen=True, kw_only=True)
class Detect(Command):
    """Find the board in every picture and write corners and disc colours as CSV."""

    recording: Positional[Path]
    """Folder of pictures or videos."""
    output: Annotated[Path, Output] = Path("corners.csv")
    """NAME.csv; NAME.markers.csv and NAME.rejected.csv are written beside it."""
    target: str | None = None
    """target.json, chessboard:NxM:SIZE, charuco:COLSxROWS:DICT:SQUARE:MARKER[:inverted] or
    aprilgrid:COLSxROWS:FAMILY:SIZE:SPACING. Default: target.json in the recording."""
    pattern: str | None = None
    """How file names are built, like "{camera}_{frame}"."""
    cameras: tuple[str, ...] = ()
    """Use only these cameras."""
    overlay: Path | None = None
    """Folder for pictures with corners, ids, discs and reasons drawn in."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Refuse larger pictures before decoding them."""
    max_frames: int = MAX_FRAMES
    """Of videos: how many frames of each camera to look at; sharp, still and different ones."""
    search: Annotated[
        DetectionSettings, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff
    ] = field(default_factory=DetectionSettings)
    force: Flag = False
    """Replace existing outputs."""

    def run(self) -> int:
        """Detect and write; exit code 1 if there is no board anywhere."""
        beside = [self.output.with_suffix(f".{kind}.csv") for kind in ("markers", "rejected")]
        for path in (self.output, *beside):
            check_output(path, force=self.force)
        recording = open_recording(
            self.recording,
            pattern=self.pattern,
            cameras=names_from(self.cameras),
            max_megapixels=self.max_megapixels,
        )
        target = find_target(recording, self.target, None)
        with self.progress() as progress, self._drawing() as overlay:
            recording = choose_frames(recording, self.max_frames, progress=progress)
            detection = detect_recording(
                recording, target, overlay=overlay, settings=self.search, progress=progress
            )
        write_observations(detection.dataset, detection.rejected, self.output, force=self.force)
        views = {camera: len(seen) for camera, seen in detection.dataset.views.items()}
        lines = [recording.reading]
        if detection.n_cached:
            lines.append(f"{detection.n_cached} of {recording.n_pictures} pictures from the cache")
        lines += [
            f"camera {camera}: board in {count} of {len(recording.files[camera])} pictures"
            for camera, count in views.items()
        ]
        lines += [f"  {camera} {frame}: {why}" for camera, frame, why in detection.rejected[:12]]
        if len(detection.rejected) > 12:
            lines.append(
                f"  and {len(detection.rejected) - 12} more in {self.output.stem}.rejected.csv"
            )
        lines.append(f"Wrote {self.output}")
        rejected = [
            {"camera": camera, "frame": frame, "reason": why}
            for camera, frame, why in detection.rejected
        ]
        self.show(
            "\n".join(lines), {"views": views, "rejected": rejected, "n_cached": detection.n_cached}
        )
        if any(views.values()):
            return 0
        raise DetectionError(
            f"no board in any of {recording.n_pictures} pictures; {self.output.stem}.rejected.csv "
            f"says why of each"
        )

    def _drawing(self) -> AbstractContextManager[Path | None]:
        if self.overlay is None:
            return nullcontext()
        return writing_folder(self.overlay, force=self.force, inputs=[self.recording])
