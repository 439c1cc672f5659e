"""Frames of a free run in, strain between two pads out: for controllers that close the loop over it."""

from __future__ import annotations

import math
import time

import numpy as np
from numba import set_num_threads
from pydantic import BaseModel, Field
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from fringedic.errors import FringedicError, PadError
from fringedic.extensometer import Elongation, VirtualExtensometer
from fringedic.sequence import PatternKind
from fringedic_msgs.msg import Exposure, StepStatus
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.parameters import declare
from fringedic_ros.qos import EVENTS, STATE
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.work import Worker

MEASURED = (PatternKind.OTHER, PatternKind.WHITE)  # frames of a free run, and of steps in white light


class ExtensometerParameters(BaseModel):
    """Parameters of the extensometer node."""

    first_column_px: int = Field(160, ge=0, le=32768, description="Centre of the first pad in the reference [px].")
    first_row_px: int = Field(240, ge=0, le=32768, description="Centre of the first pad in the reference [px].")
    second_column_px: int = Field(480, ge=0, le=32768, description="Centre of the second pad [px].")
    second_row_px: int = Field(240, ge=0, le=32768, description="Centre of the second pad [px].")
    pad_px: int = Field(48, ge=16, le=256, description="Width of a pad's window [px].")
    largest_sigma: float = Field(
        1e-3, gt=0, le=1, description="A strain that is less certain than this counts as invalid [-]."
    )
    frame_timeout_s: float = Field(
        0.1, gt=0, le=10, description="Without a frame for this long the strain is invalid [s]."
    )


class ExtensometerNode(Node):
    """Topics `extensometer/strain`, `extensometer/sigma`, `extensometer/valid`; service `extensometer/zero`.

    The first frame after the start, after `extensometer/zero` and after each reference step is the reference. When
    frames come faster than they can be measured, the newest is. Frames that show a pattern are passed over.
    """

    def __init__(self) -> None:
        super().__init__("extensometer")
        self.parameters = declare(self, ExtensometerParameters, self._take_parameters)
        self.diagnostics = NodeDiagnostics(self)
        self._worker = Worker(self, self._fail)
        self._extensometer: VirtualExtensometer | None = None
        self._newest: Image | None = None
        self._last_frame = time.monotonic()
        self._told_invalid = False
        self._strain = self.create_publisher(Float64, "extensometer/strain", STATE)
        self._sigma = self.create_publisher(Float64, "extensometer/sigma", STATE)
        self._valid = self.create_publisher(Bool, "extensometer/valid", STATE)
        self._frames = ImageExposurePairs(self, self._take_frame)
        self.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)
        self.create_service(Trigger, "extensometer/zero", self._zero)
        self.create_timer(0.5 * self.parameters.value.frame_timeout_s, self._watch)

    def destroy_node(self) -> None:
        """End the background thread, too."""
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
        if message.stage == StepStatus.END and message.reference:
            self._extensometer = None

    def _take_frame(self, message: Image, exposure: Exposure) -> None:
        if exposure.kind not in MEASURED:
            return
        self._last_frame = time.monotonic()
        if self._newest is not None:
            self.diagnostics.drop()  # replaced before it was measured
        self._newest = message
        if not self._worker.pending:
            self._worker.submit(self._measure_newest)

    def _measure_newest(self) -> None:
        """Measure until no frame waits; in the worker's thread."""
        set_num_threads(1)  # two pads are too small to be shared: to wait for a second core takes longer
        while (message := self._newest) is not None:
            self._newest = None
            image = image_array(message)
            extensometer = self._extensometer
            try:
                if extensometer is None:
                    extensometer = self._extensometer = self._new(image)
                read = extensometer.measure(image)
            except FringedicError as error:
                read = Elongation(math.nan, math.nan, np.full((2, 2), np.nan), str(error))
            if read.valid and not read.sigma <= self.parameters.value.largest_sigma:
                read = Elongation(
                    math.nan,
                    read.sigma,
                    read.displacements,
                    f"the strain is uncertain by {1e6 * read.sigma:.0f} µstrain",
                )
            self._tell(read)
            if read.valid:
                self.diagnostics.success(1e-9 * (time.time_ns() - to_nanoseconds(message.header.stamp)))

    def _new(self, image: np.ndarray) -> VirtualExtensometer:
        p = self.parameters.value
        first, second = (p.first_column_px, p.first_row_px), (p.second_column_px, p.second_row_px)
        return VirtualExtensometer(image, first, second, pad=p.pad_px)

    def _watch(self) -> None:
        silence = time.monotonic() - self._last_frame
        if silence > self.parameters.value.frame_timeout_s and not self._told_invalid:
            self._tell(Elongation(math.nan, math.nan, np.full((2, 2), np.nan), f"no frame for {silence:.2f} s"))

    def _tell(self, read: Elongation) -> None:
        self._told_invalid = not read.valid
        # the flag first: whoever waits for the number has it already
        self._valid.publish(Bool(data=read.valid))
        self._sigma.publish(Float64(data=read.sigma))
        self._strain.publish(Float64(data=read.strain))
        if not read.valid:
            self._fail(PadError(read.reason))

    def _fail(self, error: Exception) -> None:
        self.get_logger().error(str(error), throttle_duration_sec=1.0)
        self.diagnostics.failure(str(error))


def main() -> int:
    """Run the extensometer node."""
    return run(ExtensometerNode)


if __name__ == "__main__":
    raise SystemExit(main())
