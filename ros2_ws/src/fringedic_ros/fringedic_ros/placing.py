"""What is known about the place of the reference plane: the answer of a stage, and the state that it publishes."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from rclpy.node import Node

from fringedic.calibration.placement import apart
from fringedic.calibration.sentences import position_in_words
from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.arrivals import Arrivals
from fringedic_ros.qos import LATCHED
from fringedic_ros.stamps import to_nanoseconds

STATE = "reference_plane/state"


def placing_problem(request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response) -> str:
    """Return a sentence about an object that was not placed as requested; empty when it was.

    A plane may reach another angle or height, which the calibration then takes. Angle 0 and height 0 are where the grid
    is, which gives the scale; a tilted one stays at height 0.
    """
    if not response.success:
        return response.message or "refused without a reason"
    if not (math.isfinite(response.angle) and math.isfinite(response.height)):
        return "the stage reports an angle or a height that is no number; check its driver"
    if request.kind == ReferencePlane.GRID and apart(0.0 if request.angle else response.angle, response.height):
        reached = position_in_words(request.kind, response.angle, response.height)
        return f"the stage reports {reached}; the grid defines the scale at height 0: check the zero of the stage"
    return ""


class PlaceWatch:
    """Compares the state of a stage with the place that it reached.

    Parameters
    ----------
    node
        Owner of the subscription.

    Attributes
    ----------
    placed
        Stamp of the latest state, of the object in front of the camera.
    arrivals
        The states that came.
    """

    def __init__(self, node: Node) -> None:
        self.placed = Time()
        self.arrivals = Arrivals(node, ReferencePlane, STATE)
        self._state = ReferencePlane()
        self._reached = ReferencePlane()
        node.create_subscription(ReferencePlane, STATE, self._take_state, LATCHED)

    def take_response(self, kind: int, response: PlaceReferencePlane.Response) -> None:
        """Take the answer of a stage that has placed an object."""
        self.placed = response.placed
        self._reached = ReferencePlane(kind=kind, angle=response.angle, height=response.height)
        self._reached.header.stamp = response.placed

    def problem(self) -> str:
        """Return a sentence about a stage that has left the place that it reached since; empty when it has not.

        A driver that is started again may move the stage to its zero. A stage without state has no stamp in its answer.
        """
        reached, state = self._reached, self._state
        stamp = to_nanoseconds(reached.header.stamp)
        if not stamp or to_nanoseconds(state.header.stamp) <= stamp:
            return ""
        if state.kind == reached.kind and not apart(state.angle - reached.angle, state.height - reached.height):
            return ""
        now, before = (position_in_words(each.kind, each.angle, each.height) for each in (state, reached))
        return f"the stage has left its place: it reports {now} instead of {before}; check its driver and measure again"

    def _take_state(self, message: ReferencePlane) -> None:
        self._state, self.placed = message, message.header.stamp
        self.arrivals.take_stamped(to_nanoseconds(message.header.stamp), math.inf)
