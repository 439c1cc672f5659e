"""A programme whose nodes end again and again, or that is interrupted again and again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fringedic.configuration.conditions import Reading
from fringedic.configuration.programme import Programme, ProgrammeStep
from fringedic.errors import (
    ConfigurationError,
    MachineError,
    MoveStoppedError,
    NodeDiedError,
    OperatorError,
    RigBusyError,
    StepFailedError,
    WaitTimeoutError,
)
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.procedures import driving
from fringedic_bringup.procedures.continuing import STEPS_DONE, RecordedSteps, steps_done
from fringedic_bringup.procedures.driving import Driven
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import LoadState, StepStatus

FAULT, STOPPED = MoveCrosshead.Result.MACHINE_FAULT, MoveCrosshead.Result.STOPPED_ELSEWHERE
EXPERIMENT = "plate"
MEASURED = 5  # steps of an earlier run


class Progress:
    """Keeps the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def stage(self, text: str) -> None: ...

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None: ...

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None: ...

    def note(self, text: str) -> None:
        self.notes.append(text)


class Rig:
    """Client and processes of a rig; each step ends as planned.

    Parameters
    ----------
    logs
        Folder of the logs.
    plan
        How the steps end, one after the other: by the end of a node, by Ctrl-C, by a step of another controller, by an
        error, by a move that fails or is stopped, by a fault of the machine in a wait ("fault"), or by a result ("").
    presses
        What a person does, one after the other, while the machine is requested to hold.
    """

    def __init__(self, logs: Path, plan: list[str], presses: tuple[BaseException, ...] = ()) -> None:
        entries = (
            NodeEntry("load_frame", "load_frame_node", "load_frame"),
            NodeEntry("dic", "dic_node", "dic"),
            NodeEntry("experiment", "experiment_node", "experiment", {"experiment": EXPERIMENT}),
        )
        self.graph = Graph("rig", entries)
        self.logs, self.plan, self.presses = logs, plan, list(presses)
        self.used: list[int] = []
        self.held = self.cancelled = 0
        self.no_hold = ""
        self.last_step, self.reference, self.recorder = -1, 0, None
        self.reading_of_step = Reading(strain=0.0)
        self.load: LoadState | None = None
        self.stop: MoveStoppedError | None = None  # of the move under way when it is cancelled
        self.ends: list[StepStatus] = []
        self.node = SimpleNamespace(create_publisher=lambda *_: self)
        self.watch = list[Any]()
        self.refusals = self.silences = 0  # of the next requests for a reference, and of waits for readiness
        self.killed: list[str] = []
        self._next, self._dead = MEASURED, dict[str, str]()
        self._code = 0
        self.early = list[tuple[str, int]]()  # nodes that end before the first step, with their exit codes
        self.references_lost = list[bool]()

    # processes

    def check(self, _: object = None) -> None:
        for name in self._dead:
            raise NodeDiedError(name)

    def of_node(self, _: str) -> Rig:
        return self

    def dead(self) -> dict[str, str]:
        return dict(self._dead)

    def exit_code(self, _: str) -> int:
        return self._code

    def log(self, name: str) -> str:
        return f"{name}.log"

    def restart(self, name: str, **changes: Any) -> None:
        del self._dead[name]
        self._next = changes.get("first_step", self._next)

    def kill(self, names: Iterable[str]) -> None:
        self.killed += names
        self._dead |= dict.fromkeys(names, "was ended by SIGKILL")

    # client

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None: ...

    def measure(self, *_: object, **__: object) -> SimpleNamespace:
        number, end = self._next, self.plan.pop(0)
        self.used.append(number)
        self._next += 1
        if end == "Ctrl-C":
            raise KeyboardInterrupt
        if end == "another":
            raise RigBusyError(f"step {number} is being measured")
        if end == "error":
            self.last_step = number
            raise StepFailedError(f"step {number}: the load frame was moving")
        if end:
            self._dead[end] = "was ended by SIGKILL"
            raise NodeDiedError(end)
        self.last_step = number
        displacements = ("rms_displacement", "rms_displacement_px")
        figures = ("force_mean", "position_mean", "force_range", *displacements, "processing_time")
        return SimpleNamespace(step=number, valid_fraction=1.0, **dict.fromkeys(figures, 0.0))

    def move(self, *_: object) -> None:
        if self.plan[0] == "move":
            raise StepFailedError(self.plan.pop(0))
        if self.plan[0] == "held":
            raise MoveStoppedError(self.plan.pop(0), error_code=MoveCrosshead.Result.CANCELLED)
        if self.plan[0] == "stopped":
            raise MoveStoppedError(self.plan.pop(0), error_code=STOPPED)
        if self.plan[0] == "ended":  # the node, in order, with the result of its move
            self._dead["load_frame"] = "has ended"
            raise MoveStoppedError(self.plan.pop(0), error_code=FAULT)

    def measure_while_moving(self, *_: object, **__: object) -> SimpleNamespace:
        self.move()
        return SimpleNamespace(position=1e-3, force=0.0, force_reached=False, error_code=0)

    def highest_step(self, experiment: str) -> int:
        return self.used[-1] if self.used and experiment == EXPERIMENT else -1

    def hold(self, *_: object) -> None:
        if self.presses:
            raise self.presses.pop()
        if self.no_hold:
            raise StepFailedError(self.no_hold)
        self.held += 1

    def cancel(self, *_: object) -> None:
        self.cancelled += 1
        if self.stop is not None:
            raise self.stop

    def sleep(self, *_: object) -> None:
        if self.plan and self.plan[0] == "fault":
            self.plan.pop(0)
            self.load = LoadState(mode=LoadState.FAULT, position=0.2e-3, force=380.0)
        for watch in self.watch:
            watch()

    # publisher of the end of the programme

    def publish(self, message: StepStatus) -> None:
        self.ends.append(message)

    def wait_for_all_acked(self, _: object) -> None: ...

    def set_reference(self, *, previous_lost: bool) -> None:
        self.refusals -= 1
        if self.refusals >= 0:
            raise StepFailedError("step 7 is being measured; set the reference between steps")
        self.references_lost.append(previous_lost)

    def wait_until_ready(self, *_: object) -> None:
        if self.early:
            name, self._code = self.early.pop(0)
            self._dead[name] = "was ended by SIGKILL"
            raise NodeDiedError(name)
        self.silences -= 1
        if self.silences >= 0 and self.held:
            raise WaitTimeoutError("not ready: recorder on dic/status")

    def wait_for_strain(self) -> None: ...

    def wait_for_signals(self, _: object) -> None: ...

    def wait_until_started(self, *_: object) -> None: ...

    def wait_until_recorded(self) -> None: ...


def drive(rig: Rig, monkeypatch: pytest.MonkeyPatch, *, steps: int = 1, progress: Progress | None = None) -> Driven:
    """Drive a programme of some steps more than an earlier run has done."""
    before = RecordedSteps(list(range(MEASURED)), MEASURED - 1, MEASURED, frozenset({""}))
    return drive_steps(rig, monkeypatch, [{}] * (MEASURED + steps), before=before, progress=progress)


def drive_steps(
    rig: Rig,
    monkeypatch: pytest.MonkeyPatch,
    steps: list[dict[str, Any]],
    *,
    before: RecordedSteps | None = None,
    progress: Progress | None = None,
) -> Driven:
    """Drive a programme of these steps."""

    def client(*_: object, watch: Any, **__: object) -> Rig:
        rig.watch.append(watch)
        return rig

    monkeypatch.setattr(driving, "RigClient", client)
    programme = Programme.model_validate({"experiment": EXPERIMENT, "steps": steps})
    return driving.drive(rig, programme, progress or Progress(), before=before)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "ends",
    [("dic", "experiment"), ("experiment", "experiment"), ("experiment", "dic"), ("another", "another", "experiment")],
)
def test_no_number_of_a_step_is_used_twice(
    ends: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, [*ends, ""])
    (report,) = drive(rig, monkeypatch).steps
    assert rig.used == sorted(set(rig.used))
    assert len(rig.used) == len(ends) + 1
    assert report.step == rig.used[-1]


@pytest.mark.parametrize("presses", [(), (KeyboardInterrupt(),) * 3, (OperatorError("stopped"), KeyboardInterrupt())])
def test_an_interrupted_programme_requests_a_hold_however_often_it_is_interrupted(
    presses: tuple[BaseException, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, ["Ctrl-C"], presses)
    driven = drive(rig, monkeypatch)
    assert driven.interrupted
    assert driven.ended_early == "interrupted"
    assert (rig.held, rig.cancelled) == (1, 1)


def test_a_failed_step_is_done_and_an_interrupted_one_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path, ["", "error", "Ctrl-C"])
    driven = drive(rig, monkeypatch, steps=4)
    assert [bool(report.error) for report in driven.steps] == [False, True]
    assert driven.interrupted
    assert steps_done(tmp_path / STEPS_DONE, [], [ProgrammeStep()] * (MEASURED + 4)) == MEASURED + 2
    others = [*[ProgrammeStep()] * (MEASURED + 1), *[ProgrammeStep(position_mm=1.0)] * 3]
    with pytest.raises(ConfigurationError, match=f"the first {MEASURED + 2} steps of the programme are not those"):
        steps_done(tmp_path / STEPS_DONE, [], others)


def test_a_move_that_fails_has_no_number_of_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It had that of the step before, so that a page showed the step as measured."""
    rig = Rig(tmp_path, ["", "move", "", "error"])
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0}] * 4)
    assert [(report.step, report.error) for report in driven.steps] == [
        (MEASURED, ""),
        (-1, "move"),
        (MEASURED + 1, ""),
        (MEASURED + 2, f"step {MEASURED + 2}: the load frame was moving"),
    ]


@pytest.mark.parametrize(("measured", "done"), [(0, 0), (1, 2), (2, 4), (3, 4)])
def test_steps_of_a_run_that_did_not_count_them(measured: int, done: int, tmp_path: Path) -> None:
    moves_only, measures = {"position_mm": 1.0, "mode": "none"}, {"position_mm": 1.0}
    steps = [moves_only, measures, moves_only, measures, moves_only]
    programme = Programme.model_validate({"experiment": EXPERIMENT, "steps": steps})
    numbers = list(range(5, 5 + measured))
    assert steps_done(tmp_path / STEPS_DONE, numbers, programme.load_steps()) == done


@pytest.mark.parametrize(
    ("plan", "lost"), [(["", "dic", ""], True), (["", "experiment", ""], False), (["", ""], False)]
)
def test_the_step_after_a_lost_reference_takes_its_place(
    plan: list[str], lost: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recording then contains that the frames are to be measured against the reference of before."""
    rig = Rig(tmp_path, list(plan))
    driven = drive_steps(rig, monkeypatch, [{}, {}])
    assert rig.references_lost == [True] * lost
    assert driven.measure_again is (len(plan) == 3)


def test_a_node_that_is_killed_before_the_first_step_is_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended the command; a node that ends by itself does so again at the next start."""
    rig, progress = Rig(tmp_path, [""]), Progress()
    rig.early = [("experiment", -9), ("dic", -9)]
    driven = drive_steps(rig, monkeypatch, [{}], progress=progress)
    assert (driven.ended_early, rig.used, driven.measure_again) == ("", [MEASURED], False)
    assert rig.held == rig.cancelled == 0, "nothing has begun that could be interrupted"
    assert "experiment was ended by SIGKILL (see experiment.log); it is started again" in progress.notes
    rig = Rig(tmp_path, [""])
    rig.early = [("dic", 1)]
    with pytest.raises(NodeDiedError):
        drive_steps(rig, monkeypatch, [{}])


def test_a_node_that_dies_again_and_again_ends_the_programme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was started again without end."""
    rig = Rig(tmp_path, ["dic"] * 9)
    driven = drive(rig, monkeypatch)
    assert driven.ended_early == "dic"
    assert len(rig.used) == driving.MOST_DEATHS + 1
    assert rig.held > driving.MOST_DEATHS


@pytest.mark.parametrize(
    ("source", "ended"), [("files", "the camera ended (see camera.log) and would"), ("virtual", "")]
)
def test_a_camera_that_would_begin_again_with_its_images_ends_the_programme(
    source: str, ended: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The steps succeeded with the images of other steps."""
    rig = Rig(tmp_path, ["", "camera", ""])
    parameters = {"source": source} | ({"files": "images"} if source == "files" else {})
    rig.graph = Graph("rig", (*rig.graph.nodes, NodeEntry("camera", "camera_node", "camera", parameters)))
    driven = drive(rig, monkeypatch, steps=2)
    assert driven.ended_early.startswith(ended)
    assert bool(driven.ended_early) is (source == "files")
    assert len(driven.steps) == 2 - bool(ended)
    assert rig.held


def test_a_hold_that_was_not_accepted_is_not_said_to_be_requested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, progress = Rig(tmp_path, ["Ctrl-C"]), Progress()
    rig.no_hold = "there is no service load_frame/hold: stop the machine by hand"
    assert drive(rig, monkeypatch, progress=progress).interrupted
    [note] = [note for note in progress.notes if note.startswith("interrupted")]
    assert "no hold was accepted: there is no service load_frame/hold: stop the machine by hand" in note


def test_a_reference_that_is_refused_during_a_step_of_another_controller_is_set_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, ["dic", ""])
    rig.refusals = 3
    driven = drive(rig, monkeypatch)
    assert (driven.ended_early, rig.refusals) == ("", -1)
    assert len(driven.steps) == 1


def test_a_node_that_started_and_did_not_become_ready_is_started_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, ["dic", ""])
    rig.silences = 2  # one before the first step
    driven = drive(rig, monkeypatch)
    assert (driven.ended_early, rig.killed) == ("", ["dic"])
    assert len(driven.steps) == 1


@pytest.mark.parametrize(
    ("plan", "is_lost"),
    [
        (["", "dic"], True),
        (["", "extensometer"], True),
        (["", "load_frame", ""], False),
        (["dic", "", ""], False),
        (["error", ""], False),
    ],
)
def test_a_programme_does_not_go_on_when_the_zero_of_its_strain_is_lost(
    plan: list[str], is_lost: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The move until 2 % ended 2 % beyond the strain at the death; before the first step nothing is lost."""
    rig = Rig(tmp_path, plan)
    entries = (*rig.graph.nodes, NodeEntry("extensometer", "dic_node", "extensometer"))
    rig.graph = Graph("rig", entries)
    steps = [{}, {"position_mm": 1.0, "until": {"strain_above_percent": 2}}]
    ended = SimpleNamespace(position=0.0, force=0.0, force_reached=False, error_code=0)
    monkeypatch.setattr(rig, "move", lambda *_, **__: ended)
    driven = drive_steps(rig, monkeypatch, steps)
    assert ("the strain would count from the present load" in driven.ended_early) is is_lost
    if is_lost:
        assert rig.held >= 2
    else:
        assert (driven.ended_early, len(driven.steps)) == ("", 2)


@pytest.mark.parametrize(
    ("plan", "measured", "code"),
    [
        (["", "held"], 1, MoveCrosshead.Result.CANCELLED),
        (["", "stopped"], 1, STOPPED),
        (["error", "held"], 1, MoveCrosshead.Result.CANCELLED),
        (["dic", "stopped"], 0, STOPPED),
    ],
)
def test_a_move_that_something_else_stops_ends_the_programme(
    plan: list[str], measured: int, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine went on to the next position, also after a failed step or a restart, whose own hold was blamed."""
    rig = Rig(tmp_path, list(plan))
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0}] * 3)
    assert (driven.ended_early, len(driven.steps)) == (plan[-1], measured)
    assert rig.held
    [end] = rig.ends
    assert (end.experiment, end.stage, end.error_code) == (EXPERIMENT, StepStatus.ERROR, code)
    assert end.error_message == driven.ended_early


@pytest.mark.parametrize("mode", ["fringes", "moving"])
def test_a_load_frame_node_that_ends_in_a_move_is_no_stop(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, ["ended", ""])
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0, "mode": mode}])
    assert driven.ended_early == ""
    assert rig.ends[-1].stage == StepStatus.END


@pytest.mark.parametrize("mode", ["fringes", "moving"])
def test_a_move_that_is_refused_is_a_failed_step(mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path, ["move", ""])
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0, "mode": mode}, {}])
    assert (driven.ended_early, [each.error for each in driven.steps]) == ("", ["move", ""])


def test_a_stop_while_a_node_is_started_again_ends_the_programme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path, ["dic", ""])
    rig.stop = MoveStoppedError("stopped at the machine", error_code=STOPPED)
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0}])
    assert (driven.ended_early, driven.steps, rig.plan) == ("stopped at the machine", [], [""])


def test_a_fault_in_a_wait_ends_the_programme_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The programme waited to the end and moved on; after a reset nobody knew of the fault."""
    rig = Rig(tmp_path, ["fault", "", ""])
    driven = drive_steps(rig, monkeypatch, [{"hold_s": 1.0}] * 3)
    assert driven.ended_early.startswith("the machine reports a fault at 0.2000 mm, 380.0 N; find its cause, reset")
    assert (len(driven.steps), rig.held, rig.plan) == (0, 1, ["", ""])
    assert rig.ends[-1].error_code == FAULT


def test_a_fault_after_ctrl_c_does_not_interrupt_the_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path, ["Ctrl-C"], (MachineError("the machine reports a fault"),))
    driven = drive(rig, monkeypatch)
    assert (driven.interrupted, rig.held, rig.cancelled) == (True, 1, 1)


def test_a_failed_move_without_measurement_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path, ["move", ""])
    driven = drive_steps(rig, monkeypatch, [{"position_mm": 1.0, "mode": "none"}, {}])
    assert [(report.step, report.error) for report in driven.steps] == [(-1, "move"), (MEASURED, "")]
