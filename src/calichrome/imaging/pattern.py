"""File names as camera and frame: ``{camera}_{frame}``, ``{camera:left|right}{frame}``."""

import re
from dataclasses import dataclass

from calichrome.errors import RecordingError

__all__ = ["NamePattern"]

_FIELD = re.compile(r"\{(\w+)(?::([^{}]*))?\}")


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A compiled ``--pattern``.

    It matches the path below the recording without its extension, ``/`` included. A field may
    repeat and must then be equal; ``{camera:a|b}`` lists what the camera may be; ``{frame}`` is
    the shortest match that works.

    Examples
    --------
    >>> NamePattern.compile("{camera:left|right}{frame}").match("left01")
    ('left', '01')
    >>> NamePattern.compile("{camera}/{camera}{frame}").match("left/left7")
    ('left', '7')
    >>> NamePattern.compile("{camera}_{frame}").match("cam_a_001")
    ('cam_a', '001')
    """

    text: str
    expression: re.Pattern[str]

    @classmethod
    def compile(cls, text: str) -> "NamePattern":
        """Compile, or raise `RecordingError` with the remedy."""
        parts: list[str] = []
        seen: set[str] = set()
        position = 0
        for match in _FIELD.finditer(text):
            parts.append(re.escape(text[position : match.start()]))
            position = match.end()
            name, choices = match[1], match[2]
            if name not in ("camera", "frame"):
                raise RecordingError(
                    f"--pattern {text}: {{{name}}} is not a field; use {{camera}} and {{frame}}"
                )
            if name in seen:
                parts.append(f"(?P={name})")
            elif choices is not None:
                parts.append(f"(?P<{name}>{'|'.join(map(re.escape, choices.split('|')))})")
            else:
                parts.append(f"(?P<{name}>[^/]+{'?' if name == 'frame' else ''})")
            seen.add(name)
        rest = text[position:]
        if "frame" not in seen or re.search(r"[{}]", rest):
            raise RecordingError(
                f"--pattern {text}: must hold {{frame}}, and {{camera}} for more than one camera, "
                f'like "{{camera}}_{{frame}}" or "{{camera:left|right}}{{frame}}"'
            )
        return cls(text, re.compile("".join(parts) + re.escape(rest)))

    def match(self, path: str) -> tuple[str, str] | None:
        """Return (camera, frame), or None; the camera is ``cam0`` where no field names it."""
        found = self.expression.fullmatch(path)
        if found is None:
            return None
        fields = found.groupdict()
        return fields.get("camera") or "cam0", fields["frame"]
