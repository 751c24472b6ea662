"""The table of colour models that were tried, one for each camera."""

from collections.abc import Iterator, Mapping

from calichrome.report.text import table
from calichrome.rig import Rig

__all__ = ["candidates_text"]

_HEADER = (
    "model", "free", "solver", "fit", "left out", "95 %", "exposure", "gain", "white", "reversals",
    "ns/px",
)  # fmt: skip

_SHARED = (
    "\n(Cameras that share what the discs look like choose by that: these errors are against the "
    "discs as all cameras see them,\nthose of the cameras' table against the target.)"
)


def candidates_text(rig: Rig) -> str:
    """Say what every colour model would have done, and why it lost."""
    return "\n".join(_lines(rig))


def _lines(rig: Rig) -> Iterator[str]:
    for name, camera in rig.cameras.items():
        if camera.colour is None:
            continue
        rows = [_row(item) for item in camera.colour.candidates]
        head, *lines = table(_HEADER, [row[:-1] for row in rows])
        yield f"\nColour models of {name}, errors in dE2000"
        yield head
        yield from (f"{line}  {row[-1]}".rstrip() for line, row in zip(lines, rows, strict=True))
    if sum(camera.colour is not None for camera in rig.cameras.values()) > 1:
        yield _SHARED


def _row(item: Mapping[str, object]) -> list[str]:
    return [
        str(item["model"]),
        _said(item, "n_free", ".0f"),
        str(item.get("solver", "-")),
        *(_said(item, key, ".2f") for key in ("fit_mean", "left_out_mean", "left_out_p95")),
        _said(item, "exposure_delta_e", ".2f"),
        _said(item, "gain", ".1f"),
        _said(item, "white_delta_e", ".2f"),
        _said(item, "hue_reversals", ".0f"),
        _said(item, "ns_per_pixel", ".0f"),
        "taken" if item["why_not"] is None else str(item["why_not"]),
    ]


def _said(item: Mapping[str, object], key: str, form: str) -> str:
    value = item.get(key)
    return format(value, form) if isinstance(value, (int, float)) else "-"
