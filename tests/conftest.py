"""Shared fixtures: seeded noise, the folder of test data, a small simulated recording."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calichrome.synthetic import random_scene, write_recording
from calichrome.target import Target, colour_checker_palette, design_target

_DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache folder of this run of the tests: the user's own is never touched."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALICHROME_CACHE", str(folder))
        yield folder


@pytest.fixture
def rng() -> np.random.Generator:
    """One seed for all tests: a failure comes back."""
    return np.random.default_rng(20_100_601)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of test data; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("CALICHROME_DATA", _DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip("test data are absent: set CALICHROME_DATA")
    return folder


@pytest.fixture(scope="session")
def standard_target() -> Target:
    """10x9 squares of 30 mm with the colours of the ColorChecker."""
    palette = colour_checker_palette()
    return design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=palette)


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory, standard_target: Target) -> Path:
    """A recording of two cameras and 12 poses with truth.json; do not change it."""
    folder = tmp_path_factory.mktemp("simulated") / "recording"
    write_recording(random_scene(standard_target, 2, 12, (640, 480), seed=3), folder)
    return folder
