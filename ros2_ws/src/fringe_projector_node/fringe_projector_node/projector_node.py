"""Shows patterns on the projector and publishes what it shows."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from pydantic import ConfigDict, Field
from sensor_msgs.msg import Image

from fringe_projector_node.screen import Screen, VirtualScreen
from fringedic.errors import InvalidPatternError, ScreenError
from fringedic.patterns import render_pattern
from fringedic.sequence import PatternKind, Projection
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.images import image_message
from fringedic_ros.lifecycle import HardwareNode, HardwareParameters
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED
from fringedic_ros.records import projection
from fringedic_ros.stamps import to_msg

FRAME_ID = "projector_optical_frame"
DARK = Projection(PatternKind.OTHER)


class ProjectorParameters(HardwareParameters):
    """Parameters of the projector node."""

    model_config = ConfigDict(frozen=True)

    width_px: int = Field(800, ge=1, le=16384, description="Columns of the projector [px].")
    height_px: int = Field(600, ge=1, le=16384, description="Rows of the projector [px].")


class ProjectorNode(HardwareNode[ProjectorParameters]):
    """Serves `projector/show`; the present pattern is latched on `projector/image`. Dark until the first request."""

    def __init__(self) -> None:
        super().__init__("projector", ProjectorParameters)
        self._screen: Screen = VirtualScreen()
        self._shown = 0
        self._images = self.create_publisher(Image, "projector/image", LATCHED)
        self.create_service(ShowPattern, "projector/show", self._serve)

    def open(self) -> None:
        """Take the screen."""
        self._screen.open()

    def activate(self) -> None:
        """Begin with a dark screen."""
        self._show(DARK, "dark")

    def close(self) -> None:
        """Give the screen back."""
        self._screen.close()

    def _serve(self, request: ShowPattern.Request, response: ShowPattern.Response) -> ShowPattern.Response:
        try:
            if not self.active:
                raise ScreenError("the projector is not active; configure and activate it first")
            response.shown = to_msg(self._show(_projection(request), request.name))
            self.diagnostics.success()
        except InvalidPatternError as error:
            response.error_code, response.error_message = ShowPattern.Request.INVALID_PATTERN, str(error)
        except ScreenError as error:
            response.error_code, response.error_message = ShowPattern.Request.SCREEN_FAILED, str(error)
        if response.error_message:
            self.get_logger().error(response.error_message)
            self.diagnostics.failure(response.error_message)
        return response

    def _show(self, pattern: Projection, name: str) -> int:
        """Show a pattern and return when it was on the screen [ns]."""
        image = _rendered(pattern, self.parameters.value.width_px, self.parameters.value.height_px, name)
        self._screen.show(image)
        # later than the one before, even when the clock steps back: this stamp is how the pattern is told from others
        self._shown = max(self.get_clock().now().nanoseconds, self._shown + 1)
        self._images.publish(image_message(image, stamp_ns=self._shown, frame_id=FRAME_ID))
        return self._shown


def _projection(request: ShowPattern.Request) -> Projection:
    try:
        return projection(request)
    except ValueError as error:
        raise InvalidPatternError(f"there is no such pattern: {error}") from error


@lru_cache(maxsize=64)
def _rendered(pattern: Projection, width: int, height: int, name: str) -> np.ndarray:
    return render_pattern(pattern, width, height, name)


def main() -> int:
    """Run the projector node."""
    return run(ProjectorNode.started)
