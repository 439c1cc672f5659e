"""A stage that is killed, started again or silent while a plane is placed, and one that leaves its place."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.action.server import ActionServer, ServerGoalHandle
from rclpy.duration import Duration
from rclpy.node import Node

from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import CalibrationError, StepFailedError, WaitTimeoutError
from fringedic_bringup import client
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import Graph
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.operating.status import Job, StoppedError
from fringedic_bringup.procedures import calibrate, check
from fringedic_msgs.action import CalibrateRig
from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros import waiting
from fringedic_ros.qos import LATCHED
from fringedic_ros.spinning import Spinning
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import killed_stage
from fringedic_ros.waiting import sleep

PLANE, SPECIMEN = PlaceReferencePlane.Request.PLANE, PlaceReferencePlane.Request.SPECIMEN


class Stage(Node):
    """Reaches every place, after some time."""

    def __init__(self, delay_s: float = 0.0) -> None:
        super().__init__("stage", namespace="rig")
        self.delay_s = delay_s
        self.requests: list[PlaceReferencePlane.Request] = []
        self.states = self.create_publisher(ReferencePlane, "reference_plane/state", LATCHED)
        self.create_service(PlaceReferencePlane, "reference_plane/place", self._place)

    async def _place(
        self, request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response
    ) -> PlaceReferencePlane.Response:
        self.requests.append(request)
        await sleep(self, self.delay_s)
        response.success, response.angle, response.height = True, request.angle, request.height
        response.placed = self.report(request.kind, request.angle, request.height)
        return response

    def report(self, kind: int, angle: float, height: float) -> object:
        state = ReferencePlane(kind=kind, angle=angle, height=height)
        state.header.stamp = to_msg(time.time_ns())
        self.states.publish(state)
        return state.header.stamp


def meet(rig: RigClient, node: str) -> None:
    """Wait until a node knows all clients of the rig's client: a response to one that it does not know is lost."""
    rig.call_again(rig.node.create_client(GetParameters, f"{node}/get_parameters"), GetParameters.Request(), 60)


def meet_all(rig: RigClient) -> None:
    rig.wait_for(lambda: {"stage", "experiment"} & set(rig.node.get_node_names()), 60, lambda: "the node of the test")
    for node in {"stage", "experiment"} & set(rig.node.get_node_names()):
        meet(rig, node)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wait that does not end fails its test."""
    monkeypatch.setattr(client, "STEP_TIMEOUT_S", 60.0)


def test_a_stage_is_requested_once_however_long_it_needs(spinning: Spinning) -> None:
    stage = spinning.add(Stage(delay_s=5.0))
    with RigClient() as rig:
        meet(rig, "stage")
        rig.place(PLANE, height=5e-3)
    assert len(stage.requests) == 1


def test_a_stage_that_leaves_its_place_fails_the_plane(spinning: Spinning) -> None:
    """Its driver was started again and moved it to its zero, where the camera saw the plane."""
    stage = spinning.add(Stage())
    with RigClient() as rig:
        meet(rig, "stage")
        rig.place(PLANE, height=5e-3)
        rig.wait_for(stage.states.get_subscription_count, 30, lambda: "the subscription of the client")
        stage.report(PLANE, 0.0, 5.01e-3)
        rig.sleep(0.5)
        rig.require_place()
        stage.report(PLANE, 0.0, 0.0)
        assert stage.states.wait_for_all_acked(Duration(seconds=60))
        rig.sleep(0.5)
        with pytest.raises(StepFailedError, match=r"\+0.00 degree and \+0.000 mm instead of .*\+5.000 mm"):
            rig.require_place()


class Nodes:
    """Stands for the processes of a graph."""

    def __init__(self, *_: object, **__: object) -> None: ...

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *_: object) -> None: ...

    def check(self) -> None: ...


class Calibrating(Node):
    """An experiment node that waits for a person, without feedback."""

    def __init__(self) -> None:
        super().__init__("experiment", namespace="rig")
        self.declare_parameter("placing_timeout_s", 600.0)
        ActionServer(self, CalibrateRig, "calibrate_rig", self._calibrate)

    async def _calibrate(self, goal: ServerGoalHandle) -> CalibrateRig.Result:
        await sleep(self, 3.0)
        goal.succeed()
        return CalibrateRig.Result(verdict="good")


@pytest.fixture
def calibrating(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., AbstractContextManager[RigClient]]:
    """Return a function that yields the client of a calibration whose nodes are those of the test."""
    monkeypatch.setattr(calibrate, "calibration_graph", lambda *_: Graph("rig", ()))
    monkeypatch.setattr(calibrate, "RunningGraph", Nodes)
    monkeypatch.setattr(RigClient, "wait_until_ready", lambda rig, _: meet_all(rig))

    def client_of(ask: Callable[[str], bool], **options: Any) -> AbstractContextManager[RigClient]:
        path, job = configuration("tiny.yaml"), Job("calibrate", "", lambda: None)
        return calibrate.calibration_client(
            load_rig_file(path), tmp_path, job, place=calibrate.placing_by(ask), domain=None, **options
        )

    return client_of


@pytest.mark.parametrize("placing", [lambda: Stage(delay_s=20.0), Calibrating], ids=["stage", "person"])
def test_stop_ends_the_wait_for_a_place(spinning: Spinning, calibrating: Any, placing: Callable[[], Node]) -> None:
    spinning.add(placing())
    job = Job("check", "", lambda: None)
    threading.Timer(5.0, job.stop).start()
    begun = time.monotonic()
    with pytest.raises(StoppedError), calibrating(job.ask, watch=job.raise_when_stopped) as rig:
        rig.place(PLANE)
    assert time.monotonic() - begun < 18.0


def test_after_an_error_the_stage_is_requested_to_put_the_specimen_back(spinning: Spinning, calibrating: Any) -> None:
    stage = spinning.add(Stage())
    with pytest.raises(ZeroDivisionError), calibrating(lambda _: True) as rig:
        1 / rig.place(PLANE).height
    assert [each.kind for each in stage.requests] == [PLANE, SPECIMEN]


def test_a_person_may_place_a_plane_the_next_morning(
    spinning: Spinning, calibrating: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = spinning.add(Calibrating())
    monkeypatch.setattr(client, "STEP_TIMEOUT_S", 1.0)

    def ask(_: str) -> bool:
        time.sleep(2.0)
        return True

    with calibrating(ask) as rig:
        assert experiment.get_parameter("placing_timeout_s").value == 86_400.0
        assert rig.place(PLANE, height=5e-3).success
        assert rig.calibrate_rig([0.0]).verdict == "good"


@pytest.mark.parametrize(
    ("reached", "words"),
    [((0.0, 0.0, 0.0), "did not lift"), ((0.0, 5e-3, 5e-3), "did not lift"), ((0.0, 5e-3, 6e-5), "put the plane back")],
)
def test_a_check_judges_by_the_heights_that_the_stage_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reached: tuple[float, ...], words: str
) -> None:
    rig = MagicMock(spec=RigClient)
    rig.measure.return_value.stamp = to_msg(1)
    rig.place.side_effect = [PlaceReferencePlane.Response(success=True, height=each) for each in (*reached, 0.0)]
    monkeypatch.setattr(check, "calibration_client", lambda *_, **__: nullcontext(rig))
    path = configuration("tiny.yaml")
    with pytest.raises(CalibrationError, match=words):
        check.check(
            load_rig_file(path), path, tmp_path, Job("check", "", lambda: None), distance=5e-3, ask=lambda _: True
        )


def test_a_check_ends_with_the_first_plane_that_is_not_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = MagicMock(spec=RigClient)
    rig.measure.return_value.stamp = to_msg(1)
    rig.require_place.side_effect = [None, StepFailedError("the stage has left its place")]
    monkeypatch.setattr(check, "calibration_client", lambda *_, **__: nullcontext(rig))
    path = configuration("tiny.yaml")
    with pytest.raises(StepFailedError, match="left its place"):
        check.check(
            load_rig_file(path), path, tmp_path, Job("check", "", lambda: None), distance=5e-3, ask=lambda _: True
        )
    assert rig.measure.call_count == 2


@pytest.mark.usefixtures("spinning")
def test_a_plane_fails_when_its_stage_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "LOST_S", 1.0)
    with killed_stage("rig"), RigClient() as rig:
        meet(rig, "stage")
        with pytest.raises(WaitTimeoutError, match=r"5.000 mm .*: the service reference_plane/place is missing: start"):
            rig.place(PLANE, height=5e-3)


def test_a_stage_that_is_started_again_gets_the_request_again(spinning: Spinning) -> None:
    again: list[Stage] = []
    with killed_stage("rig", then=lambda: again.append(spinning.add(Stage()))), RigClient() as rig:
        meet(rig, "stage")
        assert rig.place(PLANE, height=5e-3).height == 5e-3
    assert again[0].requests[0].height == 5e-3
