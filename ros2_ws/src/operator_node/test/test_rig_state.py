"""What the page shows of the messages of a rig."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log

from fringedic.signals import SignalCollector
from fringedic_msgs.msg import (
    LoadState,
    ProcedureStatus,
    RecorderStatus,
    SetupItem,
    SetupState,
    Signal,
    StepReport,
    StepStatus,
)
from operator_node.rig_state import RigState


class Clock:
    """A time that a test sets [s]."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def state(clock: Clock) -> RigState:
    return RigState(clock)


def after(state: RigState, clock: Clock, passed: float, /, **fields: int) -> float | None:
    """Return the remaining time that is shown after a message that arrives so many seconds later."""
    clock.now += passed
    fields = {"state": ProcedureStatus.RUNNING, **fields}
    state.take_procedure(ProcedureStatus(procedure="noise", **fields), "procedure")
    remaining: float | None = state.snapshot({})["procedure"]["remaining_s"]
    return remaining


def test_remaining_time_follows_the_steps_that_are_done(state: RigState, clock: Clock) -> None:
    assert after(state, clock, 0, step=-1, steps=0) is None, "the nodes are started"
    assert after(state, clock, 20, step=0, steps=10) is None, "no step is done"
    assert after(state, clock, 4, step=0, steps=10, frame=8, frames=12) is None
    assert after(state, clock, 2, step=1, steps=10) == 9 * 6
    assert after(state, clock, 10, step=2, steps=10) == 8 * 8
    assert after(state, clock, 1, step=-1, steps=0) is None, "the results are computed"


def test_remaining_time_of_a_single_part_follows_its_frames(state: RigState, clock: Clock) -> None:
    assert after(state, clock, 0, step=0, steps=1, frame=1, frames=60) is None
    assert after(state, clock, 3, step=0, steps=1, frame=11, frames=60) == pytest.approx(0.3 * 49, abs=0.5)


def test_another_series_of_parts_begins_anew(state: RigState, clock: Clock) -> None:
    after(state, clock, 0, step=0, steps=3)
    after(state, clock, 9, step=2, steps=3)
    assert after(state, clock, 1, step=0, steps=7) is None
    assert after(state, clock, 2, step=1, steps=7) == 12


def test_a_pause_does_not_count(state: RigState, clock: Clock) -> None:
    after(state, clock, 0, step=0, steps=4)
    assert after(state, clock, 5, step=1, steps=4) == 15
    after(state, clock, 0, step=1, steps=4, state=ProcedureStatus.PAUSED)
    assert after(state, clock, 1000, step=1, steps=4) == 15
    assert after(state, clock, 5, step=2, steps=4) == 10


def test_what_has_ended_has_no_remaining_time(state: RigState, clock: Clock) -> None:
    after(state, clock, 0, step=0, steps=4)
    after(state, clock, 5, step=1, steps=4)
    assert after(state, clock, 5, step=3, steps=4, state=ProcedureStatus.FAILED) is None
    assert after(state, clock, 5, step=2, steps=4) is None, "the next one"


def test_minutes_until_the_disk_is_full(
    state: RigState, clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=60 * 10**9)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    def minutes(written: int) -> int | None:
        state.take_recorder(RecorderStatus(state=RecorderStatus.RECORDING, path=str(tmp_path), bytes=written))
        found: int | None = state.snapshot({})["recorder"]["minutes_left"]
        return found

    assert minutes(0) is None, "the rate is not known yet"
    clock.now += 10
    assert minutes(10**9) == 10, "at 100 MB/s"
    clock.now += 10
    assert minutes(4 * 10**9) == 5, "at 200 MB/s"


def test_an_item_shows_the_report_in_its_folder(state: RigState, tmp_path: Path) -> None:
    (tmp_path / "check.html").write_text("plane and gauge block")
    items = [SetupItem(item="check", folder=str(tmp_path)), SetupItem(item="region", folder=str(tmp_path / "none"))]
    state.take_setup(SetupState(items=items))
    assert [each["report"] for each in state.snapshot({})["setup"]] == ["/files/check/check.html", ""]


@pytest.mark.parametrize(
    ("sample", "mode"),
    [
        (LoadState(mode=LoadState.HOLD), "hold"),
        (LoadState(mode=LoadState.UNKNOWN, reason="its status is 'Hold'"), "unknown (its status is 'Hold')"),
        (LoadState(mode=7), "mode 7"),
    ],
)
def test_the_mode_of_the_machine_has_its_reason(sample: LoadState, mode: str, state: RigState) -> None:
    """A mode that the message does not have ended the node."""
    state.take_load(sample)
    assert state.snapshot({})["load"]["mode"] == mode


def test_a_step_has_the_values_of_all_signals_at_its_end_and_then_those_of_its_report(state: RigState) -> None:
    collector = SignalCollector(longest=1)
    collector.add("load_frame/state", LoadState(force=12.34567, position=1e-3))
    grip = Signal(name="grip", quantity="temperature", unit="K", source="logger")
    grip.stamps, grip.values, grip.sigmas = [Time()], [295.0], [0.5]
    collector.add("signals", grip)
    state.take_signals(collector.latest)
    found = state.snapshot({})["signals"]
    assert [(each["name"], each["unit"], each["source"], each["value"] / each["factor"]) for each in found] == [
        ("force", "N", "load_frame", 12.35),
        ("position", "mm", "load_frame", 1.0),
        ("grip", "K", "logger", 295.0),
    ]
    state.take_step(StepStatus(experiment="plate", step=3, stage=StepStatus.END))
    (step,) = state.snapshot({})["steps"]
    assert step["signals"] == {"force": 12.35, "position": 1e-3, "grip": 295.0}
    report = StepReport(step=3, force=12.0, position=2e-3)
    state.take_procedure(ProcedureStatus(procedure="run", reports=[report]), "procedure")
    (step,) = state.snapshot({})["steps"]
    assert step["signals"] == {"force": 12.0, "position": 2e-3, "grip": 295.0}


def test_without_further_frames_no_remaining_time_is_promised(state: RigState, clock: Clock) -> None:
    """It was 0 s for half a minute, while the results were computed."""
    after(state, clock, 0, step=0, steps=1, frame=1, frames=60)
    assert after(state, clock, 3, step=0, steps=1, frame=60, frames=60) is None


def test_machine_and_recorder_of_nodes_that_are_gone_are_not_shown(
    state: RigState, clock: Clock, tmp_path: Path
) -> None:
    state.take_load(LoadState(mode=LoadState.HOLD))
    collector = SignalCollector(longest=1)
    collector.add("load_frame/state", LoadState(force=5.0))
    state.take_signals(collector.latest)
    state.take_recorder(RecorderStatus(state=RecorderStatus.RECORDING, path=str(tmp_path)))
    clock.now += 4
    state.take_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name="/rig/recorder", level=b"\0")]))
    clock.now += 4
    found = state.snapshot({})
    assert (found["load"], found["recorder"]["state"]) == (None, "recording"), "the recorder gives signs of life"
    assert [(each["name"], each["value"]) for each in found["signals"]] == [("force", None), ("position", None)]
    clock.now += 4
    assert state.snapshot({})["recorder"] is None


def test_texts_and_names_without_limit_do_not_fill_the_page(state: RigState, clock: Clock) -> None:
    hostile = "<script>alert(1)</script>\x1b[2J" + 1_000_000 * "x"
    state.take_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name="/rig/camera", level=b"\0")]))
    for first in range(0, 30_000, 10_000):
        names = [f"{hostile if number < 3 else ''}{number}" for number in range(first, first + 10_000)]
        state.take_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name=name, message="m") for name in names]))
    for _ in range(300):
        state.take_log(Log(msg=hostile))
    state.take_load(LoadState(reason=hostile))
    state.take_step(StepStatus(stage=StepStatus.ERROR, error_message=hostile))
    found = state.snapshot({})
    assert [len(found["nodes"]), len(found["log"])] == [201, 200]
    assert (found["nodes"][0]["name"], found["nodes"][-1]["name"]) == ("/rig/camera", "other diagnostics")
    assert len(json.dumps(found)) < 600_000
    assert found["load"]["mode"].endswith("x... (1000029 characters))")
    clock.now += 6
    state.take_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name="/rig/phase", level=b"\0")]))
    assert [each["name"] for each in state.snapshot({})["nodes"]] == ["/rig/phase"]
