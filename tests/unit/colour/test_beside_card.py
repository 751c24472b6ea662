"""The light on a board and on a card beside it."""

from dataclasses import dataclass

import numpy as np
import pytest

from calichrome.colour.beside_card import PaperInCardLight, paper_in_card_light
from calichrome.core.arrays import FloatArray

PAPER = np.array([0.52, 0.60, 0.47])
BOARD = np.stack(np.meshgrid(np.linspace(-0.15, 0.15, 8), np.linspace(-0.13, 0.13, 6)), -1)
PATCHES = 0.042 * np.stack(np.meshgrid(np.arange(6) - 2.5, np.arange(4) - 1.5), -1)
PX = 2000.0  # per metre


@dataclass(frozen=True)
class Lamps:
    """Two lamps before a plane, and a lens that darkens towards its corners."""

    places: FloatArray  # (2, 3) metres
    colours: FloatArray  # (2, 3) of the channels
    axis: FloatArray  # (2,) where the lens looks

    def at(self, points: FloatArray) -> FloatArray:
        away = self.places[:, None] - np.concatenate([points, np.zeros((len(points), 1))], axis=1)
        squared = (away**2).sum(axis=2)
        level = (self.places[:, 2:] / squared) ** 2  # two cosines over a squared distance
        vignetting = 1 / (1 + ((points - self.axis) ** 2).sum(axis=1) / 0.8**2)
        return np.asarray(vignetting[:, None] * (level.T @ self.colours))

    @classmethod
    def drawn(cls, rng: np.random.Generator, card: FloatArray, *, tinted: bool) -> "Lamps":
        places = np.stack([[*rng.uniform(-0.9, 0.9, 2), rng.uniform(0.5, 1.6)] for _ in range(2)])
        colours = np.array([[1.0, 1.0, 1.0], [0.3, 0.3, 0.3]])
        if tinted:
            colours[1] = 0.3 * rng.uniform(0.8, 1.2, 3)
        return cls(places=places, colours=colours, axis=card / 2)


def _measured(
    rng: np.random.Generator, *, tinted: bool = False, noise: float = 0.003
) -> tuple[PaperInCardLight, FloatArray]:
    """The paper as found and as it is in the light of the card's middle."""
    sides = np.array([[0.32, 0.0], [-0.32, 0.0], [0.0, 0.25], [0.0, -0.25]])
    card = sides[rng.integers(4)] + rng.uniform(-0.05, 0.05, 2)
    lamps = Lamps.drawn(rng, card, tinted=tinted)
    board, patches = BOARD.reshape(-1, 2), card + PATCHES.reshape(-1, 2)
    in_middle = lamps.at(card[None])[0]
    light = (lamps.at(patches) / in_middle).mean(axis=1) * np.exp(rng.normal(0, 0.03, 24))
    white = PAPER * lamps.at(board) * np.exp(rng.normal(0, noise, (len(board), 3)))
    found = paper_in_card_light(PX * board, white, PX * patches, light, np.ones(24))
    assert isinstance(found, PaperInCardLight), found
    return found, PAPER * in_middle


@pytest.mark.parametrize("noise", [0.003, 0.01])
def test_paper_is_carried_to_the_card_as_well_as_stated(
    rng: np.random.Generator, noise: float
) -> None:
    """Light falls by half over board and card in the worst of these."""
    off, stated = [], []
    for _ in range(400):
        found, true = _measured(rng, noise=noise)
        off.append(float(np.log(found.rgb / true).mean()))
        stated.append(found.level_sigma)
    in_sigmas = np.array(off) / np.array(stated)
    assert np.sqrt(np.mean(np.square(off))) < 0.015
    # on the safe side where the noise is below what a quadratic is taken to miss
    assert 0.6 < np.sqrt(np.mean(in_sigmas**2)) < 1.3
    assert np.mean(np.abs(in_sigmas) < 2) > 0.9


def test_tint_of_two_lamps_is_carried_along(rng: np.random.Generator) -> None:
    off, constant, stated = [], [], []
    for _ in range(400):
        found, true = _measured(rng, tinted=True)
        ratio = np.log(found.rgb / true)
        off.append(ratio - ratio.mean())
        stated.append(np.sqrt(np.trace(found.tint_cov)))
        constant.append(np.linalg.norm(off[-1]) / max(stated[-1], 1e-9))
    rms = float(np.sqrt(np.mean(np.square(off))))
    assert rms < 0.004  # a grey is then off by 0.5 dE
    assert 0.3 < np.sqrt(np.mean(np.square(constant))) < 1.5


def test_what_the_scale_of_either_does(rng: np.random.Generator) -> None:
    board, patches = BOARD.reshape(-1, 2), 0.3 + PATCHES.reshape(-1, 2)
    white = PAPER * np.exp(rng.normal(0, 0.01, (len(board), 3)))
    light = np.exp(rng.normal(0, 0.03, 24))
    plain, brighter, lighter = (
        paper_in_card_light(board, a * white, patches, b * light, np.ones(24))
        for a, b in ((1.0, 1.0), (2.0, 1.0), (1.0, 2.0))
    )
    assert isinstance(plain, PaperInCardLight)
    assert isinstance(brighter, PaperInCardLight)
    assert isinstance(lighter, PaperInCardLight)
    np.testing.assert_allclose(brighter.rgb, 2 * plain.rgb)
    np.testing.assert_allclose(lighter.rgb, plain.rgb / 2)
    assert brighter.level_sigma == pytest.approx(plain.level_sigma)


def test_too_few_levels_or_patches_are_told() -> None:
    one = np.ones((24, 3))
    assert "only 11 white levels" in str(
        paper_in_card_light(one[:11, :2], one[:11], one[:, :2], one[:, 0], one[:, 0])
    )
    assert "only 2 patches" in str(
        paper_in_card_light(one[:, :2], one, one[:2, :2], one[:2, 0], one[:2, 0])
    )
