"""Sentences about conditions that end moves, ramps and cycles of a programme."""

from __future__ import annotations

import math

from fringedic.configuration.conditions import MetCondition, Quantity
from fringedic.configuration.programme import BlockEnd
from fringedic.wording.numbers import number_text

_UNITS = {Quantity.FORCE: " N", Quantity.STRAIN: " %", Quantity.VALID_FRACTION: ""}


def condition_sentence(condition: MetCondition) -> str:
    """Return which condition a reading met."""
    if math.isnan(condition.value):
        return f"the {condition.quantity} is not known"
    unit = _UNITS[condition.quantity]
    reached = "reached" if condition.rising else "fell to"
    return f"the {condition.quantity} of {number_text(condition.value)}{unit} {reached} {condition.limit:g}{unit}"


def block_end_sentence(end: BlockEnd) -> str:
    """Return which block a condition ended, and why."""
    return f"{end.block} ended: {condition_sentence(end.condition)}"
