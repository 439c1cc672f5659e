"""Single frames of a rig whose nodes have not discovered their client yet."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import Image

from fringedic.errors import WaitTimeoutError
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import WHITE
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.procedures.exposing import ExposingClient
from fringedic_msgs.msg import Exposure
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.images import image_message
from fringedic_ros.qos import IMAGES
from fringedic_ros.records import exposure_message
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import await_readers

PIXELS = np.arange(12, dtype=np.uint8).reshape(3, 4)


class Rig(Node):
    """Projector and camera whose first responses are lost, as before the discovery of their reader."""

    def __init__(self, **options: Any) -> None:
        super().__init__("rig", namespace="rig", **options)
        self.silent = {"projector/show", "camera/capture"}
        self.images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self.exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        group = ReentrantCallbackGroup()
        self.create_service(ShowPattern, "projector/show", self._show, callback_group=group)
        self.create_service(CaptureFrame, "camera/capture", self._capture, callback_group=group)

    async def _lose_first_response(self, service: str) -> None:
        if service in self.silent:
            self.silent.remove(service)
            await Future()

    async def _show(self, _: ShowPattern.Request, response: ShowPattern.Response) -> ShowPattern.Response:
        await self._lose_first_response("projector/show")
        response.shown = to_msg(time.time_ns())
        return response

    async def _capture(self, request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        await self._lose_first_response("camera/capture")
        if request.count:
            await_readers(self.images, request.image_subscribers)
            await_readers(self.exposures, request.exposure_subscribers)
            record = FrameRecord("single frames", 0, 0, 1, WHITE, time.time_ns(), 0.01)
            self.exposures.publish(exposure_message(record, frame_id="camera_optical_frame"))
            self.images.publish(image_message(PIXELS, stamp_ns=record.stamp, frame_id="camera_optical_frame"))
            response.stamp = to_msg(record.stamp)
        return response


@pytest.fixture
def rig() -> Iterator[Rig]:
    with private_domain() as domain:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        node, executor = Rig(context=context), SingleThreadedExecutor(context=context)
        executor.add_node(node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        yield node
        executor.create_task(executor.shutdown)  # in its own thread, as `Spinning` does
        thread.join()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_lost_first_responses_cost_no_frame(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    with ExposingClient(domain=rig.context.get_domain_id()) as client:
        assert client.show(WHITE) > 0
        image, record = client.expose()
        rig.silent.add("camera/capture")  # a camera that stands still, or has lost a later request
        monkeypatch.setattr("fringedic_bringup.client.START_TIMEOUT_S", 0.2)
        with pytest.raises(WaitTimeoutError, match="start the command again: the node of camera/capture"):
            client.expose()
    np.testing.assert_array_equal(image, PIXELS)
    assert record.experiment == "single frames"
