"""The example of a machine behind an analog and digital card, as the page of machines prints it."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

from fringedic.errors import CrossheadRangeError
from fringedic.virtual_rig import SimulatedLoadFrame, VirtualRigConfiguration
from load_frame_node.machines import LoadMode, Machine, Sample, SimulatedMachine
from load_frame_node.machines.machine import Motion

PAGE = Path(__file__).parents[4] / "docs" / "machines.md"
NEWTON_PER_VOLT, METRE_PER_VOLT = 250.0, 1e-4
MM = 1e-3


class Card:
    """A card wired to the simulated machine."""

    def __init__(self) -> None:
        frame = SimulatedLoadFrame(VirtualRigConfiguration.from_dict({"preset": "plate"}).load_frame, seed=1)
        self.machine = SimulatedMachine(frame)
        self.target = 0.0
        self.lines = {0: False, 1: False}

    def read_volts(self, channel: int) -> float:
        sample = self.machine.sample()
        return sample.force / NEWTON_PER_VOLT if channel == 0 else sample.position / METRE_PER_VOLT

    def write_volts(self, _channel: int, volts: float) -> None:
        self.target = volts * METRE_PER_VOLT

    def write_line(self, line: int, on: bool) -> None:
        rises = on and not self.lines[line]
        self.lines[line] = on
        if rises and line == 0:
            self.machine.move_to(self.target, 1 * MM)
        elif rises:
            self.machine.hold()

    def close(self) -> None:
        pass


@pytest.fixture
def machine() -> Machine:
    (text,) = re.findall(r"```python\n(class CardMachine.*?)```", PAGE.read_text(), re.DOTALL)
    names: dict[str, Any] = {
        "time": time,
        "Motion": Motion,
        "Sample": Sample,
        "CrossheadRangeError": CrossheadRangeError,
    }
    exec(text, names)
    return names["CardMachine"](Card(), NEWTON_PER_VOLT, METRE_PER_VOLT)


def until(machine: Machine, mode: LoadMode) -> Sample:
    deadline = time.monotonic() + 180
    while (sample := machine.sample()).mode is not mode:
        assert time.monotonic() < deadline, f"still {sample}"
        time.sleep(0.01)
    return sample


def test_the_printed_example_moves_reads_and_holds(machine: Machine) -> None:
    machine.move_to(0.4 * MM, 1 * MM)
    until(machine, LoadMode.MOVING)
    arrived = until(machine, LoadMode.HOLD)
    assert arrived.position == pytest.approx(0.4 * MM, abs=1e-9)
    assert 700 < arrived.force < 900
    machine.move_to(0.0, 1 * MM)
    until(machine, LoadMode.MOVING)
    machine.hold()
    assert 0.0 < until(machine, LoadMode.HOLD).position < 0.4 * MM, "it stopped on its way"
    with pytest.raises(CrossheadRangeError, match="beyond the card's 10 V"):
        machine.move_to(2 * MM, 1 * MM)
    machine.close()
