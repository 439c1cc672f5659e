"""The node that runs the procedures of the operator's page: what its check list keeps of their results."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from std_msgs.msg import Bool

from fringedic.configuration.rig_file import load_rig_file
from fringedic.rig_setup.check_list import CheckList, ItemState, SetupItem
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.operating import server
from fringedic_bringup.operating.procedures import Place, Request
from fringedic_bringup.operating.server import ProcedureServer
from fringedic_bringup.operating.status import STOPPED, Job, Outcome, State
from fringedic_bringup.participant import Participant
from fringedic_msgs.msg import SetupState
from fringedic_msgs.srv import StartProcedure
from fringedic_ros.qos import LATCHED, LATEST

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


def test_a_programme_goes_on_after_the_server_stood_still(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The signs of the driver's page wait in the queue; without any the programme pauses."""
    monkeypatch.setattr(server, "LOST_S", 1.0)
    (tmp_path / "rig.yaml").write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    jobs: list[Job] = []

    def execute(_: Place, job: Job, request: Request) -> None:
        if request.procedure != "live":
            job.controlled = job.holds_without_driver = True
            jobs.append(job)
        while not job.is_stopping:
            time.sleep(0.01)

    monkeypatch.setattr(server, "execute", execute)
    with private_domain() as domain, ProcedureServer(Place(tmp_path / "rig.yaml", domain)) as running:
        page = Participant("page", "rig", domain=domain)
        start = page.node.create_client(StartProcedure, "procedures/start")
        signs = page.node.create_publisher(Bool, "operator/driver_present", LATEST)

        def serve_until(done: Callable[[], bool], *, present: bool = True) -> None:
            end = time.monotonic() + 60
            while not done():
                assert time.monotonic() < end
                if present:
                    signs.publish(Bool(data=True))
                running.spin_once()
                page.spin_once(0.0)

        def serve(turns: int) -> None:
            left = iter(range(turns))
            serve_until(lambda: next(left, None) is None)

        serve_until(lambda: start.service_is_ready() and signs.get_subscription_count() == 1)
        serve(20)
        answer = start.call_async(StartProcedure.Request(procedure="check"))
        serve_until(answer.done)
        assert answer.result().success, answer.result().message
        serve_until(lambda: bool(jobs))
        for _ in range(5):
            running.spin_once()  # no sign is left
        time.sleep(1.5)
        running.spin_once()
        assert jobs[0].status.state is State.RUNNING
        serve(20)
        assert jobs[0].status.state is State.RUNNING
        serve_until(lambda: jobs[0].status.state is State.PAUSING, present=False)
        page.close()


def test_a_result_is_used_whenever_the_operator_wants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The button for it was gone after the next procedure, and the item was done without it."""
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")

    def execute(_: Place, job: Job, request: Request) -> None:
        if request.procedure == "live":
            while not job.is_stopping:
                time.sleep(0.01)
        else:
            job.ended(Outcome([request.procedure], "camera: {settle_ms: 20}" if request.procedure == "timing" else ""))

    monkeypatch.setattr(server, "execute", execute)
    with private_domain() as domain, ProcedureServer(Place(rig_file, domain)) as running:
        page = Participant("page", "rig", domain=domain)
        start = page.node.create_client(StartProcedure, "procedures/start")
        states: dict[str, int] = {}

        def take(setup: SetupState) -> None:
            states.update({item.item: item.state for item in setup.items})

        page.node.create_subscription(SetupState, "procedures/setup", take, LATCHED)

        def serve_until(done: Callable[[], bool]) -> None:
            end = time.monotonic() + 60
            while not done():
                assert time.monotonic() < end
                running.spin_once()
                page.spin_once(0.0)

        def ask(procedure: str, pattern: str = "", text: str = "") -> StartProcedure.Response:
            answer = start.call_async(StartProcedure.Request(procedure=procedure, pattern=pattern, text=text))
            serve_until(answer.done)
            serve_until(lambda: not running.is_measuring)
            return answer.result()

        serve_until(start.service_is_ready)
        assert "has no result" in ask("use", "timing").message
        for procedure in ("timing", "response"):
            assert ask(procedure).success
        serve_until(lambda: states.get("timing") == ItemState.NOT_IN_USE.value)
        assert ask("use", "timing").message.startswith("the rig file is changed")
        assert load_rig_file(rig_file).camera.settle_time == pytest.approx(0.02)
        serve_until(lambda: states["timing"] == ItemState.DONE.value)
        refused = ask("run", text="{steps: [{position_mm: 50}]}")
        assert (refused.success, refused.message[:14]) == (False, "step 1 of 1 of")
        page.close()
