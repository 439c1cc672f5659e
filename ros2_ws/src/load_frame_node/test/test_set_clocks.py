"""Machines and moves while the clock of this computer is set, and while this process stands still."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import pyvisa
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState

from fringedic.errors import MachineError
from fringedic.settings.load_frame import ControllerLoadFrame, LoadFrameNodeSettings
from fringedic_msgs.action import MoveCrosshead
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import Peer
from load_frame_node.crosshead import Crosshead
from load_frame_node.machines import LoadMode, Machine, Sample, ScpiDescription, SimulatedMachine, open_machine
from load_frame_node.machines.controller import ControllerMachine
from load_frame_node.move_server import MoveServer

MM = 1e-3
HOUR_S = 3600
SCPI: dict[str, Any] = {
    "protocol": "scpi",
    "resource": "TCPIP::machine::5025::SOCKET",
    "timeout_s": 0.5,
    "force": {"query": "F?"},
    "position": {"query": "P?"},
}
STATUS = {"query": "S?", "moving": [1], "hold": [2]}


class Clock:
    """Stands in for the module `time`: time passes, and the clock is set, only when a test says so."""

    def __init__(self) -> None:
        self.passed_s = 10.0
        self.set_by_s = 0

    def monotonic(self) -> float:
        return self.passed_s

    def monotonic_ns(self) -> int:
        return round(1e9 * self.passed_s)

    def time_ns(self) -> int:
        return (1_700_000_000 + self.set_by_s) * 1_000_000_000 + self.monotonic_ns()


class Instrument:
    """A VISA resource; each answer takes `answer_s`, and one more line follows it after `follows_s`."""

    def __init__(self, clock: Clock) -> None:
        self.timeout = 0
        self.answer_s, self.follows_s = 0.001, math.inf
        self.moves = True
        self.waits_s: list[float] = []
        self._clock = clock
        self._query = ""
        self._answered_s = 0.0

    def write(self, query: str) -> None:
        self._query = query

    def read_bytes(self, _count: int, *, break_on_termchar: bool = False) -> bytes:
        return self._answer() if break_on_termchar else self._rest()

    def _answer(self) -> bytes:
        self._clock.passed_s += self.answer_s
        self._answered_s = self._clock.passed_s
        position_mm = self._clock.passed_s if self.moves else 0.0
        return {"F?": b"1.5", "P?": b"%.6f" % position_mm, "S?": b"2", "T?": b"5"}[self._query]

    def _rest(self) -> bytes:
        wait_s = 1e-3 * self.timeout
        self.waits_s.append(wait_s)
        if self._answered_s + self.follows_s <= self._clock.passed_s + wait_s:
            return b"2"
        self._clock.passed_s += wait_s
        raise pyvisa.Error("time-out")

    def close(self) -> None:
        pass


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in ("crosshead", "move_server", "machines.described", "machines.scpi", "machines.controller"):
        monkeypatch.setattr(f"load_frame_node.{module}.time", clock)
    monkeypatch.setattr("fringedic.frames.clocks.time", clock)
    return clock


@pytest.fixture
def instrument(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Instrument:
    instrument = Instrument(clock)
    manager = SimpleNamespace(open_resource=lambda _resource, **_: instrument)
    monkeypatch.setattr("load_frame_node.machines.scpi.pyvisa.ResourceManager", lambda _backend: manager)
    return instrument


def opened(**changes: Any) -> Machine:
    return open_machine(ScpiDescription.model_validate(SCPI | changes))


def test_a_process_that_stood_still_waits_long_for_a_line_too_many_only_once(
    clock: Clock, instrument: Instrument
) -> None:
    """It counted its own pause of 3 s as the time of an answer, and sampling halted for 6 s once a second."""
    connected = opened(status=STATUS)
    instrument.answer_s = 3.0
    connected.sample()
    assert max(instrument.waits_s) <= SCPI["timeout_s"], "no answer may be later"
    instrument.answer_s = 0.001
    instrument.waits_s.clear()
    for _ in range(3):
        clock.passed_s += 2.0
        connected.sample()
    assert max(instrument.waits_s) < 0.01


@pytest.mark.parametrize("answer_s", [0.001, 0.1, 0.45])
def test_a_line_too_many_is_waited_for_as_long_as_an_answer_takes(
    answer_s: float, clock: Clock, instrument: Instrument
) -> None:
    connected = opened(status=STATUS)
    clock.passed_s += 2.0
    instrument.answer_s = instrument.follows_s = answer_s
    with pytest.raises(MachineError, match="sent more than was requested"):
        connected.sample()


@pytest.mark.parametrize("set_by_s", [-HOUR_S, HOUR_S])
@pytest.mark.parametrize(("moves", "mode"), [(True, LoadMode.MOVING), (False, LoadMode.HOLD)])
def test_a_clock_that_is_set_does_not_change_the_mode_from_motion(
    moves: bool, mode: LoadMode, set_by_s: int, clock: Clock, instrument: Instrument
) -> None:
    """A motion became a hold when the clock was set forward, as the same way in an hour, and UNKNOWN otherwise."""
    instrument.moves = moves
    connected = opened()
    clock.passed_s += 0.3
    assert connected.sample().mode is mode
    clock.set_by_s = set_by_s
    clock.passed_s += 0.1
    sample = connected.sample()
    assert sample.mode is mode
    assert abs(sample.stamp_ns - clock.time_ns()) < 1e9 * HOUR_S / 2, "stamps are those of the clock that was set"


@pytest.mark.usefixtures("instrument")
def test_an_old_sample_is_noticed_although_the_clock_was_set_back(clock: Clock) -> None:
    connected = opened(status=STATUS, time={"query": "T?"})
    clock.set_by_s = -HOUR_S
    clock.passed_s += 1.1
    with pytest.raises(MachineError, match=r"clock has stood at 0\.005 s for more than 1 s"):
        connected.sample()


class Controller:
    """A controller of ros2_control whose messages need 1 ms to the machine in this process."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._takers: dict[str, Callable[[Any], None]] = {}
        settings = ControllerLoadFrame(joint_states_topic="joint_states", joint="ram", wrench_topic="wrench")
        self.machine = ControllerMachine(settings, self)  # type: ignore[arg-type]

    def create_subscription(self, _kind: type, topic: str, take: Callable[[Any], None], _qos: Any) -> None:
        self._takers[topic] = take

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        return []

    def publish(self, position: float) -> None:
        joint, wrench = JointState(name=["ram"], position=[position]), WrenchStamped()
        joint.header.stamp = wrench.header.stamp = to_msg(self._clock.time_ns())
        self._clock.passed_s += 0.001
        self._takers["joint_states"](joint)
        self._takers["wrench"](wrench)


@pytest.mark.parametrize("set_by_s", [0, -HOUR_S, HOUR_S])
def test_a_controller_is_read_and_its_end_noticed_on_a_clock_that_is_set(set_by_s: int, clock: Clock) -> None:
    controller = Controller(clock)
    for number in range(10):
        clock.passed_s += 0.05
        controller.publish(number * MM)
    assert controller.machine.sample().mode is LoadMode.MOVING
    clock.set_by_s = set_by_s
    assert controller.machine.sample().mode is LoadMode.MOVING, "the latest message is 0 s old"
    clock.passed_s += 0.05
    controller.publish(10 * MM)
    sample = controller.machine.sample()
    assert (sample.mode, sample.position) == (LoadMode.MOVING, 10 * MM)
    clock.passed_s += 1.1
    with pytest.raises(MachineError, match="no node publishes joint_states"):
        controller.machine.sample()


class Scripted(SimulatedMachine):
    """A machine whose state the test sets."""

    def __init__(self, clock: Clock) -> None:
        self.mode, self.position = LoadMode.IDLE, 0.0
        self.moves = self.holds = 0
        self._clock = clock

    def sample(self) -> Sample:
        self._clock.passed_s += 1e-4
        return Sample(self._clock.time_ns(), self.mode, 0.0, self.position)

    def move_to(self, position: float, speed: float) -> None:  # noqa: ARG002 (the interface of every machine)
        self.moves += 1

    def hold(self) -> None:
        self.holds += 1


class Frame(Peer):
    """A load frame with a scripted machine, sampled while the test waits, and a client that moves it."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.active = True
        self.diagnostics = SimpleNamespace(failure=lambda _message: None)
        self.parameters = SimpleNamespace(value=LoadFrameNodeSettings())
        self.crosshead, self.machine = Crosshead(self), Scripted(clock)
        self.crosshead.open(self.machine)
        self._server = MoveServer(self, self.crosshead)  # type: ignore[arg-type]
        self._client = ActionClient(self, MoveCrosshead, "move_crosshead")

    def until(self, predicate: Callable[[], Any], what: str) -> None:
        def is_true() -> bool:
            self.crosshead.take(self.crosshead.read())
            return bool(predicate())

        self.wait(is_true, what)

    def start(self) -> Any:
        """Start a move by 1 mm."""
        self.until(self._client.server_is_ready, "the action server")
        sending = self._client.send_goal_async(MoveCrosshead.Goal(position=MM, speed=MM))
        self.until(lambda: sending.done() and self.machine.moves, "the move")
        return sending.result()

    def end(self, goal: Any) -> MoveCrosshead.Result:
        ending = goal.get_result_async()
        self.until(ending.done, "the result")
        return ending.result().result


@pytest.fixture
def frame(clock: Clock) -> Iterator[Frame]:
    rclpy.init()
    frame = Frame(clock)
    yield frame
    frame.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize("set_by_s", [-HOUR_S, HOUR_S])
def test_a_move_ends_although_the_clock_was_set(set_by_s: int, frame: Frame, clock: Clock) -> None:
    goal = frame.start()
    clock.set_by_s = set_by_s
    frame.machine.mode, frame.machine.position = LoadMode.HOLD, MM
    result = frame.end(goal)
    assert (result.error_code, result.error_message) == (MoveCrosshead.Result.NONE, "")


def test_a_fault_in_a_move_is_noticed_although_the_clock_was_set_back(frame: Frame, clock: Clock) -> None:
    goal = frame.start()
    frame.machine.mode = LoadMode.MOVING
    clock.set_by_s = -HOUR_S
    frame.machine.mode = LoadMode.FAULT
    result = frame.end(goal)
    assert result.error_code == MoveCrosshead.Result.MACHINE_FAULT
    assert result.error_message == (
        "the machine reports a fault; find its cause, and reset the machine at its own controls; a hold was requested"
    )


def test_standstill_after_a_hold_is_noticed_although_the_clock_was_set_back(frame: Frame, clock: Clock) -> None:
    goal = frame.start()
    frame.machine.mode = LoadMode.MOVING
    goal.cancel_goal_async()
    frame.until(lambda: frame.machine.holds, "the hold")
    clock.set_by_s = -HOUR_S
    frame.machine.mode = LoadMode.HOLD
    result = frame.end(goal)
    assert (result.error_code, result.error_message) == (
        MoveCrosshead.Result.CANCELLED,
        "cancelled; holding at 0.0000 mm",
    )


def test_a_fault_from_before_the_request_does_not_end_a_move(frame: Frame) -> None:
    """The thread that samples may stand still between reading a sample and taking it."""
    before = frame.crosshead.read()._replace(mode=LoadMode.FAULT)
    goal = frame.start()
    frame.crosshead.take(before)
    frame.serve(0.1)
    frame.machine.mode, frame.machine.position = LoadMode.HOLD, MM
    assert frame.end(goal).error_code == MoveCrosshead.Result.NONE
