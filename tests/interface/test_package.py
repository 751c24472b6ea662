"""What importing, packaging and releasing rely on."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import calichrome
from calichrome.rig.file import RigFile

Cli = Callable[..., Any]

_ROOT = Path(__file__).resolve().parents[2]


def _python(code: str) -> list[str]:
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr == ""
    return done.stdout.split()


def test_import_is_light() -> None:
    loaded = set(_python("import sys, calichrome; print(*sys.modules)"))
    assert "calichrome" in loaded
    heavy = {"cv2", "colour", "scipy", "numpy", "PIL", "pydantic", "tyro", "matplotlib"}
    assert not loaded & heavy


def test_help_does_not_load_what_is_slow() -> None:
    """colour-science takes seconds; only what needs its tables may wait for it."""
    code = "import sys; from calichrome.cli.main import main; print(*sys.modules)"
    assert "colour" not in _python(code)


def test_public_names_resolve() -> None:
    assert len(set(calichrome.__all__)) == len(calichrome.__all__)
    for name in calichrome.__all__:
        assert getattr(calichrome, name) is not None
    assert set(calichrome._HOMES) | {"__version__"} == set(calichrome.__all__)
    assert dir(calichrome) == sorted(calichrome.__all__)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="calibrat"):
        _ = calichrome.calibrat


@pytest.mark.parametrize("name", ["Target", "detect_board", "calibrate", "load_rig", "Corrector"])
def test_names_of_the_contract(name: str) -> None:
    assert name in calichrome.__all__


def test_version_of_the_command_line(cli: Cli) -> None:
    outcome = cli("--version")
    assert (outcome.code, outcome.out) == (0, f"calichrome {calichrome.__version__}\n")
    assert re.fullmatch(r"\d+\.\d+\.\d+", calichrome.__version__)


def test_generator_of_rig_json(simulated_rig: Path) -> None:
    rig = json.loads(simulated_rig.read_text())
    assert rig["generator"] == f"calichrome {calichrome.__version__}"


def test_constraints_hold_names_and_versions_only() -> None:
    lines = (_ROOT / "constraints.txt").read_text("utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    for pin in pins:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", pin)


def test_schema_is_that_of_the_model() -> None:
    """The schema ships with the package; write it again when the model changes."""
    path = Path(calichrome.__file__).parent / "rig" / "schema" / "rig-1.json"
    expected = json.dumps(RigFile.model_json_schema(), indent=1) + "\n"
    assert path.read_text("utf-8") == expected


def test_written_rig_has_every_key_of_the_schema(simulated_rig: Path) -> None:
    schema = RigFile.model_json_schema()
    rig = json.loads(simulated_rig.read_text())
    assert set(schema["properties"]) == set(rig)
    camera = rig["cameras"]["cam0"]
    assert set(schema["$defs"]["_CameraFile"]["properties"]) == set(camera)
    assert set(schema["$defs"]["_ColourFile"]["properties"]) == set(camera["colour"])


def test_examples_in_help_are_complete(cli: Cli) -> None:
    """Every command explains itself."""
    for words in (["calibrate"], ["detect"], ["correct"], ["rectify"], ["target", "make"]):
        outcome = cli(*words, "--help")
        assert outcome.code == 0
        assert "--json" in outcome.out
        assert "-o" in outcome.out
