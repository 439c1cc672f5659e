"""Faults of machine, controllers, clock and disk in the running system: each is named, the machine is asked to hold,
what was recorded is readable, and the next step works. The machine speaks Modbus TCP over a real socket.
"""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from running_system import CONFIG, MACHINE, WORKING, ModbusServer, wait_until

from fringedic.errors import StepFailedError
from fringedic.recording import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.graph import rig_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.run import load_rig
from fringedic_msgs.action import MeasureStep, MoveCrosshead

JUMPING_CLOCK = Path(__file__).parent / "jumping_clock"
MM = 1e-3
# The camera of a virtual rig, which has to know where the specimen is, may notice first.
UNTOLD = "(the load frame does not tell what it does|.*crosshead position nan mm)"


class Rig:
    """The tiny virtual rig with its machine, and a controller."""

    def __init__(self, running: RunningGraph, client: RigClient, server: ModbusServer, folder: Path) -> None:
        self.running, self.client, self.server, self.folder = running, client, server, folder

    def works(self) -> MeasureStep.Result:
        """Measure a step that has to work."""
        result = self.client.measure()
        assert result.valid_fraction > WORKING and result.load_samples > 3
        return result

    def fails(self, words: str, *, at_frame: int = 0, then: Callable[[], object] = lambda: None) -> None:
        """Measure a step that has to fail; do something when a frame has been taken."""
        done = False

        def look(feedback: MeasureStep.Feedback) -> None:
            nonlocal done
            if feedback.frame >= at_frame and not done:
                done = True
                then()

        with pytest.raises(StepFailedError, match=rf"step \d+: {words}"):
            self.client.measure(feedback=look)

    @contextmanager
    def settings(self, **values: Any) -> Iterator[None]:
        """Other parameters of the experiment node for a while."""
        before = {"hold_required": True, "load_drift_n": 0.0}
        self._set(values)
        try:
            yield
        finally:
            self._set({name: before[name] for name in values})

    def _set(self, values: dict[str, Any]) -> None:
        client = self.client._node.create_client(SetParametersAtomically, "experiment/set_parameters_atomically")
        self.client._wait(client.service_is_ready, 20.0, lambda: "parameter service")
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self.client._call(client, SetParametersAtomically.Request(parameters=changes)).result
        assert result.successful, result.reason
        self.client._node.destroy_client(client)

    @contextmanager
    def creeping(self) -> Iterator[None]:
        """Let the machine creep, which nobody stops but a request to hold; that has to come."""
        self.client.move(0.0, 5 * MM)
        goal = MoveCrosshead.Goal(position=0.9 * MM, speed=0.05 * MM, controller="creep")
        handle = self.client._send(self.client._move, goal, "creeping", lambda _: None)
        with self.settings(hold_required=False):
            yield
        ended = handle.get_result_async()
        self.client._wait(ended.done, 30.0, lambda: "the end of the motion")
        result = ended.result().result
        assert result.error_code == MoveCrosshead.Result.CANCELLED
        assert "load_frame/hold stopped it" in result.error_message


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("machine")
    with ModbusServer() as server, _running(folder, server) as rig:
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
        rig = Rig(running, client, server, folder)
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


def test_machine_that_answers_nonsense(rig: Rig) -> None:
    try:
        rig.fails(UNTOLD, at_frame=2, then=lambda: rig.server.switch(2, True))
    finally:
        rig.server.switch(2, False)
    wait_until(lambda: _holds(rig), "the machine to be understood again")
    rig.works()


def test_machine_that_reports_a_fault(rig: Rig) -> None:
    rig.fails("the load frame reported a fault", at_frame=2, then=lambda: rig.server.switch(3, True))
    rig.server.switch(3, False)
    wait_until(lambda: _holds(rig), "the end of the fault")
    rig.works()


def test_server_that_is_gone_in_the_middle_of_a_stack(rig: Rig) -> None:
    try:
        rig.fails(UNTOLD, at_frame=3, then=rig.server.kill)
    finally:
        rig.server.start()
    wait_until(lambda: _holds(rig), "the machine to be found again")
    rig.client.move(0.2 * MM, 5 * MM)
    rig.works()


def test_clock_that_jumps_back(rig: Rig) -> None:
    def jump() -> None:
        for name in ("projector", "camera", "load_frame", "experiment"):
            os.kill(rig.running.pid(name), signal.SIGUSR1)

    rig.fails(".*the clock jumped back", at_frame=4, then=jump)
    # who takes no frame in the rest of that step notices with the next one
    wait_until(lambda: _steps(rig), "a step after the jump")


def test_disk_that_is_full_while_recording(rig: Rig) -> None:
    """Last in this module. The limit of a file's size stands for the end of a disk; the error is another number."""
    good = rig.works().step
    bag = rig.folder / "bag"
    wait_until(lambda: _recorded(bag, good) == 12, "the step to be on the disk")
    size = (bag / "bag_0.mcap").stat().st_size
    resource.prlimit(rig.running.pid("recorder"), resource.RLIMIT_FSIZE, (size + 50_000, size + 50_000))
    with pytest.raises(StepFailedError, match="the disk is full"):
        for _ in range(3):  # the recorder writes behind the measurement, and tells it of the next step
            rig.works()
    assert _recorded(bag, good) == 12
    rig.running.stop(["recorder"])
    rig.running.restart("recorder", bag_path=str(rig.folder / "bag-2"))
    wait_until(lambda: _steps(rig), "a step with the new recorder")
    after = rig.works().step
    wait_until(lambda: _recorded(rig.folder / "bag-2", after) == 12, "its frames to be on the disk")


def _recorded(bag: Path, step: int) -> int:
    """Exposures of a step that can be read."""
    reader = BagReader(bag)
    return sum(message.step == step for _, message, _ in reader.messages(reader.find("camera/exposure").values()))


def _holds(rig: Rig) -> bool:
    rig.client.sleep(0.1)  # takes what came before
    rig.client._load = None
    rig.client.sleep(0.1)
    load = rig.client._load
    return load is not None and load.mode in (load.HOLD, load.IDLE)


def _steps(rig: Rig) -> bool:
    try:
        rig.works()
    except StepFailedError as error:  # the new one is still starting
        print(error)
        return False
    return True
