"""``calichrome calibrate``."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.core.files import check_output
from calichrome.errors import OutputError, RecordingError
from calichrome.imaging.sizes import parse_size
from calichrome.pipeline.calibrate import CalibrationSettings, run, run_on_corners
from calichrome.pipeline.detect import DetectionSettings
from calichrome.report.text import summary
from calichrome.report.text_candidates import candidates_text
from calichrome.rig import rig_to_json, save_rig

__all__ = ["Calibrate"]


@dataclass(frozen=True, kw_only=True)
class Calibrate(Command):
    """Calibrate all cameras of a recording in geometry and colour."""

    recording: Positional[Path | None] = None
    """Folder of pictures: RECORDING/<camera>/<frame>.png, or see --pattern."""
    output: Annotated[Path, Output] = Path("rig.json")
    """Where to write the rig; rig.npz with the evidence is written beside it."""
    settings: Annotated[CalibrationSettings, tyro.conf.OmitArgPrefixes] = field(
        default_factory=CalibrationSettings
    )
    search: Annotated[
        DetectionSettings, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff
    ] = field(default_factory=DetectionSettings)
    corners: Path | None = None
    """Use these corners (NAME.csv of `detect`) instead of detecting."""
    size: tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]] = ()
    """Picture sizes for --corners without a recording, like left=640x480, for each camera."""
    candidates: Flag = False
    """Also print what every colour model would have done, and why it lost."""
    force: Flag = False
    """Replace existing outputs."""

    def run(self) -> int:
        """Calibrate, save, and print the summary."""
        if self.output.suffix == ".npz":
            raise OutputError(f"{self.output}: the evidence takes this name; choose -o rig.json")
        for path in (self.output, self.output.with_suffix(".npz")):
            check_output(path, force=self.force)
        settings = replace(self.settings, cameras=names_from(self.settings.cameras))
        with self.progress() as progress:
            if self.corners is not None:
                sizes = dict(parse_size(text) for texts in self.size for text in texts)
                done = run_on_corners(
                    self.corners, self.recording, sizes, settings, progress=progress
                )
            elif self.recording is None:
                raise RecordingError("nothing to calibrate; give a RECORDING or --corners NAME.csv")
            else:
                done = run(self.recording, settings, detecting=self.search, progress=progress)
        save_rig(done.rig, done.evidence, self.output, force=self.force)
        reading = "" if done.recording is None else f"{done.recording.reading}\n"
        ignored = () if done.recording is None else done.recording.ignored
        if ignored:
            names = ", ".join(path.name for path in ignored[:5])
            more = ", ..." if len(ignored) > 5 else ""
            reading += f"ignored {len(ignored)} pictures: {names}{more}\n"
        text = f"{reading}{summary(done.rig)}"
        if self.candidates:
            text += f"\n{candidates_text(done.rig)}\n"
        self.show(f"{text}\nWrote {self.output}", rig_to_json(done.rig))
        return 0 if done.rig.trustworthy else 3
