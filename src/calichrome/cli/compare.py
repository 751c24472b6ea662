"""``calichrome compare``."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from calichrome.cli.terminal import Command
from calichrome.core.units import parse_lengths
from calichrome.errors import RecordingError
from calichrome.report.text_compare import comparison_summary, comparison_to_json
from calichrome.rig import load_rig
from calichrome.rig.compare import compare_rigs, evidence_beside

__all__ = ["Compare"]


@dataclass(frozen=True, kw_only=True)
class Compare(Command):
    """Compare two calibrations of the same cameras."""

    first: Positional[Path]
    """rig.json; rig.npz beside it says how sure it is."""
    second: Positional[Path]
    """rig.json of other pictures, another day, or another lens model."""
    distance: str | None = None
    """Distance at which projections are compared, like 0.7m; default: where the boards were."""

    def run(self) -> int:
        """Compare; a difference is an answer, not an error."""
        rigs = load_rig(self.first), load_rig(self.second)
        found = compare_rigs(
            *rigs,
            evidence=(evidence_beside(self.first), evidence_beside(self.second)),
            distance_m=None if self.distance is None else _metres(self.distance),
        )
        self.show(comparison_summary(found), comparison_to_json(found))
        return 0


def _metres(text: str) -> float:
    try:
        return parse_lengths(text)[0]
    except ValueError as error:
        raise RecordingError(f"--distance {error}") from error
