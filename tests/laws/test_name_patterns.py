"""Names of pictures as camera and frame, with the examples of the contract."""

import pytest

from calichrome.errors import RecordingError
from calichrome.imaging.pattern import NamePattern


@pytest.mark.parametrize(
    ("pattern", "path", "expected"),
    [
        ("{camera}_{frame}", "left_0001", ("left", "0001")),
        ("{camera}_{frame}", "cam_a_001", ("cam_a", "001")),  # the frame is the shortest match
        ("{camera:left|right}{frame}", "left01", ("left", "01")),
        ("{camera:left|right}{frame}", "right12", ("right", "12")),
        ("{camera:left|right}{frame}", "middle01", None),
        ("{camera:left|right}{frame}", "left", None),  # a frame has a name
        ("{camera}/{camera}{frame}", "left/left7", ("left", "7")),
        ("{camera}/{camera}{frame}", "left/right7", None),  # repeated fields must be equal
        ("{camera}/{frame}", "a/b/c", None),  # a field does not pass a folder
        ("shots/{frame}", "shots/17", ("cam0", "17")),  # one camera, no field for it
        ("{frame}.{camera}", "f1.left", ("left", "f1")),  # the dot is a dot
        ("{frame}.{camera}", "f1xleft", None),
        ("{camera:a.b|c}{frame}", "a.b1", ("a.b", "1")),
        ("{camera:a.b|c}{frame}", "axb1", None),
    ],
)
def test_patterns_read_names(pattern: str, path: str, expected: tuple[str, str] | None) -> None:
    assert NamePattern.compile(pattern).match(path) == expected


@pytest.mark.parametrize(
    ("pattern", "reason"),
    [
        ("{camera}", "must hold {frame}"),
        ("{cam}_{frame}", "{cam} is not a field"),
        ("{frame}_{", "must hold {frame}"),
        ("", "must hold {frame}"),
    ],
)
def test_patterns_that_cannot_do_are_refused(pattern: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        NamePattern.compile(pattern)
