"""From a recording to a rig: the one place that knows geometry and colour."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.samples import collect_samples, disc_means
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.core.pose import Pose
from calichrome.detection import BoardToPixels, measure_discs
from calichrome.errors import FileFormatError, RecordingError
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rig_solution import RigSolution
from calichrome.imaging import (
    MAX_FRAMES,
    MAX_MEGAPIXELS,
    Image,
    Recording,
    Unreadable,
    choose_frames,
    open_recording,
)
from calichrome.observations import BoardView, Dataset, read_corners
from calichrome.pipeline.assemble import assemble_rig, gather_evidence
from calichrome.pipeline.detect import (
    Detection,
    DetectionSettings,
    Progress,
    detect_recording,
    find_target,
    require_boards,
    silent,
)
from calichrome.pipeline.judge import greys_contradict, judge_target
from calichrome.pipeline.judge_geometry import judge_geometry
from calichrome.pipeline.solve_colour import ColourChoices, solve_colour
from calichrome.pipeline.solve_geometry import GeometrySettings, solve_geometry
from calichrome.pipeline.tone import linearise_camera
from calichrome.pipeline.world import place_world
from calichrome.rig import Evidence, Rig
from calichrome.target import Target

__all__ = ["Calibration", "CalibrationSettings", "calibrate", "calibrate_dataset", "run"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings(GeometrySettings, ColourChoices):
    """How to calibrate.

    Parameters
    ----------
    target
        target.json; chessboard:NxM:SIZE with NxM inner corners (chessboard:9x6:30mm);
        charuco:COLSxROWS:DICT:SQUARE:MARKER (squares; charuco:7x5:4X4_50:30mm:22mm, and :inverted
        for white codes on black); or aprilgrid:COLSxROWS:FAMILY:SIZE:SPACING (tags;
        aprilgrid:6x6:36h11:88mm:0.3). Default: target.json in the recording.
    square
        Measured size of a square, like 39.7mm or 39.7x39.9mm; overrides the target's.
    pattern
        How file names are built, like "{camera}_{frame}" or "{camera:left|right}{frame}".
    cameras
        Use only these cameras.
    max_megapixels
        Refuse larger pictures before decoding them.
    max_frames
        Of videos: how many frames of each camera to look at; sharp, still and different ones.
    """

    target: str | None = None
    square: str | None = None
    pattern: str | None = None
    cameras: tuple[str, ...] = ()
    max_megapixels: float = MAX_MEGAPIXELS
    max_frames: int = MAX_FRAMES


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A rig and what it was computed from."""

    rig: Rig
    evidence: Evidence
    recording: Recording | None = None
    n_pictures: int = 0


def calibrate(
    recording: Path | str,
    settings: CalibrationSettings | None = None,
    *,
    detecting: DetectionSettings | None = None,
    progress: Progress = silent,
) -> Rig:
    """Calibrate the cameras of a recording; see `CalibrationSettings` and `DetectionSettings`.

    Raises
    ------
    CalichromeError
        One sentence that says what is wrong and what to do.
    """
    settings = settings or CalibrationSettings()
    return run(Path(recording), settings, detecting=detecting, progress=progress).rig


def run(
    folder: Path,
    settings: CalibrationSettings,
    *,
    detecting: DetectionSettings | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate a recording, and keep the evidence."""
    recording = open_recording(
        folder,
        pattern=settings.pattern,
        cameras=settings.cameras,
        max_megapixels=settings.max_megapixels,
    )
    target = find_target(recording, settings.target, settings.square)
    _check_reference(settings, recording)
    recording = choose_frames(recording, settings.max_frames, progress=progress)
    detection = detect_recording(recording, target, settings=detecting, progress=progress)
    require_boards(detection, recording)
    return _calibrate(detection, target, settings, recording, progress)


def _check_reference(settings: CalibrationSettings, recording: Recording) -> None:
    """Refuse an unknown reference camera before the long work."""
    reference = settings.reference_camera or recording.settings.reference_camera
    if reference is not None and reference not in recording.cameras:
        raise RecordingError(
            f"reference camera {reference} is not among {', '.join(recording.cameras)}; correct "
            f"--reference-camera or recording.toml"
        )


def run_on_corners(
    corners: Path,
    folder: Path | None,
    sizes_wh: Mapping[str, tuple[int, int]],
    settings: CalibrationSettings,
    *,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate from a corner file instead of pictures.

    Parameters
    ----------
    corners
        NAME.csv of `detect`; colours come from NAME.markers.csv if it is there.
    folder
        The recording, for picture sizes and target.json; may be None.
    sizes_wh
        Picture sizes by camera, where there is no recording.
    settings, progress
        As in `run`.
    """
    if not corners.is_file():
        raise FileFormatError(f"{corners}: there is no such file; give NAME.csv of `detect`")
    recording = None
    if folder is not None:
        recording = open_recording(
            folder,
            pattern=settings.pattern,
            cameras=settings.cameras,
            max_megapixels=settings.max_megapixels,
        )
        _check_reference(settings, recording)
    target = find_target(recording, settings.target, settings.square)
    sizes = ({} if recording is None else _sizes_of(recording)) | dict(sizes_wh)
    dataset = read_corners(corners, sizes, target.n_corners, pattern=settings.pattern)
    if not dataset.views:
        raise FileFormatError(f"{corners}: holds no corners; run detect again")
    dataset = _only(dataset, settings.cameras, corners)
    _check_inside(dataset, corners)
    dataset, findings = _usable(_with_open_turns(dataset, target, corners), target)
    detection = Detection(dataset=dataset, rejected=(), findings=tuple(findings))
    return _calibrate(detection, target, settings, recording, progress, measure=False)


def _only(dataset: Dataset, cameras: Sequence[str], corners: Path) -> Dataset:
    missing = [camera for camera in cameras if camera not in dataset.views]
    if missing:
        raise FileFormatError(
            f"{corners}: has no camera {', '.join(missing)}; there are {', '.join(dataset.views)}"
        )
    return dataset.with_views({name: dataset.views[name] for name in cameras or dataset.views})


def _with_open_turns(dataset: Dataset, target: Target, corners: Path) -> Dataset:
    """Leave open which way up a board was that looks the same after half a turn."""
    if len(target.symmetries) == 1 or len(dataset.views) == 1:
        return dataset
    for camera, views in dataset.views.items():
        for frame, view in views.items():
            if len(view.corner_ids) != target.n_corners:
                raise FileFormatError(
                    f"{corners}: camera {camera}, frame {frame} has {len(view.corner_ids)} of "
                    f"{target.n_corners} corners; a board that looks the same after half a turn "
                    f"must be seen whole, so remove this view"
                )
    return dataset.with_views(
        {
            camera: {
                frame: replace(view, half_turn_ambiguous=True) for frame, view in views.items()
            }
            for camera, views in dataset.views.items()
        }
    )


def _usable(dataset: Dataset, target: Target) -> tuple[Dataset, list[Finding]]:
    """Leave out views whose corners fix no pose: fewer than four, or all on one line."""
    kept: dict[str, dict[str, BoardView]] = {camera: {} for camera in dataset.views}
    findings = []
    for camera, views in dataset.views.items():
        for frame, view in views.items():
            points = target.corners_board[view.corner_ids, :2]
            if len(points) >= 4 and np.linalg.matrix_rank(points - points.mean(axis=0)) == 2:
                kept[camera][frame] = view
                continue
            text = (
                f"camera {camera}, frame {frame}: {len(points)} corners, too few or all on one "
                f"line, fix no pose; the view is left out."
            )
            findings.append(finding("no_board_frame", text, camera=camera, frames=[frame]))
    return dataset.with_views(kept), findings


def _check_inside(dataset: Dataset, corners: Path) -> None:
    """Refuse corners outside the picture: of another size, or not in pixels."""
    for camera, views in dataset.views.items():
        size_wh = dataset.sizes_wh[camera]
        for frame, view in views.items():
            # one pixel of grace, for other conventions of where pixel 0 is
            if ((view.corners_px < -1) | (view.corners_px > size_wh)).any():
                raise FileFormatError(
                    f"{corners}: camera {camera}, frame {frame}: a corner lies outside the picture "
                    f"of {size_wh[0]}x{size_wh[1]}; correct it or --size"
                )


def _sizes_of(recording: Recording) -> dict[str, tuple[int, int]]:
    sizes = {}
    for camera in recording.cameras:
        size = recording.read_size(camera)
        if isinstance(size, Unreadable):
            raise RecordingError(f"camera {camera}: none of its pictures can be read")
        sizes[camera] = size
    return sizes


def calibrate_dataset(
    dataset: Dataset, target: Target, settings: CalibrationSettings | None = None
) -> Calibration:
    """Calibrate observations that are already in memory."""
    detection = Detection(dataset=dataset, rejected=(), findings=())
    return _calibrate(detection, target, settings or CalibrationSettings(), None, silent)


def _calibrate(
    detection: Detection,
    target: Target,
    settings: CalibrationSettings,
    recording: Recording | None,
    progress: Progress,
    *,
    measure: bool = True,
) -> Calibration:
    fixed, lenses = {}, {}
    if recording is not None:
        entries = {camera: recording.entry(camera) for camera in recording.cameras}
        fixed = {camera: entry.fixed for camera, entry in entries.items()}
        lenses = {camera: entry.lens for camera, entry in entries.items() if entry.lens}
        if settings.reference_camera is None:
            settings = replace(settings, reference_camera=recording.settings.reference_camera)
    progress("solving the geometry", 0, 2)
    geometry = solve_geometry(detection.dataset, target, settings, fixed=fixed, lenses=lenses)
    solved = geometry.solution
    progress("solving the geometry", 1, 2)
    findings = [*detection.findings, *judge_target(target), *judge_geometry(geometry, target)]
    progress("solving the geometry", 2, 2)

    dataset = solved.dataset
    encodings: dict[str, EncodingName | ToneCurve | None] = dict.fromkeys(dataset.cameras)
    bits: dict[str, int | None] = dict.fromkeys(dataset.cameras)
    if recording is not None and target.markers:
        if measure:
            dataset = _measure_again(recording, solved, target, progress)
        bits |= {camera: recording.entry(camera).bits for camera in dataset.cameras}
        dataset, read_as, tone_findings = _linearise(recording, dataset, target)
        encodings |= read_as
        findings += tone_findings
    colour = solve_colour(dataset, target, solved, encodings, settings.colour_settings())
    findings += colour.findings

    world_from_ref = place_world(
        solved, target.corners_board, frame=settings.world_frame, points=settings.world_points
    )
    rig = assemble_rig(
        solved, target, geometry.held_out, colour.solutions, encodings, bits, colour.vignettings,
        findings, world_from_ref, geometry.halves,
    )  # fmt: skip
    return Calibration(
        rig=rig,
        evidence=gather_evidence(solved, target),
        recording=recording,
        n_pictures=0 if recording is None else recording.n_pictures,
    )


def _measure_again(
    recording: Recording, solved: RigSolution, target: Target, progress: Progress
) -> Dataset:
    """Measure the discs where lens and pose say they are."""
    n_views = sum(len(views) for views in solved.dataset.views.values())
    done = 0
    measured: dict[str, dict[str, BoardView]] = {}
    for camera, views in solved.dataset.views.items():
        measured[camera] = {}
        for frame, view in views.items():
            progress("measuring colours", done, n_views)
            image = recording.read(camera, frame)
            discs = None
            if isinstance(image, Image) and image.is_colour:
                to_pixels = _projection(solved.lenses[camera], solved.cam_from_board(camera, frame))
                discs = measure_discs(image, target, to_pixels, view.corner_ids)
            measured[camera][frame] = replace(view, discs=discs)
            done += 1
    progress("measuring colours", done, n_views)
    return solved.dataset.with_views(measured)


def _encoding_of(recording: Recording, camera: str) -> EncodingName:
    """Return the encoding stated for a camera, or that of its first readable colour picture."""
    stated = recording.entry(camera).encoding
    if stated is not None and stated != "unknown":
        return stated
    images = (recording.read(camera, frame) for frame in recording.files[camera])
    colour = (item for item in images if isinstance(item, Image) and item.is_colour)
    first = next(colour, None)
    return "srgb" if first is None else first.encoding


def _linearise(
    recording: Recording, dataset: Dataset, target: Target
) -> tuple[Dataset, dict[str, EncodingName | ToneCurve], list[Finding]]:
    """Estimate tone curves that are stated as unknown, or assumed and contradicted by greys."""
    views = dict(dataset.views)
    encodings: dict[str, EncodingName | ToneCurve] = {}
    findings: list[Finding] = []
    for camera in dataset.cameras:
        assumed, stated = _encoding_of(recording, camera), recording.entry(camera).encoding
        encodings[camera] = assumed
        samples = collect_samples(views[camera])
        if samples is None:
            continue
        disc_rgb, _, _ = disc_means(samples, len(target.markers))
        if stated == "unknown" or (stated is None and greys_contradict(disc_rgb, target)):
            found = linearise_camera(dataset, camera, assumed, target)
            views[camera], encodings[camera] = found.views, found.encoding
            findings += found.findings
    return dataset.with_views(views), encodings, findings


def _projection(lens: Lens, cam_from_board: Pose) -> BoardToPixels:
    def to_pixels(points_board: FloatArray) -> FloatArray:
        return lens.project(cam_from_board.apply(points_board))

    return to_pixels
