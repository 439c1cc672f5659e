"""Load frame as a step observes it: the machine must hold, and force and position must not drift."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.experiment_parameters import ExperimentParameters
from experiment_node.running_step import RunningStep
from fringedic.errors import WaitTimeoutError
from fringedic.recording.load_samples import summarise_load
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import LoadState
from fringedic_ros.qos import STATE
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result
HELD = (LoadState.HOLD, LoadState.IDLE)
LOAD_TIMEOUT = 0.5  # [s] for a sample of the present, or of the last exposure, to arrive


class LoadWatch:
    """Collects the samples of `load_frame/state` and checks them before, during and after the exposures of a step.

    Parameters
    ----------
    node
        Owner of the subscription.
    changed
        Notified after each sample of a running step.

    Attributes
    ----------
    step
        The running step, which collects the samples; None between steps.
    """

    def __init__(self, node: Node, changed: Condition) -> None:
        self.step: RunningStep | None = None
        self._node = node
        self._changed = changed
        self._latest: LoadState | None = None
        node.create_subscription(LoadState, "load_frame/state", self._take, STATE)

    def _take(self, message: LoadState) -> None:
        self._latest = message
        if self.step is not None:
            self.step.load.append(message)
            self._changed.notify()

    @property
    def _present(self) -> bool:
        return bool(self._node.count_publishers("load_frame/state"))

    async def await_hold(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Check before the first frame that a load frame that is present holds.

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD.
        """
        if not parameters.hold_required or not self._present:
            return
        # the latest sample may be older than the hold: prefer one that was acquired from now on
        begin = self._node.get_clock().now().nanoseconds
        with suppress(WaitTimeoutError):
            await self._changed.wait(
                lambda: self._latest is not None and to_nanoseconds(self._latest.header.stamp) >= begin, LOAD_TIMEOUT
            )
        await step.goal.wait(
            lambda: self._latest is not None,
            parameters.start_timeout_s,
            lambda: (
                Result.LOAD_NOT_HELD,
                "the load frame publishes no sample on load_frame/state; check its connection and its log",
            ),
        )
        self.check_latest(parameters)

    def check_latest(self, parameters: ExperimentParameters) -> None:
        """Check that the latest sample shows a hold, when one is required.

        Raises
        ------
        StepFailure
            LOAD_NOT_HELD.
        """
        if parameters.hold_required:
            _check_held([self._latest])

    async def check_exposures(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Check hold and drift over the exposures of a step whose frames are all taken.

        Raises
        ------
        StepFailure
            CAMERA_FAILED without exposure records; LOAD_NOT_HELD; LOAD_DRIFT.
        """
        await step.goal.wait(
            lambda: {0, len(step.patterns) - 1} <= step.exposures.keys(),
            parameters.camera_timeout_s,
            lambda: (Result.CAMERA_FAILED, "the camera published no exposure record of the first or last frame"),
        )
        if self._latest is None or not self._present:
            return
        await self._await_last_sample(step)
        samples = step.load_during_exposures()
        if parameters.hold_required:
            _check_held(samples)
        _check_drift(samples, parameters)

    async def _await_last_sample(self, step: RunningStep) -> None:
        """Wait for the sample after the last exposure; without one, the checks report what is missing."""
        end = step.exposures[len(step.patterns) - 1][1]
        with suppress(WaitTimeoutError):
            await self._changed.wait(
                lambda: bool(step.load) and to_nanoseconds(step.load[-1].header.stamp) >= end, LOAD_TIMEOUT
            )


def _check_held(samples: Iterable[LoadState | None]) -> None:
    for sample in samples:
        if sample is None or sample.mode in HELD:
            continue
        if sample.mode == LoadState.UNKNOWN:
            message = "the load frame reports no state; check its connection and the log of load_frame"
        else:
            activity = "was moving" if sample.mode == LoadState.MOVING else "reported a fault"
            message = (
                f"the load frame {activity} at position {sample.position * 1e3:.4f} mm, {sample.force:.1f} N; "
                "it has to hold from before the first exposure until after the last one"
            )
        raise StepFailure(Result.LOAD_NOT_HELD, message)


def _check_drift(samples: Sequence[LoadState], parameters: ExperimentParameters) -> None:
    """End the step when force or position changed during the exposures by more than the parameters allow."""
    stamps = [to_nanoseconds(sample.header.stamp) for sample in samples]
    for what, values, factor, unit, limit in (
        ("force", [sample.force for sample in samples], 1.0, "N", parameters.load_drift_n),
        ("crosshead", [sample.position for sample in samples], 1e6, "µm", parameters.position_drift_um),
    ):
        summary = summarise_load(stamps, values)
        if limit and not summary.samples:
            raise StepFailure(
                Result.LOAD_DRIFT,
                f"no sample of the {what} arrived during the exposures, so its drift is unknown; increase the sampling "
                "rate, or set its limit to 0",
            )
        drift = factor * summary.drift
        if limit and abs(drift) > limit:
            raise StepFailure(
                Result.LOAD_DRIFT,
                f"the {what} drifted by {drift:+.3g} {unit} during the exposures, {limit:g} {unit} are allowed; "
                "hold longer before the step",
            )
