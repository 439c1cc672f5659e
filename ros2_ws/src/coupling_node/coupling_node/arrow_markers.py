"""Displacement as arrows for RViz; needs visualization_msgs, which every stock ROS has."""

from __future__ import annotations

from geometry_msgs.msg import Point
from rclpy.node import Node

from fringedic.figures.arrows import displacement_arrows
from fringedic.steps.step_results import CouplingResult
from fringedic_ros.qos import DERIVED
from fringedic_ros.stamps import to_msg

try:
    from visualization_msgs.msg import Marker, MarkerArray
except ImportError:
    MarkerArray = None

_SHAFT, _HEAD = 0.08, 0.2  # diameters over the length of the arrow
_BLUE = (0.0, 0.2, 0.8, 1.0)


class ArrowMarkers:
    """Publishes `coupling/arrows` while there is a subscriber.

    Parameters
    ----------
    node
        The coupling node.
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(MarkerArray, "coupling/arrows", DERIVED) if MarkerArray else None

    def publish(self, result: CouplingResult, frame: str) -> None:
        """Publish the arrows of a step, whose namespace tells their magnification; they replace the former ones."""
        if self._publisher is None or not self._publisher.get_subscription_count():
            return
        arrows = displacement_arrows(result.displacement)
        markers = [Marker(action=Marker.DELETEALL)]
        for number, (start, end) in enumerate(zip(arrows.starts.tolist(), arrows.ends.tolist(), strict=True)):
            marker = Marker(id=number, type=Marker.ARROW, ns=f"displacement x {arrows.magnification:g}")
            marker.points = [Point(x=x, y=y, z=z) for x, y, z in (start, end)]
            length = sum((a - b) ** 2 for a, b in zip(start, end, strict=True)) ** 0.5
            marker.scale.x, marker.scale.y = _SHAFT * length, _HEAD * length
            marker.color.r, marker.color.g, marker.color.b, marker.color.a = _BLUE
            markers.append(marker)
        for marker in markers:
            marker.header.frame_id, marker.header.stamp = frame, to_msg(result.stamp)
        self._publisher.publish(MarkerArray(markers=markers))
