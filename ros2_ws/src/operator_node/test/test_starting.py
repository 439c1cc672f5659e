"""A programme that is started from the page, and the results that stay reachable; no browser."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
import rclpy
from std_srvs.srv import Trigger

from fringedic.errors import OperatorError
from fringedic.report.page_server.app import Alarm, SetAlarms, Start
from fringedic.report.page_server.marks import KeepMarks
from fringedic_msgs.msg import LoadState, ProcedureStatus
from fringedic_msgs.srv import StartProcedure
from fringedic_ros.qos import LATCHED, PREVIEWS
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import Peer
from fringedic_ros.waiting import AGAIN_S
from operator_node import operator_node
from operator_node.operator_node import TOKEN, OperatorNode

RIG = "{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}, load_frame: {source: simulated}}"


def requests_to(peer: Peer, kind: type[Any], name: str, refusal: str = "") -> list[Any]:
    """Offer a service that succeeds, or refuses with a sentence; return the list that its requests are added to."""
    requests: list[Any] = []

    def answer(request: Any, response: Any) -> Any:
        requests.append(request)
        response.success, response.message = not refusal, refusal
        return response

    peer.create_service(kind, name, answer)
    return requests


def load_state(force: float) -> LoadState:
    """Return a sample of a machine that holds, acquired now."""
    state = LoadState(mode=LoadState.HOLD, force=force)
    state.header.stamp = to_msg(time.time_ns())
    return state


@pytest.fixture
def operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OperatorNode]:
    monkeypatch.setenv(TOKEN, "0123456789abcdef")
    server = MagicMock()
    server.return_value.wheel.present = True
    monkeypatch.setattr(operator_node, "PageServer", server)
    (tmp_path / "rig.yaml").write_text(RIG)
    rclpy.init(args=["--ros-args", "-p", f"rig_file:={tmp_path / 'rig.yaml'}"])
    operator = OperatorNode()
    yield operator
    operator.destroy_node()
    rclpy.try_shutdown()


def test_the_started_programme_is_shown_and_its_report_outlasts_other_procedures(operator: OperatorNode) -> None:
    peer = Peer("procedures")
    started = requests_to(peer, StartProcedure, "procedures/start")
    statuses = peer.create_publisher(ProcedureStatus, "procedures/status", LATCHED)
    peer.serve_also(operator)
    peer.wait(lambda: operator.snapshot()["rig"]["operated"], "the service")
    peer.serve(0.5)  # the service knows the client
    command = Start(procedure="run", text="{ramp: {to_mm: 1.0, steps: 3}}")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(lambda: asyncio.run(operator.do(command)))
        peer.wait(answer.done, "the answer")
    assert answer.result() == ""
    assert [request.text for request in started] == [command.text]
    assert [row["position_mm"] for row in operator.snapshot()["rig"]["running"]] == [0.0, 0.5, 1.0]
    for procedure in ("run", "noise"):
        statuses.publish(
            ProcedureStatus(procedure=procedure, state=ProcedureStatus.RUNNING, folder=f"/tests/{procedure}")
        )
        peer.wait(
            lambda name=procedure: (operator.snapshot()["procedure"] or {}).get("procedure") == name, "the status"
        )
    assert operator.folders()["run"] == Path("/tests/run"), "a noise floor has no report of a test"
    peer.destroy_node()


def test_a_limit_of_a_signal_requests_one_hold_of_the_machine(operator: OperatorNode) -> None:
    peer = Peer("load_frame")
    holds = requests_to(peer, Trigger, "load_frame/hold")
    states = peer.create_publisher(LoadState, "load_frame/state", PREVIEWS)
    peer.serve_also(operator)
    peer.wait(lambda: operator.snapshot()["rig"]["machine"], "the service")
    peer.serve(0.5)  # the service knows the client
    asyncio.run(operator.do(SetAlarms(alarms=[Alarm(signal="force", above=450.0)])))

    def publish(force: float) -> bool:
        states.publish(load_state(force))
        return any(each["value"] == force for each in operator.snapshot()["signals"])

    peer.wait(lambda: publish(449.0), "the state")
    assert not holds
    peer.wait(lambda: publish(451.0) and holds, "the hold")
    peer.serve(0.5)
    assert len(holds) == 1
    assert operator.snapshot()["alarms"][0]["reached"] == "force 451 N reached its limit 450; a hold was requested"
    peer.destroy_node()


def test_a_refused_hold_of_a_limit_is_shown(operator: OperatorNode) -> None:
    peer = Peer("load_frame")
    holds = requests_to(peer, Trigger, "load_frame/hold", refusal="the machine is in fault")
    states = peer.create_publisher(LoadState, "load_frame/state", PREVIEWS)
    peer.serve_also(operator)
    peer.wait(lambda: operator.snapshot()["rig"]["machine"], "the service")
    peer.serve(0.5)  # the service knows the client
    asyncio.run(operator.do(SetAlarms(alarms=[Alarm(signal="force", above=450.0)])))

    def is_told() -> bool:
        states.publish(load_state(451.0))
        return "NO HOLD" in operator.snapshot()["alarms"][0]["reached"]

    peer.wait(is_told, "the refusal")
    words = "NO HOLD: the machine is in fault; stop the machine at its own controls"
    assert operator.snapshot()["alarms"][0]["reached"] == f"force 451 N reached its limit 450; {words}"
    assert len(holds) == 1
    peer.destroy_node()


def test_a_hold_of_a_limit_is_requested_again_until_it_is_answered(operator: OperatorNode) -> None:
    machine, sender = Peer("load_frame"), Peer("sender")
    holds = requests_to(machine, Trigger, "load_frame/hold")
    states = sender.create_publisher(LoadState, "load_frame/state", PREVIEWS)
    sender.serve_also(operator)
    sender.wait(lambda: operator.snapshot()["rig"]["machine"], "the service")
    asyncio.run(operator.do(SetAlarms(alarms=[Alarm(signal="force", above=450.0)])))

    def is_reached() -> bool:
        states.publish(load_state(451.0))
        return bool(operator.snapshot()["alarms"][0]["reached"])

    sender.wait(is_reached, "the limit")
    sender.serve(1.2 * AGAIN_S)  # the machine does not answer
    machine.serve(0.5)
    assert len(holds) == 2
    sender.serve(1.2 * AGAIN_S)
    machine.serve(0.5)
    assert len(holds) == 2, "it was answered"
    for peer in (machine, sender):
        peer.destroy_node()


def test_marks_need_a_test(operator: OperatorNode) -> None:
    with pytest.raises(OperatorError, match="marks and notes are kept with a test"):
        asyncio.run(operator.do(KeepMarks(notes={0: "text"})))
