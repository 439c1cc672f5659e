"""Limits of signals at which the page requests a hold of the machine.

A request of software, which needs this node and the network: limits that protect people belong to the machine.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fringedic.errors import OperatorError
from fringedic.report.page_server.app import Alarm
from fringedic.report.page_server.maps import described_signal
from fringedic.signals import Sample
from fringedic.wording.translation import Sentence, translatable


class Alarms:
    """Limits and which of them were reached; from any thread. Each limit requests one hold, until it is set again."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._alarms: list[Alarm] = []
        self._reached: dict[int, str] = {}

    def set(self, alarms: Sequence[Alarm]) -> str:
        """Replace all limits, and return a sentence about it.

        Raises
        ------
        OperatorError
            A signal has no limit, or a lower one that is not below the upper one.
        """
        for alarm in alarms:
            if alarm.below is None and alarm.above is None:
                raise OperatorError(Sentence("{signal}: write a lower or an upper limit", signal=alarm.signal))
            if alarm.below is not None and alarm.above is not None and alarm.below >= alarm.above:
                raise OperatorError(
                    Sentence("{signal}: the lower limit is not below the upper one", signal=alarm.signal)
                )
        with self._lock:
            self._alarms, self._reached = list(alarms), {}
        if not alarms:
            return translatable("no limit requests a hold")
        return Sentence("limits in force: {count}", count=len(alarms))

    def check(self, latest: Mapping[str, Sample], request: Callable[[str], str]) -> None:
        """Request a hold for each limit that the latest samples reach and that was not reached before.

        Parameters
        ----------
        latest
            Samples by the names of their signals.
        request
            Called with a sentence about the limit; requests the hold, and returns what became of it.
        """
        with self._lock:
            for number, alarm in enumerate(self._alarms):
                sample = latest.get(alarm.signal)
                if sample is None or number in self._reached:
                    continue
                unit = described_signal(alarm.signal, sample.channel.unit, sample.channel.source)
                value = sample.value / unit["factor"]
                limit = _limit(alarm, value)
                if limit is not None:
                    shown = {"value": f"{value:.4g}", "unit": unit["unit"], "limit": f"{limit:g}"}
                    reason = Sentence("{signal} {value} {unit} reached its limit {limit}", signal=alarm.signal, **shown)
                    self._reached[number] = Sentence("{reason}; {answer}", reason=reason, answer=request(reason))

    def answer(self, reason: str, words: str) -> None:
        """Tell what became of the hold that was requested for a reason."""
        with self._lock:
            for number, reached in self._reached.items():
                if reached.startswith(f"{reason}; "):
                    self._reached[number] = Sentence("{reason}; {answer}", reason=reason, answer=words)

    def shown(self) -> list[dict[str, Any]]:
        """Return the limits for the page, with the sentence about each that was reached."""
        with self._lock:
            return [
                alarm.model_dump() | {"reached": self._reached.get(number, "")}
                for number, alarm in enumerate(self._alarms)
            ]


def _limit(alarm: Alarm, value: float) -> float | None:
    """Return the limit that a value reaches, None for none; NaN reaches none, because it is not known."""
    if alarm.above is not None and value >= alarm.above:
        return alarm.above
    return alarm.below if alarm.below is not None and value <= alarm.below else None
