"""A picture of the ColorChecker card for those who read nothing else, through the same look."""

import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from benchmarks.colour.looks import Look
from benchmarks.colour.peers import NotRunError
from benchmarks.colour.problems import ColourProblem
from benchmarks.colour.scoring import Apply
from numpy.typing import NDArray

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.rgb_spaces import XYZ_FROM_RGB
from calichrome.core.arrays import FloatArray

__all__ = ["CARD_LEVEL", "card_means", "card_picture", "chromacal"]

CARD_LEVEL = 0.9  # of full scale, for the perfect diffuser
_PATCH_PX, _GAP_PX, _BORDER_PX = 90, 12, 60
_NOISE = 0.005  # of each pixel, multiplicative
_FRAME = 0.03  # reflectance of what holds the patches
_TABLE = 0.35  # and of what the card lies on


def card_picture(problem: ColourProblem, look: Look, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw the card in even light, (H, W, 3) RGB."""
    pitch = _PATCH_PX + _GAP_PX
    height, width = 4 * pitch + _GAP_PX, 6 * pitch + _GAP_PX
    linear = np.full((height + 2 * _BORDER_PX, width + 2 * _BORDER_PX, 3), _TABLE)
    linear[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = _FRAME
    for index, rgb in enumerate(problem.train.rgb):
        linear[_patch(index, 0)] = rgb
    linear *= CARD_LEVEL * (1 + rng.normal(0, _NOISE, linear.shape))
    return look.of_picture(linear)


def card_means(picture: NDArray[np.uint8]) -> FloatArray:
    """Mean stored values 0..1 of the inner three fifths of each patch, (24, 3)."""
    inset = _PATCH_PX // 5
    return np.array([picture[_patch(index, inset)].mean(axis=(0, 1)) for index in range(24)]) / 255


def _patch(index: int, inset: int) -> tuple[slice, slice]:
    begin = np.array(divmod(index, 6)) * (_PATCH_PX + _GAP_PX) + _BORDER_PX + _GAP_PX
    y, x = (slice(int(at) + inset, int(at) + _PATCH_PX - inset) for at in begin)
    return y, x


def chromacal(python: Path | None, picture: NDArray[np.uint8]) -> Apply:
    """Fit chromacal to a card's picture, with its own detection and its own references for D50.

    The map gives XYZ under D50.

    Parameters
    ----------
    python
        Interpreter of an environment with chromacal; None: not run.

    Raises
    ------
    NotRunError
        If it cannot be imported or does not find the card.
    """
    if python is None:
        raise NotRunError
    worker = Path(__file__).with_name("chromacal_worker.py")

    def apply(rgb: FloatArray) -> FloatArray:
        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder) / name for name in ("card.npy", "stored.npy", "made.npy")]
            np.save(files[0], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            np.save(files[1], rgb)
            command = [str(python), str(worker), *map(str, files)]
            done = subprocess.run(command, capture_output=True, check=False, text=True)  # noqa: S603
            if done.returncode != 0:
                lines = done.stderr.strip().splitlines()
                print(f"chromacal: {lines[-1] if lines else done.returncode}")
                raise NotRunError
            linear = np.load(files[2])
        return adapt(linear @ XYZ_FROM_RGB["srgb"].T, D65, D50)

    return apply
