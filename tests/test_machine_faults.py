"""Faults of machine, controllers, clock and disk in the running system.

Each is reported by name, the machine is requested to hold, the recording is readable, and the next step works. The
machine has Modbus TCP over a real socket.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from faulty_rig import FRAMES, MM, Rig, action, recorded
from running_system import CONFIG, MACHINE, WORKING, ModbusServer, wait_until

from fringedic.errors import StepFailedError
from fringedic.recording.reader import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.run import load_rig
from fringedic_msgs.action import MeasureStep

JUMPING_CLOCK = Path(__file__).parent / "jumping_clock"
# The camera of a virtual rig needs the position of the specimen, and may report the fault first.
UNKNOWN = "(the load frame reports the mode UNKNOWN|.*crosshead position nan mm)"


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
    content["camera"]["settle_ms"] = 150.0  # so that a fault comes before the last frame on a busy computer, too
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
        rig.fails("cancelled by the client", at_frame=3, then=rig.client.request_cancel)
    rig.works()


def test_second_controller(rig: Rig) -> None:
    refusals = []
    done = False
    with action(rig.client, MeasureStep, "measure_step", "experiment") as measure:

        def interfere(feedback: MeasureStep.Feedback) -> None:
            nonlocal done
            if feedback.frame and not done:
                done = True
                sent = measure.send_goal_async(MeasureStep.Goal(controller="fatigue"))
                sent.add_done_callback(lambda _: refusals.append(sent.result().get_result_async()))

        assert rig.client.measure(feedback=interfere).valid_fraction > WORKING
        rig.client.wait_for(lambda: bool(refusals) and refusals[0].done(), 60.0, lambda: "the refusal")
    result = refusals[0].result().result
    assert result.error_code == MeasureStep.Result.BUSY
    assert "is being measured for tension; fatigue has to wait" in result.error_message


def test_load_that_drifts_during_the_stack(rig: Rig) -> None:
    with rig.creeping(), rig.settings(load_drift_n=1.0):
        rig.fails(r"the force drifted by \+[\d.]+ N during the exposures, 1 N are allowed")
    rig.works()


def test_machine_that_answers_nonsense(rig: Rig, machine: ModbusServer) -> None:
    try:
        rig.fails(UNKNOWN, at_frame=2, then=lambda: machine.switch(2, True))
    finally:
        machine.switch(2, False)
    rig.wait_for_hold("valid answers of the machine")
    rig.works()


def test_load_frame_that_is_stopped(rig: Rig) -> None:
    """Its last sample said HOLD, and nobody knows what the machine does since."""
    pid = rig.running.pid("load_frame")
    os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0)  # right after a sample the step would begin, and end without one during its exposures
    try:
        # the wait for a sample ends after the lease of the stopped node, which then counts as gone
        rig.fails("whether the machine holds is unknown: no node publishes .*load_frame/state; start its node")
    finally:
        os.kill(pid, signal.SIGCONT)
    rig.wait_for_hold("samples of the machine")
    rig.works()


def test_machine_that_reports_a_fault(rig: Rig, machine: ModbusServer) -> None:
    rig.fails("the load frame reported a fault", at_frame=2, then=lambda: machine.switch(3, True))
    machine.switch(3, False)
    rig.wait_for_hold("the end of the fault")
    rig.works()


def test_server_that_is_gone_in_the_middle_of_a_stack(rig: Rig, machine: ModbusServer) -> None:
    try:
        rig.fails(UNKNOWN, at_frame=3, then=machine.kill)
    finally:
        machine.start()
    rig.client.move(0.2 * MM, 5 * MM)  # which waits until the node has connected it again
    rig.works()


def test_clock_that_jumps_back(rig: Rig) -> None:
    def jump() -> None:
        for name in ("projector", "camera", "load_frame", "experiment"):
            os.kill(rig.running.pid(name), signal.SIGUSR1)

    rig.fails(".*the clock jumped back", at_frame=4, then=jump)
    # a node that takes no frame in the rest of this step notices the jump in the next one
    wait_until(rig.works_again, "a step after the jump")


def measure_three(rig: Rig) -> None:
    """Measure three steps: the recorder writes after the measurement, and its error fails a later step."""
    for _ in range(3):
        rig.works()


def test_disk_that_is_full_while_recording(rig: Rig) -> None:
    """Last in this module. A limit of the file size replaces a full disk; only the number of the error differs."""
    good = rig.works().step
    bag = rig.folder / "bag"
    wait_until(lambda: recorded(bag, good) == FRAMES, "the step to be on the disk")
    size = (bag / "bag_0.mcap").stat().st_size
    resource.prlimit(rig.running.pid("recorder"), resource.RLIMIT_FSIZE, (size + 50_000, size + 50_000))
    with pytest.raises(StepFailedError, match="the disk is full"):
        measure_three(rig)
    assert recorded(bag, good) == FRAMES
    rig.running.stop(["recorder"])
    in_time = rig.folder / "in_time"
    rig.running.restart("recorder", bag_path=str(in_time))
    wait_until(rig.works_again, "a step with a recorder that has space")
    free = shutil.disk_usage(rig.folder).free / 1e6
    rig.set("recorder", {"smallest_free_mb": min(free + 10_000.0, 1e6)})
    with pytest.raises(StepFailedError, match=r"the disk is full: \d+ MB are left"):
        measure_three(rig)
    assert not BagReader(in_time).lost, "it was closed in time, with its index"
    rig.running.stop(["recorder"])
    rig.running.restart("recorder", bag_path=str(rig.folder / "bag-2"))
    wait_until(rig.works_again, "a step with the new recorder")
    after = rig.works().step
    wait_until(lambda: recorded(rig.folder / "bag-2", after) == FRAMES, "its frames to be on the disk")
