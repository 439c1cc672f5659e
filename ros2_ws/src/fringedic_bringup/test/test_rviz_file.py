"""The RViz file: its topics, types, channels and frame are those of the running nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml

from camera_node.camera_node import CameraNode
from coupling_node.coupling_node import CouplingNode
from dic_node.dic_node import DicNode
from fringedic.steps.shape_tracker import DISPLACEMENT_FIELDS
from fringedic.steps.step_results import STRAIN_FIELDS
from fringedic_ros.rig_node import RIG_FRAME, frame_id

FILE = Path(__file__).parent.parent / "rviz" / "fringedic.rviz"
NAMESPACE = "/rig"
TYPES = {
    "rviz_default_plugins/PointCloud2": "sensor_msgs/msg/PointCloud2",
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/Image": "sensor_msgs/msg/Image",
}
CHANNELS = {
    "/rig/coupling/displacement": DISPLACEMENT_FIELDS,
    "/rig/coupling/strain": ("x", "y", "z", *STRAIN_FIELDS),
}


@pytest.fixture(scope="module")
def manager() -> dict[str, Any]:
    return yaml.safe_load(FILE.read_text())["Visualization Manager"]


@pytest.fixture(scope="module")
def nodes() -> Iterator[list[Any]]:
    rclpy.init(args=["--ros-args", "-r", f"__ns:={NAMESPACE}", "-p", "autostart:=false"])
    nodes = [kind() for kind in (CameraNode, DicNode, CouplingNode)]
    yield nodes
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture(scope="module")
def published(nodes: list[Any]) -> dict[str, str]:
    """Type of each topic that the nodes publish."""
    types = {}
    for publisher in (each for node in nodes for each in node.publishers):
        package, _, _ = publisher.msg_type.__module__.partition(".")
        types[publisher.topic_name] = f"{package}/msg/{publisher.msg_type.__name__}"
    return types


def displays(manager: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [each for each in manager["Displays"] if each["Class"] == f"rviz_default_plugins/{kind}"]


def test_each_display_shows_a_published_topic_of_its_type(manager: dict[str, Any], published: dict[str, str]) -> None:
    pytest.importorskip("visualization_msgs", reason="the arrows need visualization_msgs")
    shown = {each["Topic"]["Value"]: TYPES[each["Class"]] for each in manager["Displays"] if "Topic" in each}
    assert shown.items() <= published.items()


def test_the_views_are_there(manager: dict[str, Any]) -> None:
    kinds = [each["Class"].partition("/")[2] for each in manager["Displays"]]
    assert {"PointCloud2", "MarkerArray", "Image", "TF"} <= set(kinds)
    colours = {(each["Topic"]["Value"], each["Color Transformer"]) for each in displays(manager, "PointCloud2")}
    assert {("/rig/coupling/shape", "AxisColor"), ("/rig/coupling/displacement", "Intensity")} <= colours


def test_clouds_are_coloured_by_a_field_that_they_have(manager: dict[str, Any]) -> None:
    coloured = [each for each in displays(manager, "PointCloud2") if each["Color Transformer"] == "Intensity"]
    assert len(coloured) == 2
    for display in coloured:
        assert display["Channel Name"] in CHANNELS[display["Topic"]["Value"]]


def test_the_fixed_frame_is_that_of_the_clouds(manager: dict[str, Any], nodes: list[Any]) -> None:
    assert {frame_id(node, RIG_FRAME) for node in nodes} == {manager["Global Options"]["Fixed Frame"]}
