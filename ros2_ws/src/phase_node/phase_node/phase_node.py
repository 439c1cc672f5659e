"""Fringe frames in, phase map, its uncertainty, modulation and texture out."""

from __future__ import annotations

from functools import partial

from rclpy.publisher import Publisher
from sensor_msgs.msg import Image

from fringedic.figures.previews import phase_preview
from fringedic.frames.collector import Stack
from fringedic.patterns.pattern import PatternKind
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.rehearsal import rehearse_phase
from fringedic.steps.remarks import Remark
from fringedic_msgs.msg import Exposure
from fringedic_ros.exchange import Exchange
from fringedic_ros.frame_steps import FrameSteps
from fringedic_ros.images import image_message
from fringedic_ros.main import run
from fringedic_ros.processing import Outcome, ProcessingNode, StepId
from fringedic_ros.qos import DERIVED
from fringedic_ros.rig_node import CAMERA_FRAME, frame_id


class PhaseNode(ProcessingNode[PhaseParameters]):
    """Collects the frames of a step and publishes the result of `phase_step`."""

    def __init__(self, exchange: Exchange | None = None) -> None:
        super().__init__("phase", PhaseParameters, rehearse_phase, exchange)
        self._frame = frame_id(self, CAMERA_FRAME)
        self._map = self._image_publisher("map")
        self._sigma = self._image_publisher("sigma")
        self._modulation = self._image_publisher("modulation")
        self._texture = self._image_publisher("texture")
        self._preview = self._image_publisher("preview")
        self.subscribe_to_steps()
        self._frames = FrameSteps(self, PatternKind.FRINGES, self._take_stack, self._take_other)

    def _image_publisher(self, name: str) -> Publisher:
        return self.create_publisher(Image, f"phase/{name}", DERIVED)

    def _take_stack(self, stack: Stack) -> None:
        self.report_unjoined(self._frames.unpaired)
        work = partial(self._measure_phase, stack, self.parameters.value)
        self.measure(StepId(stack.experiment, stack.step, stack.stamp), work)

    def _take_other(self, exposure: Exposure) -> None:
        if exposure.kind == PatternKind.WHITE:  # there is no phase in a white step
            self.skip(StepId.of(exposure))

    def abandon(self, step: StepId) -> str:
        """Drop the frames of a step."""
        return self._frames.abandon(step.experiment, step.step)

    def _measure_phase(self, stack: Stack, parameters: PhaseParameters) -> Outcome:
        result = phase_step(stack, parameters)
        if self.exchange is not None:
            self.exchange.give("phase", result)
        for publisher, array in (
            (self._texture, result.texture),  # first: the dic node, which takes longest, waits for it
            (self._map, result.phase),
            (self._sigma, result.sigma),
            (self._modulation, result.modulation),
        ):
            if publisher.get_subscription_count():
                publisher.publish(image_message(array, stamp_ns=result.stamp, frame_id=self._frame))
        if self._preview.get_subscription_count():
            colours = phase_preview(result.phase)
            self._preview.publish(image_message(colours, stamp_ns=result.stamp, frame_id=self._frame))
        return Outcome(
            result.valid_fraction,
            len(stack.records),
            phase_sigma=result.rms,
            remarks=tuple(map(Remark.of_finding, result.remarks)),
            corrections=result.corrections,
            relative=result.relative,
        )


def main() -> int:
    """Run the phase node."""
    return run(PhaseNode)
