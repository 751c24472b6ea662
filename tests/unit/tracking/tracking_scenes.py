"""Balls on known paths seen by a ring of cameras, without pictures: regions as they would be."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.rig import Camera, CameraCovariance, Rig
from calichrome.target import chessboard
from calichrome.tracking import Region, SurfaceColour

SIZE_WH = (960, 720)
FPS = 30.0
_LENS = BrownConrady(fx=800, fy=802, cx=481, cy=358, k1=-0.12, k2=0.03, p1=3e-4, p2=-2e-4)


def ring(n_cameras: int = 6, radius_m: float = 2.0, scale: float = 1.0) -> Rig:
    """Cameras around and above the origin of a workspace, the first of which is the reference.

    Pictures are `scale` times as wide and high as `SIZE_WH`.
    """
    places = []
    for index in range(n_cameras):
        angle = 2 * np.pi * index / n_cameras
        centre = radius_m * np.array([np.cos(angle), np.sin(angle), 0.6])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        places.append(Pose(rotation, -rotation @ centre))
    ref_from_room = places[0]
    cameras = {
        f"cam{index}": Camera(
            size_wh=(round(scale * SIZE_WH[0]), round(scale * SIZE_WH[1])),
            lens=replace(
                _LENS,
                fx=scale * (800.0 + 7 * index),
                fy=scale * _LENS.fy,
                cx=scale * _LENS.cx,
                cy=scale * _LENS.cy,
            ),
            lens_sigma=dict.fromkeys(BrownConrady.NAMES),
            cam_from_ref=place @ ref_from_room.inverse(),
            sigma_rad=None,
            sigma_m=None,
            n_views=20,
            n_corners=1000,
            rms_px=0.1,
        )
        for index, place in enumerate(places)
    }
    return Rig(
        target=chessboard((9, 8), (0.03, 0.03)),
        reference_camera="cam0",
        cameras=cameras,
        pairs=(),
        frames={},
        world_from_ref=ref_from_room.inverse(),
    )


def camera_covariance(
    rig: Rig, *, focal_px: float = 0.6, turn_rad: float = 1e-4, shift_m: float = 2e-4
) -> CameraCovariance:
    """Independent errors of every camera but for the place of the reference."""
    cameras, names, sigmas = [], [], []
    for camera in rig.cameras:
        moved = 0.0 if camera == rig.reference_camera else 1.0
        own = {"fx": focal_px, "fy": focal_px, "cx": focal_px / 2, "cy": focal_px / 2}
        for name in BrownConrady.NAMES:
            cameras.append(camera)
            names.append(name)
            sigmas.append(own.get(name, 0.0))
        for kind, sigma in (("omega", turn_rad), ("tau", shift_m)):
            for axis in "xyz":
                cameras.append(camera)
                names.append(f"{kind}_{axis}")
                sigmas.append(moved * sigma)
    return CameraCovariance(
        camera=tuple(cameras), parameter=tuple(names), matrix=np.diag(np.square(sigmas))
    )


def disturbed(rig: Rig, covariance: CameraCovariance, rng: np.random.Generator) -> Rig:
    """The rig as a calibration with these errors would find it."""
    sigma = np.sqrt(np.diag(covariance.matrix))
    step = rng.normal(size=len(sigma)) * sigma
    cameras = {}
    for name, camera in rig.cameras.items():
        rows = [row for row, own in enumerate(covariance.camera) if own == name]
        lens = type(camera.lens).from_parameters(camera.lens.parameters + step[rows[:-6]])
        cameras[name] = replace(
            camera, lens=lens, cam_from_ref=camera.cam_from_ref.perturbed(step[rows[-6:]])
        )
    return replace(rig, cameras=cameras)


@dataclass(frozen=True, kw_only=True, eq=False)
class Balls:
    """B balls over T instants, in world coordinates."""

    times_s: FloatArray
    positions: FloatArray  # (T, B, 3)
    velocities: FloatArray  # (T, B, 3)
    radius_m: FloatArray  # (B,)
    xyz: FloatArray  # (B, 3)


def lissajous(n_balls: int, n_frames: int, rng: np.random.Generator) -> Balls:
    """Closed curves of 0.1 to 0.5 m, at about half a metre per second."""
    times = np.arange(n_frames) / FPS
    rate = rng.uniform(0.8, 2.2, (n_balls, 3))
    phase = rng.uniform(0, 2 * np.pi, (n_balls, 3))
    size = rng.uniform(0.1, 0.3, (n_balls, 3)) * [1, 1, 0.5]
    middle = rng.uniform(-0.4, 0.4, (n_balls, 3)) * [1, 1, 0.5]
    angle = rate * times[:, None, None] + phase
    return Balls(
        times_s=times,
        positions=middle + size * np.sin(angle),
        velocities=size * rate * np.cos(angle),
        radius_m=rng.uniform(0.02, 0.035, n_balls),
        xyz=rng.uniform(0.08, 0.5, (n_balls, 3)),
    )


Observe = Callable[[int], Mapping[str, Sequence[Region]]]


def observer(
    rig: Rig,
    balls: Balls,
    rng: np.random.Generator,
    *,
    noise_px: float = 0.1,
    bias_px: float = 0.0,
    colour_de: float = 0.0,
    hidden: Callable[[int, str, int], bool] = lambda _frame, _camera, _ball: False,
) -> Observe:
    """Regions of every camera at one instant; one that covers another hides its centre."""
    bias = rng.normal(0, bias_px, (len(rig.cameras), len(balls.radius_m), 2)) if bias_px else None
    tint = rng.normal(0, colour_de, (len(rig.cameras), 3))
    ref_from_world = rig.world_from_ref.inverse()

    def observe(frame: int) -> Mapping[str, Sequence[Region]]:
        points = ref_from_world.apply(balls.positions[frame])
        seen = {}
        for number, (name, camera) in enumerate(rig.cameras.items()):
            pixels = camera.project(points)
            depth = np.linalg.norm(camera.cam_from_ref.apply(points), axis=1)
            half = np.arcsin(balls.radius_m / depth)
            extent = half * camera.lens.fx
            regions = []
            for ball in rng.permutation(len(points)):
                apart = np.linalg.norm(pixels - pixels[ball], axis=1)
                touches = (apart < extent + extent[ball] + 2) & (apart > 0)
                if touches.any() or hidden(frame, name, int(ball)):
                    continue  # merged regions have no centre of a ball: as if not seen
                centre = pixels[ball] + rng.normal(0, noise_px, 2)
                if bias is not None:
                    centre = centre + bias[number, ball]
                low = np.floor(pixels[ball] - extent[ball]).astype(int)
                high = np.ceil(pixels[ball] + extent[ball]).astype(int) + 1
                if (low <= 0).any() or (high >= SIZE_WH).any():
                    continue
                light = float(np.exp(rng.normal(0, 0.05)))
                xyz = balls.xyz[ball] * light
                regions.append(
                    Region(
                        camera=name,
                        centre_px=centre,
                        cov_px2=0.05**2 * np.eye(2),
                        solid_angle_sr=float(2 * np.pi * (1 - np.cos(half[ball]))),
                        n_px=int(np.pi * extent[ball] ** 2),
                        box=(int(low[0]), int(low[1]), int(high[0]), int(high[1])),
                        mask=np.ones((int(high[1] - low[1]), int(high[0] - low[0])), dtype=bool),
                        whole=True,
                        colour=SurfaceColour(
                            lab_from_xyz(xyz) + tint[number], xyz, 0.01 * np.eye(3)
                        ),
                    )
                )
            seen[name] = regions
        return seen

    return observe
