"""Strain between two gauge subsets in the frames of a free run, for closed-loop control."""

from __future__ import annotations

import math
import threading
import time
from collections import deque

import numpy as np
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from fringedic.correlation.extensometer import StrainReading, VirtualExtensometer
from fringedic.errors import CorrelationError, FringedicError
from fringedic.patterns.pattern import PatternKind
from fringedic.settings.extensometer import ExtensometerNodeSettings
from fringedic_msgs.msg import Exposure, StepStatus
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.parameters import declare
from fringedic_ros.qos import EVENTS, STATE
from fringedic_ros.rig_node import RigNode
from fringedic_ros.serialized import image_view
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import Patience
from fringedic_ros.work import Worker

MEASURED = (PatternKind.OTHER, PatternKind.WHITE)  # frames of a free run, and of steps in white light
TAKING_FRAMES = (StepStatus.BEGIN, StepStatus.CAPTURE)  # stages in which a free run may show a pattern of the step


class ExtensometerNode(RigNode):
    """Topics `extensometer/strain`, `extensometer/sigma`, `extensometer/valid`; service `extensometer/zero`.

    The first frame after the start is the reference, and again the first frame that is exposed after a request of
    `extensometer/zero`, after a change of parameters, and after the last exposure of each reference step. When frames
    arrive faster than they can be measured, only the newest is. Frames that show a pattern are ignored, and so are
    those of a free run while a step takes its frames.
    """

    def __init__(self) -> None:
        super().__init__("extensometer")
        self.parameters = declare(self, ExtensometerNodeSettings, self._take_parameters)
        self.diagnostics = NodeDiagnostics(self)
        self._worker = Worker(self, self._fail)
        self._measuring = threading.Lock()  # a reference is not replaced while a frame is measured and published
        self._extensometer: VirtualExtensometer | None = None
        self._reference_after_ns = -math.inf  # stamp after which the exposure of the reference begins
        self._newest: deque[tuple[bytes, Exposure]] = deque(maxlen=1)
        self._step_takes_frames = False
        self._silence = Patience(self.parameters.value.frame_timeout_s)
        self._published_invalid = False
        self._strain = self.create_publisher(Float64, "extensometer/strain", STATE)
        self._sigma = self.create_publisher(Float64, "extensometer/sigma", STATE)
        self._valid = self.create_publisher(Bool, "extensometer/valid", STATE)
        self._frames = ImageExposurePairs(self, self._take_frame)
        self.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)
        self.create_service(Trigger, "extensometer/zero", self._zero)
        self.create_timer(0.5 * self.parameters.value.frame_timeout_s, self._check_frames)

    def destroy_node(self) -> None:
        """End the background thread and the node."""
        self._worker.stop()
        super().destroy_node()

    def _take_parameters(self, parameters: ExtensometerNodeSettings) -> None:
        self._silence = Patience(parameters.frame_timeout_s)
        self._request_reference(time.time_ns())

    def _zero(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._request_reference(time.time_ns())
        response.success = True
        response.message = "the first frame that is exposed after this request is the reference"
        return response

    def _take_step(self, message: StepStatus) -> None:
        self._step_takes_frames = message.stage in TAKING_FRAMES
        if message.stage == StepStatus.END and message.reference:
            last_exposure_ns: float = to_nanoseconds(message.header.stamp)
            if self._extensometer is None:
                # topic and service have no common order: a zero that was requested after the step may be served first
                last_exposure_ns = max(last_exposure_ns, self._reference_after_ns)
            self._request_reference(last_exposure_ns)

    def _request_reference(self, after_ns: float) -> None:
        """Measure against the first frame whose exposure begins after a stamp [ns]; older frames may be queued."""
        with self._measuring:
            self._extensometer, self._reference_after_ns = None, after_ns

    def _take_frame(self, image: bytes, exposure: Exposure) -> None:
        if exposure.kind not in MEASURED or (exposure.kind == PatternKind.OTHER and self._step_takes_frames):
            return
        self._silence.renew()
        if self._newest:
            self.diagnostics.drop()  # replaced before it was measured
        self._newest.append((image, exposure))
        self._worker.submit(self._measure_newest)

    def _measure_newest(self) -> None:
        """Measure the frame that waits; in the thread of the worker."""
        if not self._newest:
            return  # it was replaced, and its successor is measured
        image, exposure = self._newest.popleft()
        with self._measuring:
            try:
                reading = self._measure(image_array(image_view(image)), exposure)
            except FringedicError as error:
                reading = StrainReading.invalid(str(error))
            self._publish(reading)
        if reading.valid:
            self.diagnostics.success(1e-9 * (time.time_ns() - to_nanoseconds(exposure.header.stamp)))

    def _measure(self, image: np.ndarray, exposure: Exposure) -> StrainReading:
        p = self.parameters.value
        if self._extensometer is None:
            middle_s = 1e-9 * (to_nanoseconds(exposure.header.stamp) - self._reference_after_ns)
            begin_s = middle_s - 0.5 * exposure.exposure_time
            if not begin_s > 0:  # also an exposure time that is NaN
                reason = f"the reference is awaited: the exposure of this frame began {-begin_s:.3f} s too early for it"
                return StrainReading.invalid(reason)
            (column, row), (other_column, other_row) = p.first_px, p.second_px
            self._extensometer = VirtualExtensometer(
                image, (column, row), (other_column, other_row), subset=p.subset_px
            )
        return self._extensometer.measure(image).limited(1e-6 * p.largest_sigma_ustrain)

    def _check_frames(self) -> None:
        # the executor runs timers before subscriptions: after a standstill of this process frames may be queued
        if self._silence.is_over() and not self._published_invalid:
            self._publish(StrainReading.invalid(f"no frame for {self.parameters.value.frame_timeout_s:g} s"))

    def _publish(self, reading: StrainReading) -> None:
        self._published_invalid = not reading.valid
        # the flag first: a subscriber that waits for the strain has received it then
        self._valid.publish(Bool(data=reading.valid))
        self._sigma.publish(Float64(data=reading.sigma))
        self._strain.publish(Float64(data=reading.strain))
        if not reading.valid:
            self._fail(CorrelationError(reading.reason))

    def _fail(self, error: Exception) -> None:
        self.get_logger().error(str(error), throttle_duration_sec=1.0)
        self.diagnostics.failure(str(error))


def main() -> int:
    """Run the extensometer node."""
    return run(ExtensometerNode)


if __name__ == "__main__":
    raise SystemExit(main())
