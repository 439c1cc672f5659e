"""The state of a procedure between its thread and the operator."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from fringedic.command.outcome import RunReport, StepReport
from fringedic.errors import FringedicError, NodeDiedError, OperatorError, RecordingError
from fringedic_bringup.operating import procedures
from fringedic_bringup.operating.procedures import PROCEDURES, Place, Request, execute, requested
from fringedic_bringup.operating.status import Job, Outcome, State, StoppedError

PROGRAMME = "{experiment: plate, steps: [{}]}"


def job(name: str = "run", *, controlled: bool = True) -> Job:
    made = Job(name, "", lambda: None)
    made.controlled = controlled
    return made


def test_programme_pauses_after_the_step_and_continues() -> None:
    run = job()
    assert run.may_begin()
    run.pause()
    assert run.status.state == State.PAUSING, "the present step is finished"
    assert not run.may_begin()
    assert run.status.state == State.PAUSED
    run.resume()
    assert run.may_begin()
    with pytest.raises(OperatorError, match="run is not paused"):
        run.resume()


def test_stop_ends_a_programme_once_so_that_its_results_are_written() -> None:
    run = job()
    run.stop()
    with pytest.raises(StoppedError):
        run.check()
    run.check()
    run.stage("writing the dataset")


def test_stop_ends_another_procedure_at_its_next_progress() -> None:
    timing = job("timing", controlled=False)
    timing.part(1, 3, "dark")
    assert (timing.status.step, timing.status.steps) == (0, 3)
    with pytest.raises(OperatorError, match="timing cannot pause"):
        timing.pause()
    timing.stop()
    with pytest.raises(StoppedError):
        timing.part(2, 3, "white")


@pytest.mark.parametrize("good", [True, False])
def test_stop_after_the_end_leaves_the_result(good: bool) -> None:
    """Its thread has ended, and the server has not taken the result yet: the page would show "stopping" for ever."""
    ended = job("check", controlled=False)
    ended.ended(Outcome(["checked"], good=good))
    ended.stop()
    assert ended.status.state == (State.DONE if good else State.FAILED)


@pytest.mark.parametrize(("answer", "expected"), [(True, True), (False, False), (None, False)])
def test_question_waits_for_the_operator(answer: bool | None, expected: bool) -> None:
    calibrate, answers = job("calibrate", controlled=False), list[bool]()
    asking = threading.Thread(target=lambda: answers.append(calibrate.ask("Lay the grid on the plane")))
    asking.start()
    end = time.monotonic() + 180
    while not calibrate.status.question:
        assert time.monotonic() < end
        time.sleep(0.01)
    if answer is None:
        calibrate.stop()
    else:
        calibrate.answer(answer)
    asking.join(10)
    assert answers == [expected]
    assert not calibrate.status.question
    with pytest.raises(OperatorError, match="no question"):
        calibrate.answer(True)


def test_pause_without_a_driver_is_noted_once() -> None:
    run = job()
    run.note_pause("the page is closed")
    run.note_pause("the page is closed")
    assert run.status.notes == ("the page is closed",)
    assert not run.may_begin()


def test_reports_and_notes_are_kept() -> None:
    run = job()
    run.measured(StepReport(0))
    run.measured(StepReport(1, error="no light"))
    for number in range(300):
        run.note(str(number))
    assert [report.step for report in run.status.reports] == [0, 1]
    assert run.status.notes[-1] == "299"
    assert len(run.status.notes) == 200


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (requested("run", text="ramp: ["), "line 1"),
        (requested("run", text="{steps: [{position_mm: far}]}"), "programme: steps.0"),
        (Request("region", text="no region"), "region"),
        (Request("settings", text="camera: 5"), "camera"),
        (requested("timing"), "no such"),
        (requested("calibrate", options="{angles_deg: far}"), "angles far"),
        (requested("live", options="{region: all}"), "region all"),
        (
            requested("run", text=PROGRAMME, options="{continue_run: ../other}"),
            "continue_run: ../other is no name of a folder",
        ),
        (
            requested("run", text=PROGRAMME, options="{continue_run: plate-7}"),
            "plate-7 contains no recording to continue",
        ),
    ],
)
def test_whatever_is_wrong_is_a_failure_with_a_reason(tmp_path: Path, request_: Request, words: str) -> None:
    rig = tmp_path / "rig.yaml"
    if request_.procedure != "timing":
        rig.write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    failing = job(request_.procedure, controlled=False)
    execute(Place(rig), failing, request_)
    assert failing.status.state == State.FAILED
    assert words.lower() in failing.status.error.lower()
    assert len(failing.status.error) <= 500


def test_options_are_those_of_the_command() -> None:
    """Names, types, limits and defaults come from the declaration of the command."""
    assert requested("timing", options="{exposure_ms: 2}").options.model_dump() == {
        "exposure_ms": 2.0,
        "longest_ms": 300.0,
    }
    assert requested("check", options='{"vdi": true}').options.model_dump() == {"distance_mm": 5.0, "vdi": True}
    assert requested("advise").options.model_dump()["strain_window_points"] == 5
    assert all(procedure.options(name)() for name, procedure in PROCEDURES.items())


@pytest.mark.parametrize(
    ("procedure", "options", "words"),
    [
        ("noise", "{steps: 0}", "noise: steps: Input should be greater than or equal to 3 (it is 0)"),
        ("timing", "{exposure_ms: 0.01}", "timing: exposure_ms: Input should be greater than or equal to 0.05"),
        ("noise", "{step: 5}", "noise: step: unknown key; known are steps"),
        ("check", "{distance_mm: .nan}", "check: distance_mm: Input should be a finite number"),
        ("timing", "[3]", "timing: the options are no mapping; write them as {exposure_ms: 3.0}"),
        ("timing", "{exposure_ms: [", "timing: the options are not YAML"),
        ("response", "{steps: 3}", "response: steps: unknown key"),
        ("format", "", "format: there is no such procedure; use live, timing,"),
    ],
)
def test_wrong_options_are_refused_before_anything_starts(procedure: str, options: str, words: str) -> None:
    with pytest.raises(FringedicError) as refused:
        requested(procedure, options=options)
    assert str(refused.value).startswith(words)
    assert len(str(refused.value)) <= 500


def test_a_run_that_ended_early_is_continued_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop of the machine ends it; the page could only begin a new run."""
    (tmp_path / "rig.yaml").write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    report = RunReport("plate", tmp_path, [], [], ended_early="the machine reports a fault")
    run = MagicMock(return_value=report)
    monkeypatch.setattr(procedures, "run_experiment", run)
    running = job()
    execute(Place(tmp_path / "rig.yaml"), running, requested("run", text=PROGRAMME))
    assert running.status.state == State.FAILED
    assert running.status.outcome.words[1] == "ended early: the machine reports a fault"
    assert run.call_args.kwargs["resume"] is False
    folder, continued = Path(running.status.folder), job()
    execute(
        Place(tmp_path / "rig.yaml"),
        continued,
        requested("run", text=PROGRAMME, options=f"{{continue_run: {folder.name}}}"),
    )
    assert run.call_args.kwargs["resume"] is True
    assert run.call_args.args[3] == folder == Path(continued.status.folder)


@pytest.mark.parametrize(("died", "told"), [("load_frame", True), ("dic", False)])
def test_a_session_by_hand_whose_node_ends_has_its_results(
    died: str, told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.yaml").write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    nodes, client = MagicMock(), MagicMock()
    nodes.__enter__.return_value.dead.return_value = {died: "was ended by SIGKILL"}
    client.__enter__.return_value.sleep.side_effect = NodeDiedError(f"{died} was ended by SIGKILL.")
    written = MagicMock(return_value=RunReport("by_hand", tmp_path, [], []))
    monkeypatch.setattr(procedures, "RunningGraph", lambda *_, **__: nodes)
    monkeypatch.setattr(procedures, "ExposingClient", lambda *_, **__: client)
    monkeypatch.setattr(procedures, "write_results", written)
    for broken in (None, RecordingError("the recording has no image")):
        written.side_effect = broken
        by_hand = job("by_hand")
        execute(Place(tmp_path / "rig.yaml"), by_hand, requested("by_hand"))
        assert by_hand.status.state == State.FAILED
        *problems, result = by_hand.status.outcome.words
        assert f"{died} was ended by SIGKILL." in problems
        assert any("no hold could be requested" in each for each in problems) is told
        assert result.startswith("dataset and report in by_hand" if broken is None else "no dataset: the recording")
    assert written.call_count == 2
