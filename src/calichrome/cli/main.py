"""The command ``calichrome``."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from calichrome._version import __version__
from calichrome.cli.calibrate import Calibrate
from calichrome.cli.check import Check
from calichrome.cli.compare import Compare
from calichrome.cli.correct import Correct
from calichrome.cli.demo import Demo
from calichrome.cli.detect import Detect
from calichrome.cli.export import Export
from calichrome.cli.observe import Observe
from calichrome.cli.record import Record
from calichrome.cli.rectify import Rectify
from calichrome.cli.simulate import Simulate
from calichrome.cli.target import TargetCheck, TargetMake
from calichrome.cli.target_measure import TargetMeasure
from calichrome.cli.terminal import Command
from calichrome.cli.triangulate import Triangulate
from calichrome.errors import CalichromeError

__all__ = ["main"]


@dataclass(frozen=True, kw_only=True)
class _Target:
    """Design, check or measure a target: make | check | measure."""

    action: (
        Annotated[TargetMake, tyro.conf.subcommand("make")]
        | Annotated[TargetCheck, tyro.conf.subcommand("check")]
        | Annotated[TargetMeasure, tyro.conf.subcommand("measure")]
    )

    def run(self) -> int:
        """Run the chosen action."""
        return self.action.run()


_Commands = (
    Annotated[_Target, tyro.conf.subcommand("target")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[Detect, tyro.conf.subcommand("detect")]
    | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
    | Annotated[Correct, tyro.conf.subcommand("correct")]
    | Annotated[Rectify, tyro.conf.subcommand("rectify")]
    | Annotated[Triangulate, tyro.conf.subcommand("triangulate")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Observe, tyro.conf.subcommand("observe")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 done and trustworthy; 1 cannot, with one sentence on stderr; 2 wrong usage; 3 done, but a
        critical finding says not to trust it.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:
        print(f"calichrome {__version__}")
        return 0
    try:
        command: Command | _Target = tyro.cli(
            _Commands,
            prog="calichrome",
            description="Calibrate camera rigs in geometry and colour from one printed board.",
            args=arguments,
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
        )
    except SystemExit as stop:  # tyro has printed help (0) or what is wrong with the words (2)
        return int(stop.code or 0)
    return _run(command)


def _run(command: Command | _Target) -> int:
    """Run a command; whatever its user can act on becomes one sentence."""
    try:
        return command.run()
    except CalichromeError as error:
        reason = str(error)
    except BrokenPipeError:  # the reader, like head, has seen enough
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123
        return 0
    except OSError as error:  # of files that nobody expected to be in the way
        reason = (
            f"{error.filename or 'a file'} cannot be read or written ({error.strerror or error}); "
            f"check the path, its permissions and the space on the disk"
        )
    except MemoryError as error:
        reason = f"there is not enough memory ({error}); use smaller pictures"
    except KeyboardInterrupt:
        reason = "interrupted; what was being written is left out"
    print(f"calichrome: {' '.join(reason.split())}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
