"""Lengths and durations as people type them: a number with its unit."""

import math
import re

__all__ = ["parse_duration", "parse_length", "parse_lengths"]

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0}
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(mm|cm|m|in)?\s*")


def parse_length(text: str) -> float:
    """Return metres.

    Raises
    ------
    ValueError
        If the unit is missing, the text is not a length, or it is not positive.

    Examples
    --------
    >>> parse_length("30mm"), parse_length("1.2in")
    (0.03, 0.03048)
    """
    match = _LENGTH.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a length: write a number and mm, cm, m or in, like 30mm")
    if match[2] is None:
        raise ValueError(f"{text!r} has no unit: write {text.strip()}mm, {text.strip()}cm ...")
    metres = float(f"{float(match[1]) * _METRES[match[2]]:.15g}")  # 39.7mm is 0.0397, not ..06
    if not 0 < metres < math.inf:
        raise ValueError(f"{text!r} is not a positive length")
    return metres


def parse_lengths(text: str) -> tuple[float, float]:
    """Return metres along x and y of "39.7mm" or "39.7x39.9mm".

    Examples
    --------
    >>> parse_lengths("39.7x39.9mm")
    (0.0397, 0.0399)
    """
    first, cross, second = text.partition("x")
    if not cross:
        return (parse_length(text),) * 2
    unit = re.search(r"[a-z]+\s*$", second)
    if unit is not None and re.search(r"[a-z]", first) is None:
        first += unit[0]
    return parse_length(first), parse_length(second)


def parse_duration(text: str) -> float:
    """Return seconds.

    Raises
    ------
    ValueError
        If the text is not a number with its unit.

    Examples
    --------
    >>> parse_duration("2s"), parse_duration("500ms")
    (2.0, 0.5)
    """
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(ms|s|min)\s*", text)
    if match is None:
        raise ValueError(f"{text!r} is not a duration: write a number and ms, s or min, like 2s")
    return float(match[1]) * _SECONDS[match[2]]
