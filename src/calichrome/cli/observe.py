"""``calichrome observe``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output
from calichrome.core.files import check_folder, check_output
from calichrome.core.findings import worst_severity
from calichrome.errors import RecordingError
from calichrome.pipeline.detect import Progress as ProgressCall
from calichrome.pipeline.observe import Observation, ObserveSettings, observe
from calichrome.pipeline.observe_pictures import (
    Classifier,
    check_plot,
    classify,
    load_classifier,
    write_overlay,
    write_plot,
)
from calichrome.pipeline.observe_tables import (
    distances,
    write_distances,
    write_sightings,
    write_tracks,
)
from calichrome.report.text_observe import observe_summary, observe_to_json
from calichrome.rig import load_rig
from calichrome.rig.compare import evidence_beside

__all__ = ["Observe"]


@dataclass(frozen=True, kw_only=True)
class Observe(Command):
    """Find what moves in a scene, in every camera; place and follow it in space."""

    rig: Positional[Path]
    """rig.json; rig.npz beside it says how sure the calibration is."""
    recording: Positional[Path]
    """Pictures or videos of all cameras; frames named background... show the empty scene."""
    output: Annotated[Path, Output] = Path("tracks.csv")
    """Where to write the tracks."""
    distances: Path | None = None
    """Write the distance of every pair of objects, with its 95 % lower bound."""
    sightings: Path | None = None
    """Write what each camera saw of each object."""
    overlay: Path | None = None
    """Folder for a video per camera with boxes, numbers and tails."""
    plot: Path | None = None
    """Draw the tracks in space, PNG, PDF or SVG."""
    classify: str | None = None
    """module:function or FILE.py:function that names an object by (crop, Lab, size)."""
    background: str | None = None
    """FIRST:LAST: indices of the frames that show the empty scene."""
    fps: float | None = None
    """Frames per second, where timestamps.csv does not tell the times."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    settings: Annotated[
        ObserveSettings, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff
    ] = field(default_factory=ObserveSettings)
    force: Flag = False
    """Replace existing outputs."""

    def run(self) -> int:
        """Observe, write, and report; exit code 3 if the rig is not to be trusted."""
        for path in (self.output, self.distances, self.sightings, self.plot):
            if path is not None:
                check_output(path, force=self.force)
        if self.overlay is not None:
            check_folder(self.overlay, force=self.force, inputs=[self.recording])
        if self.plot is not None:
            check_plot(self.plot)
        classifier = None if self.classify is None else load_classifier(self.classify)
        if self.fps is not None and not self.fps > 0:
            raise RecordingError(f"--fps {self.fps}: give a number above 0")
        with self.progress() as progress:
            seen = observe(
                load_rig(self.rig),
                evidence_beside(self.rig),
                self.recording,
                settings=self.settings,
                pattern=self.pattern,
                background=_range(self.background),
                fps=self.fps,
                progress=progress,
            )
            self._write(seen, classifier, progress)
        found = seen.trajectories, seen.errors, seen.findings
        unit_s = seen.watch.time_unit_s
        self.show(
            observe_summary(
                *found,
                n_born=seen.n_born,
                n_lost=seen.n_lost,
                cameras=seen.watch.cameras,
                n_frames=len(seen.watch.times_s),
                time_unit_s=unit_s,
            ),
            observe_to_json(*found, n_born=seen.n_born, n_lost=seen.n_lost, time_unit_s=unit_s),
        )
        return 3 if worst_severity(seen.findings) == "critical" else 0

    def _write(
        self, seen: Observation, classifier: Classifier | None, progress: ProgressCall
    ) -> None:
        rows = list(seen.rows())
        classes = {} if classifier is None else classify(seen, rows, classifier)
        write_tracks(self.output, rows, classes, force=self.force)
        if self.sightings is not None:
            write_sightings(self.sightings, rows, force=self.force)
        if self.distances is not None:
            write_distances(self.distances, distances(seen, rows), force=self.force)
        if self.plot is not None:
            write_plot(seen, rows, self.plot, force=self.force)
        if self.overlay is not None:
            write_overlay(seen, rows, classes, self.overlay, force=self.force, progress=progress)


def _range(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not (colon and first.isdecimal() and last.isdecimal()):
        raise RecordingError(f"--background {text}: write FIRST:LAST, like 0:24")
    return int(first), int(last)
