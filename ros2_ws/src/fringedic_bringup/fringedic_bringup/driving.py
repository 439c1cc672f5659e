"""Drives a programme: moves, holds and measures step by step, as the controller of a load frame would.

A node that ends on the way does not end the test: the machine is asked to hold, the node is started again, and the
step is done once more.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.errors import NodeDiedError, NotAnsweredError, StepFailedError
from fringedic.programme import Programme, ProgrammeStep, Reading
from fringedic_bringup.client import RigClient
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.report import Progress, StepReport
from fringedic_msgs.action import MeasureStep

MOST_DEATHS = 3  # of one node in one run; one that dies more often has a reason that a new start does not remove
FORGETFUL = ("dic", "coupling")  # keep the reference step in memory
INTERRUPTION_S = 5.0  # for the answer of what was interrupted


class Driven(NamedTuple):
    """What a programme has left behind.

    Attributes
    ----------
    steps
        Of those that were measured, or should have been.
    measure_again
        Step against which all are to be measured again from the recording, because a node that ended took the
        reference with it; None when nothing has to be.
    """

    steps: list[StepReport]
    measure_again: int | None


def drive(running: RunningGraph, programme: Programme, progress: Progress, *, domain: int | None = None) -> Driven:
    """Move, hold and measure, step by step; a step that fails is reported and the next one follows.

    Parameters
    ----------
    running
        The nodes of the rig; one that ends is started again.
    programme
        The load steps.
    progress
        Told what goes on.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    NodeDiedError
        A node ended before all were ready, or again and again.
    NotAnsweredError
        The nodes did not get ready, or nobody publishes the strain that a condition needs.
    """
    with RigClient(running.graph.namespace, domain=domain, watch=running.check, name="programme") as rig:
        rig.wait_until_ready(running.graph.names)
        if any(until.needs_strain for until in programme.conditions()):
            rig.wait_for_strain()
        driver = _Driver(running, rig, progress, len(programme.load_steps()))
        walk = programme.walk(progress.note)
        reading: Reading | None = None
        with suppress(StopIteration):
            while True:
                reading = driver.do(walk.send(reading))
        driver.finish()
    first = next((report.step for report in driver.reports if not report.error), None)
    own = any(step.set_reference for step in programme.load_steps())
    return Driven(driver.reports, first if driver.reference_was_lost and not own else None)


class _Driver:
    """Does one step after the other.

    Attributes
    ----------
    reports
        Of the steps that are measured.
    reference_was_lost
        A node that ended took the reference with it.
    """

    def __init__(self, running: RunningGraph, rig: RigClient, progress: Progress, steps: int) -> None:
        self.reports: list[StepReport] = []
        self._running, self._rig, self._progress = running, rig, progress
        self._number, self._steps = 0, steps
        self.reference_was_lost = False
        self._revived = False  # since the last step that succeeded
        self._reference = -1
        self._deaths: Counter[str] = Counter()

    def do(self, step: ProgrammeStep) -> Reading | None:
        """Do a step, and once more when a node ends meanwhile; return what conditions are asked about."""
        self._number += 1
        return self._outlive(lambda: self._move_and_measure(step))

    def finish(self) -> None:
        """Wait until everything is recorded."""
        self._outlive(self._rig.wait_until_recorded)
        if self._rig.recorder is not None and self._rig.recorder.error_message:
            self._progress.note(f"recorder: {self._rig.recorder.error_message}")

    def _move_and_measure(self, step: ProgrammeStep) -> Reading | None:
        moved = ""
        try:
            if step.position is not None and "load_frame" in self._running.graph.names:
                moved = self._move(step)
            if step.hold_s:
                self._tell("hold")
                self._rig.sleep(step.hold_s)
            if step.mode == "none":
                return self._rig.reading
            result = self._rig.measure(step.mode, set_reference=step.set_reference, feedback=self._show)
        except StepFailedError as error:
            self._running.check()  # a node that has ended is the reason, and the step will be done once more
            self._progress.note(str(error))
            if self._revived:
                # nodes that were started again may not have found each other yet, which nobody else can see
                self._revived = False
                self._progress.note(f"step {self._number} is done once more")
                return self._move_and_measure(step)
            if step.mode != "none":
                number = max([self._rig.last_step, *(report.step for report in self.reports)], default=0)
                self.reports.append(StepReport(max(number, 0), error=str(error)))
            return None
        self._revived = False
        if moved:
            self._progress.note(moved)
        if self._reference < 0 or step.set_reference:
            self._reference = result.step
        self.reports.append(_report(step, result))
        return Reading(result.force_mean, self._rig.strain_of_step, result.valid_fraction)

    def _move(self, step: ProgrammeStep) -> str:
        """Move, and return why the move ended before its position; empty when it did not."""
        position, until = step.position, step.until
        assert position is not None, "asked by the caller"
        if until is None:
            self._tell(f"move to {position * 1e3:.3f} mm")
            self._rig.move(position, step.speed)
            return ""
        self._tell(f"move towards {position * 1e3:.3f} mm")
        words = ""

        def met(reading: Reading) -> bool:
            nonlocal words
            words = words or until.met(reading)
            return bool(words)

        ended = self._rig.move(position, step.speed, until=met)
        where = f"step {self._number}: move ended at {ended.position * 1e3:.4f} mm, {ended.force:.1f} N"
        return f"{where}: {words or 'no condition was met before its position'}"

    def _tell(self, text: str) -> None:
        self._progress.step(self._number, self._steps, text)

    def _show(self, feedback: MeasureStep.Feedback) -> None:
        self._progress.step(self._number, self._steps, feedback.stage, feedback.frame, feedback.frames)

    # nodes that end

    def _outlive(self, work: Callable[[], Any]) -> Any:
        """Do something, and once more after nodes that ended meanwhile have been started again."""
        while True:
            try:
                return work()
            except NodeDiedError as death:
                self._revive(death)

    def _revive(self, death: NodeDiedError) -> None:
        while True:
            try:
                forgotten = self._start_again(death)
                self._rig.wait_until_ready(self._running.graph.names)
                self._revived = True
                if forgotten and self._reference >= 0:
                    self._rig.set_reference()
                    self.reference_was_lost = True
                    self._progress.note(
                        f"{' and '.join(forgotten)} lost the reference: until the end of the programme displacements "
                        f"count from the next step; the dataset is measured against step {self._reference} again"
                    )
                return
            except NodeDiedError as another:
                death = another

    def _start_again(self, death: NodeDiedError) -> list[str]:
        """Start again what has ended; the machine holds meanwhile. Return which of them have lost the reference."""
        dead = self._running.dead()
        self._deaths.update(dead.keys())
        if any(self._deaths[name] > MOST_DEATHS for name in dead):
            raise death
        since = time.time_ns()
        for name, how in dead.items():
            self._running.restart(name, **self._changes(name))
            self._progress.note(
                f"{name} {how} (see {self._running.log(name)}); it is started again, and step {self._number} is done "
                "once more"
            )
        for request in (self._rig.hold, self._rig.cancel):
            # whoever should answer may be the one that is gone
            with suppress(StepFailedError, NotAnsweredError):
                request(INTERRUPTION_S)
        self._rig.wait_until_started(dead, since)
        return [name for name in dead if name in FORGETFUL]

    def _changes(self, name: str) -> dict[str, Any]:
        """Parameters with which a node goes on where its predecessor ended."""
        entry = next(each for each in self._running.graph.nodes if each.name == name)
        if name == "recorder" and entry.parameters["bag_path"]:
            return {"bag_path": str(next_part(Path(entry.parameters["bag_path"])))}
        if name == "experiment":  # the step that was cut off has a number already
            return {"first_step": self._rig.last_step + 2, "reference_step": self._reference}
        if name == "camera" and entry.parameters.get("truth_folder"):
            return {"truth_folder": ""}  # a new file would begin with another reference
        return {}


def next_part(bag: Path) -> Path:
    """Return the folder of the next part of a recording: bag-2, bag-3 ... beside bag."""
    number = 2
    while bag.with_name(f"{bag.name}-{number}").exists():
        number += 1
    return bag.with_name(f"{bag.name}-{number}")


def _report(step: ProgrammeStep, result: MeasureStep.Result) -> StepReport:
    return StepReport(
        result.step,
        position=result.position_mean,
        force=result.force_mean,
        force_range=result.force_range,
        rms_displacement=result.rms_displacement,
        white=step.mode == "white",
        valid_fraction=result.valid_fraction,
        processing_time=result.processing_time,
    )
