"""Faults of machine, controllers, clock and disk in the running system: each is named, the machine is asked to hold,
what was recorded is readable, and the next step works. The machine speaks Modbus TCP over a real socket.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from faulty_rig import FRAMES, MM, Rig, recorded
from running_system import CONFIG, MACHINE, WORKING, ModbusServer, wait_until

from fringedic.errors import StepFailedError
from fringedic.recording import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.graph import rig_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.run import load_rig
from fringedic_msgs.action import MeasureStep

JUMPING_CLOCK = Path(__file__).parent / "jumping_clock"
# The camera of a virtual rig, which has to know where the specimen is, may notice first.
UNTOLD = "(the load frame does not tell what it does|.*crosshead position nan mm)"


@pytest.fixture(scope="module")
def machine() -> Iterator[ModbusServer]:
    with ModbusServer() as server:
        yield server


@pytest.fixture(scope="module")
def rig(machine: ModbusServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("machine")
    with _running(folder, machine) as rig:
        yield rig


@contextmanager
def _running(folder: Path, server: ModbusServer) -> Iterator[Rig]:
    (folder / "machine.yaml").write_text(yaml.safe_dump({**MACHINE, "port": server.port}))
    content = yaml.safe_load((CONFIG / "tiny.yaml").read_text())
    content["load_frame"] = {"source": "machine", "file": "machine.yaml"}
    (folder / "rig.yaml").write_text(yaml.safe_dump(content))
    rig_file, _ = load_rig(folder / "rig.yaml", None, None)
    graph = rig_graph(rig_file, folder / "rig.yaml", folder, experiment="faults")
    path = os.pathsep.join([str(JUMPING_CLOCK), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)
    with (
        RunningGraph(graph, folder / "logs", environment={"PYTHONPATH": path}) as running,
        RigClient(graph.namespace, name="tension") as client,
    ):
        client.wait_until_ready(graph.names)
        rig = Rig(running, client, folder)
        client.move(0.3 * MM, 5 * MM)
        rig.works()
        yield rig


def test_cancelled_half_way(rig: Rig) -> None:
    with rig.creeping():
        rig.fails("cancelled by the caller", at_frame=3, then=lambda: rig.client._running.cancel_goal_async())
    rig.works()


def test_second_controller(rig: Rig) -> None:
    refusals = []

    def interfere() -> None:
        goal = MeasureStep.Goal(controller="fatigue")
        sent = rig.client._measure.send_goal_async(goal)
        sent.add_done_callback(lambda _: refusals.append(sent.result().get_result_async()))

    done = False

    def look(feedback: MeasureStep.Feedback) -> None:
        nonlocal done
        if feedback.frame and not done:
            done = True
            interfere()

    assert rig.client.measure(feedback=look).valid_fraction > WORKING
    rig.client._wait(lambda: bool(refusals) and refusals[0].done(), 10.0, lambda: "the refusal")
    result = refusals[0].result().result
    assert result.error_code == MeasureStep.Result.BUSY
    assert "is being measured for tension; fatigue has to wait" in result.error_message


def test_load_that_drifts_during_the_stack(rig: Rig) -> None:
    with rig.creeping(), rig.settings(load_drift_n=1.0):
        rig.fails(r"the force drifted by \+[\d.]+ N during the exposures, 1 N are allowed")
    rig.works()


def test_machine_that_answers_nonsense(rig: Rig, machine: ModbusServer) -> None:
    try:
        rig.fails(UNTOLD, at_frame=2, then=lambda: machine.switch(2, True))
    finally:
        machine.switch(2, False)
    wait_until(rig.holds, "the machine to be understood again")
    rig.works()


def test_machine_that_reports_a_fault(rig: Rig, machine: ModbusServer) -> None:
    rig.fails("the load frame reported a fault", at_frame=2, then=lambda: machine.switch(3, True))
    machine.switch(3, False)
    wait_until(rig.holds, "the end of the fault")
    rig.works()


def test_server_that_is_gone_in_the_middle_of_a_stack(rig: Rig, machine: ModbusServer) -> None:
    try:
        rig.fails(UNTOLD, at_frame=3, then=machine.kill)
    finally:
        machine.start()
    wait_until(rig.holds, "the machine to be found again")
    rig.client.move(0.2 * MM, 5 * MM)
    rig.works()


def test_clock_that_jumps_back(rig: Rig) -> None:
    def jump() -> None:
        for name in ("projector", "camera", "load_frame", "experiment"):
            os.kill(rig.running.pid(name), signal.SIGUSR1)

    rig.fails(".*the clock jumped back", at_frame=4, then=jump)
    # who takes no frame in the rest of that step notices with the next one
    wait_until(rig.works_again, "a step after the jump")


def test_disk_that_is_full_while_recording(rig: Rig) -> None:
    """Last in this module. The limit of a file's size stands for the end of a disk; the error is another number."""
    good = rig.works().step
    bag = rig.folder / "bag"
    wait_until(lambda: recorded(bag, good) == FRAMES, "the step to be on the disk")
    size = (bag / "bag_0.mcap").stat().st_size
    resource.prlimit(rig.running.pid("recorder"), resource.RLIMIT_FSIZE, (size + 50_000, size + 50_000))
    with pytest.raises(StepFailedError, match="the disk is full"):
        for _ in range(3):  # the recorder writes behind the measurement, and tells it of the next step
            rig.works()
    assert recorded(bag, good) == FRAMES
    rig.running.stop(["recorder"])
    foretold = rig.folder / "foretold"
    rig.running.restart("recorder", bag_path=str(foretold))
    wait_until(rig.works_again, "a step with a recorder that has room")
    free = shutil.disk_usage(rig.folder).free / 1e6
    rig.set("recorder", {"smallest_free_mb": min(free + 10_000.0, 1e6)})
    with pytest.raises(StepFailedError, match=r"the disk is full: \d+ MB are left"):
        for _ in range(3):
            rig.works()
    assert not BagReader(foretold).lost, "it was closed in time, with its index"
    rig.running.stop(["recorder"])
    rig.running.restart("recorder", bag_path=str(rig.folder / "bag-2"))
    wait_until(rig.works_again, "a step with the new recorder")
    after = rig.works().step
    wait_until(lambda: recorded(rig.folder / "bag-2", after) == FRAMES, "its frames to be on the disk")
