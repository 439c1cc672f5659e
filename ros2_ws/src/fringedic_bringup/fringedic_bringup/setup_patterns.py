"""Patterns that a person chooses for the projector while a rig is set up."""

from __future__ import annotations

from enum import StrEnum

from fringedic.patterns.pattern import PatternKind


class ShownPattern(StrEnum):
    """Patterns of `fringedic show`."""

    CROSSHAIR = "crosshair"
    GRID = "grid"
    FOCUS = "focus"
    WHITE = "white"
    GREY = "grey"
    DARK = "dark"
    FRINGES = "fringes"


class LivePattern(StrEnum):
    """Patterns of `fringedic live`."""

    WHITE = "white"
    FRINGES = "fringes"
    FOCUS = "focus"
    CROSSHAIR = "crosshair"

    @property
    def kind(self) -> PatternKind:
        """Kind of the projected pattern."""
        kinds = {LivePattern.WHITE: PatternKind.WHITE, LivePattern.FRINGES: PatternKind.FRINGES}
        return kinds.get(self, PatternKind.OTHER)
