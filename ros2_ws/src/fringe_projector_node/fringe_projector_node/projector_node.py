"""Shows fringes, white light and set-up patterns, and publishes the pattern on the screen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import Image

from fringe_projector_node.screens import Screen, VirtualScreen
from fringedic.errors import PatternError, ScreenError
from fringedic.patterns.pattern import PatternKind, ProjectedPattern, pattern_of_message
from fringedic.patterns.render import render_pattern
from fringedic.patterns.response import ResponseCurve
from fringedic.settings.projector import ProjectorNodeSettings
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.images import image_message
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED
from fringedic_ros.rig_node import PROJECTOR_FRAME, frame_id
from fringedic_ros.stamps import to_msg

_CHECK_PERIOD_S = 0.1
_KEPT_PATTERNS = 64  # more than a sequence has: the steps after the first do not render


class ProjectorNode(HardwareNode[ProjectorNodeSettings]):
    """Service `projector/show`; topic `projector/image`."""

    def __init__(self) -> None:
        super().__init__("projector", ProjectorNodeSettings)
        self._screen: Screen = VirtualScreen()
        self._shown_ns = 0
        self._images = self.create_publisher(Image, "projector/image", LATCHED)
        # one group, so that the screen serves one call after the other
        screen = MutuallyExclusiveCallbackGroup()
        self.create_service(ShowPattern, "projector/show", self._show, callback_group=screen)
        self._lost: ScreenError | None = None
        self.create_timer(_CHECK_PERIOD_S, self._check, callback_group=screen)

    def open(self) -> None:
        """Open the screen that the parameters select."""
        settings = self.parameters.value
        width, height = settings.size
        file = settings.device.response_curve
        response = ResponseCurve.load(file) if file else None

        @lru_cache(maxsize=_KEPT_PATTERNS)
        def render(pattern: ProjectedPattern, name: str) -> np.ndarray:
            return render_pattern(pattern, width, height, name, response=response)

        self._render = render
        self._screen = settings.device.open(self)

    def activate(self) -> None:
        """Start with a dark screen."""
        self._put(self._render(ProjectedPattern(PatternKind.OTHER), "dark"))

    def close(self) -> None:
        """Close the screen."""
        self._screen.close()
        self._screen = VirtualScreen()

    def _put(self, image: np.ndarray) -> int:
        shown_ns = self._screen.show(image)
        # a stamp identifies a pattern: successive ones differ, even when the clock is set back
        self._shown_ns = shown_ns + (shown_ns == self._shown_ns)
        self._images.publish(image_message(image, stamp_ns=self._shown_ns, frame_id=frame_id(self, PROJECTOR_FRAME)))
        return self._shown_ns

    def _show(self, request: ShowPattern.Request, response: ShowPattern.Response) -> ShowPattern.Response:
        try:
            if not self.active:
                raise ScreenError("the projector is not active; configure and activate it")
            lost, self._lost = self._lost, None
            if lost is not None:
                raise lost
            response.shown = to_msg(self._put(self._render(pattern_of_message(request), request.name)))
            self.diagnostics.success()
        except PatternError as error:
            self._refuse(response, ShowPattern.Request.INVALID_PATTERN, error)
        except ScreenError as error:
            self._refuse(response, ShowPattern.Request.SCREEN_FAILED, error)
        return response

    def _check(self) -> None:
        """Check the screen between two patterns; an error is reported with the next show request."""
        try:
            self._screen.check()
        except ScreenError as error:
            if self._lost is None:  # the same error is logged once
                self.get_logger().error(str(error))
            self._lost = error
            self.diagnostics.failure(str(error))

    def _refuse(self, response: ShowPattern.Response, code: int, error: Exception) -> None:
        response.error_code, response.error_message = code, str(error)
        self.get_logger().error(str(error))
        self.diagnostics.failure(str(error))


def main() -> int:
    """Run the projector node."""
    return run(ProjectorNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
