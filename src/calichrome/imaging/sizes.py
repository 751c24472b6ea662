"""Picture sizes as people type them."""

import re

from calichrome.errors import RecordingError

__all__ = ["parse_size"]


def parse_size(text: str) -> tuple[str, tuple[int, int]]:
    """Read ``camera=WIDTHxHEIGHT``.

    Examples
    --------
    >>> parse_size("left=640x480")
    ('left', (640, 480))
    """
    match = re.fullmatch(r"(.+)=(\d{1,6})x(\d{1,6})", text)
    if match is None:
        raise RecordingError(f"--size {text}: write CAMERA=WIDTHxHEIGHT, like left=640x480")
    return match[1], (int(match[2]), int(match[3]))
