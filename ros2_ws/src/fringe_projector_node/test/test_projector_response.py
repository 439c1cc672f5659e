"""A projector node that is told its response curve shows patterns that make up for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rclpy
from sensor_msgs.msg import Image

from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.patterns.response import ResponseCurve
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.images import image_array
from fringedic_ros.qos import LATCHED
from fringedic_ros.testing import NodeProcess, Peer

WIDTH, HEIGHT = 100, 75


def test_patterns_make_up_for_the_response_curve(tmp_path: Path) -> None:
    curve = ResponseCurve(tuple(float(value) for value in (np.arange(256) / 255) ** 2.2))
    curve.save(tmp_path / "response.yaml")
    curve = ResponseCurve.load(tmp_path / "response.yaml")
    parameters = {"width": WIDTH, "height": HEIGHT, "response_curve": str(tmp_path / "response.yaml")}
    fringes = ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 25.0, 1, 4)
    rclpy.init()
    audience = Peer()
    images: list[Image] = audience.listen(Image, "projector/image", LATCHED)
    show = audience.create_client(ShowPattern, "projector/show")
    try:
        with NodeProcess("fringe_projector_node.projector_node", tmp_path, parameters):
            request = ShowPattern.Request(kind=int(fringes.kind), pitch=25.0, shift=1, shifts=4)
            stamp = audience.ask(show, request, "the projector's answer").shown
            audience.wait(lambda: any(image.header.stamp == stamp for image in images), "the image")
    finally:
        audience.destroy_node()
        rclpy.shutdown()
    shown = next(image_array(image) for image in images if image.header.stamp == stamp)
    np.testing.assert_array_equal(shown, render_pattern(fringes, WIDTH, HEIGHT, response=curve))
    assert not np.array_equal(shown, render_pattern(fringes, WIDTH, HEIGHT))
