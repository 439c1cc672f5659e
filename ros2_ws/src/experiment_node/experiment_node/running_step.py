"""State of the step that is being measured."""

from __future__ import annotations

import math
import time
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from experiment_node.active_goal import ActiveGoal
from experiment_node.experiments import Experiment
from fringedic.patterns.pattern import ProjectedPattern, middle_two, moving_frames
from fringedic.signals import Channel, SignalCollector
from fringedic_msgs.msg import LoadState, NodeStatus
from fringedic_ros.result_codes import failed_node
from fringedic_ros.stamps import to_nanoseconds

SAMPLES = 200_000  # kept, over three minutes at 1 kHz


@dataclass
class RunningStep:
    """Request and state of the step that is being measured.

    Attributes
    ----------
    goal
        The active goal, which ends the step when it is cancelled.
    patterns
        Pattern of each frame.
    nodes
        Processing nodes whose results end the step.
    on_stage
        Called with the stage and this step when the stage or the number of frames changes.
    previous_lost
        The step is the reference only because nodes have lost the one before.
    started, exposed, answered
        Time [s] of the start, of the last frame and of the last result on the monotonic clock.
    stamps
        Stamps of the frames taken so far [ns].
    requested_ns, answered_ns
        When the first frame was requested and the camera answered the last request, on the clock of this node [ns]: all
        exposures lie between them, whatever the clock of the camera.
    recorded_frames, recorded_crc
        Frames that the recorder has confirmed, and the CRC-32 of the CRCs of their images; 0 before.
    exposures
        Start and end of the exposure of each frame [ns].
    crcs
        CRC-32 of the image of each frame, as the camera sent it.
    statuses
        Status of each processing node that has answered.
    load
        Samples of the load frame since the start, whose modes prove a hold.
    signals
        Signals of the rig since the start.
    load_ahead
        Longest time by which one of them was stamped after its arrival [s]; -inf before the first.
    load_back
        Longest time by which one of them was stamped before the previous one [s]; 0 when the stamps never decrease.
    """

    goal: ActiveGoal
    experiment: Experiment
    number: int
    patterns: tuple[ProjectedPattern, ...]
    nodes: Sequence[str]
    is_reference: bool
    on_stage: Callable[[str, RunningStep], None]
    previous_lost: bool = False
    started: float = field(default_factory=time.monotonic)
    stamps: list[int] = field(default_factory=list)
    requested_ns: int = 0
    answered_ns: int = 0
    exposed: float = 0.0
    answered: float = 0.0
    recorded_frames: int = 0
    recorded_crc: int = 0
    exposures: dict[int, tuple[int, int]] = field(default_factory=dict)
    crcs: dict[int, int] = field(default_factory=dict)
    statuses: dict[str, NodeStatus] = field(default_factory=dict)
    load: deque[LoadState] = field(default_factory=lambda: deque(maxlen=SAMPLES))
    signals: SignalCollector = field(default_factory=lambda: SignalCollector(SAMPLES))
    load_ahead: float = -math.inf
    load_back: float = 0.0

    def is_named(self, experiment: str, step: int) -> bool:
        """Return whether a message with this experiment and step number belongs to this step."""
        return (experiment, step) == (self.experiment.name, self.number)

    def report(self, stage: str) -> None:
        """Report a stage to the client of the goal."""
        self.on_stage(stage, self)

    @property
    def is_moving(self) -> bool:
        """Whether the step is measured in motion: the machine need not hold."""
        return bool(moving_frames(self.patterns))

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
        """The first processing node, in the order of processing, that answered with an error."""
        return failed_node(self.nodes, self.statuses)

    @property
    def processing_time(self) -> float:
        """Time from the last frame to the last result [s]."""
        return max(self.answered - self.exposed, 0.0) if self.statuses else 0.0

    def image_crcs(self) -> list[int]:
        """Return the CRCs of the images in the order of the frames."""
        return [crc for _, crc in sorted(self.crcs.items())]

    def exposed_over(self) -> tuple[int, int]:
        """Return the start of the first exposure and the end of the last one [ns]."""
        return self.exposures[0][0], self.exposures[len(self.patterns) - 1][1]

    def value_of(self, channel: Channel) -> tuple[float, float]:
        """Return mean and range of a signal over the exposures; of a step in motion its value at the time of it."""
        signal = self.signals.signals[channel.name]
        summary = signal.summary_over(*self.exposed_over())
        finest = moving_frames(self.patterns)
        if not finest:
            return summary.mean, summary.spread
        exposures = [self.exposures[k] for k in finest if k in self.exposures]
        first = exposures[0][0]
        time = first + sum(begin + end - 2 * first for begin, end in exposures) / (2 * len(exposures))
        before, after = middle_two(exposures)
        return signal.value_at(time, before[0], after[1]).mean, summary.spread

    def load_around_requests(self) -> list[LoadState]:
        """Return the samples of the load frame that prove a hold on every clock.

        They are those around the exposures and the requests for them, with the last one before and the first one after.
        """
        start, end = self.exposed_over()
        stamps = [to_nanoseconds(sample.header.stamp) for sample in self.load]
        first = max(bisect_right(stamps, min(start, self.requested_ns)) - 1, 0)
        return list(self.load)[first : bisect_left(stamps, max(end, self.answered_ns)) + 1]
