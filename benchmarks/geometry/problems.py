"""Random problems for a blind start: any focal length, few views or many, things gone wrong."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.geometry.rigs import (
    Recording,
    Scene,
    bare_scene,
    observed,
)
from benchmarks.geometry.scenes import (
    board_turn,
    hold,
    in_reference,
    looking,
    placed,
)

from calichrome.core.arrays import IntArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import BoardView
from calichrome.target.board import chessboard

__all__ = ["COUNTS", "Mishap", "Problem", "counted", "random_problem"]

SIZES_WH = ((1280, 960), (1920, 1080), (640, 480))
BOARDS = ((11, 8), (9, 6), (8, 6), (7, 5))
FOCAL_RANGE = (0.4, 2.5)  # of the naive guess, the picture's width
VIEWS = (3, 30)
GROSS_SHARE = 0.02
FEW = 8  # with fewer frames nothing else is wrong
MIN_VIEWS = 3  # of each camera
_SHARES_ALONE = {"turned": 0.7, "mirrored": 0.3}
_SHARES_OF_RIGS = {"turned": 0.4, "swapped": 0.4, "mirrored": 0.2}


COUNTS: Mapping[str, tuple[int, int]] = {
    "straight": (1, 1),
    "turned": (-1, -1),
    "mirrored": (-1, 1),
    "turned and mirrored": (1, -1),
}
"""Ways to count the corners of a board: along x and y, 1 forwards, -1 backwards."""


def counted(corners_xy: tuple[int, int], count: str) -> IntArray:
    """Return which corner has each id, (n_corners,), if corners are counted another way."""
    nx, ny = corners_xy
    along_x, along_y = COUNTS[count]
    return np.arange(nx * ny).reshape(ny, nx)[::along_y, ::along_x].ravel()


@dataclass(frozen=True, slots=True)
class Mishap:
    """What was done to a camera's frames.

    Parameters
    ----------
    kind
        "turned": corner ids half a turn wrong; "mirrored": ids counted from the other side;
        "swapped": the names of two frames exchanged.
    """

    kind: str
    camera: str
    frames: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A recording with mishaps, and the truth.

    Parameters
    ----------
    recording
        What the solver gets.
    pristine
        The same corners under their right names.
    origin
        (camera, frame) as the solver knows it -> the frame in which it was really taken.
    """

    seed: int
    scene: Scene
    recording: Recording
    pristine: Recording
    mishaps: tuple[Mishap, ...]
    origin: Mapping[tuple[str, str], str]

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.scene.ref_from_boards)


def random_problem(seed: int) -> Problem:
    """Draw a problem: 40 % one camera, 30 % two, 30 % three or four."""
    rng = np.random.default_rng([seed, 5])
    n_cameras = int(rng.choice([1, 2, 3, 4], p=[0.4, 0.3, 0.15, 0.15]))
    scene = _scene(rng, n_cameras)
    pristine = observed(scene, [seed], gross_share=GROSS_SHARE)
    mishaps = _mishaps(rng, scene) if len(scene.ref_from_boards) >= FEW else ()
    recording, origin = _befallen(pristine, scene, mishaps)
    return Problem(seed, scene, recording, pristine, mishaps, origin)


def _scene(rng: np.random.Generator, n_cameras: int) -> Scene:
    """Cameras side by side on an arc around the boards, as far away as their focal length asks."""
    corners_xy = BOARDS[rng.integers(len(BOARDS))]
    target = chessboard(corners_xy, (0.025, 0.025))
    size_wh = SIZES_WH[rng.integers(len(SIZES_WH))]
    factor = float(np.exp(rng.uniform(*np.log(FOCAL_RANGE))))
    width_m = float(np.ptp(target.corners_board[:, 0]))
    distance_m = factor * width_m / rng.uniform(0.3, 0.5)  # the board fills 30-50 % of the width
    reach_m = distance_m / factor / 2  # half the width of what a camera sees there
    step = np.radians(rng.uniform(8, min(25, 50 / max(n_cameras - 1, 1))))
    cams_from_world = {}
    for index in range(n_cameras):
        azimuth = step * (index - (n_cameras - 1) / 2)
        height = rng.uniform(-0.15, 0.15)
        direction = np.array([np.sin(azimuth), height, -np.cos(azimuth)])
        position = distance_m * direction
        aside = rng.uniform(-0.2, 0.2, 3) * reach_m * [1, 1, 0]
        cams_from_world[f"cam{index}"] = looking(position, aside)
    cams_from_ref, ref_from_world = in_reference(cams_from_world)
    lenses = {camera: _lens(rng, factor, size_wh) for camera in cams_from_ref}
    bare = bare_scene(cams_from_ref, lenses, target, size_wh)
    names = list(cams_from_ref)

    def propose(index: int) -> tuple[Pose, Sequence[str]]:
        facing = board_turn(rng, np.radians(40), np.radians(30))
        place = rng.uniform(-1, 1, 3) * [reach_m, 0.75 * reach_m, 0.3 * distance_m]
        pose = placed(ref_from_world, facing, place, target)
        # the first frames are seen by all, later ones by two or more if there are as many
        if index < MIN_VIEWS or n_cameras == 1:
            return pose, names
        count = int(rng.integers(min(2, n_cameras), n_cameras + 1))
        return pose, sorted(map(str, rng.choice(names, count, replace=False)))

    n_frames = int(rng.integers(VIEWS[0], VIEWS[1] + 1))
    return hold(bare, propose, n_frames, candidates=3)


def _lens(rng: np.random.Generator, factor: float, size_wh: tuple[int, int]) -> BrownConrady:
    """Draw a lens whose distortion at the picture's corner is the same for every focal length."""
    width, height = size_wh
    focal = factor * width * rng.uniform(0.95, 1.05)
    focal = float(np.clip(focal, FOCAL_RANGE[0] * width, FOCAL_RANGE[1] * width))
    corner2 = (width**2 + height**2) / 4 / focal**2  # squared radius of the picture's corner
    cx, cy = (np.array(size_wh) - 1) / 2 + rng.uniform(-0.02, 0.02, 2) * width
    return BrownConrady(
        fx=focal,
        fy=focal * rng.uniform(0.997, 1.003),
        cx=cx,
        cy=cy,
        k1=rng.uniform(-0.2, 0.08) / corner2,
        k2=rng.uniform(-0.03, 0.08) / corner2**2,
        k3=rng.uniform(-0.01, 0.01) / corner2**3,
        p1=rng.uniform(-1e-3, 1e-3),
        p2=rng.uniform(-1e-3, 1e-3),
    )


def _mishaps(rng: np.random.Generator, scene: Scene) -> tuple[Mishap, ...]:
    """Draw one or two, never of more than a quarter of a camera's views."""
    found: list[Mishap] = []
    used: set[tuple[str, str]] = set()
    shares = _SHARES_ALONE if len(scene.lenses) == 1 else _SHARES_OF_RIGS
    for _ in range(int(rng.integers(1, 3))):
        kind = str(rng.choice(list(shares), p=list(shares.values())))
        camera = str(rng.choice(list(scene.seen)))
        n_used = sum(known == camera for known, _ in used)
        n_allowed = max(len(scene.seen[camera]) // 4, 1) - n_used
        if n_allowed < 2 and kind == "swapped":
            kind = "turned"
        if n_allowed < 1:
            continue
        free = [frame for frame in scene.seen[camera] if (camera, frame) not in used]
        chosen = rng.choice(free, 2 if kind == "swapped" else 1, replace=False)
        frames = tuple(sorted(map(str, chosen)))
        found.append(Mishap(kind, camera, frames))
        used |= {(camera, frame) for frame in frames}
    return tuple(found)


def _befallen(
    pristine: Recording, scene: Scene, mishaps: Sequence[Mishap]
) -> tuple[Recording, dict[tuple[str, str], str]]:
    views = {camera: dict(seen) for camera, seen in pristine.dataset.views.items()}
    gross = dict(pristine.gross)
    origin = {(camera, frame): frame for camera, seen in views.items() for frame in seen}
    for mishap in mishaps:
        camera = mishap.camera
        if mishap.kind == "swapped":
            one, two = mishap.frames
            seen = views[camera]
            seen[one], seen[two] = seen[two], seen[one]
            gross[camera, one], gross[camera, two] = gross[camera, two], gross[camera, one]
            origin[camera, one], origin[camera, two] = origin[camera, two], origin[camera, one]
            continue
        for frame in mishap.frames:
            view, order = views[camera][frame], counted(scene.target.corners_xy, mishap.kind)
            views[camera][frame] = replace(view, corners_px=view.corners_px[order])
            gross[camera, frame] = gross[camera, frame][order]
    if len(scene.target.symmetries) > 1:
        views = {
            camera: {frame: _ambiguous(view) for frame, view in seen.items()}
            for camera, seen in views.items()
        }
    return Recording(pristine.dataset.with_views(views), gross), origin


def _ambiguous(view: BoardView) -> BoardView:
    return replace(view, half_turn_ambiguous=True)
