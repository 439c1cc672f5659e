"""Topics of the processing nodes: the declared inputs are the subscriptions of the real nodes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

from coupling_node.coupling_node import CouplingNode
from dic_node.dic_node import DicNode
from fringedic_ros.exchange import Exchange
from fringedic_ros.processing import ProcessingNode
from fringedic_ros.topics import DERIVED_TOPICS, PROCESSING_INPUTS, PUBLISHED, RAW_TOPICS
from phase_node.phase_node import PhaseNode

OF_EVERY_NODE = {"/parameter_events", "/clock", "/node_parameters"}  # a node may follow the parameters of others


@pytest.fixture(scope="module")
def ros() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(("name", "kind"), [("phase", PhaseNode), ("dic", DicNode), ("coupling", CouplingNode)])
def test_a_processing_node_subscribes_to_its_declared_inputs(name: str, kind: type[ProcessingNode]) -> None:
    node = kind()
    subscribed = {subscription.topic_name for subscription in node.subscriptions} - OF_EVERY_NODE
    published = {publisher.topic_name for publisher in node.publishers}
    node.destroy_node()
    assert subscribed == {f"/{topic}" for topic in PROCESSING_INPUTS[name]}
    assert {f"/{topic}" for topic in PUBLISHED[name]} <= published


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(("name", "kind"), [("dic", DicNode), ("coupling", CouplingNode)])
def test_a_composed_node_takes_results_from_its_process(name: str, kind: type[ProcessingNode]) -> None:
    """All maps and clouds are still published for others."""
    node = kind(Exchange())
    subscribed = {subscription.topic_name for subscription in node.subscriptions} - OF_EVERY_NODE
    published = {publisher.topic_name for publisher in node.publishers}
    node.destroy_node()
    whole = {f"/{topic}" for topic in DERIVED_TOPICS if not topic.endswith("/status")}
    assert subscribed == {f"/{topic}" for topic in PROCESSING_INPUTS[name]} - whole
    assert {f"/{topic}" for topic in PUBLISHED[name]} <= published


def test_every_input_is_recorded_or_computed() -> None:
    inputs = {topic for topics in PROCESSING_INPUTS.values() for topic in topics}
    assert inputs <= {*RAW_TOPICS, *DERIVED_TOPICS}


def test_the_coupling_node_needs_the_exposures() -> None:
    """Their pitch belongs to the phase: a replay must not begin before the node is subscribed to them."""
    assert "camera/exposure" in PROCESSING_INPUTS["coupling"]
