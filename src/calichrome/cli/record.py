"""``calichrome record``."""

import json
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from calichrome.cli.simulate import size_from, standard_target
from calichrome.cli.terminal import Command, Flag, Output, names_from
from calichrome.core.files import writing_file
from calichrome.core.units import parse_duration
from calichrome.errors import RecordingError
from calichrome.imaging.devices import CameraDevice, CvCamera, Setting
from calichrome.imaging.recording_writer import RecordingWriter
from calichrome.pipeline.record import Recorded, Shot, record
from calichrome.report.text import finding_lines
from calichrome.synthetic import Renderer, SyntheticCamera, random_scene
from calichrome.target import Target, load_target, target_to_json

__all__ = ["Record"]

_SYNTHETIC = "synthetic:"
_POSES = 12  # of a synthetic board, if no --count says how many
_STILL_S = 0.5  # from the beep to the shot; choice: who hears it stops moving in half a second
_SYNTHETIC_SIZE_WH = (640, 480)


@dataclass(frozen=True, kw_only=True)
class Record(Command):
    """Record several cameras at once, their settings locked, as a folder for calibrate."""

    cameras: tuple[str, ...]
    """Like 0,1,2: numbers of cameras, device files or addresses of streams, with a name if wanted
    (left=0); synthetic:0,synthetic:1 show a rendered board."""
    output: Annotated[Path, Output]
    """Folder to write; it must not exist or be empty."""
    every: str = "2s"
    """Time from the end of one shot to the next."""
    key: Flag = False
    """Wait for Enter before each shot instead; q and Enter ends."""
    count: int | None = None
    """End after so many frames. Default: at Ctrl-C."""
    size: str | None = None
    """Width x height to ask of the cameras, like 1280x720. Default: what they offer first."""
    beep: bool = True
    """Sound the terminal's bell half a second before each shot."""
    target: Path | None = None
    """target.json of the board that is shown; it is copied into the recording."""

    def run(self) -> int:
        """Record and report; exit code 3 if a camera got lost or hung."""
        sources = _sources(names_from(self.cameras))
        if self.count is not None and self.count < 1:
            raise RecordingError(f"--count {self.count}: give 1 or more")
        every_s = self._every_s()
        size_wh = None if self.size is None else size_from(self.size)
        synthetic = any(source.startswith(_SYNTHETIC) for source in sources.values())
        target = None if self.target is None else load_target(self.target)
        if target is None and synthetic:
            target = standard_target()
        writer = RecordingWriter(self.output)

        def taken(shot: Shot) -> None:
            if target is not None and writer.n_frames == 1:  # whatever happens later, it is there
                text = json.dumps(target_to_json(target), indent=1, ensure_ascii=False)
                with writing_file(self.output / "target.json") as temporary:
                    temporary.write_text(text + "\n", encoding="utf-8")
            self._tell_shot(shot)

        with ExitStack() as stack:
            devices = self._opened(sources, size_wh, target, stack)
            done = record(
                devices,
                writer,
                self._on_key if self.key else self._after(every_s),
                count=self.count,
                locked=self._tell_settings,
                taken=taken,
            )
        self.show("\n".join(_summary(done, self.output)), _to_json(done, self.output))
        return 3 if any(item.severity == "critical" for item in done.findings) else 0

    def _every_s(self) -> float:
        try:
            return parse_duration(self.every)
        except ValueError as error:
            raise RecordingError(f"--every {error}") from error

    def _opened(
        self,
        sources: Mapping[str, str],
        size_wh: tuple[int, int] | None,
        target: Target | None,
        stack: ExitStack,
    ) -> dict[str, CameraDevice]:
        numbers = {
            camera: int(source.removeprefix(_SYNTHETIC))
            for camera, source in sources.items()
            if source.startswith(_SYNTHETIC)
        }
        devices: dict[str, CameraDevice] = {}
        if numbers:
            assert target is not None  # noqa: S101 (synthetic cameras have one)
            scene = random_scene(
                target,
                max(numbers.values()) + 1,
                self.count or _POSES,
                size_wh or _SYNTHETIC_SIZE_WH,
            )
            renderer = Renderer(scene)
        for camera, source in sources.items():
            if camera in numbers:
                devices[camera] = SyntheticCamera(renderer, f"cam{numbers[camera]}")
            else:
                devices[camera] = CvCamera(int(source) if source.isdigit() else source, size_wh)
            stack.callback(devices[camera].release)
        return devices

    def _after(self, every_s: float) -> Callable[[int], bool]:
        """Wait from the end of one shot to the next; cameras may take long to lock and to grab."""
        notice_s = min(_STILL_S, every_s) if self.beep else 0.0

        def ready(number: int) -> bool:  # noqa: ARG001 (called with the number of the shot)
            time.sleep(every_s - notice_s)
            self._sound()
            time.sleep(notice_s)
            return True

        return ready

    def _on_key(self, number: int) -> bool:
        print(f"Enter takes frame {number:03d}, q ends: ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line or line.strip().lower() == "q":
            return False
        self._sound()
        if self.beep:
            time.sleep(_STILL_S)
        return True

    def _sound(self) -> None:
        if self.beep:
            print("\a", end="", file=sys.stderr, flush=True)

    def _tell_settings(self, camera: str, settings: Sequence[Setting]) -> None:
        if not self.json:
            held = [f"{item.name} {item.value:g}" for item in settings if item.locked]
            print(f"camera {camera}: locked {', '.join(held) or 'nothing'}", flush=True)

    def _tell_shot(self, shot: Shot) -> None:
        if not self.json:
            print(f"frame {shot.frame_id}: grabbed within {shot.spread_s * 1e3:.1f} ms", flush=True)


def _sources(words: Sequence[str]) -> dict[str, str]:
    """Camera id -> source of ``left=0``, ``1``, ``synthetic:0`` or ``/dev/video2``."""
    sources: dict[str, str] = {}
    for word in words:
        named = re.fullmatch(r"([\w-]+)=(.+)", word)
        source = named[2] if named else word
        number = source.removeprefix(_SYNTHETIC)
        if source.startswith(_SYNTHETIC) and not number.isdecimal():
            raise RecordingError(
                f"--cameras {word}: write synthetic: and a number, like synthetic:0"
            )
        if named:
            camera = named[1]
        elif number.isdecimal():
            camera = f"cam{int(number)}"
        else:
            camera = re.sub(r"[^\w-]+", "-", Path(source).stem).strip("-")
        if camera in ("", "background") or camera in sources:
            raise RecordingError(
                f"--cameras {word}: {'is named twice' if camera in sources else 'has no name'}; "
                f"give each camera a name of its own, like left=0"
            )
        sources[camera] = source
    if not sources:
        raise RecordingError("--cameras is empty; give numbers like 0,1")
    return sources


def _summary(done: Recorded, output: Path) -> list[str]:
    spreads = [shot.spread_s for shot in done.shots]
    cameras = len(done.shots[0].times_s)
    wrote = (
        f"Wrote {output}: {cameras} camera{'s' * (cameras > 1)}, {len(spreads)} "
        f"frame{'s' * (len(spreads) > 1)}, grabbed within {max(spreads) * 1e3:.1f} ms at most"
    )
    return [*finding_lines(done.findings), wrote]


def _to_json(done: Recorded, output: Path) -> dict[str, object]:
    return {
        "recording": str(output),
        "frames": [
            {"frame": shot.frame_id, "times_s": dict(shot.times_s), "spread_s": shot.spread_s}
            for shot in done.shots
        ],
        "settings": {
            camera: {item.name: {"value": item.value, "locked": item.locked} for item in own}
            for camera, own in done.settings.items()
        },
        "findings": [
            {"code": item.code, "severity": item.severity, "text": item.text, **item.data}
            for item in done.findings
        ],
    }
