"""Testing machines over real sockets: servers in processes of their own, which can be killed."""

from __future__ import annotations

import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import pyvisa
import rclpy
import yaml
from fuzzed_replies import KINDS, fuzz
from geometry_msgs.msg import WrenchStamped
from pymodbus.client import ModbusTcpClient
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic.errors import (
    ConfigurationError,
    CrossheadRangeError,
    MachineError,
    MachineGoneError,
    MachineNotReadyError,
)
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import ClockDrift, LoadState
from fringedic_ros.qos import LATCHED, STATE
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer
from load_frame_node.crosshead import Crosshead
from load_frame_node.machines import DescribedMachine, LoadMode, Sample, SimulatedMachine, load_machine, open_machine
from load_frame_node.machines.machine import Motion

HERE = Path(__file__).parent
MM = 1e-3
DEAF = 4  # coil of the Modbus machine
LIMITS = {"lowest_mm": 0.0, "highest_mm": 1.0, "fastest_mm_per_s": 5.0}
MODBUS: dict[str, Any] = {
    "protocol": "modbus",
    "timeout_s": 5.0,
    "host": "127.0.0.1",
    "force": {"register": 0},
    "position": {"register": 2},
    "status": {"register": 4, "idle": [0], "moving": [11], "hold": [12], "fault": [99]},
    "move": {"position": {"register": 10}, "speed": {"register": 12}, "start": {"coil": 0}},
    "hold": {"coil": 1},
    "limits": LIMITS,
}
SCPI: dict[str, Any] = {
    "protocol": "scpi",
    "timeout_s": 5.0,
    "force": {"query": "MEAS:FORC?", "unit": "kN"},
    "position": {"query": "MEAS:POS?", "unit": "um"},
    "status": {"query": "STAT?", "idle": ["IDLE"], "moving": ["RUN"], "hold": ["HOLD"], "fault": ["TRIP"]},
    "move": {"commands": ["SPEED {speed:.4f}", "GOTO {position:.4f}"], "speed_unit": "mm/min"},
    "hold": ["STOP"],
    "limits": LIMITS,
}


@contextmanager
def server(script: str, port: int = 0, *options: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Run a machine; it listens on `port`, or on a free one."""
    command = [sys.executable, str(HERE / script), str(port), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, int(process.stdout.readline())
        finally:
            process.kill()


def description(kind: str, port: int) -> dict[str, Any]:
    if kind == "modbus":
        return {**MODBUS, "port": port}
    return {**SCPI, "resource": f"TCPIP::127.0.0.1::{port}::SOCKET"}


def counts_um(scale: float) -> dict[str, Any]:
    return {"register": 2, "type": "int32", "unit": "um", "scale": scale}


def opened(content: dict[str, Any], folder: Path) -> DescribedMachine[Any]:
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(content))
    return open_machine(load_machine(path))


@contextmanager
def machine(
    kind: str, folder: Path, **changes: Any
) -> Iterator[tuple[DescribedMachine[Any], subprocess.Popen[str], int]]:
    with server(f"{kind}_machine.py") as (process, port):
        connected = opened({**description(kind, port), **changes}, folder)
        try:
            yield connected, process, port
        finally:
            connected.close()


@contextmanager
def modbus(folder: Path, **changes: Any) -> Iterator[tuple[subprocess.Popen[str], int, dict[str, Any]]]:
    """Run a Modbus machine; yield its process, its port, and the parameters of a load frame node for it."""
    path = folder / "machine.yaml"
    with server("modbus_machine.py") as (process, port):
        path.write_text(yaml.safe_dump({**description("modbus", port), **changes}))
        yield process, port, {"source": "machine", "file": str(path), "rate_hz": 50.0}


def until(connected: DescribedMachine[Any], mode: LoadMode) -> Sample:
    deadline = time.monotonic() + 180
    while (sample := connected.sample()).mode is not mode:
        assert time.monotonic() < deadline, f"still {sample}"
        time.sleep(0.01)
    return sample


@pytest.mark.parametrize(
    ("kind", "place"), [("modbus", {"register": 0}), ("scpi", {"query": "MEAS:FORC?", "scale": 1e3})]
)
def test_further_signals_are_read_with_the_sample(kind: str, place: dict[str, Any], tmp_path: Path) -> None:
    """The signal is the force once more, in newtons, as the machine file describes it."""
    signals = {"load_2": {"unit": "N", "sigma": 2.0, "positive": "tension", **place}}
    with machine(kind, tmp_path, signals=signals) as (connected, _, _):
        connected.move_to(0.2 * MM, 1.0 * MM)
        sample = until(connected, LoadMode.HOLD)
        [load] = sample.signals
        assert load.channel == ("load_2", "force", "N", "tension", "testing machine")
        assert (load.stamp, load.sigma) == (sample.stamp_ns, 2.0)
        assert load.value == pytest.approx(sample.force, abs=5.0)
        assert abs(load.value) > 100
        assert [each.entry for each in connected.inspect()][-1] == "signals.load_2"


@pytest.mark.parametrize("kind", ["modbus", "scpi"])
def test_moves_and_holds_with_samples_in_si(kind: str, tmp_path: Path) -> None:
    """The virtual plate's grips are 2000 N/mm stiff; units differ from machine to machine, SI is what comes out."""
    with machine(kind, tmp_path) as (connected, _, _):
        before = time.time_ns()
        sample = connected.sample()
        assert before < sample.stamp_ns < time.time_ns()
        assert sample.mode is LoadMode.IDLE
        connected.move_to(0.4 * MM, 2 * MM)
        assert until(connected, LoadMode.MOVING).position < 0.4 * MM
        until(connected, LoadMode.HOLD)  # SCPI: its position was asked for before its state, perhaps still on the way
        arrived = connected.sample()
        assert arrived.position == pytest.approx(0.4 * MM, abs=1e-8)
        assert 700 < arrived.force < 900
        connected.move_to(0.0, 0.1 * MM)
        until(connected, LoadMode.MOVING)
        connected.hold()
        held = until(connected, LoadMode.HOLD)
        assert 0.3 * MM < held.position < 0.4 * MM, "it stopped on its way"


UNLISTED = {
    "scpi": [
        (
            {"query": "STAT?", "moving": ["RUN"], "hold": ["Hold"]},
            "status: 'HOLD' is in no list of status, and hold has 'Hold': write 'HOLD' in hold",
        ),
        (
            {"query": "STAT?", "moving": ["RUN"]},
            "status: 'HOLD' is in no list of status: add it to idle, moving, hold or fault",
        ),
    ],
    "modbus": [
        ({"register": 4, "moving": [11]}, "status: 12 is in no list of status: add it to idle, moving, hold or fault")
    ],
}


@pytest.mark.parametrize(
    ("kind", "status", "words"), [(kind, *each) for kind, found in UNLISTED.items() for each in found]
)
def test_a_status_in_no_list_is_reported_with_the_key_to_extend(
    kind: str, status: dict[str, Any], words: str, operator: Operator, tmp_path: Path
) -> None:
    """The state is UNKNOWN, and nobody could see why. The status is that of the hold which a starting node requests."""
    path = tmp_path / "machine.yaml"
    with server(f"{kind}_machine.py") as (_, port):
        path.write_text(yaml.safe_dump({**description(kind, port), "status": status}))
        parameters = {"source": "machine", "file": str(path), "rate_hz": 20.0}
        with NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters) as node:
            operator.wait(lambda: re.search(words, operator.until(LoadState.UNKNOWN).reason), "the reason")
            operator.wait(lambda: re.search(words, node.log), "the line in the log")


@pytest.mark.parametrize("kind", ["modbus", "scpi"])
def test_mode_from_motion_when_the_machine_reports_no_status(kind: str, tmp_path: Path) -> None:
    with machine(kind, tmp_path, status=None, motion={"slowest_mm_per_s": 0.01, "span_s": 0.1}) as (connected, _, _):
        assert connected.sample().mode is LoadMode.UNKNOWN
        until(connected, LoadMode.HOLD)
        connected.move_to(0.2 * MM, 0.5 * MM)
        until(connected, LoadMode.MOVING)
        assert until(connected, LoadMode.HOLD).position == pytest.approx(0.2 * MM, abs=1e-8)


@pytest.mark.parametrize("kind", ["modbus", "scpi"])
def test_server_that_dies_and_comes_back(kind: str, tmp_path: Path) -> None:
    with machine(kind, tmp_path) as (connected, process, port):
        process.kill()
        process.wait()
        with pytest.raises(MachineError, match=f"testing machine at .*{port}.*: sample: "):
            connected.sample()
        with pytest.raises(MachineError, match="hold: "):
            connected.hold()
        with server(f"{kind}_machine.py", port):
            deadline, found = time.monotonic() + 180, False
            while not found and time.monotonic() < deadline:
                with suppress(MachineError):
                    found = bool(connected.sample())
                time.sleep(0.1)
            assert connected.sample().mode is LoadMode.IDLE


@pytest.mark.parametrize("kind", ["modbus", "scpi"])
def test_moves_beyond_the_limits_do_not_reach_the_machine(kind: str, tmp_path: Path) -> None:
    with machine(kind, tmp_path) as (connected, _, _):
        for position, speed, words in (
            (1.2 * MM, MM, "position 1.2 mm is outside 0 to 1 mm"),
            (float("nan"), MM, "position nan mm"),
            (0.5 * MM, 0.0, "speed 0 mm/s"),
            (0.5 * MM, 6 * MM, "speed 6 mm/s is outside"),
        ):
            with pytest.raises(CrossheadRangeError, match=words):
                connected.move_to(position, speed)
        assert connected.sample().mode is LoadMode.IDLE


def test_modbus_machine_that_refuses_or_sends_nonsense(tmp_path: Path) -> None:
    with machine("modbus", tmp_path, limits={**LIMITS, "highest_mm": 100.0}) as (connected, _, port):
        with pytest.raises(MachineError, match="move: refused"):
            connected.move_to(50 * MM, MM)  # beyond the machine's own limit
        with ModbusTcpClient("127.0.0.1", port=port) as technician:
            technician.write_coil(2, True, device_id=1)
            with pytest.raises(MachineError, match="force is nan"):
                connected.sample()
            technician.write_coil(2, False, device_id=1)
            technician.write_coil(3, True, device_id=1)
            assert connected.sample().mode is LoadMode.FAULT
    with server("modbus_machine.py") as (_, port), pytest.raises(MachineError, match="sample: refused"):
        opened({**MODBUS, "force": {"register": 900}, "port": port}, tmp_path)


@pytest.mark.parametrize(
    ("command", "words"), [("BABBLE", r"'\?#!', which is not a number"), ("SILENT", "has no answer within 2 s")]
)
def test_scpi_machine_that_babbles_or_is_silent(command: str, words: str, tmp_path: Path) -> None:
    with machine("scpi", tmp_path, timeout_s=2.0, hold=[command]) as (connected, _, _):
        connected.hold()
        with pytest.raises(MachineError, match=words):
            connected.sample()


@pytest.mark.parametrize(
    ("query", "reply", "words"),
    [
        ("MEAS:FORC?", "9.91E37", r"the force is unknown: 'MEAS:FORC\?' was answered with '9.91E37', outside -5000 to"),
        ("MEAS:FORC?", "-9.9E37", r"'-9.9E37', outside -5000 to 5000 N \(force_range_n\)"),
        ("MEAS:FORC?", "5.1", "'5.1', outside -5000 to 5000 N"),
        ("MEAS:POS?", "9.9e34", r"the position is unknown: .* '9.9e34', outside -2000 to 2001 mm \(limits and 2000 mm"),
    ],
)
def test_a_number_that_no_machine_shows_is_unknown(query: str, reply: str, words: str, tmp_path: Path) -> None:
    """It was a force of 1e41 N, or a position of 1e29 m; kN and um are the units of this machine."""
    with machine("scpi", tmp_path, force_range_n=[-5000.0, 5000.0], hold=[f"REPLY {query} {reply}"]) as (
        connected,
        _,
        _,
    ):
        connected.hold()
        sample = connected.sample()
        assert (sample.mode, math.isnan(sample.force), math.isnan(sample.position)) == (
            LoadMode.IDLE,
            "FORC" in query,
            "POS" in query,
        )
        assert re.search(words, sample.unknown), sample.unknown


def test_forces_without_a_range_and_positions_without_limits_have_bounds_nevertheless(tmp_path: Path) -> None:
    read_only: dict[str, Any] = {"move": None, "limits": None, "hold": {"coil": 1}}
    offsets = {"force": {"register": 0, "offset": -1e36}, "position": {"register": 2, "offset": 9.9e37}}
    with machine("modbus", tmp_path, **read_only, **offsets) as (connected, _, _):
        sample = connected.sample()
    assert math.isnan(sample.force)
    assert math.isnan(sample.position)
    assert re.search(
        r"register 0 contains \S+, outside -1e\+09 to 1e\+09 N .*; .*register 2 contains 0", sample.unknown
    )


def samples(connected: DescribedMachine[Any], count: int) -> None:
    for _ in range(count):
        connected.sample()


def test_scpi_machine_that_acknowledges_its_commands_is_refused(tmp_path: Path) -> None:
    """Each acknowledgement would shift all later answers by one, the position to the place of the status."""
    with machine("scpi", tmp_path, hold=["ACKNOWLEDGE"]) as (connected, _, _):
        samples(connected, 3)
        connected.hold()
        with pytest.raises(MachineError, match=r"sent more than was requested, .* acknowledges commands"):
            samples(connected, 5)  # on a busy computer the acknowledgement may come after the first answer


def test_modbus_machine_with_swapped_bytes(tmp_path: Path) -> None:
    with server("modbus_machine.py", 0, "swapped") as (_, port):
        file = description("modbus", port)
        with closing(opened({**file, "byte_order": "little"}, tmp_path)) as connected:
            assert connected.sample().mode is LoadMode.IDLE
            connected.move_to(0.4 * MM, 2 * MM)
            until(connected, LoadMode.MOVING)
            until(connected, LoadMode.HOLD)
            assert connected.sample().position == pytest.approx(0.4 * MM, abs=1e-8)
        with closing(opened(file, tmp_path)) as connected:
            force, position, status = connected.inspect()
        words = "makes no sense; with word_order: big and byte_order: little it would be"
        assert f"{words} 12" in str(status.error)
        for answer in (force, position):  # a wrong order may also give a sensible number
            assert answer.error is None or words in str(answer.error)


def test_modbus_status_as_bits(tmp_path: Path) -> None:
    bits = {
        "register": 5,
        "idle": [{"bits_set": [0, 7], "bits_clear": [1, 2]}],
        "moving": [{"bits_set": [1]}],
        "hold": [{"bits_set": [2, 7]}],
        "fault": [{"bits_set": [3]}],
    }
    with machine("modbus", tmp_path, status=bits) as (connected, _, port):
        assert connected.sample().mode is LoadMode.IDLE
        connected.move_to(0.4 * MM, 2 * MM)
        until(connected, LoadMode.MOVING)
        until(connected, LoadMode.HOLD)
        switch(port, 3, on=True)
        assert connected.sample().mode is LoadMode.FAULT, "it is also on hold"
        assert [answer.raw for answer in connected.inspect()][2] == "0x008C"


def test_modbus_value_that_does_not_fit_its_register(tmp_path: Path) -> None:
    """A position in micrometres of 16 bits ends at 32.8 mm."""
    position = {"register": 10, "type": "int16", "unit": "um"}
    changes = {"move": {**MODBUS["move"], "position": position}, "limits": {**LIMITS, "highest_mm": 50.0}}
    with machine("modbus", tmp_path, **changes) as (connected, _, _):
        with pytest.raises(MachineError, match="move: 40000 does not fit register 10 of type int16"):
            connected.move_to(40 * MM, MM)
        assert connected.sample().mode is LoadMode.IDLE


@pytest.mark.parametrize("kind", KINDS)
def test_only_a_hold_that_the_machine_reports_is_believed(kind: str) -> None:
    modes = fuzz(kind, 1000)
    assert set(modes) == {"refused", "HOLD", "MOVING", "UNKNOWN"}, modes
    assert min(modes.values()) > 5, modes


def test_a_machine_that_repeats_an_old_sample_is_not_believed(tmp_path: Path) -> None:
    """Its clock is register 6; the constant register 8 is the clock of a controller that hangs."""
    with machine("modbus", tmp_path, time={"register": 8}) as (connected, _, _):
        connected.sample()
        time.sleep(1.1)
        with pytest.raises(MachineError, match="clock has stood at 0 s for more than 1 s"):
            connected.sample()


def test_scpi_over_another_visa_backend(tmp_path: Path) -> None:
    """The simulated instruments of pyvisa-sim: the same driver, another way to the machine."""
    instruments = tmp_path / "instruments.yaml"
    instruments.write_text(
        yaml.safe_dump(
            {
                "spec": "1.1",
                "devices": {
                    "machine": {
                        "eom": {"ASRL INSTR": {"q": "\n", "r": "\n"}},
                        "error": "ERROR",
                        "dialogues": [{"q": "F?", "r": "-1.5"}, {"q": "P?", "r": "12.25"}, {"q": "S?", "r": "2"}],
                    }
                },
                "resources": {"ASRL1::INSTR": {"device": "machine"}},
            }
        )
    )
    content = {
        "protocol": "scpi",
        "resource": "ASRL1::INSTR",
        "backend": f"{instruments}@sim",
        "force": {"query": "F?", "unit": "kN", "scale": -1.0},
        "position": {"query": "P?", "offset": -2.25},
        "status": {"query": "S?", "moving": [1], "hold": [2]},
    }
    connected = opened(content, tmp_path)
    sample = connected.sample()
    assert (sample.mode, sample.force, sample.position) == (LoadMode.HOLD, 1500.0, pytest.approx(10 * MM))
    with pytest.raises(MachineError, match="has no move"):
        connected.move_to(0.0, MM)
    with pytest.raises(MachineError, match="has no hold; stop it at the machine"):
        connected.hold()
    connected.close()
    pyvisa.ResourceManager(f"{instruments}@sim").close()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"protocol": "telepathy"}, "protocol"),
        ({"host": None}, "host: "),
        ({"force": {"register": 70000}}, "force.register: "),
        ({"force": {"register": 0, "unit": "lbf"}}, "force.unit: "),
        ({"force": {"register": 0, "scale": 0}}, "force: scale is 0"),
        ({"force_range_n": [500, -500]}, r"force_range_n \[500.0, -500.0\]: give the smaller force first"),
        ({"colour": "red"}, "colour: "),
        ({"hold": None}, "move is given without hold"),
        ({"limits": None}, "move is given without limits"),
        ({"hold": {"coil": 1, "register": 2}}, "hold: give either coil or register"),
        (
            {"status": None, "position": counts_um(10.0)},
            "position is 0.01 mm, and a motion of 0.01 mm/s would look like",
        ),
    ],
)
def test_machine_file_with_a_mistake(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump({**MODBUS, **changes}))
    with pytest.raises(ConfigurationError, match=rf"machine\.yaml: .*{words}"):
        load_machine(path)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load_machine(tmp_path / "absent.yaml")


def test_fine_counts_of_the_position_show_the_slowest_motion(tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump({**MODBUS, "status": None, "position": counts_um(1.0)}))
    assert load_machine(path).status is None


def test_machine_file_with_a_key_twice(tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(MODBUS) + "host: 192.168.1.11\n")
    with pytest.raises(ConfigurationError, match=r"machine\.yaml: .*the key 'host' is in line \d+ already"):
        load_machine(path)


def test_motion_over_a_clock_that_jumps_back() -> None:
    motion = Motion(slowest=0.01 * MM, span=0.2)
    times = [int(1e8 * k) for k in range(6)]
    modes = [motion.mode(time_ns, 0.05 * MM * k) for k, time_ns in enumerate(times)]
    assert modes == [LoadMode.UNKNOWN] * 2 + [LoadMode.MOVING] * 4
    assert motion.mode(0, 0.0) is LoadMode.UNKNOWN
    assert motion.mode(int(1e8), 0.0) is LoadMode.UNKNOWN
    assert motion.mode(int(2e8), 0.0) is LoadMode.HOLD
    assert motion.mode(int(3e8), math.nan) is LoadMode.UNKNOWN, "an unknown position proves no standstill"
    assert motion.mode(int(4e8), 0.0) is LoadMode.UNKNOWN


class Operator(Peer):
    def __init__(self) -> None:
        super().__init__()
        self.states = self.listen(LoadState, "load_frame/state", STATE)
        self._move = ActionClient(self, MoveCrosshead, "move_crosshead")
        self._hold = self.create_client(Trigger, "load_frame/hold")

    def move(self, position: float, speed: float) -> MoveCrosshead.Result:
        return self.end(self.start(position, speed))

    def start(self, position: float, speed: float, **further: Any) -> ClientGoalHandle:
        self.wait(self._move.server_is_ready, "the action server")
        self.meet("load_frame")
        sending = self._move.send_goal_async(MoveCrosshead.Goal(position=position, speed=speed, **further))
        self.wait(sending.done, "the answer to the goal")
        return sending.result()

    def end(self, goal: ClientGoalHandle) -> MoveCrosshead.Result:
        ending = goal.get_result_async()
        self.wait(ending.done, "the result")
        return ending.result().result

    def hold(self) -> Trigger.Response:
        return self.ask(self._hold, Trigger.Request(), "the hold")

    def until(self, mode: int) -> LoadState:
        """Return a sample of this mode that was taken from now on; earlier ones may still be on their way."""
        begin = time.time_ns()

        def is_there() -> bool:
            latest = self.states[-1] if self.states else LoadState()
            return latest.mode == mode and to_nanoseconds(latest.header.stamp) > begin

        self.wait(is_there, f"mode {mode}")
        return self.states[-1]


@pytest.fixture
def operator() -> Iterator[Operator]:
    rclpy.init()
    operator = Operator()
    yield operator
    operator.destroy_node()
    rclpy.shutdown()


def test_node_drives_a_modbus_machine_that_is_lost_and_found(operator: Operator, tmp_path: Path) -> None:
    with (
        modbus(tmp_path) as (process, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        arrived = operator.move(0.3 * MM, 1.0 * MM)
        assert (arrived.error_code, arrived.error_message) == (MoveCrosshead.Result.NONE, "")
        assert arrived.position == pytest.approx(0.3 * MM, abs=1e-8)
        assert operator.move(0.3 * MM, 1.0 * MM).error_code == MoveCrosshead.Result.NONE, "it is there already"
        assert operator.move(2 * MM, 1.0 * MM).error_code == MoveCrosshead.Result.INVALID_GOAL
        held = operator.until(LoadState.HOLD)
        assert held.force > 500
        process.kill()
        process.wait()
        unknown = operator.until(LoadState.UNKNOWN)
        assert math.isnan(unknown.force)
        assert math.isnan(unknown.position)
        refused = operator.move(0.1 * MM, 1.0 * MM)
        assert refused.error_code == MoveCrosshead.Result.MACHINE_FAULT
        assert "no state for 10 s and is not moved: testing machine at 127.0.0.1" in refused.error_message
        called_off = operator.start(0.1 * MM, 1.0 * MM)
        time.sleep(0.5)
        called_off.cancel_goal_async()
        assert operator.end(called_off).error_code == MoveCrosshead.Result.CANCELLED
        assert not operator.hold().success
        with server("modbus_machine.py", port):
            operator.until(LoadState.HOLD)  # which was requested while there was no machine
            assert operator.move(0.1 * MM, 1.0 * MM).error_code == MoveCrosshead.Result.NONE


def test_a_hold_that_was_not_accepted_is_requested_again(operator: Operator, tmp_path: Path) -> None:
    """The machine does not answer for longer than the time-out in a move until a force, and goes on moving."""
    with (
        modbus(tmp_path, timeout_s=1.0) as (process, _, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        goal = operator.start(1.0 * MM, 0.02 * MM, force_above=[1000.0])
        operator.until(LoadState.MOVING)
        process.send_signal(signal.SIGSTOP)
        result = operator.end(goal)
        process.send_signal(signal.SIGCONT)
        assert result.error_code == MoveCrosshead.Result.MACHINE_FAULT
        assert "a hold was not accepted and is requested again with every sample" in result.error_message
        assert operator.until(LoadState.HOLD).force < 500


def switch(port: int, coil: int, *, on: bool) -> None:
    with ModbusTcpClient("127.0.0.1", port=port) as technician:
        technician.write_coil(coil, on, device_id=1)


def test_a_hold_that_was_lost_is_requested_again_while_the_machine_moves(operator: Operator, tmp_path: Path) -> None:
    """It was accepted, so that it was never requested again, and the move went on to its end."""
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        switch(port, DEAF, on=True)
        goal = operator.start(1.0 * MM, 0.02 * MM, force_above=[100.0])
        operator.wait(lambda: operator.states and operator.states[-1].force > 120.0, "a motion beyond the limit")
        switch(port, DEAF, on=False)
        result = operator.end(goal)
        assert (result.error_code, result.force_reached) == (MoveCrosshead.Result.NONE, True)
        assert result.force < 500
        operator.until(LoadState.HOLD)


@pytest.mark.parametrize("how", ["limit", "cancel", "hold"])
def test_a_hold_that_the_machine_does_not_follow_is_a_fault(how: str, operator: Operator, tmp_path: Path) -> None:
    """The move to its farthest position was reported as ended by its limit, as cancelled, or as stopped."""
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        switch(port, DEAF, on=True)
        goal = operator.start(0.2 * MM, 0.03 * MM, **({"force_above": [20.0]} if how == "limit" else {}))
        operator.until(LoadState.MOVING)
        if how == "cancel":
            goal.cancel_goal_async()
        if how == "hold":
            assert operator.hold().success
        result = operator.end(goal)
    assert (result.error_code, result.force_reached) == (MoveCrosshead.Result.MACHINE_FAULT, False)
    assert "the machine did not follow a hold: it moved on for" in result.error_message


@pytest.mark.parametrize("how", ["cancel", "hold"])
def test_a_move_that_was_completed_is_not_said_to_be_stopped(how: str, operator: Operator, tmp_path: Path) -> None:
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        switch(port, DEAF, on=True)
        operator.until(LoadState.IDLE)
        operator.states.clear()
        goal = operator.start(0.25 * MM, 0.5 * MM)
        operator.wait(lambda: any(state.mode == LoadState.MOVING for state in operator.states), "a motion")
        if how == "cancel":
            goal.cancel_goal_async()
        else:
            assert operator.hold().success
        result = operator.end(goal)
    assert result.position == pytest.approx(0.25 * MM, abs=0.01 * MM)
    assert not re.search("holding|stopped", result.error_message), "on a slow computer it did not follow the hold"


def test_a_machine_that_still_moves_after_a_hold_is_named(operator: Operator, tmp_path: Path) -> None:
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        switch(port, DEAF, on=True)
        result = operator.end(operator.start(1.0 * MM, 0.02 * MM, force_above=[20.0]))
    assert (result.error_code, result.force_reached) == (MoveCrosshead.Result.MACHINE_FAULT, False)
    assert result.error_message == (
        "the machine still moves 15 s after a hold was requested; stop it at its own controls"
    )


@pytest.mark.parametrize("last", [LoadMode.HOLD, LoadMode.IDLE])
def test_an_accepted_hold_is_owed_until_standstill(
    last: LoadMode, operator: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when the connection was lost meanwhile; later motions are those of an operator."""

    class Deaf(SimulatedMachine):
        holds = 0

        def __init__(self) -> None:
            pass

        def hold(self) -> None:
            self.holds += 1

    monkeypatch.setattr("load_frame_node.crosshead.REPEAT_S", 0.0)
    crosshead, deaf = Crosshead(operator), Deaf()
    crosshead.open(deaf)
    crosshead.take(Sample(0, LoadMode.IDLE, 0.0, 0.0))
    crosshead.hold()
    counts = []
    for mode in (LoadMode.MOVING, LoadMode.UNKNOWN, LoadMode.MOVING, last, LoadMode.MOVING):
        crosshead.take(Sample(0, mode, 0.0, 0.0))
        counts.append(deaf.holds)
    assert counts == [2, 2, 3, 3, 3]


def test_a_node_that_ends_requests_the_hold_until_it_is_accepted(operator: Operator, tmp_path: Path) -> None:
    """It tried once, while there was no connection, and the machine moved on."""
    with modbus(tmp_path, timeout_s=1.0) as (process, port, parameters):
        with NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters):
            operator.start(1.0 * MM, 0.02 * MM)
            operator.until(LoadState.MOVING)
            process.send_signal(signal.SIGSTOP)
            operator.until(LoadState.UNKNOWN)
            back = threading.Timer(3.0, process.send_signal, [signal.SIGCONT])
            back.start()
        back.join()
        connected = opened(description("modbus", port), tmp_path)
        held = connected.sample()
        connected.close()
        assert held.mode is LoadMode.HOLD
        assert held.position < 0.9 * MM


@pytest.mark.parametrize("is_reached", [True, False])
def test_a_node_that_was_killed_in_a_move_requests_the_hold_at_its_next_start(
    is_reached: bool, operator: Operator, tmp_path: Path
) -> None:
    """Whether the machine is reached at once or, as after a lost connection, later."""
    with modbus(tmp_path, timeout_s=1.0) as (process, _, parameters):
        killed = NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters).__enter__().process
        operator.start(1.0 * MM, 0.02 * MM)
        operator.until(LoadState.MOVING)
        killed.kill()
        killed.wait()
        if not is_reached:
            process.send_signal(signal.SIGSTOP)
        with NodeProcess("load_frame_node.load_frame_node", tmp_path, {**parameters, "machine_required": False}):
            if not is_reached:
                operator.until(LoadState.UNKNOWN)
                refused = operator.move(0.1 * MM, 1.0 * MM)
                assert refused.error_code == MoveCrosshead.Result.MACHINE_FAULT, "and the hold is still owed"
                process.send_signal(signal.SIGCONT)
            assert operator.until(LoadState.HOLD).position < 0.9 * MM


def test_a_start_leaves_a_machine_that_stands_still_alone(operator: Operator, tmp_path: Path) -> None:
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        operator.until(LoadState.IDLE)
        with ModbusTcpClient("127.0.0.1", port=port) as technician:
            for register, value in ((10, 0.5), (12, 0.1)):
                words = technician.convert_to_registers(value, technician.DATATYPE.FLOAT32)
                technician.write_registers(register, words, device_id=1)
            technician.write_coil(0, True, device_id=1)
        operator.until(LoadState.MOVING)
        operator.serve(0.5)
        operator.until(LoadState.MOVING)


@pytest.mark.parametrize(("error", "mode"), [(MachineError, LoadMode.UNKNOWN), (MachineGoneError, LoadMode.HOLD)])
def test_a_move_that_is_not_accepted_does_not_replace_a_hold(
    operator: Operator, error: type[MachineError], mode: LoadMode
) -> None:
    """Nor may a move whose answer is missing, and which may have begun, remain without one."""

    class Refusing(SimulatedMachine):
        holds = 0

        def __init__(self) -> None:
            pass

        def sample(self) -> Sample:
            return Sample(0, LoadMode.IDLE, 0.0, 0.0)

        def move_to(self, position: float, speed: float) -> None:
            raise error(f"{position} {speed}")

        def hold(self) -> None:
            self.holds += 1

    crosshead, refusing = Crosshead(operator), Refusing()
    crosshead.open(refusing)
    if error is MachineGoneError:
        crosshead.take(Sample(0, LoadMode.IDLE, 0.0, 0.0))
        assert not refusing.holds, "it stands still"
    with pytest.raises(error):
        crosshead.move_to(0.5 * MM, 1.0 * MM, lambda _: False)
    for _ in range(2):
        crosshead.take(Sample(0, mode, 0.0, 0.0))
    assert refusing.holds == 1


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (
            Sample(0, LoadMode.FAULT, 0.0, 0.0),
            "no move was sent: the machine reports a fault; find its cause, and reset",
        ),
        (Sample(0, LoadMode.UNKNOWN, 0.0, 0.0), "no move was sent: the machine reports no state"),
        (Sample(0, LoadMode.HOLD, 0.0, math.nan, unknown="POS? is 9.9E37"), "position .* is unknown; POS\\? is 9.9E37"),
        (MachineGoneError("no connection"), "no move was sent: no connection"),
    ],
)
def test_no_move_is_sent_to_a_machine_that_does_not_work_now(
    operator: Operator, answer: Sample | MachineError, words: str
) -> None:
    """The latest sample showed a hold; the next one would have been taken after the move."""

    class Tripped(SimulatedMachine):
        moves = 0

        def __init__(self) -> None:
            pass

        def sample(self) -> Sample:
            if isinstance(answer, MachineError):
                raise answer
            return answer

        def move_to(self, position: float, speed: float) -> None:
            self.moves += position * speed > 0

    crosshead, tripped = Crosshead(operator), Tripped()
    crosshead.open(tripped)
    crosshead.take(Sample(0, LoadMode.HOLD, 0.0, 0.0))
    with pytest.raises(MachineNotReadyError, match=words):
        crosshead.move_to(0.5 * MM, 1.0 * MM, lambda _: False)
    assert tripped.moves == 0
    assert crosshead.sample.mode is (LoadMode.UNKNOWN if isinstance(answer, MachineError) else answer.mode)


def test_nothing_moves_a_machine_with_a_fault_and_nobody_moves_it_after_a_stop(
    operator: Operator, tmp_path: Path
) -> None:
    """Goals went to the tripped machine; a controller that waited for a move went on after the stop of that move."""
    path = tmp_path / "machine.yaml"
    with server("scpi_machine.py") as (_, port):
        path.write_text(yaml.safe_dump(description("scpi", port)))
        parameters = {"source": "machine", "file": str(path), "rate_hz": 50.0}
        with NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters) as node:
            goal = operator.start(0.8 * MM, 0.05 * MM)
            operator.until(LoadState.MOVING)
            technician(port, "TRIP")
            tripped = operator.end(goal)
            assert (tripped.error_code, tripped.error_message) == (
                MoveCrosshead.Result.MACHINE_FAULT,
                "the machine reports a fault; find its cause, and reset the machine at its own controls; a hold was "
                "requested",
            )
            refused = operator.move(0.1 * MM, 1.0 * MM)
            assert refused.error_code == MoveCrosshead.Result.MACHINE_FAULT
            assert refused.error_message.startswith("no move was sent: the machine reports a fault")
            assert moves_sent(port) == 1
            technician(port, "RESET")
            operator.until(LoadState.HOLD)

            goal = operator.start(0.8 * MM, 0.05 * MM, controller="tension")
            operator.until(LoadState.MOVING)
            busy = operator.end(operator.start(0.1 * MM, 1.0 * MM, controller="fatigue"))
            assert busy.error_code == MoveCrosshead.Result.BUSY
            technician(port, "STOP")
            assert operator.end(goal).error_code == MoveCrosshead.Result.STOPPED_ELSEWHERE
            waited = operator.end(operator.start(0.1 * MM, 1.0 * MM, controller="fatigue"))
            assert waited.error_code == MoveCrosshead.Result.STOPPED_ELSEWHERE
            assert "no move was sent, because the move before was stopped: the crosshead" in waited.error_message
            assert moves_sent(port) == 2
            again = operator.end(operator.start(0.1 * MM, 1.0 * MM, controller="fatigue"))
            assert again.error_code == MoveCrosshead.Result.NONE, "a person has decided to go on"

            technician(port, "REPLY MEAS:FORC? 9.91E37")
            operator.wait(lambda: math.isnan(operator.states[-1].force), "an unknown force")
            operator.serve(0.5)
            assert operator.states[-1].mode == LoadState.HOLD
            stopped = operator.end(operator.start(0.5 * MM, 0.05 * MM, force_above=[500.0]))
            assert stopped.force_reached, "an unknown force ends a move that has a limit"
            assert math.isnan(stopped.reached_force)
            assert node.log.count("'MEAS:FORC?' was answered with '9.91E37', outside -1e+09 to 1e+09 N") == 1


def technician(port: int, command: str) -> str:
    """Send a command or a query at the machine itself; return the answer to a query."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(f"{command}\n".encode())
        return connection.makefile().readline().strip() if command.endswith("?") else ""


def moves_sent(port: int) -> int:
    return technician(port, "LOG?").count("GOTO")


def test_a_move_that_is_stopped_at_the_machine_has_not_arrived(operator: Operator, tmp_path: Path) -> None:
    with (
        modbus(tmp_path) as (_, port, parameters),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters),
    ):
        goal = operator.start(0.8 * MM, 0.05 * MM)
        operator.until(LoadState.MOVING)
        with ModbusTcpClient("127.0.0.1", port=port) as technician:
            technician.write_coil(1, True, device_id=1)
        result = operator.end(goal)
    assert result.error_code == MoveCrosshead.Result.STOPPED_ELSEWHERE
    assert "mm from its target: it was stopped at the machine" in result.error_message
    # the standstill may be a wrong report
    assert result.error_message.endswith("; a hold was requested")


def test_node_publishes_the_drift_of_the_clock_of_the_machine(operator: Operator, tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    clocks = operator.listen(ClockDrift, "load_frame/clock", LATCHED)
    with server("modbus_machine.py") as (_, port):
        path.write_text(yaml.safe_dump({**description("modbus", port), "time": {"register": 6}}))
        parameters = {"source": "machine", "file": str(path), "rate_hz": 100.0}
        with NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters):
            operator.wait(
                lambda: clocks and clocks[-1].samples >= 20 and clocks[-1].drift_sigma < 0.003,
                "a drift whose uncertainty is a third of its value",
            )
    told = clocks[-1]
    assert told.clock == "load_frame"
    error = told.drift - 0.01 / 1.01  # per second of the machine, whose clock is 1 % fast
    assert abs(error) < 4 * told.drift_sigma, f"drift {told.drift:.5f} +- {told.drift_sigma:.5f}, off by {error:.5f}"


def test_node_listens_to_a_controller(operator: Operator, tmp_path: Path) -> None:
    """What ros2_control publishes becomes the machine's state; moves are left to the controller."""
    joints = operator.create_publisher(JointState, "/joint_states", 10)
    wrenches = operator.create_publisher(WrenchStamped, "/load_cell", 10)
    position = [0.2 * MM]

    def publish() -> None:
        now = operator.get_clock().now().to_msg()
        joint = JointState(name=["table", "ram"], position=[9.0, position[0]])
        wrench = WrenchStamped()
        joint.header.stamp = wrench.header.stamp = now
        wrench.wrench.force.x, wrench.wrench.force.z = -120.0, 5.0
        joints.publish(joint)
        wrenches.publish(wrench)

    timer = operator.create_timer(0.01, publish)
    parameters = {
        "source": "controller",
        "joint": "ram",
        "wrench_topic": "/load_cell",
        "force_axis": "x",
        "force_sign": -1,
    }
    with NodeProcess("load_frame_node.load_frame_node", tmp_path, parameters):
        held = operator.until(LoadState.HOLD)
        assert (held.force, held.position) == (120.0, 0.2 * MM)
        refused = operator.move(0.1 * MM, 1.0 * MM)
        assert refused.error_code == MoveCrosshead.Result.MACHINE_FAULT
        assert "its own controller" in refused.error_message
        ramp = operator.create_timer(0.01, lambda: position.__setitem__(0, position[0] + 1e-6))
        assert operator.until(LoadState.MOVING).force == 120.0
        operator.destroy_timer(ramp)
        operator.until(LoadState.HOLD)
        operator.destroy_timer(timer)
        operator.until(LoadState.UNKNOWN)
        for stamp_s, names, words in (
            (0, ["ram"], r"/joint_states: \d+ messages? came in .* with a stamp of 0 s"),
            (57, ["ram"], r"none usable: .* behind the clock of this computer \(the latest by \d+ days\)"),
            (57, ["leg"], r"none usable: .* without a position of the joint 'ram' \(the latest names 'leg'\)"),
        ):
            unusable = JointState(name=names, position=[0.2 * MM])
            unusable.header.stamp.sec = stamp_s
            timer = operator.create_timer(0.01, partial(joints.publish, unusable))
            operator.wait(lambda w=words: re.search(w, operator.states[-1].reason), words)
            operator.destroy_timer(timer)
        joints.publish(JointState(name=["ram"]))  # a joint without position, which the message allows
        operator.until(LoadState.UNKNOWN)
