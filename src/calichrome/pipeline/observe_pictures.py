"""A second look at the pictures, once the tracks are known: classes, and videos with the tracks."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from runpy import run_path

import numpy as np

from calichrome.colorimetry.difference import xyz_from_lab
from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.files import writing_file, writing_folder
from calichrome.errors import CalichromeError, OutputError
from calichrome.imaging import StreamFormat, Unreadable, VideoSettings, VideoWriter
from calichrome.pipeline.detect import Progress, silent
from calichrome.pipeline.observe import Observation, Row
from calichrome.pipeline.watch import Viewer
from calichrome.report.figures import tracks_figure
from calichrome.tracking import Mark, draw_marks

__all__ = ["Classifier", "check_plot", "classify", "load_classifier", "write_overlay", "write_plot"]

Classifier = Callable[[UInt8Array, FloatArray, FloatArray], str]
"""(crop (h, w, 3) sRGB, Lab (3,), size (3,) metres) -> label."""

_LOOKS = 5  # at each object, the largest there are; the commonest label wins
_TAIL = 30  # instants
_TICKS = 90_000  # per second, the clock of MPEG


def load_classifier(text: str) -> Classifier:
    """Import what ``module:function`` or ``FILE.py:function`` names.

    Raises
    ------
    CalichromeError
        If there is no such function.
    """
    place, colon, name = text.rpartition(":")
    if not (colon and place and name.isidentifier()):
        raise CalichromeError(f"--classify {text}: write module:function or FILE.py:function")
    try:
        variables = run_path(place) if place.endswith(".py") else vars(import_module(place))
        function: Classifier = variables[name]
    except Exception as error:  # a file of the user's may fail in any way
        raise CalichromeError(
            f"--classify {text}: cannot be imported ({type(error).__name__}: {error}); give a "
            f"function of three arguments (crop, Lab, size) that returns a label"
        ) from error
    if not callable(function):
        raise CalichromeError(f"--classify {text}: {name} is no function of (crop, Lab, size)")
    return function


def classify(
    observation: Observation, rows: Sequence[Row], classifier: Classifier
) -> dict[int, str]:
    """Return a label for each track, the commonest of a few looks at it.

    Parameters
    ----------
    observation, rows
        What was seen.
    classifier
        Called with a crop of the corrected picture, Lab and the sides of the object.

    Raises
    ------
    CalichromeError
        If the classifier fails.
    """
    watch = observation.watch
    viewers = {camera: watch.viewer(camera) for camera in watch.cameras}
    labels: dict[int, str] = {}
    for track in dict.fromkeys(row.track for row in rows):
        looks = [
            (seen.half_angle_rad, row, camera)
            for row in rows
            if row.track == track
            for camera, seen in row.sightings.items()
            if seen.used
        ]
        looks.sort(key=lambda look: -look[0])
        # of instants that lie apart, so that one bad moment does not decide
        chosen = looks[:: max(1, len(looks) // (2 * _LOOKS))][:_LOOKS]
        found = [_label(viewers[camera], row, camera, classifier) for _, row, camera in chosen]
        known = [label for label in found if label is not None]
        if known:
            labels[track] = Counter(known).most_common(1)[0][0]
    return labels


def _label(viewer: Viewer, row: Row, camera: str, classifier: Classifier) -> str | None:
    picture = viewer(row.frame)
    if isinstance(picture, Unreadable):
        return None
    left, top, right, bottom = row.sightings[camera].box
    try:
        return str(classifier(picture[top:bottom, left:right], row.lab_d65, row.extent_m))
    except Exception as error:
        raise CalichromeError(
            f"--classify: the function failed on track {row.track} in {camera}/{row.frame} "
            f"({type(error).__name__}: {error}); correct it"
        ) from error


def write_overlay(
    observation: Observation,
    rows: Sequence[Row],
    classes: Mapping[int, str],
    folder: Path,
    *,
    force: bool,
    progress: Progress = silent,
) -> None:
    """Write ``folder/<camera>.mp4``: the corrected pictures with boxes, numbers and tails.

    Raises
    ------
    RecordingError
        If PyAV is not installed.
    OutputError
        If the folder cannot be written.
    """
    watch = observation.watch
    times = np.array(list(watch.times_s.values()))
    times = times - times[0]
    usual_s = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    form = StreamFormat(
        time_base=Fraction(1, _TICKS), rate=Fraction(1 / usual_s).limit_denominator(1001)
    )
    with writing_folder(folder, force=force) as temporary:
        for number, camera in enumerate(watch.cameras):
            writer = VideoWriter(
                temporary / f"{camera}.mp4",
                watch.rig.cameras[camera].size_wh,
                form,
                VideoSettings(),
            )
            try:
                for done, (stamp, picture) in enumerate(_drawn(observation, rows, classes, camera)):
                    at = round(times[stamp] * _TICKS)
                    writer.write(writer.frame(picture, at))
                    progress(
                        "drawing", number * len(times) + done + 1, len(watch.cameras) * len(times)
                    )
            finally:
                writer.close()


def _drawn(
    observation: Observation, rows: Sequence[Row], classes: Mapping[int, str], camera: str
) -> Iterator[tuple[int, UInt8Array]]:
    """Yield index and marked picture of every instant of a camera."""
    watch = observation.watch
    ref_from_world = watch.rig.world_from_ref.inverse()
    viewer = watch.viewer(camera)
    by_frame: dict[str, list[Row]] = {}
    for row in rows:
        by_frame.setdefault(row.frame, []).append(row)
    tails: dict[int, list[FloatArray]] = {}
    for index, frame in enumerate(watch.times_s):
        for row in by_frame.get(frame, ()):
            tails.setdefault(row.track, []).append(row.position_m)
        picture = viewer(frame)
        if isinstance(picture, Unreadable):
            continue
        marks = []
        for row in by_frame.get(frame, ()):
            seen = row.sightings.get(camera)
            tail = ref_from_world.apply(np.array(tails[row.track][-_TAIL:]))
            label = classes.get(row.track)
            marks.append(
                Mark(
                    track=row.track,
                    caption=f"{row.track} {label}" if label else str(row.track),
                    box=None if seen is None else seen.box,
                    tail_px=watch.rig.cameras[camera].project(tail),
                    used=seen is not None and seen.used,
                )
            )
        yield index, draw_marks(picture, marks)


def check_plot(path: Path) -> None:
    """Raise now if `write_plot` could not draw later, after long work.

    Raises
    ------
    CalichromeError
        If matplotlib is not installed, or draws no such file.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise CalichromeError(
            'figures need matplotlib; add it with pip install "calichrome[report]", or leave out '
            "--plot"
        ) from error
    known = sorted(Figure().canvas.get_supported_filetypes())
    if path.suffix.lower().removeprefix(".") not in known:
        raise OutputError(f"{path}: --plot draws .png, .pdf or .svg; choose one of these")


def write_plot(observation: Observation, rows: Sequence[Row], path: Path, *, force: bool) -> None:
    """Draw the tracks in space.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    rig = observation.watch.rig
    paths: dict[int, list[FloatArray]] = {}
    labs: dict[int, list[FloatArray]] = {}
    for row in rows:
        paths.setdefault(row.track, []).append(row.position_m)
        labs.setdefault(row.track, []).append(row.lab_d65)
    colours = {}
    for track, own in labs.items():
        known = np.array([lab for lab in own if np.isfinite(lab).all()]).reshape(-1, 3)
        xyz = xyz_from_lab(np.median(known, axis=0)) if len(known) else np.full(3, 0.2)
        colours[track] = encode(np.clip(xyz @ RGB_FROM_XYZ["srgb"].T, 0, 1), "srgb")
    centres = {
        camera: rig.world_from_ref.apply(rig.cameras[camera].cam_from_ref.inverse().trans_m)
        for camera in observation.watch.cameras
    }
    points = {track: np.array(own) for track, own in paths.items()}
    figure = tracks_figure(points, colours, centres)
    with writing_file(path, force=force) as temporary:
        figure.savefig(temporary, dpi=150)
