"""What a user can act on; wrong calls raise ``ValueError`` or ``TypeError``.

Every message says what was found, where, and what to do about it.
"""

from collections.abc import Sequence

__all__ = [
    "AmbiguousBoardError",
    "CalichromeError",
    "DetectionError",
    "DisconnectedRigError",
    "FileFormatError",
    "InterruptedOutputError",
    "OutputError",
    "RecordingError",
    "SolveError",
    "TargetError",
]


class CalichromeError(Exception):
    """Base of everything that the command line reports in one sentence (exit code 1)."""


class TargetError(CalichromeError):
    """The printed target is described wrongly, or cannot be printed as asked."""


class RecordingError(CalichromeError):
    """The pictures cannot be read as a recording."""


class FileFormatError(CalichromeError):
    """A file of ours (rig, target, corners) is damaged or from another release."""


class OutputError(CalichromeError):
    """An output cannot be written, or would overwrite something."""


class InterruptedOutputError(OutputError):
    """Ctrl-C ended the work; what was done is kept under names that say so."""


class DetectionError(CalichromeError):
    """No board was found where one is needed."""


class SolveError(CalichromeError):
    """The observations do not determine what was asked for."""


class AmbiguousBoardError(SolveError):
    """A board that looks the same after half a turn, and no rig that decides it."""

    def __init__(self, frames: Sequence[str]) -> None:
        self.frames = tuple(frames)
        super().__init__(
            f"the board looks the same after half a turn and the other cameras do not decide which "
            f"way up it was in {_enumerate(self.frames)}; print a board whose corner counts have "
            f"different parity (for example 9x6), or leave these frames out"
        )


class DisconnectedRigError(SolveError):
    """Groups of cameras that never see the board at the same instant."""

    def __init__(self, groups: Sequence[Sequence[str]]) -> None:
        self.groups = tuple(tuple(group) for group in groups)
        named = " | ".join(", ".join(group) for group in self.groups)
        super().__init__(
            f"the cameras fall into {len(self.groups)} groups that never see the board at the same "
            f"time: {named}; record at least three board poses that are visible to one camera of "
            f"each group, or calibrate the groups apart with --cameras"
        )


def _enumerate(names: Sequence[str], most: int = 6) -> str:
    shown = ", ".join(names[:most])
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{'frame' if len(names) == 1 else 'frames'} {shown}{more}"
