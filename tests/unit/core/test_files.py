"""Outputs are whole or absent."""

from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from calichrome.core.files import check_output, writing_file, writing_folder
from calichrome.errors import OutputError


class _StopError(Exception):
    pass


def _fail_halfway(writing: AbstractContextManager[Path], text: str) -> None:
    with writing as temporary:
        (temporary / text if temporary.is_dir() else temporary).write_text(text)
        raise _StopError


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "rig.json"
    with writing_file(path) as temporary:
        temporary.write_text("half")
        assert not path.exists()
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    assert [item.name for item in path.parent.iterdir()] == ["rig.json"]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text("old")
    with pytest.raises(_StopError):
        _fail_halfway(writing_file(path, force=True), "half")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text("old")
    with pytest.raises(OutputError, match="--force"), writing_file(path):
        pytest.fail("the block must not run")
    with writing_file(path, force=True) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_a_folder_appears_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()  # an empty folder may be filled
    with writing_folder(path) as temporary:
        (temporary / "1.png").write_text("1")
        assert not any(path.iterdir())
    assert [item.name for item in path.iterdir()] == ["1.png"]
    with pytest.raises(OutputError, match="--force"), writing_folder(path):
        pytest.fail("the block must not run")
    with writing_folder(path, force=True) as temporary:
        (temporary / "2.png").write_text("2")
    assert sorted(item.name for item in path.iterdir()) == ["1.png", "2.png"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_folder_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(_StopError):
        _fail_halfway(writing_folder(tmp_path / "out"), "1.png")
    assert not any(tmp_path.iterdir())


def test_kinds_are_not_mixed_up(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a folder"), writing_file(tmp_path, force=True):
        pytest.fail("the block must not run")
    with (
        pytest.raises(OutputError, match="is a file"),
        writing_folder(tmp_path / "file", force=True),
    ):
        pytest.fail("the block must not run")


def test_outputs_are_checked_before_the_work(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "er" / "rig.json"
    check_output(path, force=False)
    assert not any(tmp_path.iterdir())
    path.parent.mkdir(parents=True)
    path.write_text("")
    with pytest.raises(OutputError, match="exists"):
        check_output(path, force=False)
    check_output(path, force=True)
