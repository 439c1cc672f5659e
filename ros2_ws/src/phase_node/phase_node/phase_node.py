"""Fringe frames in, phase map, its uncertainty, modulation and texture out."""

from __future__ import annotations

from functools import partial

from rclpy.publisher import Publisher
from sensor_msgs.msg import Image

from fringedic.chain import PhaseParameters, phase_step
from fringedic.sequence import FrameCollector, PatternKind, Stack
from fringedic_msgs.msg import Exposure, NodeStatus
from fringedic_ros.images import image_array, image_message
from fringedic_ros.main import run
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.processing import Outcome, ProcessingNode
from fringedic_ros.qos import DERIVED, OVERRIDABLE
from fringedic_ros.records import frame_record
from fringedic_ros.stamps import to_nanoseconds


class PhaseNode(ProcessingNode[PhaseParameters]):
    """Collects the frames of a step and publishes what `phase_step` makes of them."""

    def __init__(self) -> None:
        super().__init__("phase", PhaseParameters)
        self._map = self._image_publisher("map")
        self._sigma = self._image_publisher("sigma")
        self._modulation = self._image_publisher("modulation")
        self._texture = self._image_publisher("texture")
        self._preview = self._image_publisher("preview")
        self._collector = FrameCollector()
        self.subscribe_to_steps()
        self._pairs = ImageExposurePairs(self, self._take_frame)

    def _image_publisher(self, name: str) -> Publisher:
        return self.create_publisher(Image, f"phase/{name}", DERIVED, qos_overriding_options=OVERRIDABLE)

    def _take_frame(self, image: Image, exposure: Exposure) -> None:
        experiment, step = exposure.experiment, exposure.step
        stamp = to_nanoseconds(exposure.header.stamp)
        self.report_unjoined(self._pairs.unpaired)
        if exposure.kind == PatternKind.OTHER:
            return
        if self.answered(experiment, step):
            self.diagnostics.drop()
        elif exposure.kind == PatternKind.WHITE:
            self.answer(experiment, step, stamp, NodeStatus.NONE)
        else:
            self._collect(experiment, step, stamp, image, exposure)

    def _collect(self, experiment: str, step: int, stamp: int, image: Image, exposure: Exposure) -> None:
        try:
            stack = self._collector.add(frame_record(exposure), image_array(image))
        except Exception as error:
            self.abandon(experiment, step)
            self.fail(experiment, step, stamp, error)
            return
        if stack is not None:
            self.measure(experiment, step, stamp, partial(self._measure_phase, stack, self.parameters.value))

    def abandon(self, experiment: str, step: int) -> None:
        self._collector.abandon(experiment, step)

    def _measure_phase(self, stack: Stack, parameters: PhaseParameters) -> Outcome:
        result = phase_step(stack, parameters)
        frame = "camera_optical_frame"
        for publisher, array in (
            (self._map, result.phase),
            (self._sigma, result.sigma),
            (self._modulation, result.modulation),
            (self._texture, result.texture),
        ):
            publisher.publish(image_message(array, stamp_ns=result.stamp, frame_id=frame))
        return Outcome(result.valid_fraction, result.rms, len(stack.records))


def main() -> int:
    """Run the phase node."""
    return run(PhaseNode)
