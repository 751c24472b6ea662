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
    match = re.fullmatch(r"(.+)=([1-9]\d{0,5})x([1-9]\d{0,5})", text)
    if match is None:
        raise RecordingError(f"--size {text}: write CAMERA=WIDTHxHEIGHT, like left=640x480")
    return match[1], (int(match[2]), int(match[3]))
