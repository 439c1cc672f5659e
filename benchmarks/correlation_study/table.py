"""The table of measured figures beside their targets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One figure or several of a kind, at most as large as their targets.

    `measured` is empty where it could not be measured; `note` says why or on which condition.
    """

    name: str
    measured: tuple[float, ...]
    targets: tuple[float, ...] = ()
    digits: int = 4
    note: str = ""

    @property
    def value(self) -> str:
        """Measured values as text."""
        return " / ".join(_number(value, self.digits) for value in self.measured) or "not available"

    @property
    def target(self) -> str:
        """Targets as text."""
        return "≤ " + " / ".join(_number(value, self.digits) for value in self.targets) if self.targets else ""

    @property
    def verdict(self) -> str:
        """Met or missed, one word for each figure."""
        if not self.targets or not self.measured:
            return ""
        words = ["met" if m <= t else "missed" for m, t in zip(self.measured, self.targets, strict=True)]
        return words[0] if len(set(words)) == 1 else " / ".join(words)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}"


def printed(rows: list[Row]) -> str:
    """The table for a terminal."""
    widths = [max(len(cell) for cell in column) for column in zip(*(_cells(row) for row in rows), strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(_cells(row), widths, strict=True)) for row in rows
    )


def _cells(row: Row) -> tuple[str, str, str, str]:
    name = f"{row.name} ({row.note})" if row.note else row.name
    return name, row.value, row.target, row.verdict
