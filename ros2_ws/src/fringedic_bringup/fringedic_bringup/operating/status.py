"""State of the procedure that an operator has started: what the page shows, and what the operator wants."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

from fringedic.command.outcome import StepReport
from fringedic.errors import OperatorError
from fringedic_bringup.procedures.outcome import RunControl

NOTES = 200  # lines that are kept


class State(IntEnum):
    """States of ``fringedic_msgs/ProcedureStatus``."""

    IDLE = 0
    RUNNING = 1
    PAUSING = 2
    PAUSED = 3
    STOPPING = 4
    DONE = 5
    FAILED = 6


@dataclass(frozen=True)
class Outcome:
    """Result of a procedure: sentences, lines for the rig file, the picture in its folder, and whether it is good.

    Attributes
    ----------
    measured_with
        Lines of the rig file that the result is about, such as the calibration that was checked.
    """

    words: Sequence[str] = ()
    settings: str = ""
    picture: str = ""
    good: bool = True
    measured_with: str = ""


STOPPED = Outcome(["stopped by the operator"], good=False)


@dataclass(frozen=True)
class Status:
    """What the page shows of a procedure; fields as of ``fringedic_msgs/ProcedureStatus``, times in [s]."""

    procedure: str = ""
    state: State = State.IDLE
    started: float = 0.0
    activity: str = ""
    step: int = -1
    steps: int = 0
    frame: int = 0
    frames: int = 0
    question: str = ""
    pattern: str = ""
    folder: str = ""
    notes: tuple[str, ...] = ()
    outcome: Outcome = field(default_factory=Outcome)
    error: str = ""
    reports: tuple[StepReport, ...] = ()


class StoppedError(OperatorError):
    """The operator has stopped the procedure."""


class Job(RunControl):
    """One procedure: receives its progress, and passes the operator's wishes on to it.

    The procedure runs in a thread of its own.

    Parameters
    ----------
    name, pattern
        Of the procedure, and of a live view.
    changed
        Called after each change, from any thread.
    """

    def __init__(self, name: str, pattern: str, changed: Callable[[], None]) -> None:
        self._lock = threading.Condition()
        self._changed = changed
        self._status = Status(procedure=name, pattern=pattern, state=State.RUNNING, started=time.time())
        self._answer: bool | None = None
        self._stopping = False
        self.controlled = False  # a programme ends in order by `check`, others by an error from their progress
        self.holds_without_driver = False
        self.figures: tuple[str, ...] = ()  # of the latest image of a live view, in sentences

    @property
    def is_live(self) -> bool:
        """Whether it is the live view, which ends for every other procedure."""
        return self._status.procedure == "live"

    @property
    def status(self) -> Status:
        """The present state."""
        return self._status

    def _change(self, **changes: object) -> None:
        with self._lock:
            self._status = replace(self._status, **changes)  # type: ignore[arg-type]
            self._lock.notify_all()
        self._changed()

    # wishes of the operator

    def pause(self) -> None:
        """Pause after the present step.

        Raises
        ------
        OperatorError
            The procedure has no steps between which it could pause.
        """
        if not self.controlled or self._status.state != State.RUNNING:
            raise OperatorError(f"{self._status.procedure} cannot pause: only a running programme can")
        self._change(state=State.PAUSING)

    def resume(self) -> None:
        """Continue after a pause.

        Raises
        ------
        OperatorError
            It is not paused.
        """
        if self._status.state not in (State.PAUSING, State.PAUSED):
            raise OperatorError(f"{self._status.procedure} is not paused")
        self._change(state=State.RUNNING)

    def stop(self) -> None:
        """End the procedure as soon as possible; one that has ended keeps its result."""
        with self._lock:
            if self._status.state in (State.DONE, State.FAILED):
                return
            self._stopping = True
            self._change(state=State.STOPPING, question="")

    def answer(self, confirmed: bool) -> None:
        """Answer the question of the procedure.

        Raises
        ------
        OperatorError
            It has none.
        """
        if not self._status.question:
            raise OperatorError("there is no question to answer")
        self._answer = confirmed
        self._change(question="")

    @property
    def is_stopping(self) -> bool:
        """Whether the operator has stopped it."""
        return self._stopping

    def note_pause(self, text: str) -> None:
        """Pause because of an event, unless it pauses already."""
        if self.controlled and self._status.state == State.RUNNING:
            self.note(text)
            self._change(state=State.PAUSING)

    # progress of the procedure, as of `Progress`

    def stage(self, text: str) -> None:
        """Take a text about what is being done now."""
        self.raise_when_stopped()
        self._change(activity=text, step=-1, steps=0, frame=0, frames=0)

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Take the progress of a load step."""
        self.raise_when_stopped()
        self._change(activity=text, step=number, steps=last + 1, frame=frame, frames=frames)

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Take the progress of a part."""
        self.step(number - 1, parts - 1, text, frame, frames)

    def note(self, text: str) -> None:
        """Take a line for the operator."""
        self._change(notes=(*self._status.notes, text)[-NOTES:])

    def ask(self, words: str) -> bool:
        """Ask the operator, and wait for the answer; False when the operator stops."""
        self._answer = None
        self._change(question=words)
        with self._lock:
            self._lock.wait_for(lambda: self._answer is not None or self._stopping)
        return bool(self._answer) and not self._stopping

    def writes_into(self, folder: str) -> None:
        """Take the folder of the files."""
        self._change(folder=folder)

    def ended(self, outcome: Outcome) -> None:
        """Take the result."""
        self._change(state=State.DONE if outcome.good else State.FAILED, outcome=outcome, activity="", question="")

    def failed(self, error: str) -> None:
        """Take the reason why there is no result."""
        self._change(state=State.FAILED, error=error, activity="", question="")

    def raise_when_stopped(self) -> None:
        """End a procedure other than a programme by an error, when the operator has stopped it.

        Raises
        ------
        StoppedError
            It is stopped.
        """
        if self._stopping and not self.controlled:
            raise StoppedError("stopped by the operator")

    # control of a programme, as of `RunControl`

    def check(self) -> None:
        """End a programme by an error once, when the operator has stopped it; its results are written then."""
        if self._stopping and self.controlled:
            self._stopping = False
            raise StoppedError("stopped by the operator")

    def may_begin(self) -> bool:
        """Return whether the next step may begin."""
        if self._status.state == State.PAUSING:
            self._change(state=State.PAUSED)
        return self._status.state != State.PAUSED

    def measured(self, report: StepReport) -> None:
        """Take the outcome of a step."""
        self._change(reports=(*self._status.reports, report))
