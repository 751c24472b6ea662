"""Cameras whose tone curve is unknown: estimate it from their discs and read those again."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from calichrome.colorimetry.encoding import EncodingName, ToneCurve, encode, linearise
from calichrome.colour.light import light_at
from calichrome.colour.linearisation import CurveEstimate, estimate_curve
from calichrome.colour.pairs import print_tolerance
from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.observations import BoardView, Dataset, DiscSamples
from calichrome.target import Target

__all__ = ["LinearisedViews", "linearise_camera", "read_again"]

_SHARE_OF_Y = 0.03
"""Relative change of Y for a unit of L*: 3 / (L* + 16) (from L* = 116 Y^(1/3) - 16) is 2.6 % at
L* = 100, 4.5 % at 50; about what the light half of a card has."""
_STEP = 1e-3  # of full scale, to carry covariances through a curve


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearisedViews:
    """A camera's views in the light that its tone curve says.

    Parameters
    ----------
    views
        By frame.
    encoding
        The known encoding or the curve that was found; what was assumed before if none was.
    findings
        What was found, or why not.
    """

    views: Mapping[str, BoardView]
    encoding: EncodingName | ToneCurve
    findings: tuple[Finding, ...]


def linearise_camera(
    dataset: Dataset, camera: str, assumed: EncodingName, target: Target
) -> LinearisedViews:
    """Estimate the tone curve of one camera and read its discs with it.

    Parameters
    ----------
    dataset
        Discs that were read as `assumed`.
    camera
        Which.
    assumed
        Encoding that was removed.
    target
        Nominal colours.
    """
    views = dataset.views[camera]
    estimate = _estimate(views, assumed, target)
    if isinstance(estimate, str):
        return LinearisedViews(
            views=views, encoding=assumed, findings=(_doubt(camera, assumed, estimate),)
        )
    findings = tuple(_told(camera, estimate))
    return LinearisedViews(
        views={
            frame: replace(view, discs=read_again(view.discs, assumed, estimate.encoding))
            for frame, view in views.items()
        },
        encoding=estimate.encoding,
        findings=findings,
    )


def _estimate(
    views: Mapping[str, BoardView], assumed: EncodingName, target: Target
) -> CurveEstimate | str:
    discs = [view.discs for view in views.values() if view.discs is not None and len(view.discs)]
    if not discs:
        return "no discs were seen in colour"
    sigma = [
        np.sqrt(np.diagonal(item.cov_rgb, axis1=1, axis2=2) / np.maximum(item.n_px, 1)[:, None])
        for item in discs
    ]
    mean = np.concatenate([item.mean_rgb for item in discs])
    clipped = np.concatenate([item.clipped for item in discs]) > 0
    white = np.concatenate([light_at(item.centres_px, item.white_rgb) for item in discs])
    paper = target.paper.white_xyz_d65
    return estimate_curve(
        np.where(clipped[:, None], np.nan, encode(mean, assumed)),
        encode(white, assumed),
        np.concatenate([item.marker_ids for item in discs]),
        target.marker_xyz_d65,
        None if paper is None else np.asarray(paper),
        stored_sigma=np.concatenate(sigma) * _slope_of_encoding(mean, assumed),
        nominal_sigma=_SHARE_OF_Y * print_tolerance(target),
    )


def _slope_of_encoding(linear: FloatArray, encoding: EncodingName) -> FloatArray:
    low = np.maximum(linear - _STEP, 0.0)
    return np.asarray(
        (encode(linear + _STEP, encoding) - encode(low, encoding)) / (linear + _STEP - low)
    )


def read_again(
    discs: DiscSamples | None, assumed: EncodingName, encoding: EncodingName | ToneCurve
) -> DiscSamples | None:
    """Return the discs as another encoding reads what was read as `assumed`."""
    if discs is None or encoding == assumed:
        return discs

    def again(linear: FloatArray) -> FloatArray:
        return linearise(encode(linear, assumed), encoding)

    slope = (again(discs.mean_rgb + _STEP) - again(discs.mean_rgb)) / _STEP
    return replace(
        discs,
        mean_rgb=again(discs.mean_rgb),
        median_rgb=again(discs.median_rgb),
        cov_rgb=discs.cov_rgb * slope[:, :, None] * slope[:, None, :],
        white_rgb=again(discs.white_rgb),
        black_rgb=again(discs.black_rgb),
    )


def _told(camera: str, estimate: CurveEstimate) -> Iterator[Finding]:
    what = (
        "a curve of its own"
        if isinstance(estimate.encoding, ToneCurve)
        else f"{estimate.encoding}, which explains its pictures as well as any curve"
    )
    yield finding(
        "encoding_estimated",
        f"Camera {camera}: its tone curve was estimated from the discs: {what}. State the encoding "
        f"in recording.toml if you know it.",
        camera=camera,
    )
    if estimate.doubts is not None:
        yield finding(
            "encoding_doubtful",
            f"Camera {camera}: {estimate.doubts}. Turn off contrast, saturation and sharpening of "
            f"the camera, or record raw pictures.",
            camera=camera,
        )


def _doubt(camera: str, assumed: EncodingName, why: str) -> Finding:
    return finding(
        "encoding_doubtful",
        f"Camera {camera}: its tone curve could not be estimated, since {why}; it was read as "
        f"{assumed}. State the encoding in recording.toml if you can find out.",
        camera=camera,
    )
