"""Step numbers and references of experiments."""

from __future__ import annotations

import pytest

from experiment_node.experiments import Experiments


@pytest.mark.parametrize("lost", [True, False])
def test_an_experiment_that_is_continued_has_lost_its_reference(lost: bool) -> None:
    experiment = Experiments().resume("plate", 4, None, previous_lost=lost)
    assert (experiment.next_is_reference, experiment.previous_lost) == (True, lost)
    experiment.set_reference(experiment.take_number(), replaces=experiment.previous_lost)
    assert (experiment.reference, experiment.reference_replaces) == (4, lost)
    assert (experiment.next_is_reference, experiment.previous_lost) == (False, False)


def test_a_reference_that_was_asked_for_remains_so_when_the_present_one_is_lost() -> None:
    experiment = Experiments().begin("plate")
    experiment.set_reference(0)
    experiment.require_reference(previous_lost=True)
    assert experiment.previous_lost
    experiment.require_reference(previous_lost=False)
    experiment.require_reference(previous_lost=True)
    assert (experiment.next_is_reference, experiment.previous_lost) == (True, False)


def test_the_reference_of_an_earlier_process_remains() -> None:
    experiment = Experiments().resume("plate", 4, 2)
    assert (experiment.reference, experiment.next_is_reference, experiment.measured) == (2, False, {2})
