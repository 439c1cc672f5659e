"""Sentences about the units of a campaign."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from fringedic.campaign.plan import Plan, Unit
from fringedic.campaign.receipts import Failure, Receipt
from fringedic.campaign.run import Status
from fringedic.campaign.store import RECEIPTS, RECORDINGS
from fringedic.wording.numbers import counted

_SHOWN = 20  # failures, before the rest is counted


def plan_sentences(plan: Plan) -> list[str]:
    """Return what a plan contains, refuses and finds odd."""
    steps, size = sum(unit.steps for unit in plan.units), sum(unit.size for unit in plan.units)
    largest = max((unit.memory for unit in plan.units), default=0.0)
    return [
        f"plan: {len(plan.units)} of {counted(plan.size, 'recording')}, about {counted(steps, 'step')}, "
        f"{1e-9 * size:.2f} GB, {1e-9 * largest:.1f} GB of memory per worker, store {plan.store}",
        *(
            f"odd: {name} has images of {columns}x{rows} px, unlike most recordings"
            for name, (rows, columns) in plan.unusual_shapes.items()
        ),
        *(f"being recorded: {unit.name}" for unit in plan.units if unit.growing),
        *(f"refused: {reason}" for reason in plan.refused.values()),
    ]


def status_sentences(status: Status) -> list[str]:
    """Return the state of a campaign and its failures."""
    counts = f"{len(status.done)} of {counted(status.plan.size, 'recording')} complete"
    return [
        f"{counts}, {len(status.failed)} failed, {len(status.waiting)} waiting, {len(status.plan.refused)} refused",
        *_list("begun", [_begun_words(name, begun) for name, begun in status.begun.items()]),
        *_list("refused", list(status.plan.refused.values())),
        *_list("failed", [failure.reason for failure in status.failed.values()]),
        *unplanned_sentences(status),
    ]


def unrecorded_sentences(store: str, failures: Sequence[Failure]) -> list[str]:
    """Return which recordings failed without a record of it in the store, and what to do; nothing without any."""
    reasons = [f"{failure.name}: {failure.reason}" for failure in failures]
    words = f"failed, and the store {store} cannot be written: make it writable and repeat the command, which continues"
    return list(_list(words, reasons))


def verification_sentences(status: Status, damaged: list[str]) -> list[str]:
    """Return whether the results in a store are those of their receipts, and what to do with the others."""
    if not damaged:
        return [f"verified: all objects of {counted(len(status.done), 'recording')} have the checksum of their receipt"]
    store = status.plan.store
    reasons = _list(
        "damaged",
        [
            f"{name}: {store}/{RECORDINGS}/{name} is not what was written; remove {store}/{RECEIPTS}/{name}.json and "
            "repeat 'fringedic campaign run', which processes it again"
            for name in damaged
        ],
    )
    return list(reasons)


def unplanned_sentences(status: Status) -> list[str]:
    """Return which results of a store are not opened because the plan does not contain them; nothing without any."""
    if not status.unplanned:
        return []
    return [
        f"not opened: results of {counted(len(status.unplanned), 'recording')} that the plan does not contain, such as "
        f"{status.unplanned[0]}; 'fringedic campaign run --recompute' removes them"
    ]


def _begun_words(name: str, begun: dict[str, Any]) -> str:
    steps, attempts = begun["steps"], begun["attempts"]
    measured = f", {counted(steps, 'step')} measured while it is recorded" if steps else ""
    return f"{name} by {begun['worker']}{measured}" + (f", attempt {attempts}" if attempts > 1 else "")


def _list(what: str, reasons: list[str]) -> Iterator[str]:
    yield from (f"{what}: {reason}" for reason in reasons[:_SHOWN])
    if len(reasons) > _SHOWN:
        yield f"{what}: {len(reasons) - _SHOWN} more"


@dataclass
class CampaignProgress:
    """Rates and remaining time while units are processed.

    Attributes
    ----------
    units
        Those that are to be processed.
    finished
        Their outcomes so far.
    """

    units: list[Unit]
    finished: list[Receipt | Failure] = field(default_factory=list)

    def sentence(self, outcome: Receipt | Failure, seconds: float) -> str:
        """Take an outcome and return one line about it.

        Parameters
        ----------
        outcome
            Of a unit.
        seconds
            Since the beginning.
        """
        self.finished.append(outcome)
        place = f"{len(self.finished)} of {len(self.units)}: {outcome.name}"
        if isinstance(outcome, Failure):
            return f"{place} failed: {outcome.reason}"
        failed = outcome.figures["failed_steps"]
        words = f"{place}: {counted(outcome.figures['steps'], 'step')}" + (f", {failed} failed" if failed else "")
        done = [outcome for outcome in self.finished if isinstance(outcome, Receipt)]
        seconds = max(seconds, 1e-3)
        steps = sum(receipt.figures["steps"] for receipt in done) / seconds
        rate = sum(receipt.input_size for receipt in done) / seconds
        names = {outcome.name for outcome in self.finished}
        left = sum(unit.size for unit in self.units if unit.name not in names)
        to_go = left / max(rate, 1.0)
        duration = f"{to_go / 60:.0f} min" if to_go < 6000 else f"{to_go / 3600:.1f} h"
        if to_go < 100:
            duration = f"{to_go:.0f} s"
        text = f"{words}, {outcome.seconds:.1f} s; {steps:.2g} steps/s, {1e-6 * rate:.3g} MB/s, {duration} left"
        lost = sum(isinstance(outcome, Failure) for outcome in self.finished)
        retried = sum(isinstance(outcome, Receipt) and outcome.attempts > 1 for outcome in self.finished)
        return text + (f", {lost} failed" if lost else "") + (f", {retried} retried" if retried else "")
