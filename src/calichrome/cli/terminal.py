"""What every command shares: the option --json, progress on stderr, results on stdout."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from calichrome.core.units import parse_lengths
from calichrome.errors import TargetError
from calichrome.pipeline.detect import Progress as ProgressCall
from calichrome.report.text import finding_lines
from calichrome.rig import Rig

__all__ = ["Command", "Flag", "Output", "names_from", "square_size"]

Output = tyro.conf.arg(aliases=["-o"])
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True, kw_only=True)
class Command:
    """Base of all commands."""

    json: Flag = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Do the work and return the exit code."""
        raise NotImplementedError

    def show(self, text: str, data: dict[str, Any]) -> None:
        """Print the result for a person, or with --json for a program."""
        print(json.dumps(data, indent=1) if self.json else text)

    def verdict(self, rig: Rig) -> int:
        """Return the exit code of work that was done with a rig: 3 if it is not to be trusted.

        Why not is said on stderr, so that results on stdout stay as they are.
        """
        doubts = [item for item in rig.findings if item.severity == "critical"]
        for line in finding_lines(doubts):
            print(line, file=sys.stderr)
        return 3 if doubts else 0

    @contextmanager
    def progress(self) -> Iterator[ProgressCall]:
        """Yield a callback that draws progress bars on stderr, if someone is watching."""
        console = Console(stderr=True)
        bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _PerSecond(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=self.json or not sys.stderr.isatty(),
        )
        tasks: dict[str, Any] = {}
        with bars:

            def report(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bars.add_task(what, total=total)
                bars.update(tasks[what], completed=done, total=total)

            yield report


class _PerSecond(ProgressColumn):
    """How fast it goes: frames per second of a video."""

    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{task.speed:.1f}/s")


def names_from(values: Sequence[str]) -> tuple[str, ...]:
    """Split lists like ``a,b``; ``a b`` works as well."""
    return tuple(name for value in values for name in value.split(",") if name)


def square_size(text: str) -> tuple[float, float]:
    """Read ``--square``: one length or two, metres."""
    try:
        return parse_lengths(text)
    except ValueError as error:
        raise TargetError(f"--square {error}") from error
