"""``calichrome check``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from calichrome.cli.terminal import Command
from calichrome.imaging import MAX_MEGAPIXELS
from calichrome.pipeline.check import check_recording
from calichrome.pipeline.detect import DetectionSettings
from calichrome.report.text_compare import check_summary, check_to_json
from calichrome.rig import load_rig
from calichrome.rig.compare import evidence_beside

__all__ = ["Check"]


@dataclass(frozen=True, kw_only=True)
class Check(Command):
    """Tell from one new picture per camera whether a camera moved, its lens or colour changed."""

    rig: Positional[Path]
    """rig.json; rig.npz beside it says how sure the calibration is."""
    pictures: Positional[Path]
    """Folder of new pictures of the board, laid out as for calibrate."""
    target: str | None = None
    """Default: that of the rig."""
    pattern: str | None = None
    """How file names are built, as for calibrate."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Refuse larger pictures before decoding them."""
    search: Annotated[
        DetectionSettings, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff
    ] = field(default_factory=DetectionSettings)

    def run(self) -> int:
        """Check; exit code 3 if something changed."""
        rig, evidence = load_rig(self.rig), evidence_beside(self.rig)
        with self.progress() as progress:
            found = check_recording(
                rig,
                evidence,
                self.pictures,
                target=self.target,
                pattern=self.pattern,
                max_megapixels=self.max_megapixels,
                detecting=self.search,
                progress=progress,
            )
        self.show(check_summary(found), check_to_json(found))
        return 0 if found.unchanged else 3
