"""Tables of what was measured against what was asked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["NOT_RUN", "Bar", "print_bars", "print_table"]

NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class Bar:
    """One figure, the range in which it has to lie, and its own standard error if it is sampled."""

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    sigma: float = 0.0

    @property
    def is_met(self) -> bool:
        """False for nan."""
        return self.low <= self.value <= self.high

    @property
    def _range(self) -> str:
        if math.isinf(self.low):
            return f"<= {self.high:g}"
        if math.isinf(self.high):
            return f">= {self.low:g}"
        return f"{self.low:g} to {self.high:g}"

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Name, value, range, verdict."""
        text = f"{self.value:.3g}" if abs(self.value) < 0.1 else f"{self.value:.3f}"
        if self.sigma:
            text += f" +- {self.sigma:.3f}"
        return self.name, text, self._range, "yes" if self.is_met else "NO"


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print in Markdown."""
    print(f"\n| {' | '.join(head)} |")
    print("|" + " --- |" * len(head))
    for row in rows:
        print(f"| {' | '.join(row)} |")


def print_bars(bars: Sequence[Bar]) -> None:
    """Print each figure with its bar."""
    print_table(("figure", "measured", "bar", "met"), [bar.cells for bar in bars])
