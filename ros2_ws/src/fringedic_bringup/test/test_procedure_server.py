"""The node that runs the procedures of the operator's page: what its check list keeps of their results."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fringedic.rig_setup.check_list import CheckList, ItemState, SetupItem
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.operating import server
from fringedic_bringup.operating.procedures import Place, Request
from fringedic_bringup.operating.server import ProcedureServer
from fringedic_bringup.operating.status import STOPPED, Job, Outcome
from fringedic_bringup.participant import Participant
from fringedic_msgs.srv import StartProcedure

HOLDS, FAILS = Outcome(["The rig holds its calibration."]), Outcome(["The rig does not hold it."], good=False)


@pytest.mark.parametrize(
    ("procedure", "last", "state", "words"),
    [
        ("check", FAILS, ItemState.FAILED, FAILS.words),
        ("check", STOPPED, ItemState.DONE, HOLDS.words),
        ("check", None, ItemState.DONE, HOLDS.words),
        ("calibrate", FAILS, ItemState.DONE, HOLDS.words),  # the calibration before is still in use
    ],
)
def test_a_check_that_was_not_passed_replaces_the_one_before(
    procedure: str,
    last: Outcome | None,
    state: ItemState,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "rig.yaml").write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    outcomes = [HOLDS, last]

    def execute(_: Place, job: Job, request: Request) -> None:
        if request.procedure == "live":
            while not job.is_stopping:
                time.sleep(0.01)
        elif (outcome := outcomes.pop(0)) is None:
            job.failed("camera ended with exit code 1")
        else:
            job.ended(outcome)

    monkeypatch.setattr(server, "execute", execute)
    with private_domain() as domain, ProcedureServer(Place(tmp_path / "rig.yaml", domain)) as running:
        page = Participant("page", "rig", domain=domain)
        start = page.node.create_client(StartProcedure, "procedures/start")

        def serve_until(done: Callable[[], bool]) -> None:
            end = time.monotonic() + 60
            while not done():
                assert time.monotonic() < end
                running.spin_once()
                page.spin_once(0.0)

        serve_until(start.service_is_ready)
        while outcomes:
            answer = start.call_async(StartProcedure.Request(procedure=procedure))
            serve_until(answer.done)
            assert answer.result().success, answer.result().message
            serve_until(lambda: not running.is_measuring)
        page.close()
    found = {each.item: each for each in CheckList.load(tmp_path / "rig_setup.yaml").items()}[SetupItem(procedure)]
    assert found.state is state
    assert found.record is not None
    assert list(found.record.words) == words
