"""The projector node in a process of its own: requested patterns are shown pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import Image

from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.images import image_array
from fringedic_ros.qos import LATCHED
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer

WIDTH, HEIGHT = 100, 75


class Audience(Peer):
    """Requests patterns and collects the images of the screen."""

    def __init__(self) -> None:
        super().__init__()
        self.images = self.listen(Image, "projector/image", LATCHED)
        self._show = self.create_client(ShowPattern, "projector/show")

    def show(self, **request: object) -> ShowPattern.Response:
        return self.ask(self._show, ShowPattern.Request(**request), "the projector's answer")

    def seen(self, stamp_ns: int) -> np.ndarray:
        self.wait(lambda: any(to_nanoseconds(image.header.stamp) == stamp_ns for image in self.images), "the image")
        return image_array(next(image for image in self.images if to_nanoseconds(image.header.stamp) == stamp_ns))


@pytest.fixture(scope="module")
def audience(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Audience]:
    rclpy.init()
    audience = Audience()
    size = {"width": WIDTH, "height": HEIGHT}
    with NodeProcess("fringe_projector_node.projector_node", tmp_path_factory.mktemp("projector"), size):
        yield audience
    audience.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        (ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 25.0, 1, 4), ""),
        (ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 12.5, 3, 8), ""),
        (ProjectedPattern(PatternKind.FRINGES, Orientation.HORIZONTAL, 25.0, 2, 4), ""),
        (ProjectedPattern(PatternKind.GRAY_CODE, Orientation.VERTICAL, 25.0, 2, 6), ""),
        (ProjectedPattern(PatternKind.GREY, shift=77, shifts=255), ""),
        (ProjectedPattern(PatternKind.WHITE), ""),
        (ProjectedPattern(PatternKind.OTHER), "grid"),
    ],
)
def test_shows_the_requested_pattern(audience: Audience, pattern: ProjectedPattern, name: str) -> None:
    stamps = []
    for _ in range(2):  # the second time from the cache
        response = audience.show(
            kind=int(pattern.kind),
            orientation=int(pattern.orientation),
            pitch=pattern.pitch,
            shift=pattern.shift,
            shifts=pattern.shifts,
            name=name,
        )
        assert response.error_code == ShowPattern.Request.NONE, response.error_message
        stamps.append(to_nanoseconds(response.shown))
        expected = render_pattern(pattern, WIDTH, HEIGHT, name)
        np.testing.assert_array_equal(audience.seen(stamps[-1]), expected)
    assert stamps[1] > stamps[0]


def test_late_camera_gets_the_present_pattern(audience: Audience) -> None:
    shown = to_nanoseconds(audience.show(kind=int(PatternKind.WHITE)).shown)
    late = Peer("late_camera")
    images = late.listen(Image, "projector/image", LATCHED)
    late.wait(lambda: images, "the latched image")
    assert [to_nanoseconds(image.header.stamp) for image in images] == [shown]
    late.destroy_node()


@pytest.mark.parametrize(
    ("request_fields", "words"),
    [
        ({"kind": 1, "pitch": float("nan"), "shift": 1, "shifts": 4}, "pitch"),
        ({"kind": 1, "pitch": 1.0, "shift": 1, "shifts": 4}, "pitch"),
        ({"kind": 1, "pitch": 20.0, "shift": 1, "shifts": 2}, "3 shifts"),
        ({"kind": 2, "name": "flowers"}, "flowers"),
        ({"kind": 9}, "9"),
    ],
)
def test_bad_pattern_is_refused_and_the_next_works(
    audience: Audience, request_fields: dict[str, object], words: str
) -> None:
    response = audience.show(**request_fields)
    assert response.error_code == ShowPattern.Request.INVALID_PATTERN
    assert words in response.error_message
    assert audience.show(kind=int(PatternKind.WHITE)).error_code == ShowPattern.Request.NONE


def test_inactive_projector_refuses(audience: Audience) -> None:
    change = audience.create_client(ChangeState, "projector/change_state")

    def transition(number: int) -> bool:
        future = change.call_async(ChangeState.Request(transition=Transition(id=number)))
        audience.wait(future.done, "the transition")
        return future.result().success

    audience.wait(change.service_is_ready, "the lifecycle service")
    audience.meet("projector")
    assert transition(Transition.TRANSITION_DEACTIVATE)
    response = audience.show(kind=int(PatternKind.WHITE))
    assert response.error_code == ShowPattern.Request.SCREEN_FAILED
    assert "not active" in response.error_message
    assert transition(Transition.TRANSITION_ACTIVATE)
    assert audience.show(kind=int(PatternKind.WHITE)).error_code == ShowPattern.Request.NONE
