"""Parts of the tests of the running system that several modules use."""

from __future__ import annotations

import fcntl
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeVar

import pytest
import rclpy
from pymodbus.client import ModbusTcpClient
from served import free_port as free_port
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.command.outcome import RunReport
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_bringup.procedures import run
from fringedic_msgs.msg import Signal
from fringedic_ros.testing import command_lines, node_pids

Result = TypeVar("Result")
ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "ros2_ws" / "src" / "fringedic_bringup" / "config"
WITHOUT_ROS = ROOT / "tests" / "without_ros"
# Measured part of the tiny rig's image in a good step. The plate fills 94 % of the 160 px across, and an edge of up to
# 5 px, where a window of 32 px overlaps too little of it, is NaN: (150 - 10) (120 - 10) / (160 * 120) = .80
WORKING = 0.80
MACHINES = ROOT / "ros2_ws" / "src" / "load_frame_node" / "test"
MACHINE: dict[str, Any] = {
    "protocol": "modbus",
    "host": "127.0.0.1",
    "timeout_s": 3.0,  # on a busy computer the server of the test has needed more than 0.3 s
    "force": {"register": 0},
    "position": {"register": 2},
    "status": {"register": 4, "idle": [0], "moving": [11], "hold": [12], "fault": [99]},
    "move": {"position": {"register": 10}, "speed": {"register": 12}, "start": {"coil": 0}},
    "hold": {"coil": 1},
    "limits": {"lowest_mm": 0.0, "highest_mm": 1.0, "fastest_mm_per_s": 5.0},
}


@dataclass
class Progress:
    """Keeps the progress of a run as lines."""

    lines: list[str] = field(default_factory=list)

    def stage(self, text: str) -> None:
        self.lines.append(text)

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        self.lines.append(f"step {number} (last: {last}): {text} {frame}/{frames}")

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None:
        self.lines.append(f"{number} of {parts}: {text} {frame}/{frames}")

    def note(self, text: str) -> None:
        self.lines.append(text)


class Killer(Progress):
    """Kills nodes, each after the third frame of a step, or a later one when a busy computer loses that feedback.

    Parameters
    ----------
    folder
        Folder of the run.
    victims
        The node that is killed, by the place of its step among those that have begun, counted from 1: a step that is
        repeated takes two numbers.
    early
        Nodes that are killed before the first step, as soon as each runs.
    """

    def __init__(self, folder: Path, victims: dict[int, str], early: Sequence[str] = ()) -> None:
        super().__init__()
        self._folder, self._victims, self._early = folder, dict(victims), list(early)
        self._begun: dict[int, int] = {}

    def stage(self, text: str) -> None:
        super().stage(text)
        if self._early and "starting" in text:
            threading.Thread(target=self._kill_early).start()

    def _kill_early(self) -> None:
        while self._early:
            running = node_pids(self._folder)
            for name in [each for each in self._early if each in running]:
                self._early.remove(name)
                os.kill(running[name], signal.SIGKILL)
            time.sleep(0.02)

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        super().step(number, last, text, frame, frames)
        place = self._begun.setdefault(number, len(self._begun) + 1)
        if place in self._victims and frame >= 3:
            os.kill(node_pids(self._folder)[self._victims.pop(place)], signal.SIGKILL)


@dataclass(frozen=True)
class RecordedExperiment:
    """A run of the command: its report and its output."""

    report: RunReport
    output: str


@contextmanager
def thermocouple(domain: int) -> Iterator[None]:
    """Publish a temperature of 295 K +- .5 K at 20 Hz in the namespace of the rig, as a node of others would."""
    context, ended = rclpy.Context(), threading.Event()
    context.init(domain_id=domain)
    node = rclpy.create_node("thermocouple", namespace="rig", context=context)
    publisher = node.create_publisher(Signal, "signals", 10)

    def publish() -> None:
        while not ended.wait(0.05):
            sample = Signal(name="temperature_grip", quantity="temperature", unit="K", source="thermocouple")
            sample.header.stamp = node.get_clock().now().to_msg()
            sample.stamps, sample.values, sample.sigmas = [sample.header.stamp], [295.0], [0.5]
            publisher.publish(sample)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        node.destroy_node()
        context.shutdown()


def record_experiment(rig: Path, folder: Path, *options: str) -> RecordedExperiment:
    """Run ``fringedic run RIG --output FOLDER`` in this process, in a ROS domain of its own, with a thermocouple."""
    reports: list[RunReport] = []
    run_experiment = run.run_experiment

    def keep_report(*arguments: Any, **options: Any) -> RunReport:
        reports.append(run_experiment(*arguments, **options))
        return reports[-1]

    with private_domain() as domain, pytest.MonkeyPatch.context() as patch:
        for name, value in node_environment(domain).items():
            patch.setenv(name, value)
        patch.setattr(run, "run_experiment", keep_report)
        with thermocouple(domain):
            done = CliRunner().invoke(app, ["run", str(rig), "--output", str(folder), *options])
    assert done.exit_code == 0, f"{done.output}\n{done.exception!r}"
    return RecordedExperiment(reports[0], done.output)


def shared_result(tmp_path_factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Result]) -> Result:
    """Return the result of a function, which the first of several workers of pytest-xdist calls with a new folder."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    folder.mkdir(exist_ok=True)
    file = folder / "result.pickle"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            file.write_bytes(pickle.dumps(make(folder)))
        result: Result = pickle.loads(file.read_bytes())
    return result


def without_ros() -> str:
    """Return a PYTHONPATH with which a process cannot import ROS."""
    return os.pathsep.join(filter(None, [str(WITHOUT_ROS), os.environ.get("PYTHONPATH")]))


def processes_of(domain: str) -> list[str]:
    """Return the command lines of all processes in a ROS domain, except this one."""
    found = []
    for pid, words in command_lines():
        try:
            variables = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
        except OSError:
            continue  # it has ended, or belongs to another user
        if f"ROS_DOMAIN_ID={domain}".encode() in variables and any(words) and pid != os.getpid():
            found.append(" ".join(words))
    return found


def wait_until(done: Callable[[], object], what: str, timeout_s: float = 300.0) -> None:
    """Wait until a condition is true."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end, f"{what} did not happen within {timeout_s:g} s"
        time.sleep(0.05)


class MachineServer:
    """The process of a machine; it can be killed and started again at the same port."""

    script = ""

    def __init__(self) -> None:
        self.port = 0

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> None:
        command = [sys.executable, str(MACHINES / self.script), str(self.port)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


class ModbusServer(MachineServer):
    """A machine with Modbus TCP."""

    script = "modbus_machine.py"

    def switch(self, coil: int, on: bool) -> None:
        with ModbusTcpClient("127.0.0.1", port=self.port) as technician:
            technician.write_coil(coil, on, device_id=1)


class ScpiServer(MachineServer):
    """A machine with text commands on a socket."""

    script = "scpi_machine.py"

    def send(self, command: str) -> str:
        """Send a command or query at the machine itself; return the answer to a query."""
        with socket.create_connection(("127.0.0.1", self.port)) as technician:
            technician.sendall(f"{command}\n".encode())
            return technician.makefile().readline().strip() if command.endswith("?") else ""
