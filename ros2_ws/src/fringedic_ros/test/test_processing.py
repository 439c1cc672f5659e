"""Every processing node publishes one status per step with a named code, and its memory is bounded."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import rclpy
from pydantic import BaseModel

from fringedic.errors import CorrelationError, ErrorCode, PhaseError, StepError
from fringedic_msgs.msg import NodeStatus, StepStatus
from fringedic_ros.processing import JOINED_STEPS, QUEUED_STEPS, Outcome, ProcessingNode, StampJoin, StepId
from fringedic_ros.qos import EVENTS
from fringedic_ros.testing import Peer


class NoParameters(BaseModel):
    """A node without parameters."""


class TestedNode(ProcessingNode[NoParameters]):
    """A node that joins no messages."""

    __test__ = False

    def abandon(self, _step: StepId) -> str:
        return ""


@pytest.fixture
def peer() -> Iterator[Peer]:
    rclpy.init()
    peer = Peer()
    yield peer
    peer.destroy_node()
    rclpy.try_shutdown()


def fail() -> None:
    raise RuntimeError("no rehearsal")


@pytest.fixture
def node(peer: Peer) -> Iterator[ProcessingNode[NoParameters]]:
    """A node whose rehearsal fails, which must not matter to its steps."""
    node = TestedNode("tested", NoParameters, fail)
    node.subscribe_to_steps()
    peer.serve_also(node)
    yield node
    node.destroy_node()


def statuses(peer: Peer) -> list[NodeStatus]:
    heard = peer.listen(NodeStatus, "tested/status", EVENTS)
    peer.serve(0.5)
    return heard


def test_join_in_any_order_and_bounded() -> None:
    join = StampJoin(("a", "b", "c"))
    assert join.add("b", 7, "b7") is None
    assert join.add("a", 8, "a8") is None
    assert join.add("c", 7, "c7") is None
    assert join.add("a", 7, "a7") == {"a": "a7", "b": "b7", "c": "c7"}
    assert join.discard(7) == ""
    assert join.discard(8) == "waiting for b, c"
    assert join.unjoined == 1
    for stamp in range(JOINED_STEPS + 2):
        join.add("a", stamp, stamp)
        join.add("b", stamp, stamp)
    assert join.unjoined == 1 + 2 * 2, "the two oldest are given up"
    assert join.add("c", 0, 0) is None
    assert join.add("c", JOINED_STEPS + 1, 0) is not None


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (StepError("another size", code=ErrorCode.FRAME_MISMATCH), NodeStatus.FRAME_MISMATCH),
        (PhaseError("another size", code=ErrorCode.INVALID_SEQUENCE), NodeStatus.FRAME_MISMATCH),
        (CorrelationError("another size", code=ErrorCode.NO_CORRELATION), NodeStatus.NO_CORRELATION),
        (ZeroDivisionError("another size"), NodeStatus.FAILED),
    ],
)
def test_exceptions_become_codes_and_the_next_step_works(
    peer: Peer, node: ProcessingNode[NoParameters], error: Exception, code: int
) -> None:
    heard = statuses(peer)

    def work() -> Outcome:
        raise error

    node.measure(StepId("experiment", 0, 10), work)
    node.measure(StepId("experiment", 1, 11), lambda: Outcome(0.5, 3, phase_sigma=2.0))
    peer.wait(lambda: len(heard) == 2, "both statuses")
    assert (heard[0].error_code, heard[0].frames) == (code, 0)
    assert "another size" in heard[0].error_message
    assert (heard[1].error_code, heard[1].valid_fraction, heard[1].phase_sigma, heard[1].frames) == (0, 0.5, 2.0, 3)


def test_one_status_per_step_and_a_bounded_queue(peer: Peer, node: ProcessingNode[NoParameters]) -> None:
    heard = statuses(peer)
    release = threading.Event()

    def work() -> Outcome:
        release.wait(300)
        return Outcome()

    steps = QUEUED_STEPS + 2
    for step in range(steps):
        node.measure(StepId("experiment", step, step), work)
        node.measure(StepId("experiment", step, step), work)
        node.answer(StepId("experiment", step, step), NodeStatus.STEP_ABORTED, "")
    ended = peer.create_publisher(StepStatus, "experiment/step", EVENTS)
    peer.wait(ended.get_subscription_count, "the node")
    for step in range(steps):
        ended.publish(StepStatus(experiment="experiment", step=step, stage=StepStatus.ERROR))
    peer.wait(lambda: len(heard) == 2, "the refusals")
    assert [(each.step, each.error_code) for each in heard] == [
        (QUEUED_STEPS, NodeStatus.FAILED),
        (QUEUED_STEPS + 1, NodeStatus.FAILED),
    ]
    assert "16 steps are waiting" in heard[0].error_message
    release.set()
    peer.wait(lambda: len(heard) >= steps, "the statuses of what was queued")
    peer.serve(0.3)
    assert [each.step for each in heard[2:]] == list(range(QUEUED_STEPS))
    assert {each.error_code for each in heard[2:]} == {NodeStatus.NONE}
