"""A programme that is started from the page, and the results that stay reachable; no browser."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import rclpy

from fringedic.report.page_server.app import Start
from fringedic_msgs.msg import ProcedureStatus
from fringedic_msgs.srv import StartProcedure
from fringedic_ros.qos import LATCHED
from fringedic_ros.testing import Peer
from operator_node import operator_node
from operator_node.operator_node import TOKEN, OperatorNode

RIG = "{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}, load_frame: {source: simulated}}"


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
    peer, started = Peer("procedures"), list[StartProcedure.Request]()

    def start(request: StartProcedure.Request, response: StartProcedure.Response) -> StartProcedure.Response:
        started.append(request)
        response.success = True
        return response

    peer.create_service(StartProcedure, "procedures/start", start)
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
