"""Texture of a step in, in-plane displacement against the reference step out."""

from __future__ import annotations

from functools import partial

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image

from fringedic.chain import DicParameters, DicResult, DisplacementTracker, white_texture
from fringedic.pictures import displacement_preview
from fringedic.sequence import PatternKind, Stack
from fringedic_msgs.msg import NodeStatus, Reference
from fringedic_ros.frame_steps import FrameSteps
from fringedic_ros.images import image_array, image_message
from fringedic_ros.main import run
from fringedic_ros.processing import Outcome, ProcessingNode, StampJoin
from fringedic_ros.qos import DERIVED, EVENTS, LATCHED, OVERRIDABLE
from fringedic_ros.stamps import to_msg, to_nanoseconds

FRAME = "camera_optical_frame"


class DicNode(ProcessingNode[DicParameters]):
    """Hands the texture of each step to a `DisplacementTracker`.

    The texture of a fringe step comes from the phase node and is known by that node's status of the same stamp; a white
    step's frame comes straight from the camera.
    """

    def __init__(self) -> None:
        super().__init__("dic", DicParameters)
        self._displacement = self._image_publisher("displacement")
        self._sigma = self._image_publisher("sigma")
        self._preview = self._image_publisher("preview")
        self._grid = self.create_publisher(CameraInfo, "dic/camera_info", DERIVED)
        self._tracker = DisplacementTracker(self.parameters.value)
        self._textures = StampJoin(("phase/status", "phase/texture"))
        self.create_subscription(Reference, "experiment/reference", self._take_reference, LATCHED)
        self.subscribe_to_steps()
        self.create_subscription(NodeStatus, "phase/status", self._take_phase_status, EVENTS)
        self.create_subscription(
            Image, "phase/texture", self._take_texture, DERIVED, qos_overriding_options=OVERRIDABLE
        )
        self._frames = FrameSteps(self, PatternKind.WHITE, self._take_white)

    def _image_publisher(self, name: str) -> Publisher:
        return self.create_publisher(Image, f"dic/{name}", DERIVED, qos_overriding_options=OVERRIDABLE)

    def _take_reference(self, message: Reference) -> None:
        # through the queue, so that steps which arrived before it are measured without it
        self.worker.submit(self._tracker.set_reference, message.experiment, message.step)

    def _take_phase_status(self, message: NodeStatus) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        if message.error_code != NodeStatus.NONE:
            self._textures.discard(stamp)
            self.refuse_input("phase", message)
        elif message.frames:  # a white step has none for the phase node
            self._join("phase/status", stamp, message)

    def _take_texture(self, message: Image) -> None:
        self._join("phase/texture", to_nanoseconds(message.header.stamp), message)

    def _join(self, topic: str, stamp: int, message: NodeStatus | Image) -> None:
        joined = self._textures.add(topic, stamp, message)
        self._report_losses()
        if joined is None:
            return
        status: NodeStatus = joined["phase/status"]
        try:
            texture = image_array(joined["phase/texture"])
        except Exception as error:
            self.fail(status.experiment, status.step, stamp, error)
        else:
            self._submit(status.experiment, status.step, stamp, texture, status.frames)

    def _take_white(self, stack: Stack) -> None:
        self._report_losses()
        self._submit(stack.experiment, stack.step, stack.stamp, white_texture(stack.frames[-1]), len(stack.records))

    def _submit(self, experiment: str, step: int, stamp: int, texture: np.ndarray, frames: int) -> None:
        work = partial(self._measure_displacement, experiment, step, stamp, texture, frames, self.parameters.value)
        self.measure(experiment, step, stamp, work)

    def _report_losses(self) -> None:
        self.report_unjoined(self._frames.unpaired + self._textures.unjoined)

    def abandon(self, experiment: str, step: int, stamp: int) -> str:
        """Forget what has arrived of a step."""
        return self._textures.discard(stamp) or self._frames.abandon(experiment, step)

    def _measure_displacement(
        self, experiment: str, step: int, stamp: int, texture: np.ndarray, frames: int, parameters: DicParameters
    ) -> Outcome:
        self._tracker.parameters = parameters
        result = self._tracker.step(experiment, step, stamp, texture)
        for publisher, array in ((self._displacement, result.displacement), (self._sigma, result.sigma)):
            publisher.publish(image_message(array, stamp_ns=stamp, frame_id=FRAME))
        self._grid.publish(grid_message(result, texture.shape))
        if self._preview.get_subscription_count():
            colours = displacement_preview(result.displacement)
            self._preview.publish(image_message(colours, stamp_ns=stamp, frame_id=FRAME))
        return Outcome(result.valid_fraction, result.rms, frames, correlated_step=result.correlated_step)


def grid_message(result: DicResult, shape: tuple[int, ...]) -> CameraInfo:
    """Tell where the points are: point (i, j) is at row y_offset + i binning_y, column x_offset + j binning_x.

    Parameters
    ----------
    result
        A measured step.
    shape
        (row, column) of the camera's image.
    """
    rows, columns = result.displacement.shape[:2]
    message = CameraInfo(height=shape[0], width=shape[1], binning_x=result.spacing, binning_y=result.spacing)
    message.header.stamp = to_msg(result.stamp)
    message.header.frame_id = FRAME
    message.roi.y_offset, message.roi.x_offset = result.origin
    message.roi.height = (rows - 1) * result.spacing + 1
    message.roi.width = (columns - 1) * result.spacing + 1
    return message


def main() -> int:
    """Run the dic node."""
    return run(DicNode)
