"""What a watched workspace is made of: balls, their paths, and boxes that hide them.

World frame, lights and cameras are those of `calichrome.synthetic.scene`; y points down.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, checked, frozen
from calichrome.core.pose import Pose
from calichrome.synthetic.scene import Panel, Scene

__all__ = ["Ball", "Box", "HarmonicPath", "Workspace"]

# Directions of a box's own axes out of its faces; it stands on the face that is left out.
_SIDES = ((1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HarmonicPath:
    """A smooth path: each coordinate swings about its centre.

    Equal rates draw circles and ellipses, others Lissajous figures, arcs and crossings.

    Parameters
    ----------
    centre_world, amplitude_m : (3,) float, metres
    rate_rad_s, phase_rad : (3,) float
        Angular frequency, radians per second, and phase at time 0, radians.
    """

    centre_world: FloatArray
    amplitude_m: FloatArray
    rate_rad_s: FloatArray
    phase_rad: FloatArray

    def __post_init__(self) -> None:
        for name in ("centre_world", "amplitude_m", "rate_rad_s", "phase_rad"):
            object.__setattr__(self, name, frozen(checked(getattr(self, name), (3,), name)))

    def positions_world(self, times_s: FloatArray) -> FloatArray:
        """Positions (n, 3) at times (n,), metres."""
        angle = times_s[:, None] * self.rate_rad_s + self.phase_rad
        return np.asarray(self.centre_world + self.amplitude_m * np.sin(angle))

    def velocities_world(self, times_s: FloatArray) -> FloatArray:
        """Velocities (n, 3) at times (n,), metres per second."""
        angle = times_s[:, None] * self.rate_rad_s + self.phase_rad
        return np.asarray(self.amplitude_m * self.rate_rad_s * np.cos(angle))

    @property
    def rms_speed_m_s(self) -> float:
        """Root mean square of the speed over a long time, metres per second."""
        return float(np.sqrt(((self.amplitude_m * self.rate_rad_s) ** 2).sum() / 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ball:
    """A matt ball.

    Parameters
    ----------
    name
        What its surface is.
    radius_m
        Metres.
    reflectance : (81,) float, 0..1
    path
        Of its centre.
    """

    name: str
    radius_m: float
    reflectance: FloatArray
    path: HarmonicPath

    def __post_init__(self) -> None:
        object.__setattr__(self, "reflectance", frozen(checked(self.reflectance, (81,), "ball")))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """A box that stands in the workspace, hides what is behind it and casts a shadow.

    Parameters
    ----------
    world_from_box
        Its centre and directions; y points down, to the face it stands on.
    half_size_m : (3,) float
        Half of its edges along its own axes, metres.
    reflectance : (81,) float, 0..1
    """

    world_from_box: Pose
    half_size_m: tuple[float, float, float]
    reflectance: FloatArray

    @property
    def panels(self) -> tuple[Panel, ...]:
        """Its four sides and its top."""
        half = np.array(self.half_size_m)
        faces = []
        for side in _SIDES:
            outward = np.array(side, dtype=np.float64)
            z = -outward
            x = np.array([1.0, 0, 0]) if side[1] else np.cross([0.0, 1.0, 0.0], z)
            turn = np.column_stack([x, np.cross(z, x), z])
            faces.append(
                Panel(
                    world_from_panel=self.world_from_box @ Pose(turn, half * outward),
                    half_size_m=(float(np.abs(x) @ half), float(np.abs(turn[:, 1]) @ half)),
                    reflectance=self.reflectance,
                    texture_contrast=0.05,
                    texture_m=0.08,
                )
            )
        return tuple(faces)

    @property
    def reach_m(self) -> float:
        """Radius of the sphere around it, metres."""
        return float(np.linalg.norm(self.half_size_m))

    def blocks(self, starts_world: FloatArray, end_world: FloatArray) -> BoolArray:
        """Whether straight lines from points (n, 3) to a point (3,) pass through it, (n,)."""
        box_from_world = self.world_from_box.inverse()
        starts, end = box_from_world.apply(starts_world), box_from_world.apply(end_world)
        # A line that starts on a face does not pass through the box by that.
        enters, leaves = np.full(len(starts), 1e-9), np.ones(len(starts))
        for start, last, half in zip(starts.T, end, self.half_size_m, strict=True):
            step = last - start
            step = np.where(np.abs(step) < 1e-12, 1e-12, step)
            middle, reach = -start / step, half / np.abs(step)
            np.maximum(enters, middle - reach, out=enters)
            np.minimum(leaves, middle + reach, out=leaves)
        return np.asarray(leaves > enters)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Workspace:
    """A workspace before it is rendered.

    Parameters
    ----------
    scene
        Cameras, lights and surroundings; its board poses calibrate the cameras.
    boxes
        Stand in the workspace while it is watched, not while the board is shown.
    balls
        In the order of the truth.
    floor_m
        y of the floor in the world.
    rate_hz
        Frames per second of all cameras, which are taken at the same instants.
    n_frames, n_background
        Frames with the balls, and frames of the empty workspace before them.
    """

    scene: Scene
    boxes: tuple[Box, ...]
    balls: tuple[Ball, ...]
    floor_m: float
    rate_hz: float
    n_frames: int
    n_background: int

    @property
    def times_s(self) -> FloatArray:
        """When the frames with the balls are taken, (n_frames,), seconds."""
        return np.arange(self.n_frames) / self.rate_hz

    @property
    def frame_ids(self) -> tuple[str, ...]:
        """Names of the frames with the balls."""
        return tuple(f"{index:04d}" for index in range(self.n_frames))

    @property
    def background_ids(self) -> tuple[str, ...]:
        """Names of the frames without balls."""
        return tuple(f"background{index:04d}" for index in range(self.n_background))
