"""Sentences about a programme: its time and disk space, and the conditions that end its moves."""

from __future__ import annotations

import math

from fringedic.configuration.conditions import MetCondition
from fringedic.configuration.forecast import Forecast
from fringedic.configuration.programme import BlockEnd
from fringedic.wording.numbers import counted, grouped, number_text


def forecast_sentence(forecast: Forecast) -> str:
    """Return one sentence about a forecast."""
    most = "at most " if forecast.early else ""
    free = f" and {grouped(forecast.free_frames)} of the free run" if forecast.free_frames else ""
    steps, frames = counted(forecast.steps, "step"), counted(forecast.frames, "frame")
    return (
        f"{most}{steps}, {frames}{free}: about {_duration(forecast.duration)}, then "
        f"{_duration(forecast.writing)} for dataset and report, if the computer has no other work; "
        f"{_size(forecast.size)} of disk space"
    )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _size(size: float) -> str:
    return f"{size / 1e6:.0f} MB" if size < 1e9 else f"{size / 1e9:.1f} GB"


def condition_sentence(condition: MetCondition) -> str:
    """Return which condition a reading met."""
    if math.isnan(condition.value):
        return f"the {condition.quantity} is not known"
    unit = condition.unit and f" {condition.unit}"
    reached = "reached" if condition.rising else "fell to"
    return f"the {condition.quantity} of {number_text(condition.value)}{unit} {reached} {condition.limit:g}{unit}"


def block_end_sentence(end: BlockEnd) -> str:
    """Return which block a condition ended, and why."""
    return f"{end.block} ended: {condition_sentence(end.condition)}"
