"""The print measured by a camera that sees a ColorChecker card beside it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.encoding import EncodingName
from calichrome.colour import ChartFit, fit
from calichrome.colour.print_reading import (
    PrintMeasurement,
    PrintReading,
    combine_readings,
    read_print,
)
from calichrome.core.arrays import FloatArray
from calichrome.detection import detect_board
from calichrome.detection.card import CardReading, is_convex, measure_card
from calichrome.detection.card_search import find_card
from calichrome.errors import DetectionError, RecordingError, TargetError
from calichrome.imaging import MAX_MEGAPIXELS, Image, Unreadable, picture_files, read_image
from calichrome.imaging.recording_file import RecordingFile, read_recording_file
from calichrome.observations import NotFound
from calichrome.pipeline.detect import Progress, silent
from calichrome.target import PaletteColour, Target, colour_checker_palette, measured_target
from calichrome.target.measure import PAPER_BLACK, PAPER_WHITE

__all__ = ["CardMeasurement", "UsedPicture", "measure_from_card"]

_MISLEADS = "encoding_doubtful"  # no critical doubt of a fit, but each colour would be wrong
_MOST_NAMED = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class UsedPicture:
    """A picture that measured the print.

    Parameters
    ----------
    path
        Its file.
    model
        Colour model that its card chose.
    left_out_delta_e
        dE2000 of the card's patches when left out of the fit, root mean square.
    remarks
        What the user should know of it.
    """

    path: Path
    model: str
    left_out_delta_e: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CardMeasurement:
    """A print measured from pictures.

    Parameters
    ----------
    target
        With the measured colours.
    change_delta_e : (n_markers,) float
        dE2000 from the colours before.
    measured
        Colours and how sure they are.
    used, left_out
        Pictures, and why others were of no use.
    """

    target: Target
    change_delta_e: FloatArray
    measured: PrintMeasurement
    used: tuple[UsedPicture, ...]
    left_out: tuple[tuple[Path, str], ...]


def measure_from_card(
    target: Target,
    pictures: Path,
    *,
    card_corners_px: FloatArray | None = None,
    encoding: EncodingName | None = None,
    max_megapixels: float = MAX_MEGAPIXELS,
    progress: Progress = silent,
) -> CardMeasurement:
    """Measure the discs and the paper of a printed board.

    Parameters
    ----------
    target
        The board with nominal colours.
    pictures
        A picture, or a folder of pictures, that show a ColorChecker card beside the board.
    card_corners_px : (4, 2) float, optional
        Centres of the card's corner patches in every picture, as `measure_card` wants them.
        Default: the card is searched.
    encoding
        Of the pictures. Default: what recording.toml beside them says, else by their depth.
    max_megapixels
        Refuse larger pictures before decoding them.
    progress
        Called after each picture.

    Raises
    ------
    TargetError
        If the board has no discs.
    RecordingError
        If there are no pictures, or their encoding is said to be unknown.
    DetectionError
        If no picture is of use, or some discs are in none; the message says why, and which.
    """
    if not target.markers:
        raise TargetError("the board has no colour discs; there is nothing to measure by a card")
    if card_corners_px is not None and not is_convex(card_corners_px):
        raise DetectionError(
            "the corners of the card are not in order around it; give dark skin, bluish green, "
            "black, white"
        )
    folder = pictures if pictures.is_dir() else pictures.parent
    settings = read_recording_file(folder / "recording.toml")
    palette = colour_checker_palette()
    readings: list[PrintReading] = []
    used: list[UsedPicture] = []
    left_out: list[tuple[Path, str]] = []
    paths = _paths(pictures)
    for count, path in enumerate(paths, 1):
        image = _read(path, settings, encoding, max_megapixels)
        result = (
            image
            if isinstance(image, Unreadable)
            else _measure(image, target, palette, card_corners_px)
        )
        if isinstance(result, _Measured):
            readings.append(result.reading)
            used.append(replace(result.picture, path=path))
        else:
            left_out.append((path, result.reason))
        progress("looking for card and board", count, len(paths))
    if not readings:
        raise DetectionError(_nothing(pictures, left_out))
    measured = combine_readings(readings, len(target.markers))
    _require_all(target, measured, readings)
    with_colours = measured_target(target, _values(target, measured))
    return CardMeasurement(
        target=with_colours,
        change_delta_e=delta_e_2000_xyz(target.marker_xyz_d65, with_colours.marker_xyz_d65),
        measured=measured,
        used=tuple(used),
        left_out=tuple(left_out),
    )


def _paths(pictures: Path) -> list[Path]:
    if not pictures.exists():
        raise RecordingError(f"{pictures}: is not there; give a picture, or a folder of pictures")
    paths = picture_files(pictures) if pictures.is_dir() else [pictures]
    if not paths:
        raise RecordingError(
            f"{pictures}: holds no picture; give PNG, JPEG or TIFF that show card and board"
        )
    return paths


def _read(
    path: Path, settings: RecordingFile, encoding: EncodingName | None, max_megapixels: float
) -> Image | Unreadable:
    entry = settings.camera(path.parent.name)
    if encoding is None and entry.encoding == "unknown":
        raise RecordingError(
            f"{path}: recording.toml says that its encoding is unknown, which one card cannot "
            f"tell; give --encoding"
        )
    stated = encoding or (None if entry.encoding == "unknown" else entry.encoding)
    return read_image(path, encoding=stated, bits=entry.bits, max_megapixels=max_megapixels)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Measured:
    """A picture of use."""

    reading: PrintReading
    picture: UsedPicture


def _measure(
    image: Image,
    target: Target,
    palette: Sequence[PaletteColour],
    corners_px: FloatArray | None,
) -> _Measured | NotFound:
    """Measure the print in one picture, or say why not."""
    if not image.is_colour:
        return NotFound("is grey; colours need a colour picture")
    view = detect_board(image, target)
    if isinstance(view, NotFound):
        return view
    camera = _camera(image, palette, corners_px)
    if isinstance(camera, NotFound):
        return camera
    card, fitted = camera
    xyz = np.array([colour.xyz_d65 for colour in palette])
    reading = read_print(fitted, card.centres_px, card.rgb, xyz, view, target)
    if isinstance(reading, str):
        return NotFound(reading)
    return _Measured(reading=reading, picture=_described(card, fitted, reading))


def _camera(
    image: Image, palette: Sequence[PaletteColour], corners_px: FloatArray | None
) -> tuple[CardReading, ChartFit] | NotFound:
    """Find the card and fit the camera to it."""
    card = find_card(image) if corners_px is None else measure_card(image, corners_px)
    if isinstance(card, NotFound):
        return card
    fitted = fit(card, palette)
    if isinstance(fitted, str):
        return NotFound(f"the card gives no camera model: {fitted}")
    why = _untrustworthy(fitted)
    return NotFound(f"the card is not to be trusted: {why}") if why else (card, fitted)


def _untrustworthy(fitted: ChartFit) -> str:
    for doubt in fitted.doubts:
        if doubt.severity == "critical" or doubt.code == _MISLEADS:
            return doubt.text
    return ""


def _described(card: CardReading, fitted: ChartFit, reading: PrintReading) -> UsedPicture:
    return UsedPicture(
        path=Path(),
        model=fitted.model.MODEL,
        left_out_delta_e=reading.model_delta_e,
        remarks=(*card.remarks, *(doubt.text for doubt in fitted.doubts)),
    )


def _nothing(pictures: Path, left_out: Sequence[tuple[Path, str]]) -> str:
    (reason, count), *_ = Counter(reason for _, reason in left_out).most_common(1)
    if len(left_out) == 1:
        return f"{pictures}: {reason}"
    return f"{pictures}: none of {len(left_out)} pictures is of use, {count} since: {reason}"


def _require_all(
    target: Target, measured: PrintMeasurement, readings: Sequence[PrintReading]
) -> None:
    missing = np.flatnonzero(measured.n_pictures == 0)
    if not len(missing):
        return
    clipped = np.any([reading.clipped for reading in readings], axis=0)
    named = [
        f"{target.markers[marker].name} on square "
        f"{target.markers[marker].square[0]},{target.markers[marker].square[1]}"
        f"{' (clipped)' if clipped[marker] else ''}"
        for marker in missing[:_MOST_NAMED]
    ]
    more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
    remedy = "shorten the exposure" if clipped[missing].all() else "show the whole board"
    raise DetectionError(
        f"no picture measures {', '.join(named)}{more}: half a measured board would bend the fit; "
        f"{remedy}"
    )


def _values(target: Target, measured: PrintMeasurement) -> list[PaletteColour]:
    """Name every disc by its square: prints of one colour differ."""
    named = [
        (f"{marker.square[0]},{marker.square[1]}", xyz)
        for marker, xyz in zip(target.markers, measured.xyz_d65, strict=True)
    ]
    named.append((PAPER_WHITE, measured.white_xyz_d65))
    if np.isfinite(measured.black_xyz_d65).all():
        named.append((PAPER_BLACK, measured.black_xyz_d65))
    values = []
    for name, colour in named:
        x, y, z = (max(float(value), 0.0) for value in colour)  # noise about deep colours
        values.append(PaletteColour(name=name, xyz_d65=(x, y, z)))
    return values
