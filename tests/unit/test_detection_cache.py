"""Kept detections: exactly what was put in, for exactly what it was, and never in the way."""

import logging
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from platformdirs import user_cache_path

from calichrome.errors import OutputError
from calichrome.imaging import Unreadable
from calichrome.imaging.recording_file import CameraEntry
from calichrome.observations import BoardView, DiscSamples, NotFound
from calichrome.pipeline import detection_cache
from calichrome.pipeline.detection_cache import DetectionCache, Seen, cache_folder, context_of
from calichrome.pipeline.packing import pack
from calichrome.target import Target

NAME = "detections-1.sqlite"


def _seen(rng: np.random.Generator, number: int = 0, n_corners: int = 72) -> Seen:
    n_discs = 24
    discs = DiscSamples(
        marker_ids=np.arange(n_discs),
        centres_px=rng.normal(size=(n_discs, 2)),
        mean_rgb=rng.random((n_discs, 3)),
        median_rgb=rng.random((n_discs, 3)),
        cov_rgb=rng.normal(size=(n_discs, 3, 3)),
        n_px=rng.integers(1, 1000, n_discs),
        clipped=rng.random(n_discs),
        white_rgb=np.full((n_discs, 3), np.nan),
        black_rgb=rng.random((n_discs, 3)),
    )
    view = BoardView(
        corner_ids=np.arange(n_corners),
        corners_px=rng.normal(size=(n_corners, 2)),
        cov_px=rng.normal(size=(n_corners, 2, 2)),
        half_turn_ambiguous=bool(number % 2),
        discs=discs if number % 3 else None,
    )
    return Seen(
        found=view,
        size_wh=(640, 480),
        sha256=f"{number:064x}",
        exposure={"exposure_s": 0.01},
        rotation_tag=6,
    )


def _bytes(seen: Seen | None) -> bytes:
    return pack(seen, detection_cache._TYPES)


def test_what_is_kept_comes_back_bit_by_bit(tmp_path: Path, rng: np.random.Generator) -> None:
    kept = [_seen(rng, number) for number in range(6)]
    kept.append(Seen(found=NotFound("no board: add light"), size_wh=(3, 2), sha256="ab"))
    with DetectionCache(tmp_path) as cache:
        for seen in kept:
            cache.put("context", seen)
    with DetectionCache(tmp_path) as cache:
        for seen in kept:
            back = cache.get("context", seen.sha256)
            assert back is not None
            assert _bytes(back) == _bytes(seen)
            assert type(back.found) is type(seen.found)
        assert cache.get("context", "cd") is None
        assert cache.get("another", kept[0].sha256) is None
        assert cache.knows("context")
        assert not cache.knows("another")


def test_a_detection_is_kept_at_once(tmp_path: Path, rng: np.random.Generator) -> None:
    """Another connection sees it while the first is open, as it would after a kill."""
    with DetectionCache(tmp_path) as cache, DetectionCache(tmp_path) as other:
        cache.put("context", _seen(rng))
        assert other.get("context", _seen(rng).sha256) is not None


def test_a_later_detection_replaces(tmp_path: Path, rng: np.random.Generator) -> None:
    first, second = _seen(rng), _seen(rng)
    with DetectionCache(tmp_path) as cache:
        cache.put("context", first)
        cache.put("context", second)
        assert _bytes(cache.get("context", first.sha256)) == _bytes(second)


def test_files_that_cannot_be_read_are_not_kept(tmp_path: Path, rng: np.random.Generator) -> None:
    """They may be whole the next time, and to see that they are not is quick."""
    with DetectionCache(tmp_path) as cache:
        cache.put("context", Seen(found=Unreadable("cut off"), sha256="ab"))
        cache.put("context", replace(_seen(rng), sha256=""))
        assert not cache.knows("context")


def test_without_a_folder_nothing_is_kept(rng: np.random.Generator) -> None:
    with DetectionCache(None) as cache:
        cache.put("context", _seen(rng))
        assert not cache.knows("context")
        assert cache.get("context", _seen(rng).sha256) is None


def test_all_that_matters_makes_another_context(
    standard_target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = CameraEntry()
    first = standard_target.markers[0]
    xyz = (np.nextafter(first.xyz_d65[0], 1), *first.xyz_d65[1:])
    bluer = (replace(first, xyz_d65=xyz), *standard_target.markers[1:])
    contexts = [
        context_of(standard_target, entry),
        context_of(replace(standard_target, top_left="black", markers=()), entry),
        context_of(replace(standard_target, square_m=(0.031, 0.03)), entry),
        context_of(replace(standard_target, markers=bluer), entry),
        context_of(standard_target, CameraEntry(encoding="linear")),
        context_of(standard_target, CameraEntry(bits=12)),
    ]
    assert contexts[0] == context_of(replace(standard_target), CameraEntry())
    assert contexts[0] == context_of(standard_target, CameraEntry(fixed={"k3": 0}))
    with monkeypatch.context() as patch:
        patch.setattr(detection_cache, "DETECTOR_VERSION", "another")
        contexts.append(context_of(standard_target, entry))
    fewer_fields = {"NotFound": NotFound}
    monkeypatch.setattr(detection_cache, "_TYPES", fewer_fields)
    contexts.append(context_of(standard_target, entry))
    assert len(set(contexts)) == len(contexts)


def _fill(folder: Path, rng: np.random.Generator, n: int = 30) -> None:
    with DetectionCache(folder) as cache:
        for number in range(n):
            cache.put("context", _seen(rng, number))


def _garbage(path: Path) -> None:
    path.write_bytes(b"no database at all, but long enough to be taken for one" * 100)


def _overwrite_pages(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xa5" * (len(content) - 4096)
    path.write_bytes(content)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:9000])


def _other_tables(path: Path) -> None:
    path.unlink()
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE seen (something TEXT)")
    file.close()


@pytest.mark.parametrize("damage", [_garbage, _overwrite_pages, _cut, _other_tables])
def test_a_damaged_file_is_set_aside(
    damage: object,
    tmp_path: Path,
    rng: np.random.Generator,
    caplog: pytest.LogCaptureFixture,
) -> None:
    _fill(tmp_path, rng)
    assert callable(damage)
    damage(tmp_path / NAME)
    damaged = (tmp_path / NAME).read_bytes()
    with DetectionCache(tmp_path) as cache:
        for number in range(30):
            seen = _seen(rng, number)
            cache.get("context", seen.sha256)
            cache.put("context", seen)
            cache.put("context", seen)  # the one that met the damage may be lost
        assert cache.get("context", f"{29:064x}") is not None
    assert "is damaged" in caplog.text
    assert (tmp_path / f"{NAME}.damaged").read_bytes()[4096:] == damaged[4096:]
    with DetectionCache(tmp_path) as cache:
        assert cache.knows("context")


def test_a_damaged_row_is_detected_again(tmp_path: Path, rng: np.random.Generator) -> None:
    _fill(tmp_path, rng, 2)
    with sqlite3.connect(tmp_path / NAME) as file:
        content = bytearray(file.execute("SELECT content FROM seen").fetchone()[0])
        content[1000] ^= 1
        file.execute("UPDATE seen SET content = ? WHERE id = 1", (bytes(content),))
        file.execute("UPDATE seen SET picture = 'moved' WHERE id = 2")
    file.close()
    with DetectionCache(tmp_path) as cache:
        assert cache.get("context", f"{0:064x}") is None
        assert cache.get("context", "moved") is None
        cache.put("context", _seen(rng, 0))
        assert cache.get("context", f"{0:064x}") is not None


def test_a_file_that_cannot_be_opened_is_done_without(
    tmp_path: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / NAME).mkdir()
    (tmp_path / "file").write_text("")
    for folder in (tmp_path, tmp_path / "file"):
        caplog.clear()
        with DetectionCache(folder) as cache, caplog.at_level(logging.WARNING):
            cache.put("context", _seen(rng))
            assert not cache.knows("context")
        assert caplog.text.count("going on without a cache") == 1


def test_the_oldest_go_when_it_grows(tmp_path: Path, rng: np.random.Generator) -> None:
    most = 1_000_000
    with DetectionCache(tmp_path, max_bytes=most) as cache:
        for number in range(300):  # of 11 kB each
            cache.put("context", _seen(rng, 3 * number + 1))
        kept = [cache.get("context", f"{3 * number + 1:064x}") is not None for number in range(300)]
    assert kept == sorted(kept)
    assert 0.6 < sum(kept) * 11_000 / most < 1.1
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 1.2 * most


def test_processes_share_the_file(tmp_path: Path) -> None:
    """Begun at the same time on a file that none of them has made yet."""
    code = (
        "import sys; from pathlib import Path\n"
        "from calichrome.observations import NotFound\n"
        "from calichrome.pipeline.detection_cache import DetectionCache, Seen\n"
        "with DetectionCache(Path(sys.argv[1])) as cache:\n"
        "    for number in range(100):\n"
        "        seen = Seen(found=NotFound('x'), sha256=f'{sys.argv[2]}-{number}')\n"
        "        cache.put('context', seen)\n"
    )
    words = [sys.executable, "-c", code, str(tmp_path)]
    started = [
        subprocess.Popen([*words, str(number)], stderr=subprocess.PIPE)  # noqa: S603
        for number in range(4)
    ]
    assert [process.communicate(timeout=120)[1] for process in started] == [b""] * 4
    with DetectionCache(tmp_path) as cache:
        for process in range(4):
            for number in range(100):
                assert cache.get("context", f"{process}-{number}") is not None


def test_where_the_folder_is(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder(None) == cache
    assert cache_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert (tmp_path / "a" / "b").is_dir()
    monkeypatch.delenv("CALICHROME_CACHE")
    assert cache_folder(None) == user_cache_path("calichrome", appauthor=False)


def test_a_chosen_folder_must_be_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="--no-cache"):
        cache_folder(tmp_path / "file")
