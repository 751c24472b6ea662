"""--cache, --no-cache and --workers: they change how long it takes, and nothing else."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

from calichrome.pipeline import detect as detect_module
from calichrome.pipeline import workers

Cli = Callable[..., Any]
Small = Callable[..., Path]
Refused = Callable[..., str]


def _outputs(folder: Path, name: str) -> list[bytes]:
    suffixes = (".csv", ".markers.csv", ".rejected.csv")
    return [(folder / f"{name}{suffix}").read_bytes() for suffix in suffixes]


def _no_pool(*_words: object, **_options: object) -> None:
    raise AssertionError("a process was started")


def test_a_second_run_takes_all_from_the_cache(
    cli: Cli, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, cache = small(2), tmp_path / "cache"
    first = cli("detect", folder, "--cache", cache, "-o", tmp_path / "a.csv", "--workers", "2")
    assert (first.code, first.err) == (0, "")
    assert "cache" not in first.out
    monkeypatch.setattr(workers, "ProcessPoolExecutor", _no_pool)
    monkeypatch.setattr(detect_module, "detect_board", _no_pool)
    second = cli("detect", folder, "--cache", cache, "-o", tmp_path / "b.csv", "--workers", "2")
    assert (second.code, second.err) == (0, "")
    assert "\n4 of 4 pictures from the cache\n" in second.out
    assert _outputs(tmp_path, "b") == _outputs(tmp_path, "a")


def test_few_pictures_start_no_process(
    cli: Cli, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "ProcessPoolExecutor", _no_pool)
    assert cli("detect", small(2), "--no-cache", "-o", tmp_path / "a.csv").code == 0


def test_no_cache_keeps_nothing_and_asks_nothing(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder, cache = small(1), tmp_path / "cache"
    cli("detect", folder, "--cache", cache, "-o", tmp_path / "a.csv")
    shutil.rmtree(cache)
    words = ["detect", folder, "--json", "-o", tmp_path / "a.csv", "--force"]
    assert cli(*words, "--cache", cache, "--no-cache").json["n_cached"] == 0
    assert not cache.exists()


def test_what_changed_is_searched_again(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(3, toml=False)
    words = ["detect", folder, "--json", "--cache", tmp_path / "cache", "-o", tmp_path / "a.csv"]

    def n_cached(*more: str) -> int:
        return int(cli(*words, "--force", *more).json["n_cached"])

    assert n_cached() == 0
    assert n_cached("--cameras", "cam1") == 3
    picture = next((folder / "cam0").iterdir())
    pixels = cv2.imread(str(picture))
    assert pixels is not None
    cv2.imwrite(str(picture), pixels // 2)
    assert n_cached() == 5
    (folder / "recording.toml").write_text('[cameras.cam1]\nencoding = "linear"\n')
    assert n_cached() == 3
    assert n_cached() == 6
    (folder / "recording.toml").write_text("")
    assert n_cached() == 6
    assert n_cached("--target", "chessboard:9x8:30mm") == 0


def test_the_limit_of_size_holds_for_what_is_kept(
    cli: Cli, small: Small, tmp_path: Path, refused: Refused
) -> None:
    folder, cache = small(1), tmp_path / "cache"
    cli("detect", folder, "--cache", cache, "-o", tmp_path / "a.csv")
    out = tmp_path / "b.csv"
    words = ["detect", folder, "--cache", cache, "-o", out, "--max-megapixels", "0.1"]
    refused(*words, says=["megapixels"])


def test_pictures_are_drawn_from_the_cache(cli: Cli, small: Small, tmp_path: Path) -> None:
    folder = small(2)
    for name, more in (("a", ["--no-cache"]), ("b", []), ("c", ["--workers", "2"])):
        words = ["--cache", tmp_path / "cache", "-o", tmp_path / f"{name}.csv", *more]
        assert cli("detect", folder, *words, "--overlay", tmp_path / name).code == 0
    pictures = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.jpg"))
    assert len(pictures) == 4
    for picture in pictures:
        drawn = {(tmp_path / name / picture).read_bytes() for name in "abc"}
        assert len(drawn) == 1


@pytest.mark.parametrize("number", ["0", "-3"])
def test_workers_are_counted(refused: Refused, small: Small, tmp_path: Path, number: str) -> None:
    words = ["-o", tmp_path / "a.csv", "--workers", number]
    refused("detect", small(1), *words, says=["--workers", "1 or more"])


def test_a_cache_that_cannot_be(refused: Refused, small: Small, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    words = ["-o", tmp_path / "a.csv", "--cache", tmp_path / "file"]
    refused("detect", small(1), *words, says=["--cache", "--no-cache"])


def test_picture_that_memory_does_not_suffice_for(
    refused: Refused, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hungry(*_words: object) -> None:
        raise MemoryError

    monkeypatch.setattr(detect_module, "detect_board", hungry)
    words = ["-o", tmp_path / "a.csv", "--no-cache"]
    refused("detect", small(1), *words, says=["camera cam0", "picture 000", "memory"])


def test_calibrate_takes_what_detect_has_kept(
    cli: Cli, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, cache = small(6), tmp_path / "cache"
    plain = cli("calibrate", folder, "--no-cache", "-o", tmp_path / "a.json")
    assert plain.code == 0
    cli("detect", folder, "--cache", cache, "-o", tmp_path / "a.csv")
    monkeypatch.setattr(detect_module, "detect_board", _no_pool)
    kept = cli("calibrate", folder, "--cache", cache, "--workers", "2", "-o", tmp_path / "b.json")
    assert (kept.code, kept.err) == (0, "")
    assert (tmp_path / "b.json").read_bytes() == (tmp_path / "a.json").read_bytes()
