"""What the tests of the running system share."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from pymodbus.client import ModbusTcpClient

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "ros2_ws" / "src" / "fringedic_bringup" / "config"
# Part of the tiny rig's image that a good step measures. The plate fills 94 % of the 160 px across, and a rim of up to
# 5 px, where a window of 32 px sees too little of it, is NaN: (150 - 10) (120 - 10) / (160 * 120) = .80
WORKING = 0.80
MACHINES = ROOT / "ros2_ws" / "src" / "load_frame_node" / "test"
MACHINE: dict[str, Any] = {
    "protocol": "modbus",
    "host": "127.0.0.1",
    "timeout_s": 0.3,
    "force": {"register": 0},
    "position": {"register": 2},
    "status": {"register": 4, "idle": [0], "moving": [11], "hold": [12], "fault": [99]},
    "move": {"position": {"register": 10}, "speed": {"register": 12}, "start": {"coil": 0}},
    "hold": {"coil": 1},
    "limits": {"lowest_mm": 0.0, "highest_mm": 1.0, "fastest_mm_per_s": 5.0},
}


@dataclass
class Told:
    """Keeps what a run tells."""

    lines: list[str] = field(default_factory=list)

    def stage(self, text: str) -> None:
        self.lines.append(text)

    def step(self, number: int, steps: int, text: str, frame: int = 0, frames: int = 0) -> None:
        self.lines.append(f"step {number} of {steps}: {text} {frame}/{frames}")

    def note(self, text: str) -> None:
        self.lines.append(text)


class Killer(Told):
    """Kills a node when a step has taken its third frame.

    Parameters
    ----------
    folder
        Of the run.
    victims
        Which node in which step, counted from 1.
    """

    def __init__(self, folder: Path, victims: dict[int, str]) -> None:
        super().__init__()
        self._folder, self._victims = folder, dict(victims)

    def step(self, number: int, steps: int, text: str, frame: int = 0, frames: int = 0) -> None:
        super().step(number, steps, text, frame, frames)
        if number in self._victims and frame == 3:
            os.kill(node_pid(self._folder, self._victims.pop(number)), signal.SIGKILL)


def node_pid(folder: Path, name: str) -> int:
    """Process of a node, known by its parameter file."""
    marker = str(folder / "logs" / f"{name}.yaml").encode()
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if marker in (process / "cmdline").read_bytes():
                return int(process.name)
        except OSError:
            continue
    raise AssertionError(f"no process of {name}")


def processes_of(domain: str) -> list[str]:
    """Command lines of all processes, other than this one, that live in a ROS domain."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            variables = (process / "environ").read_bytes().split(b"\0")
            words = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # it has ended meanwhile, or belongs to somebody else
        if f"ROS_DOMAIN_ID={domain}".encode() in variables and words and int(process.name) != os.getpid():
            found.append(words)
    return found


def wait_until(done: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end, f"{what} did not happen within {timeout_s:g} s"
        time.sleep(0.05)


class MachineServer:
    """A machine's process; it can be killed and started again at its port."""

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
    """Speaks Modbus TCP."""

    script = "modbus_machine.py"

    def switch(self, coil: int, on: bool) -> None:
        with ModbusTcpClient("127.0.0.1", port=self.port) as technician:
            technician.write_coil(coil, on, device_id=1)


class ScpiServer(MachineServer):
    """Speaks text commands on a socket."""

    script = "scpi_machine.py"

    def tell(self, command: str) -> None:
        with socket.create_connection(("127.0.0.1", self.port)) as technician:
            technician.sendall(f"{command}\n".encode())
