"""What the page shows of a rig file and of a programme."""

from __future__ import annotations

import pytest

from operator_node.rig_file import programme_rows


def test_rows_of_a_programme_are_its_steps() -> None:
    rows = programme_rows("{ramp: {to_mm: 1.0, steps: 3, speed_mm_per_s: 2.0}}")
    assert [row["position_mm"] for row in rows] == [0.0, 0.5, 1.0]
    assert {row["speed_mm_per_s"] for row in rows} == {2.0}


@pytest.mark.parametrize("text", ["", "ramp: [", "ramp: 3", "- 5", "{ramp: {steps: 1}}"])
def test_a_wrong_programme_has_no_rows(text: str) -> None:
    assert programme_rows(text) == []
