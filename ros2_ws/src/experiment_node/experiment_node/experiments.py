"""Experiments: names, step numbers and references."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime


@dataclass
class Experiment:
    """Step numbers and references of one experiment.

    Attributes
    ----------
    next_step
        Number of the next step; no number is used twice.
    measured
        Numbers of the steps that succeeded.
    reference
        Step that the others are measured against; None before the first.
    next_is_reference
        The next step becomes the reference.
    previous_lost
        It does so only because nodes have lost the reference, see fringedic_msgs/Reference.
    reference_replaces
        The reference became one for this reason.
    has_load_frame
        A load frame was seen; from then on every step needs its samples.
    ready
        All nodes that need its messages were connected before the first frame of a step.
    """

    name: str
    next_step: int = 0
    measured: set[int] = field(default_factory=set)
    reference: int | None = None
    next_is_reference: bool = True
    previous_lost: bool = False
    reference_replaces: bool = False
    has_load_frame: bool = False
    ready: bool = False

    def take_number(self) -> int:
        """Return the number of a new step."""
        self.next_step += 1
        return self.next_step - 1

    def require_reference(self, *, previous_lost: bool) -> None:
        """Make the next step the reference; one that was asked for remains so when the present one is lost, too."""
        asked_for = self.next_is_reference and not self.previous_lost
        self.next_is_reference, self.previous_lost = True, previous_lost and not asked_for

    def set_reference(self, step: int, *, replaces: bool = False) -> None:
        """Make a measured step the reference."""
        self.reference, self.reference_replaces = step, replaces
        self.next_is_reference = self.previous_lost = False


class Experiments:
    """The experiments of one process of the node; each name belongs to one experiment."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._names

    def begin(self, name: str = "") -> Experiment:
        """Return a new experiment; without a name, it is named after the time, to the microsecond."""
        experiment = Experiment(name or datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S.%f"))
        self._names.add(experiment.name)
        return experiment

    def resume(self, name: str, next_step: int, reference: int | None, *, previous_lost: bool = False) -> Experiment:
        """Return an experiment that an earlier process began, with the step that is still its reference.

        With `previous_lost` the first step takes the place of a reference that the nodes do not have any more.
        """
        experiment = self.begin(name)
        experiment.next_step = next_step
        if reference is not None:
            experiment.measured.add(reference)
            experiment.set_reference(reference)
        else:
            experiment.previous_lost = previous_lost
        return experiment
