"""Turns and lifts the reference plane for a calibration. In this version the stage is that of the virtual rig."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from pydantic import Field
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.lifecycle import HardwareNode, HardwareParameters
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED

FRAME_ID = "reference_plane"
_KINDS = {
    ReferencePlane.GRID: "the grid",
    ReferencePlane.PLANE: "the plain plane",
    ReferencePlane.SPECIMEN: "the specimen",
}


class StageParameters(HardwareParameters):
    """Parameters of the stage node."""

    maximum_angle_degree: float = Field(
        40.0, ge=0, le=80, description="The stage turns from minus to plus this angle [degree]."
    )
    maximum_height_mm: float = Field(
        30.0, ge=0, le=1000, description="The stage lifts from minus to plus this height [mm]."
    )


class StageNode(HardwareNode[StageParameters]):
    """Service `reference_plane/place`; topic `reference_plane/state`."""

    def __init__(self) -> None:
        super().__init__("stage", StageParameters)
        self._states = self.create_publisher(ReferencePlane, "reference_plane/state", LATCHED)
        self.create_service(
            PlaceReferencePlane,
            "reference_plane/place",
            self._place,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def activate(self) -> None:
        """Begin with the specimen in front of the camera."""
        self._put(ReferencePlane.SPECIMEN, 0.0, 0.0)

    def _place(
        self, request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response
    ) -> PlaceReferencePlane.Response:
        response.message = self._why_not(request)
        if response.message:
            self.get_logger().error(response.message)
            self.diagnostics.failure(response.message)
            return response
        response.placed = self._put(request.kind, request.angle, request.height)
        response.success = True
        response.angle, response.height = request.angle, request.height
        self.diagnostics.success()
        return response

    def _why_not(self, request: PlaceReferencePlane.Request) -> str:
        parameters = self.parameters.value
        if not self.active:
            return "the stage is not active; configure and activate it"
        if request.kind not in _KINDS:
            return f"kind {request.kind} is unknown; use GRID, PLANE or SPECIMEN"
        angle, height = math.degrees(request.angle), 1e3 * request.height
        if not abs(angle) <= parameters.maximum_angle_degree * (1 + 1e-9):
            return f"the stage turns to {parameters.maximum_angle_degree:g} degree at most, not to {angle:g}"
        if not abs(height) <= parameters.maximum_height_mm * (1 + 1e-9):
            return f"the stage lifts to {parameters.maximum_height_mm:g} mm at most, not to {height:g}"
        return ""

    def _put(self, kind: int, angle: float, height: float) -> Time:
        """Say where the plane stands now, and return the stamp of that."""
        state = ReferencePlane(kind=kind, angle=angle, height=height)
        state.header.stamp, state.header.frame_id = self.get_clock().now().to_msg(), FRAME_ID
        self._states.publish(state)
        return state.header.stamp


def main() -> int:
    """Run the stage node."""
    return run(StageNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
