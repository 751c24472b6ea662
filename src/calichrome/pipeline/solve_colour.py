"""From the discs of all views to the colour of all cameras."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from calichrome.colorimetry.description import DescriptionSpace
from calichrome.colorimetry.encoding import EncodingName, ToneCurve
from calichrome.colour.flare import measure_additive
from calichrome.colour.illuminants import leave_out_other_light
from calichrome.colour.rig_fit import ColourSettings, ColourSolution, fit_rig_colour
from calichrome.colour.samples import ColourSamples, collect_samples
from calichrome.colour.shading import Vignetting
from calichrome.colour.shading_fit import VignettingFit, fit_vignetting
from calichrome.core.findings import Finding, finding
from calichrome.errors import RecordingError
from calichrome.geometry.rig_solution import RigSolution
from calichrome.observations import Dataset
from calichrome.pipeline.judge import judge_colour, judge_exposures
from calichrome.target import Target

__all__ = ["ColourChoices", "ColourModelName", "RigColour", "solve_colour"]


ColourModelName = Literal[
    "auto",
    "none",
    "white-balance",
    "linear-white",
    "linear",
    "affine",
    "root-polynomial-2-white",
    "root-polynomial-2",
    "hue-plane",
    "cheung-7",
    "subspaces",
    "hue-plane-2",
    "cheung-10",
    "cheung-11",
    "subspaces-root",
    "root-polynomial-3-white",
    "root-polynomial-3",
    "cheung-20",
    "chromaticity-spline",
    "local-regression",
    "thin-plate",
    "thin-plate-exact",
    "tetrahedral",
]
"""What a user may ask for: the names of `MODELS`, the choice among them, or nothing."""


@dataclass(frozen=True, kw_only=True)  # no slots: beside GeometrySettings it is a second base
class ColourChoices:
    """What a user may say about colour.

    Parameters
    ----------
    colour
        Name of a colour model, "auto" (the smallest leave-one-out error among the stable ones), or
        "none".
    colour_space
        Description space in which colour errors are judged and weighed.
    colour_priority
        Discs that matter more or less, like light_skin=3 or foliage=0.5.
    colour_mean_error
        Minimise the mean colour error instead of the squared one.
    reference_camera_look
        Make all cameras look like this one, instead of like the target.
    """

    colour: ColourModelName = "auto"
    colour_space: DescriptionSpace = "lab2000"
    colour_priority: tuple[str, ...] = ()
    colour_mean_error: bool = False
    reference_camera_look: str | None = None

    def colour_settings(self) -> ColourSettings | None:
        """Return what the fit wants to know, None for no fit.

        Raises
        ------
        RecordingError
            For a priority that cannot be read.
        """
        if self.colour == "none":
            return None
        return ColourSettings(
            model=self.colour,
            space=self.colour_space,
            priorities=dict(_priority(item) for item in self.colour_priority),
            mean_error=self.colour_mean_error,
            look_of=self.reference_camera_look,
        )


def _priority(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        weight = float(value)
    except ValueError:
        weight = -1.0
    if not (name and 0 < weight < float("inf")):
        raise RecordingError(
            f"--colour-priority {text}: give NAME=WEIGHT with a weight above 0, like foliage=2"
        )
    return name, weight


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigColour:
    """The colour of a rig.

    Parameters
    ----------
    solutions, vignettings
        By camera; cameras of which nothing could be told are absent.
    findings
        All of them.
    """

    solutions: Mapping[str, ColourSolution]
    vignettings: Mapping[str, Vignetting]
    findings: tuple[Finding, ...]


def solve_colour(
    dataset: Dataset,
    target: Target,
    solved: RigSolution,
    encodings: Mapping[str, EncodingName | ToneCurve | None],
    settings: ColourSettings | None,
) -> RigColour:
    """Separate light, lens and colour, then fit every camera whose pictures show the discs."""
    if not target.markers or settings is None:
        return RigColour(solutions={}, vignettings={}, findings=())
    if settings.look_of is not None and settings.look_of not in dataset.views:
        raise RecordingError(
            f"--reference-camera-look {settings.look_of}: there is no such camera; there are "
            f"{', '.join(dataset.views)}"
        )
    if unknown := set(settings.priorities) - {marker.name for marker in target.markers}:
        raise RecordingError(
            f"--colour-priority: no disc of the target is called {', '.join(sorted(unknown))}"
        )
    dataset, light_findings = leave_out_other_light(dataset)
    vignettings = _vignettings(dataset, target, solved)
    samples: dict[str, ColourSamples | None] = {
        camera: collect_samples(
            views,
            target,
            vignetting=vignettings.get(camera),
            additive=measure_additive(views, target),
            cam_from_board={frame: solved.cam_from_board(camera, frame) for frame in views},
        )
        for camera, views in dataset.views.items()
    }
    findings = [*light_findings, *judge_exposures(dataset, samples)]
    fitted = fit_rig_colour(
        {camera: item for camera, item in samples.items() if item is not None}, target, settings
    )
    solutions: dict[str, ColourSolution] = {}
    for camera, item in samples.items():
        result = (
            "its pictures are grey, or every white square is clipped"
            if item is None
            else fitted[camera]
        )
        if isinstance(result, str):
            text = f"Camera {camera}: colour was not calibrated, since {result}."
            findings.append(finding("colour_not_calibrated", text, camera=camera))
        else:
            solutions[camera] = result
            findings += judge_colour(camera, result, encodings[camera], target)
    return RigColour(solutions=solutions, vignettings=vignettings, findings=tuple(findings))


def _vignettings(dataset: Dataset, target: Target, solved: RigSolution) -> dict[str, Vignetting]:
    """Fall-off of each lens, where it can be told from the lamps'."""
    centres = {
        camera: lens.parameters[[lens.NAMES.index("cx"), lens.NAMES.index("cy")]]
        for camera, lens in solved.lenses.items()
    }
    fits = fit_vignetting(dataset, target, centres)
    return {
        camera: item.vignetting for camera, item in fits.items() if isinstance(item, VignettingFit)
    }
