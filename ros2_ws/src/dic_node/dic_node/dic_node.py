"""Texture of a step in, in-plane displacement against the reference step out."""

from __future__ import annotations

from functools import partial

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image

from fringedic.figures.previews import displacement_preview
from fringedic.frames.collector import Stack
from fringedic.patterns.pattern import PatternKind
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import DicParameters
from fringedic.steps.rehearsal import rehearse_displacement
from fringedic.steps.step_results import DicResult, PhaseResult
from fringedic_msgs.msg import NodeStatus, Reference
from fringedic_ros.exchange import Exchange
from fringedic_ros.frame_steps import FrameSteps
from fringedic_ros.images import image_array, image_message
from fringedic_ros.main import run
from fringedic_ros.processing import Outcome, ProcessingNode, StampJoin, StepId
from fringedic_ros.qos import DERIVED, EVENTS, LATCHED
from fringedic_ros.rig_node import CAMERA_FRAME, frame_id
from fringedic_ros.stamps import to_msg, to_nanoseconds


class DicNode(ProcessingNode[DicParameters]):
    """Passes the texture of each step to a `DisplacementTracker`.

    The texture of a fringe step comes from the phase node and is identified by that node's status of the same stamp;
    the frame of a white step comes directly from the camera.
    """

    def __init__(self, exchange: Exchange | None = None) -> None:
        super().__init__("dic", DicParameters, rehearse_displacement, exchange)
        self._frame = frame_id(self, CAMERA_FRAME)
        self._displacement = self._image_publisher("displacement")
        self._sigma = self._image_publisher("sigma")
        self._preview = self._image_publisher("preview")
        self._grid = self.create_publisher(CameraInfo, "dic/camera_info", DERIVED)
        self._tracker = DisplacementTracker(self.parameters.value)
        self._textures = StampJoin(("phase/status", "phase/texture"))
        self.create_subscription(Reference, "experiment/reference", self._take_reference, LATCHED)
        self.subscribe_to_steps()
        self.create_subscription(NodeStatus, "phase/status", self._take_phase_status, EVENTS)
        if exchange is None:
            self.create_subscription(Image, "phase/texture", self._take_texture, DERIVED)
        else:
            exchange.take(self, "phase", self._take_phase)
        self._frames = FrameSteps(self, PatternKind.WHITE, self._take_white)

    def _image_publisher(self, name: str) -> Publisher:
        return self.create_publisher(Image, f"dic/{name}", DERIVED)

    def _take_reference(self, message: Reference) -> None:
        # through the queue, so that it does not apply to steps that arrived before it
        self.worker.submit(self._tracker.set_reference, message.experiment, message.step)

    def _take_phase_status(self, message: NodeStatus) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        if message.error_code != NodeStatus.NONE:
            self._textures.discard(stamp)
            self.refuse_input("phase", message)
        elif not message.skipped:  # as a white step, which the phase node does not measure
            self._join("phase/status", stamp, message)

    def _take_texture(self, message: Image) -> None:
        self._join("phase/texture", to_nanoseconds(message.header.stamp), message)

    def _take_phase(self, result: PhaseResult) -> None:
        self._join("phase/texture", result.stamp, result.texture)

    def _join(self, topic: str, stamp: int, part: NodeStatus | Image | np.ndarray) -> None:
        joined = self._textures.add(topic, stamp, part)
        self._report_losses()
        if joined is None:
            return
        status, texture = joined["phase/status"], joined["phase/texture"]
        try:
            if isinstance(texture, Image):
                texture = image_array(texture)
        except Exception as error:
            self.fail(StepId.of(status), error)
        else:
            self._submit(StepId.of(status), texture, status.frames)

    def _take_white(self, stack: Stack) -> None:
        self._report_losses()
        step = StepId(stack.experiment, stack.step, stack.stamp)
        self._submit(step, white_texture(stack.frames[-1]), len(stack.records))

    def _submit(self, step: StepId, texture: np.ndarray, frames: int) -> None:
        self.measure(step, partial(self._measure_displacement, step, texture, frames, self.parameters.value))

    def _report_losses(self) -> None:
        self.report_unjoined(self._frames.unpaired + self._textures.unjoined)

    def abandon(self, step: StepId) -> str:
        """Drop the messages of a step."""
        return self._textures.discard(step.stamp) or self._frames.abandon(step.experiment, step.step)

    def _measure_displacement(
        self, step: StepId, texture: np.ndarray, frames: int, parameters: DicParameters
    ) -> Outcome:
        self._tracker.parameters = parameters
        result = self._tracker.step(*step, texture)
        if self.exchange is not None:
            self.exchange.give("dic", result)
        displacement = result.displacement
        for publisher, array in ((self._displacement, displacement), (self._sigma, result.sigma)):
            if publisher.get_subscription_count():
                publisher.publish(image_message(array, stamp_ns=step.stamp, frame_id=self._frame))
        self._grid.publish(grid_message(result, texture.shape, self._frame))
        if self._preview.get_subscription_count():
            colours = displacement_preview(displacement)
            self._preview.publish(image_message(colours, stamp_ns=step.stamp, frame_id=self._frame))
        return Outcome(
            result.valid_fraction,
            frames,
            rms_displacement_px=result.rms,
            reference_step=result.reference_step,
            correlated_step=result.correlated_step,
            window=result.field.attrs["window_px"],
            method=result.field.attrs["method"],
        )


def grid_message(result: DicResult, shape: tuple[int, ...], frame: str) -> CameraInfo:
    """Return the grid of the points: point (i, j) is at row y_offset + i binning_y, column x_offset + j binning_x.

    Region over binning is the size of the map, as sensor_msgs defines it. A point stands for the pixels up to the next
    one, so that the region may end up to ``spacing - 1`` pixels outside the image.

    Parameters
    ----------
    result
        A measured step.
    shape
        (row, column) of the camera's image.
    frame
        Frame id of the camera.
    """
    rows, columns = result.field.sizes["row"], result.field.sizes["column"]
    message = CameraInfo(height=shape[0], width=shape[1], binning_x=result.spacing, binning_y=result.spacing)
    message.header.stamp = to_msg(result.stamp)
    message.header.frame_id = frame
    message.roi.x_offset, message.roi.y_offset = result.origin
    message.roi.height, message.roi.width = rows * result.spacing, columns * result.spacing
    return message


def main() -> int:
    """Run the dic node."""
    return run(DicNode)
