"""A programme whose machine trips in a move, and is then stopped at its own controls; a person goes on with it.

The machine follows moves also while it is tripped, so that its list of commands shows whether one was sent.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from running_system import CONFIG, ScpiServer
from typer.testing import CliRunner, Result

from fringedic.command.main import app
from fringedic.recording.programme_end import programme_end
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_msgs.action import MoveCrosshead

TARGET_MM, SLOWLY = 0.6, 0.02  # [mm/s]
PROGRAMME = {
    "experiment": "stopped",
    "steps": [
        {"position_mm": 0.1, "speed_mm_per_s": 5.0, "mode": "white"},
        {"position_mm": TARGET_MM, "speed_mm_per_s": SLOWLY, "mode": "none"},
        {"position_mm": 0.2, "speed_mm_per_s": 5.0, "mode": "white"},
    ],
}
MACHINE: dict[str, Any] = {
    "protocol": "scpi",
    "timeout_s": 5.0,
    "force": {"query": "MEAS:FORC?", "unit": "kN"},
    "position": {"query": "MEAS:POS?", "unit": "um"},
    "status": {"query": "STAT?", "idle": ["IDLE"], "moving": ["RUN"], "hold": ["HOLD"], "fault": ["TRIP"]},
    "move": {"commands": ["SPEED {speed:.4f}", "GOTO {position:.4f}"], "speed_unit": "mm/min"},
    "hold": ["STOP"],
    "limits": {"lowest_mm": 0.0, "highest_mm": 1.0, "fastest_mm_per_s": 5.0},
}


@pytest.fixture
def machine() -> Iterator[ScpiServer]:
    with ScpiServer() as server:
        yield server


@pytest.fixture
def rig(machine: ScpiServer, tmp_path: Path) -> Path:
    content = yaml.safe_load((CONFIG / "tiny.yaml").read_text())
    content |= {"load_frame": {"source": "machine", "file": "machine.yaml"}, "programme": PROGRAMME}
    content["recording"] = {"process": False}  # fewer nodes
    resource = f"TCPIP::127.0.0.1::{machine.port}::SOCKET"
    (tmp_path / "machine.yaml").write_text(yaml.safe_dump({**MACHINE, "resource": resource}))
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(content))
    return tmp_path / "rig.yaml"


def moves(machine: ScpiServer) -> list[float]:
    """Return the targets of all moves that the machine was sent [mm]."""
    return [float(each.removeprefix("GOTO ")) for each in machine.send("LOG?").split(",") if each.startswith("GOTO")]


def run(rig: Path, *options: str, meanwhile: Callable[[threading.Event], None] = lambda _: None) -> Result:
    """Run the command, and a function in another thread, which gets an event that is set at the end."""
    ended = threading.Event()
    acting = threading.Thread(target=meanwhile, args=[ended])
    with private_domain() as domain, pytest.MonkeyPatch.context() as patch:
        for name, value in node_environment(domain).items():
            patch.setenv(name, value)
        acting.start()
        done = CliRunner().invoke(app, ["run", str(rig), "--output", str(rig.parent / "run"), *options])
        ended.set()
        acting.join()
    return done


def test_nothing_moves_a_machine_that_tripped_or_was_stopped_until_a_person_goes_on(
    machine: ScpiServer, rig: Path
) -> None:
    """The next move went to the tripped machine after 0.25 s, and to the stopped one after 0.19 s."""

    def in_the_slow_move(command: str) -> Callable[[threading.Event], None]:
        before = len(moves(machine))

        def act(ended: threading.Event) -> None:
            while not ended.wait(0.2):
                if moves(machine)[before:][-1:] == [TARGET_MM] and machine.send("STAT?") == "RUN":
                    time.sleep(0.5)
                    machine.send(command)
                    return

        return act

    def ends(done: Result, words: str, code: int) -> None:
        assert done.exit_code == 1, done.output
        assert f"stopped ended early: {words}" in " ".join(done.output.split()), done.output
        end = programme_end(rig.parent / "run" / "bag")
        assert end is not None
        assert (end.step, end.error_code) == (1, code)
        assert end.reason.startswith(words)

    tripped = run(rig, meanwhile=in_the_slow_move("TRIP"))
    ends(tripped, "the machine reports a fault", MoveCrosshead.Result.MACHINE_FAULT)
    assert moves(machine) == [0.1, TARGET_MM]
    assert "STOP" in machine.send("LOG?"), "a hold was requested"
    assert (rig.parent / "run" / "results.nc").exists()

    machine.send("RESET")
    stopped = run(rig, "--continue", meanwhile=in_the_slow_move("STOP"))
    ends(stopped, "the crosshead stopped at", MoveCrosshead.Result.STOPPED_ELSEWHERE)
    assert "it was stopped at the machine or by a limit of the machine" in " ".join(stopped.output.split())
    assert moves(machine) == [0.1, TARGET_MM, TARGET_MM]

    continued = run(rig, "--continue")
    assert continued.exit_code == 0, continued.output
    assert moves(machine) == [0.1, TARGET_MM, TARGET_MM, TARGET_MM, 0.2]
    shown = CliRunner().invoke(app, ["info", str(rig.parent / "run" / "bag")])
    assert "programme: stopped is complete" in shown.stdout
