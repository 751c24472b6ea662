"""Boards seen in part: python -m benchmarks.detection.partial --views 200.

Border cuts and hands, under two lights, random exposure and random colour casts. A corner is
visible if nothing hides what lies within a quarter of a square of it; views *count* for recall if
they show 4x3 whole squares and six whole discs. Wrong identities count in every view.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from benchmarks.detection.scenes import Scene, random_scene, render
from benchmarks.detection.scoring import FOUND_PX, WRONG_SPACINGS
from benchmarks.detection.surfaces import board_target, colour_look, random_cast
from benchmarks.detection.variants import PartialView, cut, hand, shows_enough, taken

from calichrome.detection import detect_board
from calichrome.imaging import Image
from calichrome.observations import BoardView
from calichrome.target import Target
from calichrome.target.design import design_target
from calichrome.target.palette import colour_checker_palette

__all__ = ["main"]

_LIGHTS = ("D65", "A")
_SHARES = (0.15, 0.9)
_PER_SCENE = 4  # views of one rendering: two cuts, two hands


@dataclass(frozen=True, slots=True)
class _Outcome:
    kind: str
    counts: bool
    share: float
    n_visible: int
    n_right: int
    n_wrong: int
    reason: str


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument(
        "--designed",
        action="store_true",
        help="the board that `calichrome target make` designs, 60 %% of its squares with discs",
    )
    parser.add_argument("--verbose", action="store_true", help="name the views that went wrong")
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    target = _designed() if options.designed else board_target()
    outcomes: list[_Outcome] = []
    for scene, kind, view, image in _views(target, options.first):
        outcome = _outcome(scene, kind, view, image)
        outcomes.append(outcome)
        if options.verbose and (outcome.n_wrong or (outcome.counts and _recall([outcome]) < 0.98)):
            print(f"seed {scene.seed} {outcome}")
        if len(outcomes) == options.views:
            break
    _print_table(outcomes)


def _designed() -> Target:
    side = board_target().square_m[0]
    return design_target(squares=(9, 8), square_m=(side, side), palette=colour_checker_palette())


def _views(target: Target, first: int) -> Iterator[tuple[Scene, str, PartialView, Image]]:
    seed = first
    while True:
        scene = random_scene(900_000 + seed, target=target)
        seed += 1
        if scene.megapixels > 1.5:
            continue
        rng = scene.rng(30)
        look = colour_look(target, _LIGHTS[seed % 2])
        clean = render(scene, look=look)
        skin_dn = (look.skin * scene.exposure_dn).astype(np.float32)
        for index in range(_PER_SCENE):
            kind = ("cut", "hand")[index % 2]
            for _ in range(20):
                view = cut(scene, clean, rng) if kind == "cut" else hand(scene, clean, skin_dn, rng)
                if _SHARES[0] <= view.share <= _SHARES[1]:
                    gain = rng.uniform(0.5, 1.05)
                    yield scene, kind, view, taken(view, scene, random_cast(rng), gain, rng)
                    break


def _outcome(scene: Scene, kind: str, view: PartialView, image: Image) -> _Outcome:
    found = detect_board(image, scene.target)
    counts = shows_enough(scene, view)
    n_visible = int(view.visible.sum())
    if not isinstance(found, BoardView):
        return _Outcome(kind, counts, view.share, n_visible, 0, 0, found.reason)
    distance = np.linalg.norm(found.corners_px - view.corners_px[found.corner_ids], axis=1)
    right = found.corner_ids[distance < FOUND_PX]
    wrong = distance > WRONG_SPACINGS * scene.spacing_px[found.corner_ids]
    n_right = int(view.visible[right].sum())
    return _Outcome(kind, counts, view.share, n_visible, n_right, int(wrong.sum()), "")


def _recall(outcomes: Sequence[_Outcome]) -> float:
    n_visible = sum(outcome.n_visible for outcome in outcomes)
    return sum(outcome.n_right for outcome in outcomes) / max(n_visible, 1)


def _print_table(outcomes: Sequence[_Outcome]) -> None:
    groups: dict[str, list[_Outcome]] = defaultdict(list)
    for outcome in outcomes:
        if outcome.counts:
            groups[f"{outcome.kind}, 4x3 squares and 6 discs show"].append(outcome)
            groups["all that show 4x3 squares and 6 discs"].append(outcome)
        else:
            groups["less shows"].append(outcome)
    groups["all"] = list(outcomes)
    print("| views | number | with ids | recall of visible corners | wrong corners | wrong views |")
    print("|" + " --- |" * 6)
    for name, group in sorted(groups.items()):
        identified = sum(outcome.n_right > 0 for outcome in group)
        wrong = sum(outcome.n_wrong for outcome in group)
        wrong_views = sum(outcome.n_wrong > 0 for outcome in group)
        print(
            f"| {name} | {len(group)} | {identified} | {_recall(group):.3f} | {wrong} | "
            f"{wrong_views} |"
        )
    reasons = Counter(outcome.reason for outcome in outcomes if outcome.counts and outcome.reason)
    for reason, number in reasons.most_common():
        print(f"{number} refused that show enough: {reason}")


if __name__ == "__main__":
    main()
