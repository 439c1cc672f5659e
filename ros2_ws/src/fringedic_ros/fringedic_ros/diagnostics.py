"""Rate, latency, lost work and the last error of a node, once a second on `/diagnostics`."""

from __future__ import annotations

import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from fringedic_ros.qos import DIAGNOSTICS

_PERIOD_S = 1.0


class NodeDiagnostics:
    """Counts the units of work of a node (frames, steps, samples) and publishes its state once a second.

    The level is ERROR after a failure until the next success, WARN in a period with lost work, else OK. All methods may
    be called from any thread.

    Parameters
    ----------
    node
        Owner of publisher and timer.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._count = 0
        self._latency_s = float("nan")
        self._drops = 0
        self._reported_drops = 0
        self._last_error = ""
        self._values: dict[str, str] = {}
        self._failing = False
        self._period_start = time.monotonic()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", DIAGNOSTICS)
        node.create_timer(_PERIOD_S, self._publish, callback_group=ReentrantCallbackGroup())

    def success(self, latency_s: float = float("nan")) -> None:
        """Count a finished unit of work, `latency_s` after its last input [s]."""
        with self._lock:
            self._count += 1
            self._latency_s = latency_s
            self._failing = False

    def drop(self, count: int = 1) -> None:
        """Count lost units of work."""
        with self._lock:
            self._drops += count

    def set_value(self, key: str, value: str) -> None:
        """Set a further value of the published state, such as the packets that a camera lost."""
        with self._lock:
            self._values[key] = value

    def failure(self, message: str) -> None:
        """Count a failed unit of work."""
        with self._lock:
            self._last_error = message
            self._failing = True

    def _publish(self) -> None:
        now = time.monotonic()
        with self._lock:
            rate = self._count / (now - self._period_start)
            dropping = self._drops > self._reported_drops
            self._count, self._period_start, self._reported_drops = 0, now, self._drops
            status = DiagnosticStatus(
                name=self._node.get_fully_qualified_name(),
                hardware_id=self._node.get_name(),
                values=[
                    KeyValue(key="rate_hz", value=f"{rate:.3g}"),
                    KeyValue(key="latency_s", value=f"{self._latency_s:.3g}"),
                    KeyValue(key="drops", value=str(self._drops)),
                    KeyValue(key="last_error", value=self._last_error),
                    *(KeyValue(key=key, value=value) for key, value in self._values.items()),
                ],
            )
            if self._failing:
                status.level, status.message = DiagnosticStatus.ERROR, self._last_error
            elif dropping:
                status.level, status.message = DiagnosticStatus.WARN, "work is being lost"
            else:
                status.level, status.message = DiagnosticStatus.OK, "ok"
        report = DiagnosticArray(status=[status])
        report.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(report)
