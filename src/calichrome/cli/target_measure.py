"""``calichrome target measure``."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional

from calichrome.cli.terminal import Command, Flag, Output, square_size
from calichrome.colorimetry.encoding import EncodingName
from calichrome.core.files import check_output, writing_file
from calichrome.detection.card import read_card_corners
from calichrome.errors import TargetError
from calichrome.imaging import MAX_MEGAPIXELS
from calichrome.pipeline.measure_card import CardMeasurement, measure_from_card
from calichrome.target import (
    Target,
    load_target,
    measured_target,
    read_colour_table,
    target_to_json,
    with_square_size,
)

__all__ = ["TargetMeasure"]


@dataclass(frozen=True, kw_only=True)
class TargetMeasure(Command):
    """Replace nominal colours and sizes by measured ones."""

    target: Positional[Path]
    """target.json as printed."""
    values: Path | None = None
    """What an instrument measured, by name: CSV or CGATS (.txt, .ti3) of X,Y,Z, L,a,b or
    reflectances; rows paper_white and paper_black measure the paper."""
    illuminant: Literal["D50", "D65"] | None = None
    """Of the values, where their file does not say it."""
    observer: str | None = None
    """Of the values, where their file does not say it; 2 (degrees)."""
    from_card: Path | None = None
    """Picture or folder of pictures that show a ColorChecker card beside the board, in its plane
    and light; better several, with the card at different sides."""
    card_corners: Path | None = None
    """CSV (x,y) of the centres of the card's corner patches in every picture, clockwise from dark
    skin. Default: the card is searched."""
    encoding: EncodingName | None = None
    """Of the pictures. Default: what recording.toml beside them says; else 8 bit is sRGB, 16 bit
    and float are linear."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Refuse larger pictures before decoding them."""
    square: str | None = None
    """Measured size of a square, like 39.7mm or 39.7x39.9mm."""
    output: Annotated[Path, Output]
    """Where to write the measured target.json."""
    force: Flag = False
    """Replace an existing output."""

    def run(self) -> int:
        """Read, replace and write."""
        self._check()
        target = load_target(self.target)
        said, lines, data = [], list[str](), dict[str, Any]()
        if self.values is not None:
            values = read_colour_table(
                self.values, illuminant=self.illuminant, observer=self.observer
            )
            target = measured_target(target, values)
            said.append(f"{len(values)} colours")
        if self.from_card is not None:
            found = self._by_card(target, self.from_card)
            target, lines, data = found.target, list(_lines(found)), _to_json(found)
            said.append(f"{len(target.markers)} discs")
        if self.square is not None:
            target = with_square_size(target, square_size(self.square))
            said.append(f"squares of {self.square}")
        with writing_file(self.output, force=self.force) as temporary:
            temporary.write_text(json.dumps(target_to_json(target), indent=1) + "\n")
        lines.append(f"Wrote {self.output} with measured {' and '.join(said)}")
        self.show("\n".join(lines), {"target": str(self.output), **data})
        return 0

    def _check(self) -> None:
        check_output(self.output, force=self.force)
        if self.values is None and self.square is None and self.from_card is None:
            raise TargetError(
                "nothing was measured; give --values FILE, --from-card PICTURES, --square SIZE, or "
                "a size with one of the others"
            )
        if self.values is not None and self.from_card is not None:
            raise TargetError("--values and --from-card both measure the colours; give one of them")
        for option, value in (("--card-corners", self.card_corners), ("--encoding", self.encoding)):
            if value is not None and self.from_card is None:
                raise TargetError(f"{option} belongs to pictures; give --from-card PICTURES")

    def _by_card(self, target: Target, pictures: Path) -> CardMeasurement:
        corners = None if self.card_corners is None else read_card_corners(self.card_corners)
        with self.progress() as progress:
            return measure_from_card(
                target,
                pictures,
                card_corners_px=corners,
                encoding=self.encoding,
                max_megapixels=self.max_megapixels,
                progress=progress,
            )


def _lines(found: CardMeasurement) -> Iterator[str]:
    """Say what was found, how sure it is, and from which pictures."""
    measured, markers = found.measured, found.target.markers
    change, sigma = found.change_delta_e, measured.sigma_delta_e
    yield (
        f"{len(markers)} discs measured by {len(found.used)} of "
        f"{len(found.used) + len(found.left_out)} pictures"
    )
    yield (
        f"Change against before: {change.mean():.1f} dE2000 on average, at most "
        f"{change.max():.1f} ({markers[int(change.argmax())].name})"
    )
    yield (
        f"Estimated error: {sigma.mean():.1f} dE2000 on average, at most {sigma.max():.1f} "
        f"({markers[int(sigma.argmax())].name}); {measured.model_delta_e:.1f} of it is the "
        f"camera's, which further pictures do not lower"
    )
    white, black = 100 * measured.white_xyz_d65[1], 100 * measured.black_xyz_d65[1]
    yield (
        f"Paper: Y = {white:.1f} ± {white * measured.level_sigma:.1f}, black squares Y = "
        f"{black:.1f}; the ± is common to all colours"
    )
    for item in found.used:
        yield f"  {item.path.name}: {item.model}, {item.left_out_delta_e:.1f} dE2000 on its card"
        yield from (f"    {text}" for text in item.remarks)
    yield from (f"  left out {path.name}: {reason}" for path, reason in found.left_out)


def _to_json(found: CardMeasurement) -> dict[str, Any]:
    measured = found.measured
    discs = [
        {
            "square": list(marker.square),
            "name": marker.name,
            "change_delta_e_2000": float(change),
            "sigma_delta_e_2000": float(sigma),
            "n_pictures": int(count),
        }
        for marker, change, sigma, count in zip(
            found.target.markers,
            found.change_delta_e,
            measured.sigma_delta_e,
            measured.n_pictures,
            strict=True,
        )
    ]
    return {
        "change_delta_e_2000": _mean_and_max(found.change_delta_e),
        "sigma_delta_e_2000": _mean_and_max(measured.sigma_delta_e),
        "camera_delta_e_2000": measured.model_delta_e,
        "paper_white_Y": 100 * float(measured.white_xyz_d65[1]),
        "paper_white_Y_sigma": 100 * float(measured.white_xyz_d65[1]) * measured.level_sigma,
        "discs": discs,
        "used": [
            {
                "file": str(item.path),
                "model": item.model,
                "left_out_delta_e_2000": item.left_out_delta_e,
                "remarks": list(item.remarks),
            }
            for item in found.used
        ],
        "left_out": [{"file": str(path), "reason": reason} for path, reason in found.left_out],
    }


def _mean_and_max(values: np.ndarray[Any, Any]) -> dict[str, float]:
    return {"mean": float(values.mean()), "max": float(values.max())}
