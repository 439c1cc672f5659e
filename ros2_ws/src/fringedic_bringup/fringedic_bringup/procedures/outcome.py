"""How an operator controls a programme."""

from __future__ import annotations

from fringedic.command.outcome import StepReport


class RunControl:
    """Lets an operator pause or end a programme, and see its steps; this one does neither."""

    def check(self) -> None:
        """End the programme by a `FringedicError`; called about ten times a second while it waits."""

    def may_begin(self) -> bool:
        """Return whether the next step may begin; asked until it may."""
        return True

    def measured(self, report: StepReport) -> None:
        """Take the outcome of a step."""
