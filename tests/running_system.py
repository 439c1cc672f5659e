"""What the tests of the running system share."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "ros2_ws" / "src" / "fringedic_bringup" / "config"
# Part of the tiny rig's image that a good step measures. The plate fills 94 % of the 160 px across, and a rim of up to
# 5 px, where a window of 32 px sees too little of it, is NaN: (150 - 10) (120 - 10) / (160 * 120) = .80
WORKING = 0.80
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


def wait_until(done: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end, f"{what} did not happen within {timeout_s:g} s"
        time.sleep(0.05)
