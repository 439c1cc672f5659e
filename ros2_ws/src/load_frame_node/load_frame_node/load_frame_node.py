"""Publishes mode, force and position of a testing machine, and passes moves and hold requests to it.

Limits and emergency stop belong to the machine; this node only passes requests on.
"""

from __future__ import annotations

import math
import time

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic.errors import ClockJumpError, MachineError
from fringedic.frames.clocks import DeviceClock
from fringedic.settings.load_frame import LoadFrameNodeSettings
from fringedic_msgs.msg import ClockDrift, LoadState, Signal
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED, SAMPLES
from fringedic_ros.records import clock_message
from fringedic_ros.rig_node import LOAD_FRAME, frame_id
from fringedic_ros.signals import signal_message
from fringedic_ros.stamps import to_msg
from fringedic_ros.work import Worker
from load_frame_node.crosshead import Crosshead
from load_frame_node.machines import Sample
from load_frame_node.move_server import MoveServer
from load_frame_node.sampler import Sampler

JOINT = "crosshead"
_LAST_HOLD_S = 10.0  # longest wait for the hold at the end; a lost machine is tried again after 8 s at most
_PUBLISHED_S = 3.0  # longest wait for the last samples to be published
_CLOCK_PERIOD_S = 1.0  # between two messages about the clock of the machine


class LoadFrameNode(HardwareNode[LoadFrameNodeSettings]):
    """Action `move_crosshead`, service `load_frame/hold`, and the samples of the machine."""

    def __init__(self) -> None:
        super().__init__("load_frame", LoadFrameNodeSettings)
        self._frame = frame_id(self, LOAD_FRAME)
        self._crosshead = Crosshead(self)
        self._sampler: Sampler | None = None
        self._was_known = (True, True)  # whether force and position were known in the latest sample with an answer
        self._publishing: Worker | None = None
        self._machine_clock = DeviceClock("testing machine")
        self._device_ns = 0  # of the latest sample, on the clock of the machine
        self._clock_published = 0.0
        self._clocks = self.create_publisher(ClockDrift, "load_frame/clock", LATCHED)
        self._states = self.create_publisher(LoadState, "load_frame/state", SAMPLES)
        self._wrenches = self.create_publisher(WrenchStamped, "load_frame/wrench", SAMPLES)
        self._joints = self.create_publisher(JointState, "load_frame/joint_states", SAMPLES)
        self._signals = self.create_publisher(Signal, "signals", SAMPLES)
        self.create_service(Trigger, "load_frame/hold", self._hold)
        self._moves = MoveServer(self, self._crosshead)

    def open(self) -> None:
        """Connect to the machine that the parameters select."""
        self._crosshead.open(self.parameters.value.device.open(self))

    def activate(self) -> None:
        """Start sampling."""
        self._machine_clock, self._device_ns = DeviceClock("testing machine"), 0
        rate = self.parameters.value.device.rate_hz
        self._publishing = Worker(self)
        self._sampler = Sampler(self._crosshead, rate, self._take_sample, self._report, self.diagnostics)

    def deactivate(self) -> None:
        """Stop sampling, request a hold, and publish the last samples."""
        if self._sampler is not None:
            self._sampler.stop()
            self._sampler = None
        if self._crosshead.machine is not None and self.parameters.value.device.held_at_end:
            try:
                self._crosshead.hold_at_last(_LAST_HOLD_S)
            except MachineError as error:
                self.get_logger().error(f"no hold was accepted: {error}; if the machine moves, stop it by hand")
        if self._publishing is not None:
            self._publishing.await_idle(_PUBLISHED_S)
            self._publishing.stop()
            self._publishing = None

    def close(self) -> None:
        """Release the machine."""
        self._crosshead.close()

    def _hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self.active:
            response.message = "the load frame is not active; configure and activate it"
            return response
        try:
            self._crosshead.hold()
        except MachineError as error:
            self.get_logger().error(str(error))
            self.diagnostics.failure(str(error))
            response.message = str(error)
            return response
        self._crosshead.hold_requested = True
        response.success = True
        response.message = f"hold requested at {1e3 * self._crosshead.sample.position:.4f} mm"
        return response

    # in the thread of the sampler

    def _take_sample(self, sample: Sample) -> None:
        """Let the crosshead act on a sample, and publish it in another thread.

        The middleware keeps a publisher waiting when it opens the port of another process, for a second and more. The
        end of a move must not wait for it, nor the next sample.
        """
        self._crosshead.take(sample)
        self._report_unknown(sample)
        assert self._publishing is not None, "it ends after the sampler"
        self._publishing.submit(self._publish, sample)

    def _report_unknown(self, sample: Sample) -> None:
        """Report once that the machine shows a force or a position that no machine can have."""
        is_known = (not math.isnan(sample.force), not math.isnan(sample.position))
        if sample.unknown and any(before > now for before, now in zip(self._was_known, is_known, strict=True)):
            self.get_logger().error(f"{sample.unknown}; check sensor and cable, and unit and scale in the machine file")
        if sample.unknown or all(is_known):
            self._was_known = is_known

    def _report(self, error: MachineError) -> None:
        self.get_logger().error(str(error), throttle_duration_sec=1.0)
        self.diagnostics.failure(str(error))

    # in the thread of the publisher

    def _publish(self, sample: Sample) -> None:
        """Publish a sample on its topics, and once a second the drift of the machine's clock."""
        state = LoadState(mode=int(sample.mode), force=sample.force, position=sample.position, reason=sample.unknown)
        state.header.stamp, state.header.frame_id = to_msg(sample.stamp_ns), self._frame
        wrench = WrenchStamped(header=state.header)
        wrench.wrench.force.z = state.force
        joint = JointState(header=state.header, name=[JOINT], position=[state.position], effort=[state.force])
        self._states.publish(state)
        self._wrenches.publish(wrench)
        self._joints.publish(joint)
        for each in sample.signals:
            values, sigmas = np.array([each.value]), np.array([each.sigma])
            self._signals.publish(signal_message(each.channel, [each.stamp], values, sigmas))
        self._compare_clocks(sample)

    def _compare_clocks(self, sample: Sample) -> None:
        if sample.device_ns is None or sample.device_ns == self._device_ns:
            return
        self._device_ns = sample.device_ns
        try:
            self._machine_clock.arrival(sample.device_ns, sample.stamp_ns)
        except ClockJumpError as error:
            self.get_logger().error(str(error))
            self.diagnostics.failure(str(error))
        estimate, now = self._machine_clock.estimate, time.monotonic()
        if estimate is not None and now - self._clock_published >= _CLOCK_PERIOD_S:
            self._clock_published = now
            self._clocks.publish(clock_message("load_frame", estimate))


def main() -> int:
    """Run the load frame node."""
    return run(LoadFrameNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
