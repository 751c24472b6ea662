"""``calichrome export``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.errors import RecordingError
from calichrome.geometry.rectified_area import Framing, PrincipalPoints, ValidArea
from calichrome.pipeline.export import CubeSettings, ExportFormat, export_rig
from calichrome.rig import load_rig

__all__ = ["Export"]


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write a rig for OpenCV, ROS, or (colours) any program that reads .cube."""

    rig: Positional[Path]
    """rig.json."""
    to: ExportFormat
    """opencv: YAML for cv2.FileStorage; ros: camera_info; cube: a 3-D table of colours."""
    output: Annotated[Path, Output]
    """Folder for one file per camera; a single file may be named, like left.yaml."""
    cameras: tuple[str, ...] = ()
    """Only these cameras."""
    pair: tuple[str, ...] = ()
    """Of opencv and ros: these two as a rectified pair, like left,right."""
    valid_area: ValidArea = "all"
    """Of --pair, as in rectify."""
    principal_points: PrincipalPoints = "common"
    """Of --pair, as in rectify."""
    cube: Annotated[CubeSettings, tyro.conf.OmitArgPrefixes] = field(default_factory=CubeSettings)
    force: Flag = False
    """Replace existing files."""

    def run(self) -> int:
        """Export and report."""
        pair = names_from(self.pair)
        if pair and len(pair) != 2:
            raise RecordingError(f"--pair wants two cameras, like left,right; got {len(pair)}")
        if pair and self.cameras:
            raise RecordingError("--pair names the two cameras already; leave out --cameras")
        rig = load_rig(self.rig)
        written, findings = export_rig(
            rig,
            self.to,
            self.output,
            cameras=names_from(self.cameras),
            pair=(pair[0], pair[1]) if pair else None,
            framing=Framing(area=self.valid_area, principal_points=self.principal_points),
            cube=self.cube,
            force=self.force,
        )
        lines = [f"{item.severity:8} {item.code}: {item.text}" for item in findings]
        if self.to == "cube" and any(rig.cameras[c].vignetting is not None for c in rig.cameras):
            lines.append(
                "A .cube holds colours alone: the fall-off of the lenses stays in the pictures."
            )
        lines.append(f"Wrote {', '.join(str(path) for path in written)}")
        data = {
            "written": [str(path) for path in written],
            "findings": [
                {"code": item.code, "severity": item.severity, "text": item.text, **item.data}
                for item in findings
            ],
        }
        self.show("\n".join(lines), data)
        return self.verdict(rig)
