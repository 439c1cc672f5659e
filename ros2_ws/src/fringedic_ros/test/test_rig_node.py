"""Common to all nodes: frame prefix, QoS overrides, unknown parameters, and timers that /clock does not stop."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import String

from fringedic.errors import ConfigurationError
from fringedic.frames.sensor import SENSOR
from fringedic_ros.parameters import report_unknown_parameters
from fringedic_ros.qos import IMAGES
from fringedic_ros.rig_node import FIXED_QOS, RIG_FRAME, RigNode, frame_id

DEPTH = IMAGES.depth


def started(*rules: str) -> RigNode:
    rclpy.init(args=["--ros-args", "-r", "__ns:=/left/rig", *rules])
    return RigNode("viewer")


@pytest.fixture(autouse=True)
def _ended() -> Iterator[None]:
    yield
    rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("rules", "expected"),
    [
        ((), "left/rig/reference_plane"),
        (("-p", "frame_prefix:=bench"), "bench/reference_plane"),
        (("-p", "frame_prefix:=''"), "reference_plane"),
    ],
)
def test_frames_have_the_prefix(rules: tuple[str, ...], expected: str) -> None:
    assert frame_id(started(*rules), RIG_FRAME) == expected


def test_a_node_has_the_name_of_its_sensor_and_refuses_one_that_is_no_name() -> None:
    assert started("-p", "sensor:=left").sensor == "left"
    rclpy.try_shutdown()
    assert started().sensor == SENSOR
    rclpy.try_shutdown()
    with pytest.raises(ConfigurationError, match=r"^viewer: sensor is '../left': it has to be a name of letters"):
        started("-p", "sensor:=../left")


def test_an_override_concerns_its_topic_alone() -> None:
    topic = "/left/rig/words"
    node = started(
        *("-p", f"qos_overrides.{topic}.publisher.depth:=3"),
        *("-p", f"qos_overrides.{topic}.subscription.reliability:=best_effort"),
    )
    words, others = (node.create_publisher(String, name, IMAGES) for name in ("words", "others"))
    heard = node.create_subscription(String, "words", lambda _: None, IMAGES)
    assert (words.qos_profile.depth, others.qos_profile.depth, IMAGES.depth) == (3, DEPTH, DEPTH)
    assert heard.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert IMAGES.reliability == ReliabilityPolicy.RELIABLE


def test_a_topic_that_follows_its_publishers_has_no_overrides() -> None:
    node = started()
    node.create_subscription(String, "words", lambda _: None, IMAGES, qos_overriding_options=FIXED_QOS)
    assert not node.get_parameters_by_prefix("qos_overrides")


def test_an_unknown_parameter_is_reported_and_a_known_one_is_not(capfd: pytest.CaptureFixture[str]) -> None:
    node = started("-p", "windw:=24", "-p", "frame_prefix:=bench", "-p", "use_sim_time:=false")
    report_unknown_parameters(node)
    told = capfd.readouterr().err
    assert "viewer has no parameter windw, which is ignored; it has" in told
    assert told.count("frame_prefix") == 1


def test_timers_run_while_the_clock_stands_still() -> None:
    node = started("-p", "use_sim_time:=true")
    assert node.get_clock().now().nanoseconds == 0
    rings: list[int] = []
    node.create_timer(0.01, lambda: rings.append(1))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for _ in range(100):
        executor.spin_once(timeout_sec=0.1)
        if rings:
            break
    assert rings
