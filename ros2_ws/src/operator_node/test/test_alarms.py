"""Limits of signals: each requests one hold, in the unit that a person wrote it in."""

from __future__ import annotations

import math

import pytest

from fringedic.errors import OperatorError
from fringedic.report.page_server.app import Alarm
from fringedic.signals import Sample
from fringedic.signals.signal import POSITION
from operator_node.alarms import Alarms


def position(millimetres: float) -> dict[str, Sample]:
    return {"position": Sample(POSITION, 0, 1e-3 * millimetres, math.nan)}


def test_a_limit_is_reached_once_until_it_is_set_again() -> None:
    alarms, requests = Alarms(), list[str]()

    def request(reason: str) -> str:
        requests.append(reason)
        return "a hold was requested"

    def check(millimetres: float) -> list[str]:
        requests.clear()
        alarms.check(position(millimetres), request)
        return list(requests)

    limits = [Alarm(signal="position", above=0.5), Alarm(signal="force", below=-3)]
    assert alarms.set(limits) == "limits in force: 2"
    assert check(0.49) == []
    assert check(math.nan) == []
    assert check(0.5) == ["position 0.5 mm reached its limit 0.5"]
    assert check(0.6) == []
    told = "position 0.5 mm reached its limit 0.5; a hold was requested"
    assert [each["reached"] for each in alarms.shown()] == [told, ""]
    assert alarms.set([Alarm(signal="position", below=0.1, above=0.5)]) == "limits in force: 1"
    assert check(0.05) == ["position 0.05 mm reached its limit 0.1"]


@pytest.mark.parametrize(
    ("alarm", "problem"),
    [(Alarm(signal="force"), "a lower or an upper"), (Alarm(signal="force", below=2, above=1), "not below the upper")],
)
def test_a_limit_without_meaning_is_refused(alarm: Alarm, problem: str) -> None:
    alarms = Alarms()
    alarms.set([Alarm(signal="force", above=9)])
    with pytest.raises(OperatorError, match=problem):
        alarms.set([alarm])
    assert [each["above"] for each in alarms.shown()] == [9]
