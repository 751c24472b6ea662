"""Findings on lenses, cameras and boards: what the numbers of a solution say to their user."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.geometry.agreement import LoneView, lone_views
from calichrome.geometry.residual_structure import (
    board_share,
    covered_share,
    covers,
    distinct_poses,
    normals_spread_rad,
    radial_share,
    smooth_share,
    systematic_share,
)
from calichrome.geometry.rig_solution import RigSolution, rms_px
from calichrome.pipeline.judge_agreement import judge_agreement
from calichrome.pipeline.solve_geometry import SolvedGeometry
from calichrome.target import Target

__all__ = ["focal_sigma", "judge_geometry"]

_FEWEST_VIEWS = 3  # two fix a lens only as far as one of its assumptions holds (Zhang, 2000)
_FEW_VIEWS = 10  # Kapusi et al., 2010: at least ten views
_SMALL_BOARD = 56  # ... of 7x8 corners
_WEAK_FOCAL = 0.02
"""Relative sigma of a focal length from which lengths are uncertain by 4 % (95 %): no rig can use
that, while ten tilted views give 0.1 %."""
_POOR_FIT = 1e-3
"""Error over picture width from which a lens does not explain its views: at common focal lengths a
ray is then off by 1 mrad, 1 mm at 1 m. The real recordings of the tests are at 1e-4 to 3e-4."""
_OUTLYING = 4.0
"""Error of a view over the median view of its camera, where it also exceeds `_POOR_FIT`. The worst
views of the real recordings of the tests are at 1.6."""
_FROM_MEDIAN = math.sqrt(1 / math.log(2))  # root mean square of a Rayleigh variable over its median
_SAME_ANGLE_RAD, _SAME_SHARE = math.radians(3), 0.03
"""Views nearer than both are one view taken twice; a choice, several times what hands that try to
hold still do."""
_COVERED = 0.2
"""Of the picture, by the hull of all corners. The real recordings of the tests cover 0.29 to 0.75
with each camera."""
_PARALLEL_RAD = math.radians(5)
"""Boards whose normals all lie this near to their mean are parallel as far as hands can hold them.
Whatever sigma such views state rests on the lens model's being exact, since each view repeats the
same two equations on the focal lengths (Zhang, 2000, section 3.2). A choice."""
_RINGS, _CELLS = 0.1, 0.25
"""Share of the residuals' variance that is a pattern in rings, or over the picture. The real
recordings of the tests are below 0.02 and 0.17, a fisheye of 110 degrees under brown-conrady
(synthetic, noise 0.2 px) is at 0.2 to 0.3 in rings."""
_PATTERN = 1e-4
"""Such a pattern over the picture's width, root mean square, from which it matters: a tenth of a
poor fit, since it grows where no corner was. A choice; the real recordings of the tests are below
0.6e-4."""
_SMOOTH, _ON_BOARD = 0.5, 0.3
"""Of a poor fit: how alike neighbours miss, and how much of it sits on the board, for the lens to
be named as the reason; choices."""
_HALVES_DIFFER = 2.0
"""Difference of two halves over what their covariances predict: a stated ± that is half of the true
one misleads; a choice. 32 simulated halves of 20 frames were at 0.3 to 1.7."""
_BY_CHANCE = 1e-3  # ... and how rarely true covariances may let halves be so far apart; a choice
_MANY_FALSE = 0.05  # of a camera's corners: a twentieth; a choice


_BOW_IS_SEEN = 5.0  # sigmas of its least certain term; a choice


def judge_geometry(geometry: SolvedGeometry, target: Target) -> Iterator[Finding]:
    """Yield doubts about lenses, cameras and boards."""
    rig = geometry.solution
    if not rig.converged:
        yield finding(
            "not_converged",
            "The solve gave up before it reached a minimum. Look at the pictures with `detect "
            "--overlay`, and give a lens near the true one, or fixed values, in recording.toml.",
        )
    lone = lone_views(rig, target.corners_board)
    for camera in rig.lenses:
        yield from _judge_views(camera, rig, target)
        yield from _judge_residuals(camera, rig, lone, target)
        yield from _judge_places(camera, rig)
    yield from judge_agreement(rig, lone, target.corners_board.mean(axis=0))
    yield from _judge_shape(geometry, target)
    yield from _judge_halves(geometry)


def focal_sigma(rig: RigSolution, camera: str) -> float | None:
    """Return the standard deviation of fx, pixels; None if the views leave it open."""
    cov = rig.lens_cov[camera]
    return None if cov is None else float(np.sqrt(cov[0, 0]))


def _judge_views(camera: str, rig: RigSolution, target: Target) -> Iterator[Finding]:
    """Ask whether there is enough, and different enough."""
    n_views = len(rig.dataset.views[camera])
    sigma = focal_sigma(rig, camera)
    costs = "unknown" if sigma is None else f"{sigma:.2g} px"
    if n_views < _FEW_VIEWS:
        expected = ""
        if sigma is not None:
            expected = f" (about {sigma * math.sqrt(n_views / 15):.2g} px with 15 views)"
        yield finding(
            "few_views" if n_views >= _FEWEST_VIEWS else "too_few_views",
            f"Camera {camera}: {n_views} views of the board; its focal length is known to "
            f"± {costs}{expected}. Record 15 to 25.",
            camera=camera, n_views=n_views, sigma_fx_px=sigma,
        )  # fmt: skip
    if target.n_corners < _SMALL_BOARD:
        expected = ""
        if sigma is not None:
            expected = f" (about {sigma * math.sqrt(target.n_corners / 88):.2g} px with 11x8)"
        yield finding(
            "small_board",
            f"Camera {camera}: the board has {target.n_corners} inner corners; the focal "
            f"length is known to ± {costs}{expected}.",
            camera=camera, n_corners=target.n_corners, sigma_fx_px=sigma,
        )  # fmt: skip
    open_names = rig.open_directions.get(camera, ())
    weak = sigma is None or sigma > _WEAK_FOCAL * rig.lenses[camera].fx or bool(open_names)
    if weak:
        which = f" Open: {', '.join(open_names[:6])}." if open_names else ""
        yield finding(
            "weak_geometry",
            f"Camera {camera}: the views do not determine everything (focal length ± {costs})."
            f"{which} Tilt the board by 30 to 45 degrees both ways and vary its distance.",
            camera=camera, sigma_fx_px=sigma, open=list(open_names),
        )  # fmt: skip
    places = [rig.cam_from_board(camera, frame) for frame in rig.dataset.views[camera]]
    if n_views > 1 and normals_spread_rad(places) < _PARALLEL_RAD and not weak:
        yield finding(
            "weak_geometry",
            f"Camera {camera}: all boards are parallel, to "
            f"{math.degrees(normals_spread_rad(places)):.2g} degrees: focal length and distance "
            f"cannot be told apart. Tilt the board by 30 to 45 degrees both ways.",
            camera=camera, sigma_fx_px=sigma, open=["fx", "fy", "distance"],
        )  # fmt: skip
    n_distinct = distinct_poses(places, angle_rad=_SAME_ANGLE_RAD, distance_share=_SAME_SHARE)
    if n_distinct < min(_FEWEST_VIEWS, n_views):
        yield finding(
            "repeated_views",
            f"Camera {camera}: {n_views} views show the board in {n_distinct} different places "
            f"only. Move and tilt it between the shots.",
            camera=camera, n_views=n_views, n_distinct=n_distinct,
        )  # fmt: skip
    size_wh = rig.dataset.sizes_wh[camera]
    pixels = np.concatenate(
        [
            view.corners_px[rig.inliers[camera, frame]]
            for frame, view in rig.dataset.views[camera].items()
        ]
    )
    share = covered_share(pixels, size_wh)
    middle = (np.array(size_wh) - 1) / 2
    if share < _COVERED or not covers(pixels, middle):
        yield finding(
            "poor_coverage",
            f"Camera {camera}: the corners span {share:.0%} of the picture"
            + ("" if covers(pixels, middle) else ", without its middle")
            + "; elsewhere the lens is a guess. Show the board in every part of the picture.",
            camera=camera, share=share,
        )  # fmt: skip
    held = rig.held.get(camera, ())
    if held:
        yield finding(
            "terms_held",
            f"Camera {camera}: {', '.join(held)} kept 0, since the views do not show them. Bring "
            f"the board to the borders of the picture, tilted.",
            camera=camera, names=list(held),
        )  # fmt: skip


def _judge_residuals(
    camera: str, rig: RigSolution, lone: Mapping[tuple[str, str], LoneView], target: Target
) -> Iterator[Finding]:
    """Ask whether the lens explains its views, each placed by itself."""
    width = rig.dataset.sizes_wh[camera][0]
    limit_px = _POOR_FIT * width
    frames = list(rig.dataset.views[camera])
    views = [lone[camera, frame] for frame in frames]
    by_view = np.array([_typical_px(view.residuals_px) for view in views])
    median_px = float(np.median(by_view))
    off = by_view > max(limit_px, _OUTLYING * median_px)
    names = [frame for frame, is_off in zip(frames, off, strict=True) if is_off]
    if names:
        yield finding(
            "views_disagree",
            f"Camera {camera}: frames {', '.join(names[:5])} miss by {by_view[off].max():.1f} px, "
            f"the others by {median_px:.2f} px. The board moved, bent or was numbered "
            f"wrongly there; look at them with `detect --overlay` and leave them out.",
            camera=camera, frames=names,
        )  # fmt: skip
    ids = [
        rig.dataset.views[camera][frame].corner_ids[view.inliers]
        for frame, view in zip(frames, views, strict=True)
    ]
    residuals = [view.residuals_px[view.inliers] for view in views]
    pixels = np.concatenate(
        [
            rig.dataset.views[camera][frame].corners_px[view.inliers]
            for frame, view in zip(frames, views, strict=True)
        ]
    )
    misses = np.concatenate(residuals)
    rings = radial_share(pixels, misses, rig.lenses[camera].parameters[2:4])
    cells = systematic_share(pixels, misses, rig.dataset.sizes_wh[camera])
    pattern_px = rms_px(misses) * math.sqrt(max(rings, cells))
    smooth = smooth_share(ids, residuals, target.corners_xy[0])
    is_poor = median_px > limit_px
    if (pattern_px > _PATTERN * width and (rings > _RINGS or cells > _CELLS)) or (
        is_poor and smooth > _SMOOTH and board_share(ids, residuals) < _ON_BOARD
    ):
        yield finding(
            "lens_misfit",
            f"Camera {camera}: its views are missed by {rms_px(misses):.2g} px in a pattern, not "
            f"at random: a {rig.lenses[camera].MODEL} lens does not bend as this one does. Try "
            f"--lens auto; if values are fixed in recording.toml, check them and the picture size.",
            camera=camera, rms_px=rms_px(misses), rings=rings, cells=cells, smooth=smooth,
        )  # fmt: skip
    elif is_poor:
        yield finding(
            "poor_fit",
            f"Camera {camera}: the views are explained only to {median_px:.2f} px. The "
            f"board may be bent, the target described wrongly, or the lens beyond "
            f"{rig.lenses[camera].MODEL}.",
            camera=camera, rms_px=median_px,
        )  # fmt: skip
    inliers = np.concatenate([rig.inliers[camera, frame] for frame in frames])
    n_false = int((~inliers).sum())
    if n_false:
        grave = n_false > _MANY_FALSE * len(inliers)
        yield finding(
            "outliers_left_out",
            f"Camera {camera}: {n_false} of {len(inliers)} corners lie further off than noise "
            f"explains and were left out"
            + (". That is many: look at the pictures with `detect --overlay`." if grave else "."),
            camera=camera, n_left_out=n_false, n_corners=len(inliers),
        )  # fmt: skip


def _typical_px(residuals_px: FloatArray) -> float:
    """Typical error of a view as a root mean square without its false corners."""
    return float(np.median(np.linalg.norm(residuals_px, axis=1))) * _FROM_MEDIAN


def _judge_places(camera: str, rig: RigSolution) -> Iterator[Finding]:
    """Ask whether the board is where a board can be."""
    behind = []
    for frame in rig.dataset.views[camera]:
        place = rig.cam_from_board(camera, frame)
        if float(place.rotation[:, 2] @ place.trans_m) < 0:  # its z points away from the viewer
            behind.append(frame)
    if behind:
        yield finding(
            "mirrored_views",
            f"Camera {camera}: frames {', '.join(behind[:5])} show the board from behind: its "
            f"corners are counted in a mirror. Do not mirror pictures; check the target.",
            camera=camera, frames=behind,
        )  # fmt: skip


def _judge_shape(geometry: SolvedGeometry, target: Target) -> Iterator[Finding]:
    """Ask whether the board is flat, and if not, whether that was allowed for."""
    rig = geometry.solution
    if rig.shape_held:
        yield finding(
            "board_taken_as_flat",
            "The views do not show whether the board is bowed; it was taken as flat. Record more "
            "views, tilted both ways.",
        )
    if geometry.bow is not None and geometry.bow.matters:
        yield finding(
            "bent_board",
            f"The board is bowed by about {geometry.bow.sagitta_m * 1e3:.2g} mm, which moves "
            f"projections by {geometry.bow.shift_sigmas:.1f} times their sigma. Leave out "
            f"--no-warp, or print on a flat plate.",
            sagitta_m=geometry.bow.sagitta_m, shift_sigmas=geometry.bow.shift_sigmas,
        )  # fmt: skip
    bow = rig.bow_m(target.corners_board)
    if bow is not None and bow[0] > _BOW_IS_SEEN * bow[1]:
        yield finding(
            "bowed_board",
            f"The board is bowed by {bow[0] * 1e3:.2g} mm (± {bow[1] * 1e3:.1g}); that was allowed "
            f"for.",
            sagitta_m=bow[0],
        )


def _judge_halves(geometry: SolvedGeometry) -> Iterator[Finding]:
    """Ask whether the stated uncertainties are true."""
    if geometry.halves is None:
        return
    for camera, found in geometry.halves.lenses.items():
        ratio, chance = found.ratio, found.chance
        if ratio is None or chance is None:
            continue
        if ratio > _HALVES_DIFFER and chance < _BY_CHANCE:
            yield finding(
                "halves_disagree",
                f"Camera {camera}: two halves of the frames, solved apart, project "
                f"{found.rms_px:.2g} px apart; their covariances say {found.sigma_px:.2g} px: "
                f"its stated ± are too small by about {ratio:.1f}. The lens may need another "
                f"model, or the board bent or moved between the frames.",
                camera=camera, ratio=ratio, rms_px=found.rms_px,
            )  # fmt: skip
