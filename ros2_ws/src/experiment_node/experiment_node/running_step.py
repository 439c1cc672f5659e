"""What is known of an experiment, and of the step of it that is being measured."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from experiment_node.turn import Turn
from fringedic.load_samples import samples_over
from fringedic.sequence import Projection
from fringedic_msgs.msg import LoadState, NodeStatus
from fringedic_ros.stamps import to_nanoseconds

LOAD_SAMPLES = 200_000  # kept, over three minutes at 1 kHz


@dataclass
class Experiment:
    """Numbers and references of one experiment.

    Attributes
    ----------
    next_step
        Number of the step measured next; never used twice.
    measured
        Steps that succeeded.
    reference
        The step that the others are measured against.
    next_is_reference
        The step measured next becomes the reference.
    ready
        Everybody who has to hear of its steps was connected at the first one.
    """

    name: str
    next_step: int = 0
    measured: set[int] = field(default_factory=set)
    reference: int | None = None
    next_is_reference: bool = True
    ready: bool = False

    def take_number(self) -> int:
        """Return the number of a new step."""
        self.next_step += 1
        return self.next_step - 1


@dataclass
class RunningStep:
    """What is known of the step that is being measured.

    Attributes
    ----------
    nodes
        Processing nodes whose results end the step.
    feed_back
        Called with the stage whenever it or the number of frames changes.
    """

    turn: Turn
    experiment: Experiment
    number: int
    projections: tuple[Projection, ...]
    nodes: Sequence[str]
    is_reference: bool
    feed_back: Callable[[str, RunningStep], None]
    started: float = field(default_factory=time.monotonic)
    stamps: list[int] = field(default_factory=list)  # of the frames taken so far [ns]
    exposed: float = 0.0  # when the last frame was reported [s], monotonic
    answered: float = 0.0  # when the last result came [s], monotonic
    recorder_answered: bool = False  # to the stage PROCESS
    exposures: dict[int, tuple[int, int]] = field(default_factory=dict)  # start and end of each frame [ns]
    statuses: dict[str, NodeStatus] = field(default_factory=dict)
    load: deque[LoadState] = field(default_factory=lambda: deque(maxlen=LOAD_SAMPLES))

    def is_named(self, experiment: str, step: int) -> bool:
        """Whether a message with these names speaks of this step."""
        return (experiment, step) == (self.experiment.name, self.number)

    @property
    def stamp(self) -> int:
        """Stamp of the last frame taken so far [ns], 0 before the first."""
        return self.stamps[-1] if self.stamps else 0

    @property
    def taken(self) -> int:
        """Number of frames taken so far."""
        return len(self.stamps)

    @property
    def failed_node(self) -> str | None:
        """The first node of the chain that answered with an error."""
        for name in self.nodes:
            if name in self.statuses and self.statuses[name].error_code != NodeStatus.NONE:
                return name
        return None

    @property
    def processing_time(self) -> float:
        """From the last exposure to the last result [s]."""
        return max(self.answered - self.exposed, 0.0) if self.statuses else 0.0

    def load_during_exposures(self) -> list[LoadState]:
        """Return the samples from the start of the first exposure to the end of the last one, or those beside it."""
        start, end = self.exposures[0][0], self.exposures[len(self.projections) - 1][1]
        samples = list(self.load)
        chosen = samples_over([to_nanoseconds(sample.header.stamp) for sample in samples], start, end)
        return [samples[index] for index in chosen.nonzero()[0]]
