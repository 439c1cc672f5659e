"""Images of another ROS 2 node: a driver of the manufacturer or of the community."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from camera_node.drivers.driver import Frame, Scene
from fringedic.errors import CameraError, CameraTimeoutError, ClockJumpError
from fringedic.frames.clocks import ClockEstimate, DeviceClock
from fringedic.frames.grey import luminance
from fringedic.settings.camera import TopicCamera
from fringedic.wording.numbers import number_text
from fringedic_ros.arrivals import MOST_BEHIND_S, Arrivals, Problem, stamp_problem
from fringedic_ros.images import image_array
from fringedic_ros.middleware import Endpoint
from fringedic_ros.rig_node import FIXED_QOS
from fringedic_ros.stamps import to_nanoseconds

_TYPE = "sensor_msgs/msg/Image"
_WAITING = 8  # images that may wait in this process and in the middleware
_LOOK_S = 0.2  # between two checks of the publishers
_AHEAD_NS = 5_000_000  # largest difference of the synchronised clocks of two computers
_SAME_AS = {"8UC1": "mono8", "16UC1": "mono16"}
_EARLIER = Problem(
    "with an exposure that began before the request", "increase timeout_s, or the frame rate of the camera's driver"
)
_COLOURS = {"bgr8": slice(None), "rgb8": slice(None, None, -1)}  # order of the channels for blue, green, red


class TopicDriver:
    """A camera that another node drives; `expose` returns the first image whose exposure began after the request.

    The subscription uses the reliability of the publisher, and follows its changes.

    Parameters
    ----------
    settings
        Topic and properties of the images.
    node
        Owner of the subscription; its executor must spin while `expose` waits in another thread.

    Raises
    ------
    CameraError
        The topic is published by this node itself.
    """

    needs_scene = False
    counts: Mapping[str, int] = {}

    def __init__(self, settings: TopicCamera, node: Node) -> None:
        self.dropped = 0
        self._node = node
        self._settings = settings
        self._topic = node.resolve_topic_name(settings.topic)
        if any(publisher.topic_name == self._topic for publisher in node.publishers):
            raise CameraError(
                f"{self._topic} is a topic of this node itself; give the topic of the camera's driver another name"
            )
        self._clock = DeviceClock("driver")
        self._jump: ClockJumpError | None = None
        self._arrivals = Arrivals(node, Image, settings.topic)
        self._last_stamp_ns = 0
        self._images: deque[tuple[Image, int]] = deque()
        self._arrived = threading.Condition()
        self._streaming = self._interrupted = False
        self._converted = False
        self._publishers: Sequence[Endpoint] = []
        self._subscription: Subscription | None = None
        self._reliability: ReliabilityPolicy | None = None
        self._look()
        self._timer = node.create_timer(_LOOK_S, self._look)

    @property
    def clock(self) -> ClockEstimate | None:
        """Clock of the driver relative to this computer."""
        return self._clock.estimate

    def start(self, rate_hz: float) -> None:  # noqa: ARG002 (only the driver can change the rate)
        """Keep every image from now on, at the rate of the driver."""
        self._streaming, self._interrupted = True, False

    def interrupt(self) -> None:
        """End the wait for an image: the executor, whose thread ends the stream, cannot deliver one."""
        with self._arrived:
            self._interrupted = True
            self._arrived.notify()

    def stop(self) -> None:
        """End the stream that `start` began."""
        self._streaming = self._interrupted = False

    def expose(self, scene: Scene) -> Frame:
        """Wait for the first image whose exposure begins from now on, or for the next one of a stream.

        Raises
        ------
        CameraTimeoutError
            No such image arrived; the message describes what did arrive.
        CameraError
            The image or its stamp cannot be used, or another exposure time is requested.
        """
        settings = self._settings
        if scene.exposure_time != settings.exposure_time:
            raise CameraError(
                f"an exposure of {1e3 * scene.exposure_time:g} ms is requested; the driver of {self._topic} exposes "
                f"for {1e3 * settings.exposure_time:g} ms; change the exposure time there"
            )
        asked = 0 if self._streaming else time.time_ns()
        deadline = time.monotonic() + settings.driver_timeout + settings.exposure_time
        if not self._streaming:
            with self._arrived:
                self._images.clear()
                self._jump = None
        self._arrivals.renew()
        while True:
            image = self._next(deadline)
            if image is None:
                raise CameraTimeoutError(str(self._arrivals))
            message, arrived = image
            stamp = to_nanoseconds(message.header.stamp)
            if settings.stamp_of.start_ns(stamp, settings.exposure_time) >= asked:
                self._check_stamp(stamp, arrived)
                middle = settings.stamp_of.middle_ns(stamp, settings.exposure_time)
                return Frame(self._grey(message), middle, settings.exposure_time)
            self._arrivals.take(stamp_problem(stamp, 0, arrived, MOST_BEHIND_S + settings.exposure_time) or _EARLIER)

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_timer(self._timer)
        self._unsubscribe()

    # in the executor's thread

    def _look(self) -> None:
        """Subscribe with the reliability of the publisher."""
        count = self._node.count_publishers(self._topic)
        matched = 0 if self._subscription is None else self._subscription.get_publisher_count()
        if count == matched == len(self._publishers):
            return
        self._publishers = self._node.get_publishers_info_by_topic(self._topic)
        offered = {each.qos_profile.reliability for each in self._publishers if each.topic_type == _TYPE}
        if not offered:
            return  # the driver may return with the same settings
        reliable = offered == {ReliabilityPolicy.RELIABLE}
        wanted = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        if wanted == self._reliability:
            return
        self._unsubscribe()
        self._reliability = wanted
        self._subscription = self._node.create_subscription(
            Image,
            self._topic,
            self._take,
            QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_WAITING, reliability=wanted),
            qos_overriding_options=FIXED_QOS,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._count_lost),
        )

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _take(self, message: Image) -> None:
        arrived = time.time_ns()
        stamp = to_nanoseconds(message.header.stamp)
        if stamp in (0, self._last_stamp_ns):  # without a time, or the same image again
            self._arrivals.take(stamp_problem(stamp, self._last_stamp_ns, arrived))
            return
        self._last_stamp_ns = stamp
        with self._arrived:
            try:
                self._clock.arrival(stamp, arrived)
            except ClockJumpError as jump:
                self._node.get_logger().warning(f"{self._topic}: {jump}")
                self._jump = jump
            if len(self._images) == _WAITING:
                self._images.popleft()
                self.dropped += self._streaming
            self._images.append((message, arrived))
            self._arrived.notify()

    def _count_lost(self, info: QoSMessageLostInfo) -> None:
        self.dropped += info.total_count_change

    # in the thread that waits

    def _next(self, deadline: float) -> tuple[Image, int] | None:
        """Return the next image and its time of arrival [ns]; None when none arrives before the deadline."""
        with self._arrived:
            self._arrived.wait_for(
                lambda: self._images or self._jump or self._interrupted, max(deadline - time.monotonic(), 0.0)
            )
            jump, self._jump = self._jump, None
            if jump is not None:
                self._images.clear()
                raise jump
            return self._images.popleft() if self._images else None

    def _check_stamp(self, stamp_ns: int, arrived_ns: int) -> None:
        settings = self._settings
        if len(self._publishers) > 1:
            raise CameraError(f"{_names(self._publishers)} publish {self._topic}; only one camera may publish it")
        ended = settings.stamp_of.start_ns(stamp_ns, settings.exposure_time) + round(1e9 * settings.exposure_time)
        if ended > arrived_ns + _AHEAD_NS:
            raise CameraError(
                f"an image of {self._topic} arrived {number_text(1e-9 * (ended - arrived_ns), 3)} s before the end of "
                "its exposure by its stamp; synchronise the clock of the driver with this computer, or correct "
                f"exposure_ms and stamp_of ({settings.stamp_of})"
            )

    def _grey(self, message: Image) -> np.ndarray:
        """Return the grey levels of an image message, uint8 or uint16 (row, column)."""
        message.encoding = _SAME_AS.get(message.encoding, message.encoding)
        if message.encoding in ("mono8", "mono16"):
            return image_array(message)
        if message.encoding not in _COLOURS:
            raise CameraError(
                f"{self._topic} has images of the encoding {message.encoding}; set the camera's driver to mono8 or "
                "mono16"
            )
        if not self._converted:
            self._converted = True
            self._node.get_logger().warning(
                f"{self._topic} has colours ({message.encoding}); their luminance is used, which is coarser and has "
                "more noise than grey images: set the driver to mono8 or mono16 if possible"
            )
        return luminance(image_array(message)[:, :, _COLOURS[message.encoding]])


def _names(publishers: Sequence[Endpoint]) -> str:
    return ", ".join(f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in publishers)
