"""Whether the C kernels and OpenCV with numpy give the same pictures, on random calibrations."""

import argparse
from collections import defaultdict

import numpy as np
from benchmarks.apply.calibrations import Case, colour_of, random_case
from benchmarks.geometry.tables import Bar, print_bars, print_table

from calichrome.apply import Corrector
from calichrome.apply.frame_format import top_of
from calichrome.apply.source_maps import SourceMap
from calichrome.core.arrays import BoolArray

__all__ = ["difference", "main"]


def difference(case: Case) -> float:
    """Return the largest difference, 1/255 of full scale, where the source lies in the picture."""
    first, second = (
        Corrector(
            case.camera, case.space, case.source_map, frames=case.frames, output=case.output,
            kernel=kernel,
        )
        for kernel in ("native", "opencv")
    )  # fmt: skip
    inside = _inside(case.source_map, case.camera.size_wh)
    a, b = (corrector.apply(case.frame).astype(np.float64) for corrector in (first, second))
    plain = case.space == "none"
    top = case.frames.top if plain else top_of(str(first.output_dtype))
    off = np.abs(a - b) * 255 / top
    return float(off.max() if inside is None else off[inside].max(initial=0))


def _inside(source_map: SourceMap | None, size_wh: tuple[int, int]) -> BoolArray | None:
    if source_map is None:
        return None
    limits = np.array(size_wh) - 1
    return np.asarray(((source_map >= 0) & (source_map <= limits)).all(axis=-1))


def main() -> None:
    """Print the largest differences by colour model, and whether the bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calibrations", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    settings = parser.parse_args()
    found: dict[str, list[float]] = defaultdict(list)
    for index in range(settings.calibrations):
        case = random_case(np.random.default_rng([settings.seed, index]))
        name = "none" if case.space == "none" else colour_of(case.camera).model.MODEL
        found[name].append(difference(case))
    rows = [
        [name, str(len(off)), f"{np.mean(off):.3f}", f"{max(off):.3f}"]
        for name, off in sorted(found.items())
    ]
    print_table(["model", "calibrations", "mean of the largest", "largest, 1/255"], rows)
    print_bars([Bar("largest difference, 1/255", max(map(max, found.values())), high=1.0)])


if __name__ == "__main__":
    main()
