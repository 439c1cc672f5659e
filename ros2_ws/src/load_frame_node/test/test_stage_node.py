"""The stage: its state, the stamp in its answer, and refused requests."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy

from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.qos import LATCHED
from fringedic_ros.spinning import Spinning
from load_frame_node.stage_node import StageNode

Request = PlaceReferencePlane.Request


class Rig:
    """A stage, a subscriber of its state, and a client of its service."""

    def __init__(self, spinning: Spinning) -> None:
        self.stage = spinning.add(StageNode.started())
        self.client = spinning.add(rclpy.create_node("operator"))
        self.place_client = self.client.create_client(PlaceReferencePlane, "reference_plane/place")
        self.states: list[ReferencePlane] = []
        self.client.create_subscription(ReferencePlane, "reference_plane/state", self.states.append, LATCHED)
        self._spinning = spinning
        assert self.place_client.wait_for_service(180)
        self._wait(lambda: bool(self.states), "the latched state")

    def _wait(self, done: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 180
        while not done():
            assert time.monotonic() < deadline, f"{what} did not come"
            time.sleep(0.01)

    def heard(self, response: PlaceReferencePlane.Response) -> ReferencePlane:
        """The state that an answer speaks of."""
        self._wait(lambda: self.states[-1].header.stamp == response.placed, "the state of the answer")
        return self.states[-1]

    def place(self, **request: Any) -> PlaceReferencePlane.Response:
        async def ask() -> PlaceReferencePlane.Response:
            return await self.place_client.call_async(Request(**request))

        return self._spinning.run(ask)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    rclpy.init()
    with Spinning() as spinning:
        yield Rig(spinning)
    rclpy.try_shutdown()


def test_begins_with_the_specimen_and_publishes_the_place_of_the_plane(rig: Rig) -> None:
    response = rig.place(kind=Request.PLANE, angle=0.2, height=-1e-3)
    assert (response.success, response.message, response.angle, response.height) == (True, "", 0.2, -1e-3)
    state = rig.heard(response)
    assert (rig.states[0].kind, len(rig.states)) == (ReferencePlane.SPECIMEN, 2)
    assert (state.kind, state.angle, state.height) == (ReferencePlane.PLANE, 0.2, -1e-3)
    assert rig.heard(rig.place(kind=Request.SPECIMEN)).kind == ReferencePlane.SPECIMEN


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"kind": 7}, "kind 7"),
        ({"kind": Request.PLANE, "angle": math.radians(41)}, "40 degree"),
        ({"kind": Request.PLANE, "angle": math.nan}, "40 degree"),
        ({"kind": Request.PLANE, "height": 0.05}, "30 mm"),
    ],
)
def test_refuses_impossible_requests(rig: Rig, request_: dict[str, Any], words: str) -> None:
    rig.heard(rig.place(kind=Request.GRID))
    heard = len(rig.states)
    response = rig.place(**request_)
    assert not response.success
    assert words in response.message
    assert len(rig.states) == heard


def test_an_inactive_stage_refuses(rig: Rig) -> None:
    rig.stage.trigger_deactivate()
    response = rig.place(kind=Request.PLANE)
    rig.stage.trigger_activate()
    assert not response.success
    assert "not active" in response.message
