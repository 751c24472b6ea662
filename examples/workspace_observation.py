"""Watch a workspace: follow what moves, and warn when two things come too near to each other.

    python examples/workspace_observation.py [RIG.json RECORDING LIMIT_M]

A warning is given when the distance can no longer be said to exceed the limit with 95 %
probability. Without arguments a simulated workspace of three cameras is calibrated and observed.
"""

import sys
import tempfile
from pathlib import Path

import calichrome as cc
from calichrome.pipeline.observe import observe
from calichrome.pipeline.observe_tables import distances
from calichrome.rig.compare import evidence_beside


def watch(rig_path: Path, recording: Path, limit_m: float) -> None:
    """Print each approach below the limit once, when it begins."""
    seen = observe(cc.load_rig(rig_path), evidence_beside(rig_path), recording)
    print(f"{len(seen.trajectories)} objects in {len(seen.watch.times_s)} frames")
    too_near: set[tuple[int, int]] = set()
    found = sorted(distances(seen, list(seen.rows())), key=lambda item: (item.time, item.tracks))
    for item in found:
        if item.lower_95_m >= limit_m:
            too_near.discard(item.tracks)
        elif item.tracks not in too_near:
            too_near.add(item.tracks)
            print(
                f"{item.time:.2f} s: objects {item.tracks[0]} and {item.tracks[1]} may be nearer "
                f"than {limit_m:g} m: {item.distance_m:.3f} m ± {1e3 * item.sigma_m:.1f} mm"
            )


def main() -> None:
    """Watch what the command line names, or a simulation."""
    if len(sys.argv) == 4:
        watch(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
        return
    from simulated import calibrated

    from calichrome.synthetic.workspace import workspace_scene, write_workspace

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "simulated"
        space = workspace_scene(
            n_cameras=3, n_balls=4, n_frames=25, n_background=8, size_wh=(640, 480)
        )
        write_workspace(space, folder)
        watch(calibrated(folder / "calibration", "80mm"), folder / "workspace", 0.4)


if __name__ == "__main__":
    main()
