"""Load frame and signals as a step observes them: the machine must hold, and limited signals must not drift."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.running_step import RunningStep
from fringedic.errors import WaitTimeoutError
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic.signals import FORCE, POSITION, summarise
from fringedic.wording.numbers import number_text
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import LoadState
from fringedic_msgs.msg import Signal as SignalMessage
from fringedic_ros.arrivals import MOST_AHEAD_S, MOST_BEHIND_S, Arrivals
from fringedic_ros.polled import PolledTopic
from fringedic_ros.qos import STATE
from fringedic_ros.signals import add_signals
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result
HELD = (LoadState.HOLD, LoadState.IDLE)
IDLE_PERIOD = 0.1  # [s] after which samples are read between steps
SAMPLE_TIMEOUT = 6.0  # [s] for a sample of the present, or of after the last exposure, to arrive: until the lease of a
# killed process ends, for whose memory a publisher may have to wait; its samples show the machine at their stamps
LONGEST_GAP = 1.0  # [s] between two samples that prove a hold: more than twice the period of the lowest rate, 2 Hz
MOST_AHEAD, MOST_BEHIND = MOST_AHEAD_S, MOST_BEHIND_S  # [s] of a stamp before and after the arrival of its sample
MOST_BACK = MOST_AHEAD  # [s] by which it may be earlier than the stamp of the sample before
FEWEST_FOR_NOISE = 5  # samples of the position
REVERSED, CERTAIN = 0.2, 6.0  # of the range and the noise of the position, by which it goes back when it reverses
RECENT = 30.0  # [s] in which one sample has to come in time: a busy computer delays some, a clock that is behind all
JUMPED_BACK = "the clock jumped back; measure the step again, and do not set the clock during a test"


class LoadWatch:
    """Collects the samples of load frame and signals and checks them before, during and after the exposures of a step.

    Only samples that were acquired in the meantime prove a hold. A load frame that was seen once in an experiment is
    expected from then on: a process that was stopped or killed publishes nothing, whatever the machine does.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    changed
        Notified after each sample of a running step.
    """

    def __init__(self, node: Node, changed: Condition) -> None:
        self._step: RunningStep | None = None
        self._node = node
        self._changed = changed
        self._latest: LoadState | None = None
        self._ahead = 0.0  # [s] by which the latest sample was stamped after its arrival
        self._arrival = self._in_time = -math.inf  # [s] of the latest sample, and of the latest one in time
        self._arrivals = Arrivals(node, LoadState, "load_frame/state")
        self._samples = PolledTopic[LoadState](node, LoadState, "load_frame/state", STATE, callback=self._take)
        self._signals = PolledTopic[SignalMessage](node, SignalMessage, "signals", STATE, callback=self._take_signal)
        for topic in (self._samples, self._signals):
            node.create_timer(IDLE_PERIOD, topic.read)

    @property
    def latest_stamp(self) -> Time:
        """Stamp of the latest sample; zero before the first."""
        return Time() if self._latest is None else self._latest.header.stamp

    @contextmanager
    def collecting(self, step: RunningStep) -> Iterator[None]:
        """Context of a running step, which collects the samples as soon as they arrive."""
        with self._samples.listening(), self._signals.listening():
            self._step = step
            try:
                yield
            finally:
                self._step = None

    def _take(self, message: LoadState) -> None:
        self._arrivals.take_stamped(to_nanoseconds(message.header.stamp))
        if self._latest is not None and _seconds_between(message, self._latest) > 0:
            self._in_time = -math.inf  # its clock was set back
        self._latest, self._ahead, self._arrival = message, _ahead(message), time.monotonic()
        if self._ahead >= -MOST_BEHIND:
            self._in_time = self._arrival
        if self._step is not None:
            _collect(self._step, message)
            self._changed.notify()

    def _take_signal(self, message: SignalMessage) -> None:
        if self._step is not None:
            add_signals(self._node, self._step.signals, "signals", message)
            self._changed.notify()

    def _is_expected(self, step: RunningStep, parameters: ExperimentNodeSettings) -> bool:
        """Return whether the rig has a load frame; one that published once in an experiment belongs to it."""
        if parameters.load_frame or self._node.count_publishers("load_frame/state"):
            step.experiment.has_load_frame = True
        return step.experiment.has_load_frame

    async def await_hold(self, step: RunningStep, parameters: ExperimentNodeSettings, begin: int) -> None:
        """Check before the first frame that an expected load frame holds, by a sample acquired since `begin` [ns].

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD.
        """
        if not self._is_expected(step, parameters) or not _must_hold(step, parameters):
            return
        timeout = SAMPLE_TIMEOUT if self._latest is not None else parameters.start_timeout_s
        await self._await_sample(step, begin, timeout)
        if not step.load and self._latest is not None:
            _collect(step, self._latest)  # of a clock that is ahead: it came before the step
        self.check_latest(step, parameters)

    async def _await_sample(self, step: RunningStep, after: int, timeout: float) -> None:
        """Wait for a sample that was acquired after a time [ns].

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD.
        """

        def is_there() -> bool:
            return self._latest is not None and to_nanoseconds(self._latest.header.stamp) >= after

        self._arrivals.renew()
        await step.goal.wait(
            is_there,
            timeout,
            lambda: (Result.LOAD_NOT_HELD, f"whether the machine holds is unknown: {self._arrivals}"),
        )

    def check_latest(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        """Check that the latest sample shows a hold, when one is required.

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD.
        """
        if _must_hold(step, parameters) and step.experiment.has_load_frame:
            self._check_clock(step, Result.LOAD_NOT_HELD)
            _check_held([self._latest])

    def _check_clock(self, step: RunningStep, code: int) -> None:
        """End the step when samples do not show the machine at the time of their stamp."""
        if step.load_ahead > MOST_AHEAD:
            raise _clock_failure(code, "load frame", step.load_ahead, MOST_AHEAD)
        if step.load_back > MOST_BACK:
            raise StepFailure(
                code,
                f"a sample of the load frame is stamped {step.load_back:.1f} s before the previous one: {JUMPED_BACK}",
            )
        if self._arrival - self._in_time > RECENT:
            raise _clock_failure(code, "load frame", self._ahead, MOST_BEHIND)

    async def check_exposures(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        """Check hold and drift over the exposures of a step, whose records have arrived; in motion its times.

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD also without samples that show a hold before, during and after the exposures; LOAD_DRIFT also
            when a drift that has a limit is unknown. One of the two when the clocks differ: force and position of the
            step, which are chosen by stamps, would be those of another time. In motion LOAD_DRIFT also when the
            crosshead reversed.
        """
        expected = self._is_expected(step, parameters)
        limits = [limit for limit in drift_limits(parameters) if expected or not limit.needs_load_frame]
        if step.is_moving:  # what is required has to be known, whatever its drift
            limits = [limit for limit in limits if math.isinf(limit.largest)]
        if not expected and not limits and not step.is_moving:
            return
        start, end = step.exposed_over()
        hold_required = expected and _must_hold(step, parameters)
        code = Result.LOAD_NOT_HELD if hold_required else Result.LOAD_DRIFT
        _check_camera_clock(step, code)
        if hold_required:
            await self._await_sample(step, max(end, step.answered_ns), SAMPLE_TIMEOUT)
        if expected:
            self._check_clock(step, code)
        if hold_required:
            _check_held_throughout(step.load_around_requests(), start)

        def show_end() -> bool:
            """Return whether the latest samples are from after the exposures and contain every limited signal."""
            latest = step.signals.latest
            if expected and (not step.load or to_nanoseconds(step.load[-1].header.stamp) < end):
                return False
            samples = [latest.get(limit.signal) for limit in limits]
            return all(each is not None and each.stamp >= end and math.isfinite(each.value) for each in samples)

        with suppress(WaitTimeoutError):  # without these samples, a drift is unknown
            await self._changed.wait(show_end, SAMPLE_TIMEOUT)
        for limit in limits:
            check_drift(step, limit)
        if step.is_moving and expected:
            check_direction(step)


class DriftLimit(NamedTuple):
    """Largest change of a signal during the exposures of a step.

    Attributes
    ----------
    signal
        Name of the signal.
    largest
        The limit in the unit of the message.
    words
        The signal in messages.
    cure
        How to remove the limit.
    unit, factor
        Unit of the message, and this unit in that of the signal; empty: that of the signal.
    """

    signal: str
    largest: float
    words: str
    cure: str
    unit: str = ""
    factor: float = 1.0

    @property
    def needs_load_frame(self) -> bool:
        """Whether the signal is one of the load frame."""
        return self.signal in (FORCE.name, POSITION.name)


def drift_limits(parameters: ExperimentNodeSettings) -> list[DriftLimit]:
    """Return the limits that the parameters set; a required signal has to be known, whatever its drift."""
    force, position = parameters.load_drift_n, parameters.position_drift_um
    limits = (
        DriftLimit(FORCE.name, force, "force", "set load_drift_n to 0"),
        DriftLimit(POSITION.name, position, "crosshead position", "set position_drift_um to 0", "µm", 1e6),
    )
    required = [
        DriftLimit(name, math.inf, f"signal '{name}'", f"write required: false to signals.{name}")
        for name in parameters.required_signals
    ]
    return [limit for limit in limits if limit.largest] + required


def _must_hold(step: RunningStep, parameters: ExperimentNodeSettings) -> bool:
    return parameters.hold_required and not step.is_moving


def check_direction(step: RunningStep) -> None:
    """Check that the crosshead did not reverse during the exposures of a step in motion.

    Raises
    ------
    StepFailure
        LOAD_DRIFT.
    """
    position = step.signals.signals[POSITION.name].around(*step.exposed_over()).values
    if len(position) < FEWEST_FOR_NOISE:
        return
    forward = position if position[-1] >= position[0] else -position
    back = float(np.max(np.maximum.accumulate(forward) - forward))
    noise = float(np.std(np.diff(position, 2))) / math.sqrt(6)  # second differences of equal noise
    if back > max(REVERSED * float(np.ptp(position)), CERTAIN * noise):
        raise StepFailure(
            Result.LOAD_DRIFT,
            f"the crosshead reversed during the exposures and went back by {1e3 * back:.4f} mm; a stack in motion "
            "needs one direction",
        )


def _collect(step: RunningStep, sample: LoadState) -> None:
    """Add a sample that has arrived now to a step."""
    if step.load:
        step.load_back = max(step.load_back, _seconds_between(sample, step.load[-1]))
    step.load.append(sample)
    step.signals.add("load_frame/state", sample)
    step.load_ahead = max(step.load_ahead, _ahead(sample))


def _ahead(sample: LoadState) -> float:
    """Return how much later than now a sample was stamped [s]."""
    return 1e-9 * (to_nanoseconds(sample.header.stamp) - time.time_ns())


def _seconds_between(sample: LoadState, later: LoadState) -> float:
    """Return the time from the stamp of a sample to that of another one [s]."""
    return 1e-9 * (to_nanoseconds(later.header.stamp) - to_nanoseconds(sample.header.stamp))


def _check_camera_clock(step: RunningStep, code: int) -> None:
    """End the step when exposures are stamped before their request or after the answer to it."""
    behind, ahead = 1e-9 * (step.requested_ns - step.stamps[0]), 1e-9 * (step.stamp - step.answered_ns)
    if max(behind, ahead) > MOST_AHEAD:
        raise _clock_failure(code, "camera", ahead if ahead > behind else -behind, MOST_AHEAD)


def _clock_failure(code: int, owner: str, ahead: float, allowed: float) -> StepFailure:
    side, cause = ("ahead of", "the clock jumped back") if ahead > 0 else ("behind", "the clock jumped forward")
    return StepFailure(
        code,
        f"the clock of the {owner} is {abs(ahead):.1f} s {side} the clock of the experiment node, {allowed:g} s are "
        f"allowed, or {cause}; synchronise the clocks of their computers (chrony) and measure the step again",
    )


def _check_held(samples: Iterable[LoadState | None]) -> None:
    for sample in samples:
        if sample is None or sample.mode in HELD:
            continue
        if sample.mode == LoadState.UNKNOWN:
            reason = sample.reason or "check its connection and the log of load_frame"
            message = f"the load frame reports the mode UNKNOWN: {reason}"
        elif sample.mode not in (LoadState.MOVING, LoadState.FAULT):
            message = f"the load frame reports the mode {sample.mode}, which fringedic_msgs/LoadState does not have"
        else:
            activity = "was moving" if sample.mode == LoadState.MOVING else "reported a fault"
            message = (
                f"the load frame {activity} at position {sample.position * 1e3:.4f} mm, {sample.force:.1f} N; "
                "it has to hold from before the first exposure until after the last one"
            )
        raise StepFailure(Result.LOAD_NOT_HELD, message)


def _check_held_throughout(samples: Sequence[LoadState], start: int) -> None:
    """Check that samples from before `start` [ns] on show a hold without a gap that could hide a motion."""
    _check_held(samples)
    stamps = [to_nanoseconds(sample.header.stamp) for sample in samples]
    if not stamps or stamps[0] > start:
        raise StepFailure(Result.LOAD_NOT_HELD, "no sample of the load frame is older than the first exposure")
    gap = _longest_gap(stamps)
    if gap > LONGEST_GAP:
        raise StepFailure(
            Result.LOAD_NOT_HELD,
            f"the load frame sent no sample for {gap:.1f} s during the exposures, {LONGEST_GAP:g} s are allowed; check "
            "its connection, or increase its rate",
        )


def check_drift(step: RunningStep, limit: DriftLimit) -> None:
    """Check that a signal is known throughout the exposures of a step and did not change by more than its limit.

    Raises
    ------
    StepFailure
        LOAD_DRIFT.
    """
    start, end = step.exposed_over()
    signal = step.signals.signals.get(limit.signal)
    around = None if signal is None else signal.around(start, end)
    if around is None or not _cover(around.stamps, start, end):
        source = "the load frame" if limit.needs_load_frame else "its source"
        raise StepFailure(
            Result.LOAD_DRIFT,
            f"the drift of the {limit.words} is unknown, because the samples of {source} do not contain the "
            f"{limit.words} throughout the exposures; check sensor and connection of {source} and increase its rate, "
            f"or {limit.cure}",
        )
    chosen = (around.stamps >= start) & (around.stamps <= end)
    if chosen.sum() < 2:  # a single sample shows no change
        chosen[:] = True
    drift = summarise(around.stamps[chosen], limit.factor * around.values[chosen]).drift
    if abs(drift) > limit.largest:
        unit = limit.unit or around.channel.unit
        raise StepFailure(
            Result.LOAD_DRIFT,
            f"the {limit.words} drifted by {number_text(drift, 3, sign=True)} {unit} during the exposures, "
            f"{limit.largest:g} {unit} are allowed; hold longer before the step",
        )


def _cover(stamps: np.ndarray, start: int, end: int) -> bool:
    """Return whether samples show a change from the first exposure [ns] until after the last one, without a gap."""
    if len(stamps) < 2 or stamps[0] > start + 1e9 * LONGEST_GAP or stamps[-1] < end:
        return False
    return _longest_gap(stamps.tolist()) <= LONGEST_GAP


def _longest_gap(stamps: Sequence[int]) -> float:
    """Return the longest time between two successive stamps [s]."""
    return 1e-9 * max((after - before for before, after in pairwise(stamps)), default=0)
