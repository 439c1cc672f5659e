"""Live figures and a preview of the camera's frames, for setting up a rig."""

from __future__ import annotations

import time
from collections import deque
from typing import Self

from pydantic import BaseModel, Field, model_validator
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from fringedic.errors import FringedicError
from fringedic.figures.live_preview import preview
from fringedic.patterns.pattern import pattern_of_message
from fringedic.rig_setup.live_figures import Figures, LiveView
from fringedic_msgs.msg import Exposure
from fringedic_msgs.msg import LiveView as LiveViewMessage
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_array, image_message
from fringedic_ros.main import run
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.parameters import declare
from fringedic_ros.qos import DERIVED
from fringedic_ros.rig_node import RigNode
from fringedic_ros.serialized import read
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.work import Worker


class LiveViewParameters(BaseModel):
    """Parameters of the live view node."""

    region_px: list[int] = Field(
        [], description="Region of the figures: first column, first row, width, height [px]; empty: all."
    )
    full_scale_grey_level: float = Field(
        0.0,
        ge=0,
        le=65535,
        description="Grey level of a saturated pixel; 0: 255 with 8 bits, else the full scale of the smallest usual "
        "number of bits for the brightest pixel so far.",
    )
    maximum_rate_hz: float = Field(
        10.0, gt=0, le=1000, description="Largest number of evaluated frames per second [Hz]."
    )

    @model_validator(mode="after")
    def _region_has_four_numbers(self) -> Self:
        if len(self.region_px) not in (0, 4):
            raise ValueError("region_px needs four numbers: first column, first row, width, height")
        return self


class LiveViewNode(RigNode):
    """Topics `live_view/figures`, `live_view/image`; service `live_view/reset`.

    When frames arrive faster than they are evaluated, only the newest is.
    """

    def __init__(self) -> None:
        super().__init__("live_view")
        self.parameters = declare(self, LiveViewParameters, self._take_parameters)
        self.diagnostics = NodeDiagnostics(self)
        self._worker = Worker(self, self._fail)
        self._view = self._new_view()
        self._newest = deque[tuple[bytes, Exposure]](maxlen=1)
        self._figures = self.create_publisher(LiveViewMessage, "live_view/figures", DERIVED)
        self._pictures = self.create_publisher(Image, "live_view/image", DERIVED)
        self._pairs = ImageExposurePairs(self, self._take_pair)
        self.create_service(Trigger, "live_view/reset", self._reset)

    def destroy_node(self) -> None:
        """End the background thread and the node."""
        self._worker.stop()
        super().destroy_node()

    def _new_view(self) -> LiveView:
        p = self.parameters.value
        region = None
        if p.region_px:
            column, row, width, height = p.region_px
            region = column, row, width, height
        return LiveView(region, p.full_scale_grey_level or None)

    def _take_parameters(self, _: LiveViewParameters) -> None:
        self._view = self._new_view()

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._view = self._new_view()
        response.success = True
        response.message = "the best focus starts with the next frame"
        return response

    def _take_pair(self, image: bytes, exposure: Exposure) -> None:
        if self._newest:
            self.diagnostics.drop()  # replaced before it was evaluated
        self._newest.append((image, exposure))
        self._worker.submit(self._evaluate_newest)

    def _evaluate_newest(self) -> None:
        """Evaluate the newest frame, unless it has been evaluated; in the thread of the worker."""
        if self._newest:
            begin = time.monotonic()
            self._evaluate(*self._newest.pop())
            time.sleep(max(0.0, 1 / self.parameters.value.maximum_rate_hz - (time.monotonic() - begin)))

    def _evaluate(self, data: bytes, exposure: Exposure) -> None:
        try:
            message = read(data, Image)
            # the pattern of a free run is unknown
            pattern = pattern_of_message(exposure) if exposure.count else None
            image = image_array(message)
            figures = self._view.look(image, pattern)
        except FringedicError as error:
            self._fail(error)
            return
        self._figures.publish(_message(message, figures))
        if self._pictures.get_subscription_count():
            stamp = to_nanoseconds(message.header.stamp)
            picture = preview(image, figures)
            self._pictures.publish(image_message(picture, stamp_ns=stamp, frame_id=message.header.frame_id))
        self.diagnostics.success(1e-9 * (time.time_ns() - to_nanoseconds(message.header.stamp)))

    def _fail(self, error: Exception) -> None:
        self.get_logger().error(str(error), throttle_duration_sec=1.0)
        self.diagnostics.failure(str(error))


def _message(image: Image, figures: Figures) -> LiveViewMessage:
    column, row, width, height = figures.region
    return LiveViewMessage(
        header=image.header,
        column=column,
        row=row,
        width=width,
        height=height,
        focus=figures.focus,
        mean=figures.mean,
        saturated=figures.saturated,
        dark=figures.dark,
        histogram=figures.histogram.tolist(),
        speckle_size=figures.speckle_size,
        modulation=figures.modulation,
        noise=figures.noise,
        full_scale=figures.full_scale,
    )


def main() -> int:
    """Run the live view node."""
    return run(LiveViewNode)


if __name__ == "__main__":
    raise SystemExit(main())
