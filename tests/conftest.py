"""What the tests of the running system share: a ROS domain of their own, and one recorded experiment."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from fringedic_bringup.processes import private_domain, remove_stale_segments
from fringedic_bringup.report import RunReport
from fringedic_bringup.run import load_rig, run_experiment

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "ros2_ws" / "src" / "fringedic_bringup" / "config"
SHARED_MEMORY = Path("/dev/shm")


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


def segments() -> set[str]:
    """Names of the shared memory that Fast DDS holds."""
    return {path.name for path in SHARED_MEMORY.glob("*fastrtps*")}


@pytest.fixture(scope="session", autouse=True)
def domain() -> Iterator[str]:
    """Give this test run a ROS domain of its own; nothing may be left in it."""
    remove_stale_segments()
    with private_domain() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
        yield str(number)
        assert not processes_of(str(number))


@pytest.fixture(scope="session")
def tiny() -> Path:
    """Return the rig file of the tiny virtual rig."""
    return CONFIG / "tiny.yaml"


@pytest.fixture(scope="session")
def experiment(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> RunReport:
    """Return a recorded experiment: three steps of the tiny virtual plate in tension, run by the real nodes."""
    folder = tmp_path_factory.mktemp("experiment")
    rig, programme = load_rig(tiny, None, None)
    return run_experiment(rig, tiny, programme, folder / "run", Told())


def wait_until(done: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end, f"{what} did not happen within {timeout_s:g} s"
        time.sleep(0.05)
