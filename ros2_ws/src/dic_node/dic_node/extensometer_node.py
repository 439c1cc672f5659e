"""Strain between two gauge subsets in the frames of a free run, for closed-loop control."""

from __future__ import annotations

import time

import numpy as np
from pydantic import BaseModel, Field
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from fringedic.correlation.extensometer import StrainReading, VirtualExtensometer
from fringedic.errors import CorrelationError, FringedicError
from fringedic.patterns.pattern import PatternKind
from fringedic_msgs.msg import Exposure, StepStatus
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.parameters import declare
from fringedic_ros.qos import EVENTS, STATE
from fringedic_ros.rig_node import RigNode
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.work import Worker

MEASURED = (PatternKind.OTHER, PatternKind.WHITE)  # frames of a free run, and of steps in white light
TAKING_FRAMES = (StepStatus.BEGIN, StepStatus.CAPTURE)  # stages in which a free run may show a pattern of the step


class ExtensometerParameters(BaseModel):
    """Parameters of the extensometer node."""

    first_column_px: int = Field(
        160, ge=0, le=32768, description="Centre of the first gauge subset in the reference [px]."
    )
    first_row_px: int = Field(
        240, ge=0, le=32768, description="Centre of the first gauge subset in the reference [px]."
    )
    second_column_px: int = Field(480, ge=0, le=32768, description="Centre of the second gauge subset [px].")
    second_row_px: int = Field(240, ge=0, le=32768, description="Centre of the second gauge subset [px].")
    pad_px: int = Field(48, ge=16, le=256, description="Width of a gauge subset [px].")
    largest_sigma: float = Field(1e-3, gt=0, le=1, description="Largest standard uncertainty of a valid strain [-].")
    frame_timeout_s: float = Field(
        0.1, gt=0, le=10, description="Time without a frame after which the strain is invalid [s]."
    )


class ExtensometerNode(RigNode):
    """Topics `extensometer/strain`, `extensometer/sigma`, `extensometer/valid`; service `extensometer/zero`.

    The first frame after the start, after `extensometer/zero` and after each reference step is the reference. When
    frames arrive faster than they can be measured, only the newest is. Frames that show a pattern are ignored, and so
    are those of a free run while a step takes its frames.
    """

    def __init__(self) -> None:
        super().__init__("extensometer")
        self.parameters = declare(self, ExtensometerParameters, self._take_parameters)
        self.diagnostics = NodeDiagnostics(self)
        self._worker = Worker(self, self._fail)
        self._extensometer: VirtualExtensometer | None = None
        self._newest: Image | None = None
        self._step_takes_frames = False
        self._last_frame = time.monotonic()
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

    def _take_parameters(self, _: ExtensometerParameters) -> None:
        self._extensometer = None

    def _zero(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._extensometer = None
        response.success = True
        response.message = "the next frame is the reference"
        return response

    def _take_step(self, message: StepStatus) -> None:
        self._step_takes_frames = message.stage in TAKING_FRAMES
        if message.stage == StepStatus.END and message.reference:
            self._extensometer = None

    def _take_frame(self, message: Image, exposure: Exposure) -> None:
        if exposure.kind not in MEASURED or (exposure.kind == PatternKind.OTHER and self._step_takes_frames):
            return
        self._last_frame = time.monotonic()
        if self._newest is not None:
            self.diagnostics.drop()  # replaced before it was measured
        self._newest = message
        if not self._worker.pending:
            self._worker.submit(self._measure_newest)

    def _measure_newest(self) -> None:
        """Measure frames until none waits; in the thread of the worker."""
        while (message := self._newest) is not None:
            self._newest = None
            try:
                reading = self._measure(image_array(message))
            except FringedicError as error:
                reading = StrainReading.invalid(str(error))
            self._publish(reading)
            if reading.valid:
                self.diagnostics.success(1e-9 * (time.time_ns() - to_nanoseconds(message.header.stamp)))

    def _measure(self, image: np.ndarray) -> StrainReading:
        p, extensometer = self.parameters.value, self._extensometer
        if extensometer is None:
            first, second = (p.first_column_px, p.first_row_px), (p.second_column_px, p.second_row_px)
            extensometer = self._extensometer = VirtualExtensometer(image, first, second, subset=p.pad_px)
        return extensometer.measure(image).limited(p.largest_sigma)

    def _check_frames(self) -> None:
        silence = time.monotonic() - self._last_frame
        if silence > self.parameters.value.frame_timeout_s and not self._published_invalid:
            self._publish(StrainReading.invalid(f"no frame for {silence:.2f} s"))

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
