"""The reference of each step, decided from the messages of a recording."""

from __future__ import annotations

from types import SimpleNamespace as Message
from typing import Any

import pytest

from fringedic.steps.recorded_references import RecordedReferences

Recorded = tuple[str, Any]


def reference(step: int, *, lost: bool | None = False, experiment: str = "e") -> Recorded:
    return "experiment/reference", Message(experiment=experiment, step=step, previous_lost=lost)


def end(step: int, stage: int = 3) -> Recorded:
    return "experiment/step", Message(experiment="e", step=step, stage=stage)


def start(node: str, second: int, **values: int) -> Recorded:
    parameters = [Message(name=name, value=Message(type=2, integer_value=value)) for name, value in values.items()]
    header = Message(stamp=Message(sec=second, nanosec=0))
    return "node_parameters", Message(node=node, header=header, parameters=parameters)


def decided(messages: list[Recorded]) -> list[int]:
    recorded = RecordedReferences()
    found = [recorded.take(topic, message) for topic, message in messages]
    return [each for each in found if each is not None]


@pytest.mark.parametrize(
    ("messages", "references"),
    [
        ([reference(0), end(0), reference(4, lost=True), end(4)], [0, 0]),
        ([reference(0), end(0), reference(2), end(2), reference(4, lost=True)], [0, 2, 2]),
        ([reference(0), end(0), reference(2), end(2, stage=4), reference(0), reference(4, lost=True)], [0, 2, 0, 0]),
        ([reference(0), end(0, stage=4), reference(1, lost=True), end(1), reference(3, lost=True)], [0, 1, 1]),
        ([reference(0), end(0), reference(4, lost=True), end(4), reference(6), end(6)], [0, 0, 6]),
        ([reference(0, experiment="f"), reference(4, lost=True)], [0, 4]),
    ],
    ids=["lost", "of a programme", "that failed", "never measured", "asked for after a loss", "of another experiment"],
)
def test_a_step_in_place_of_a_lost_reference_is_none_where_that_one_was_measured(
    messages: list[Recorded], references: list[int]
) -> None:
    assert decided(messages) == references


@pytest.mark.parametrize(
    ("meanwhile", "is_reference"),
    [
        ([start("dic", 9, window=32)], False),
        ([start("coupling", 9, window=32)], False),
        ([start("phase", 9, window=32)], True),
        ([start("dic", 1, window=32)], True),
        ([start("dic", 9, window=24)], True),
        ([start("experiment", 9, first_step=4, reference_step=-1)], False),
        ([start("experiment", 9, first_step=4, reference_step=0)], True),
        ([], True),
    ],
    ids=["dic", "coupling", "phase", "same message again", "changed", "continued", "with its reference", "asked for"],
)
def test_recordings_of_earlier_versions_show_a_loss_by_the_start_of_a_node(
    meanwhile: list[Recorded], is_reference: bool
) -> None:
    """Their references do not contain `previous_lost`. A node publishes its parameters when it starts."""
    starts = [start(node, 1, window=32) for node in ("dic", "coupling", "phase")]
    first = [*starts, start("experiment", 1, first_step=0), reference(0, lost=None), end(0)]
    later = [*meanwhile, reference(4, lost=None), end(4), reference(4, lost=None)]
    assert decided([*first, *later]) == ([0, 4, 4] if is_reference else [0, 0, 0])


def test_a_reference_in_place_of_one_that_is_not_recorded_is_named() -> None:
    recorded = RecordedReferences()
    for topic, message in [reference(4, lost=True), end(4)]:
        recorded.take(topic, message)
    assert (recorded.of("e"), recorded.replaced, recorded.unreplaced) == ({4}, {}, {("e", 4)})
