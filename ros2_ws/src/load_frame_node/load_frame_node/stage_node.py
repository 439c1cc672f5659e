"""Tilts and lifts the reference plane of the virtual rig for a calibration."""

from __future__ import annotations

import math
import time

from builtin_interfaces.msg import Time
from pydantic import Field
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration

from fringedic.settings.base import HardwareNodeSettings
from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED
from fringedic_ros.rig_node import RIG_FRAME, frame_id
from fringedic_ros.stamps import to_msg

ARRIVAL_S = 2  # a reader that has died does not confirm
_KINDS = {
    ReferencePlane.GRID: "the grid",
    ReferencePlane.PLANE: "the plain plane",
    ReferencePlane.SPECIMEN: "the specimen",
}


class StageParameters(HardwareNodeSettings):
    """Parameters of the stage node."""

    maximum_angle_degree: float = Field(
        40.0, ge=0, le=80, description="Largest angle of the stage in both directions [degree]."
    )
    maximum_height_mm: float = Field(
        30.0, ge=0, le=1000, description="Largest height of the stage in both directions [mm]."
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
        """Start with the specimen in front of the camera."""
        self._put(ReferencePlane.SPECIMEN, 0.0, 0.0)

    def _place(
        self, request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response
    ) -> PlaceReferencePlane.Response:
        response.message = self._reason_to_refuse(request)
        if response.message:
            self.get_logger().error(response.message)
            self.diagnostics.failure(response.message)
            return response
        response.placed = self._put(request.kind, request.angle, request.height)
        response.success = True
        response.angle, response.height = request.angle, request.height
        self.diagnostics.success()
        return response

    def _reason_to_refuse(self, request: PlaceReferencePlane.Request) -> str:
        """Return why a request cannot be met; empty when it can."""
        parameters = self.parameters.value
        if not self.active:
            return "the stage is not active; configure and activate it"
        if request.kind not in _KINDS:
            return f"kind {request.kind} is unknown; use GRID, PLANE or SPECIMEN"
        for what, value, largest, unit in (
            ("angle", math.degrees(request.angle), parameters.maximum_angle_degree, "degree"),
            ("height", 1e3 * request.height, parameters.maximum_height_mm, "mm"),
        ):
            if not abs(value) <= largest * (1 + 1e-9):
                return f"{what} {value:g} {unit} is outside the range of the stage, -{largest:g} to {largest:g} {unit}"
        return ""

    def _put(self, kind: int, angle: float, height: float) -> Time:
        """Publish the new place of the plane and return its stamp when it has arrived.

        A camera that exposes frames after the response must not see the object that was there before.
        """
        state = ReferencePlane(kind=kind, angle=angle, height=height)
        state.header.stamp, state.header.frame_id = to_msg(time.time_ns()), frame_id(self, RIG_FRAME)
        self._states.publish(state)
        self._states.wait_for_all_acked(Duration(seconds=ARRIVAL_S))
        return state.header.stamp


def main() -> int:
    """Run the stage node."""
    return run(StageNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
