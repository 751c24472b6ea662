"""``calichrome triangulate``."""

import csv
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output
from calichrome.core.files import check_output
from calichrome.errors import FileFormatError, SolveError
from calichrome.observations.points import read_points
from calichrome.pipeline.triangulate import LocatedPoints, locate_points, point_table, write_points
from calichrome.rig import load_rig
from calichrome.rig.compare import evidence_beside

__all__ = ["Triangulate"]

_MOST_LINES = 12
_WORDS = {
    "few_views": "seen by fewer than two cameras",
    "behind": "the rays meet behind a camera, or nowhere",
    "inconsistent": "the views contradict each other, and which is wrong is not clear",
    "small_angle": "the rays are so nearly parallel that the depth is hardly known",
}


@dataclass(frozen=True, kw_only=True)
class Triangulate(Command):
    """Locate points in space from their pixels in two cameras or more."""

    rig: Positional[Path]
    """rig.json; rig.npz beside it says how sure the calibration is."""
    points: Positional[Path]
    """CSV with the columns camera,frame,point,x,y and, if known, sigma or sxx,sxy,syy (pixels)."""
    output: Annotated[Path | None, Output] = None
    """CSV of places with their covariance, metres. Default: standard output."""
    force: Flag = False
    """Replace an existing file."""

    def run(self) -> int:
        """Triangulate and report."""
        if self.output is not None:
            check_output(self.output, force=self.force)
        rig = load_rig(self.rig)
        sizes_wh = {name: camera.size_wh for name, camera in rig.cameras.items()}
        seen = read_points(self.points, sizes_wh)
        try:
            found = locate_points(rig, evidence_beside(self.rig), seen)
        except FileFormatError as error:
            raise FileFormatError(f"{self.points}: {error}") from error
        if not found.located.any():
            remark = Counter(word for words in found.remarks for word in words).most_common(1)[0][0]
            raise SolveError(
                f"{self.points}: none of {len(found.names)} points has a place: {_WORDS[remark]}; "
                f"check that equal frames and points are the same thing in each camera"
            )
        if self.output is not None:
            write_points(found, self.output, force=self.force)
        text = "\n".join(_lines(found))
        if self.json or self.output is not None:
            where = [] if self.output is None else [f"Wrote {self.output}"]
            self.show("\n".join([text, *where]), _to_json(found))
        else:
            csv.writer(sys.stdout, lineterminator="\n").writerows(point_table(found))
            print(text, file=sys.stderr)
        return self.verdict(rig)


def _lines(found: LocatedPoints) -> Iterator[str]:
    n_located = int(found.located.sum())
    residual = float(np.sqrt(np.nanmean(found.residual_px**2)))
    yield f"{n_located} of {len(found.names)} points located, residual {residual:.2g} px RMS"
    if not found.all_stated:
        how = (
            "found from how far the views miss each other"
            if found.sigma_found
            else "as of the corners of the calibration; state sigma if yours are less sure"
        )
        yield f"positions without sigma have {found.sigma_px:.2g} px: {how}"
    if not found.with_covariance:
        yield "rig.npz is not beside the rig: the calibration counts as exact in the covariances"
    located = found.located
    doubtful = [
        f"  frame {frame}, point {point}: {'; '.join(said)}"
        for row, (frame, point) in enumerate(found.names)
        if (said := list(_said(found, row, located=bool(located[row]))))
    ]
    yield from doubtful[:_MOST_LINES]
    if len(doubtful) > _MOST_LINES:
        yield f"  and {len(doubtful) - _MOST_LINES} more points with remarks"


def _said(found: LocatedPoints, row: int, *, located: bool) -> Iterator[str]:
    for word in found.remarks[row]:
        yield _WORDS[word]
    out = [name for name, left in zip(found.cameras, found.left_out[row], strict=True) if left]
    if out and located:
        yield f"left out, since it contradicts the others: {', '.join(out)}"


def _to_json(found: LocatedPoints) -> dict[str, object]:
    header, *rows = point_table(found)
    lists = ("cameras", "left_out", "remark")
    return {
        "with_covariance": found.with_covariance,
        "sigma_px": None if found.all_stated else found.sigma_px,
        "sigma_found": found.sigma_found,
        "points": [
            {
                key: cell.split(";")
                if key in lists and cell
                else []
                if key in lists
                else cell
                if key in ("frame", "point")
                else float(cell)
                if cell
                else None
                for key, cell in zip(header, row, strict=True)
            }
            for row in rows
        ],
    }
