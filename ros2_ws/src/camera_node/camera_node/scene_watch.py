"""Scene in front of a virtual camera, from the messages of projector, load frame and stage."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Literal, NamedTuple

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from camera_node.drivers import PlacedPlane, Scene, ShownPattern
from fringedic.errors import CameraError
from fringedic_msgs.msg import LoadState, ReferencePlane
from fringedic_ros.arrivals import Arrivals
from fringedic_ros.images import image_array
from fringedic_ros.polled import PolledTopic
from fringedic_ros.qos import LATCHED, LATEST
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import Condition

_KEPT_POSITIONS = 1000  # of the crosshead: one second of the fastest machine
_KEPT_PATTERNS = 16  # the latest pattern and earlier ones that a slow projector may still show


class SceneStamps(NamedTuple):
    """Stamps of the latest messages about the scene that the client of a camera has received, or caused [ns].

    The camera may receive them later.

    Attributes
    ----------
    shown_ns
        Of the pattern on the screen; 0 without projector.
    placed_ns
        Of the state of the reference plane; 0 without stage.
    loaded_ns
        Of a sample of the load frame; 0 without load frame.
    """

    shown_ns: int
    placed_ns: int
    loaded_ns: int


class SceneWatch:
    """Collects the messages that describe the scene while it is open.

    A real camera needs none of them: a load frame at 1 kHz would cost half a processor core.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._changed = Condition(node)
        self._subscriptions: list[Subscription] = []
        self._samples: PolledTopic[LoadState] | None = None
        self._patterns: deque[Image] = deque(maxlen=_KEPT_PATTERNS)
        self._load: LoadState | None = None
        self._positions: deque[tuple[int, float]] = deque(maxlen=_KEPT_POSITIONS)  # stamp [ns] and position [m]
        self._plane: PlacedPlane | None = None
        self._placed_ns = 0
        self._pattern_arrivals = Arrivals(node, Image, "projector/image")
        self._load_arrivals = Arrivals(node, LoadState, "load_frame/state")
        self._plane_arrivals = Arrivals(node, ReferencePlane, "reference_plane/state")

    def open(self) -> None:
        """Subscribe to the topics of the scene."""
        create = self._node.create_subscription
        self._subscriptions = [
            create(Image, "projector/image", self._take_pattern, LATCHED),
            create(ReferencePlane, "reference_plane/state", self._take_plane, LATCHED),
        ]
        self._samples = PolledTopic(self._node, LoadState, "load_frame/state", LATEST, callback=self._take_load)

    def close(self) -> None:
        """Unsubscribe."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())
        if self._samples is not None:
            self._samples.destroy()
            self._samples = None

    def read_load(self) -> None:
        """Take the latest position of the specimen over from the load frame, in the thread of the executor."""
        if self._samples is not None:
            self._samples.read()

    def latest(self, exposure_time: float) -> Scene:
        """Return the scene of a free run: the latest patterns, with the specimen at the position read last."""
        position = 0.0 if self._load is None else self._load.position
        return Scene(time.time_ns(), self._shown(), position, None, exposure_time)

    async def scene(self, stamps: SceneStamps, exposure_time: float, timeout_s: float) -> Scene:
        """Return the scene of an exposure that begins now, as soon as all messages about it have arrived.

        Parameters
        ----------
        stamps
            Of the messages that have to have arrived.
        exposure_time
            Exposure time [s].
        timeout_s
            Longest wait for each message [s].

        Raises
        ------
        WaitTimeoutError
            A message did not arrive.
        CameraError
            The projector shows a later pattern.
        """
        stamp = time.time_ns() + round(exposure_time * 1e9 / 2)
        if self._samples is None:
            return Scene(stamp, (), 0.0, None, exposure_time)
        await self._await_pattern(stamps.shown_ns, timeout_s)
        if stamps.placed_ns > self._placed_ns:
            await self._changed.wait(
                lambda: self._placed_ns >= stamps.placed_ns,
                timeout_s,
                "reference_plane/state of the placed object",
                self._plane_arrivals,
            )
        self._load_arrivals.renew()
        with self._samples.listening():
            await self._changed.wait(
                lambda: (
                    self._load_ns() >= self._needed(stamp, exposure_time) or self._has_last_sample(stamps.loaded_ns)
                ),
                timeout_s,
                "a sample of load_frame/state during the exposure",
                self._load_arrivals,
            )
        position, travel = self._motion(stamp, exposure_time)
        return Scene(stamp, self._shown(), position, self._plane, exposure_time, travel)

    def _needed(self, stamp: int, exposure_time: float) -> int:
        """Return the stamp of the sample that shows the specimen until the end of an exposure [ns]."""
        return stamp + round(0.5e9 * exposure_time) if self._moves() else stamp

    def _moves(self) -> bool:
        return self._load is not None and self._load.mode == LoadState.MOVING

    def _motion(self, stamp: int, exposure_time: float) -> tuple[float, float]:
        """Return the position of the crosshead at the middle of an exposure, and its way meanwhile [m].

        It moves at constant speed between two samples.
        """
        if self._load is None or not self._moves():
            return 0.0 if self._load is None else self._load.position, 0.0
        stamps, positions = zip(*self._positions, strict=True)
        moments = 0.5 * exposure_time * np.array([-1.0, 0.0, 1.0])
        begin, middle, end = np.interp(moments, 1e-9 * (np.array(stamps) - stamp), positions)
        return float(middle), float(end - begin)

    async def _await_pattern(self, shown_ns: int, timeout_s: float) -> None:
        if not shown_ns:
            return
        await self._changed.wait(
            lambda: self._shown_ns() >= shown_ns,
            timeout_s,
            f"the pattern shown at {shown_ns} ns on projector/image",
            self._pattern_arrivals,
        )
        if self._shown_ns() != shown_ns:
            raise CameraError(
                f"the projector already shows another pattern than that of {shown_ns} ns; measure the step again"
            )

    def _take_pattern(self, message: Image) -> None:
        self._patterns.append(message)
        self._pattern_arrivals.take_stamped(to_nanoseconds(message.header.stamp), math.inf)
        self._changed.notify()

    def _take_load(self, message: LoadState) -> None:
        self._load = message
        stamp = to_nanoseconds(message.header.stamp)
        if self._positions and self._positions[-1][0] >= stamp:
            self._positions.clear()  # the clock was set back
        self._positions.append((stamp, message.position))
        self._load_arrivals.take_stamped(to_nanoseconds(message.header.stamp))
        self._changed.notify()

    def _take_plane(self, message: ReferencePlane) -> None:
        surface: Literal["plain", "grid"] = "grid" if message.kind == ReferencePlane.GRID else "plain"
        there = message.kind != ReferencePlane.SPECIMEN
        self._plane = PlacedPlane(surface, message.angle, message.height) if there else None
        self._placed_ns = to_nanoseconds(message.header.stamp)
        self._plane_arrivals.take_stamped(self._placed_ns, math.inf)
        self._changed.notify()

    def _has_last_sample(self, loaded_ns: int) -> bool:
        """Return whether no sample of the load frame will follow those that have arrived.

        A load frame that has ended leaves its last sample, also when its end is discovered during the wait. One
        that has published up to `loaded_ns`, but that this node has not discovered yet, has not ended.
        """
        return self._load_ns() >= loaded_ns and not self._node.count_publishers("load_frame/state")

    def _load_ns(self) -> int:
        """Return the stamp of the latest sample of the load frame [ns]; 0 before the first."""
        return 0 if self._load is None else to_nanoseconds(self._load.header.stamp)

    def _shown_ns(self) -> int:
        """Return the stamp of the latest pattern [ns]; 0 before the first."""
        return to_nanoseconds(self._patterns[-1].header.stamp) if self._patterns else 0

    def _shown(self) -> tuple[ShownPattern, ...]:
        """Return the latest patterns, oldest first."""
        return tuple(ShownPattern(image_array(each), to_nanoseconds(each.header.stamp)) for each in self._patterns)
