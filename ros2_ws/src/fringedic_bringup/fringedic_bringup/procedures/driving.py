"""Drives a programme: moves, holds and measures step by step, as the controller of a load frame would.

A node that ends does not end the test: the machine is requested to hold, the node is started again, and the step is
repeated. Only a camera that reads files ends it, because the images would begin again at the first one. Before the
first step a node that is killed is started again, too; one that ends by itself ends the test, because it would do so
again.

A stop that this programme has not requested ends it, and so does a fault of the machine: somebody, or the machine,
wants the crosshead to stand still, and only a person may move it again.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.duration import Duration

from fringedic.command.outcome import Progress, StepReport
from fringedic.configuration.conditions import MetCondition, Reading, Until
from fringedic.configuration.programme import Programme, ProgrammeStep
from fringedic.configuration.sentences import block_end_sentence, condition_sentence
from fringedic.errors import (
    FringedicError,
    MachineError,
    MoveStoppedError,
    NodeDiedError,
    OperatorError,
    RigBusyError,
    StepFailedError,
    WaitTimeoutError,
)
from fringedic.recording.bag_files import BAG
from fringedic.signals import FORCE
from fringedic.wording.causes import cause_of
from fringedic_bringup.client import HEARTBEATS_S, RigClient
from fringedic_bringup.launch.graph import Graph, own_name, sensor_of_node
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.continuing import STEPS_DONE, RecordedSteps, save_steps_done
from fringedic_bringup.procedures.outcome import RunControl
from fringedic_bringup.procedures.recording_parts import next_part
from fringedic_bringup.sensors_client import SensorsClient, nodes_to_watch
from fringedic_msgs.action import MeasureStep, MoveCrosshead
from fringedic_msgs.msg import LoadState, StepStatus
from fringedic_ros.qos import LATCHED
from fringedic_ros.stamps import to_msg
from fringedic_ros.topics import PROGRAMME

MOST_DEATHS = 3  # of one node without a measured step in between; after more, a restart does not remove the cause
MOST_SILENCES = 3  # missing answers without a measured step in between, although every node runs
STANDSTILL = 1e-7  # [m] of the crosshead during a stack in motion: less than its sensor resolves
LOAD_FRAME = "load_frame"
EXTENSOMETER = "extensometer"  # counts the strain from its first frame, and from each reference step
WITH_REFERENCE = ("dic", "coupling")  # keep the reference step in memory and lose it when they end
INTERRUPTION_S = 5.0  # wait for the answer to hold and cancel
BUSY_S = 1.0  # between two attempts while another controller uses the rig
PAUSE_S = 30 * 86400.0  # longest pause
RECEIVED_S = 2.0  # for the record of the end of the programme to be received
RESTART_S = 40.0  # from the start of a node until it is ready and its predecessor's lease has ended


class Driven(NamedTuple):
    """Outcome of a programme.

    Attributes
    ----------
    steps
        Reports of the steps that were to be measured.
    measure_again
        All steps are to be measured again from the recorded frames: a node ended, or the run was continued, so that
        results are missing or count from another step.
    ended_early
        Why the programme ended before its last step; empty when it did not.
    interrupted
        Whether Ctrl-C or a signal ended it.
    sensors_again
        Of several sensors, those whose steps are to be measured again.
    """

    steps: list[StepReport]
    measure_again: bool
    ended_early: str = ""
    interrupted: bool = False
    sensors_again: frozenset[str] = frozenset()


def drive(
    running: RunningGraph,
    programme: Programme,
    progress: Progress,
    *,
    domain: int | None = None,
    before: RecordedSteps | None = None,
    control: RunControl | None = None,
) -> Driven:
    """Move, hold and measure, step by step; a failed step is reported and the next one follows.

    What was measured is returned whatever happens later: nodes that end again and again, or answers that never come,
    end the programme early, with a request to hold.

    Parameters
    ----------
    running
        The nodes of the rig; a node that ends is started again.
    programme
        The load steps.
    progress
        Receives the progress.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    before
        Steps of the programme that an earlier run has done: they are left out.
    control
        Pauses or ends the programme on request of an operator.

    Raises
    ------
    NodeDiedError
        A node ended by itself before all were ready.
    WaitTimeoutError
        The nodes are not ready in time, or the strain or signal that a condition needs has no publisher.
    """
    control, faults = control or RunControl(), _FaultWatch()

    def watch(sensor: str | None = None) -> None:
        running.check(nodes_to_watch(running.graph.names, sensor))
        control.check()
        faults.check()

    with _client(running.graph, domain, watch) as rig:
        record = _EndRecord(rig, programme.experiment)
        conditions = programme.conditions()
        needs_strain = any(until.needs_strain for until in conditions)
        count = sum(step.mode != "none" for step in programme.load_steps())
        driver = _Driver(running, rig, progress, control, count - 1, needs_strain=needs_strain)
        if before is not None:
            rig.last_step = before.last
            driver.has_reference = bool(before.measured)
            driver.sensors_again |= before.sensors
        walk = programme.walk(lambda end: progress.note(block_end_sentence(end)))
        reading: Reading | None = None
        ended_early, interrupted = "", False
        driver.begin({name for until in conditions for name in until.signals})
        faults.rig = rig
        try:
            with suppress(StopIteration):
                done: list[ProgrammeStep] = []
                while True:
                    done.append(walk.send(reading))
                    if before is None or len(done) > before.done:
                        reading = driver.do(done[-1])
                        save_steps_done(running.logs / STEPS_DONE, done)
            driver.finish()
            record.publish(driver.number)
        except (FringedicError, OSError) as error:
            not_held = driver.end()
            ended_early = _reason(error, running.logs.parent)
            progress.note(f"the programme ends early: {ended_early}{not_held and f'; {not_held}'}")
            record.publish(driver.number, ended_early, _code_of(error))
        except KeyboardInterrupt:
            held = driver.end() or "a hold was requested"
            ended_early, interrupted = "interrupted", True
            progress.note(f"interrupted: {held}; the results of what was measured are written")
            record.publish(driver.number, ended_early)
    again = driver.interrupted or (before is not None and bool(before.measured))
    return Driven(driver.reports, again, ended_early, interrupted, frozenset(driver.sensors_again))


def _client(graph: Graph, domain: int | None, watch: Callable[[str | None], None]) -> RigClient:
    """Return the client of a rig, or that of a rig of several sensors."""
    if sensors := graph.sensors:
        return SensorsClient(graph.namespace, sensors, domain=domain, watch=watch, name="programme")
    return RigClient(graph.namespace, domain=domain, watch=lambda: watch(None), name="programme")


def _reason(error: FringedicError | OSError, folder: Path) -> str:
    if isinstance(error, OSError):  # of a disk that is full, or became read-only
        return f"{error.filename or folder}: {cause_of(error)}"
    return str(error)


class _FaultWatch:
    """Ends a programme once when the machine reports a fault, in whatever it does: a reset is no wish to go on.

    Attributes
    ----------
    rig
        Client that receives the samples of the machine; None before the programme begins.
    """

    def __init__(self) -> None:
        self.rig: RigClient | None = None

    def check(self) -> None:
        """Check the latest sample.

        Raises
        ------
        MachineError
            It is the first one that reports a fault.
        """
        load = None if self.rig is None else self.rig.load
        if load is not None and load.mode == LoadState.FAULT:
            self.rig = None
            raise MachineError(
                f"the machine reports a fault at {1e3 * load.position:.4f} mm, {load.force:.1f} N; find its cause, "
                "reset the machine at its own controls, and then go on with the programme"
            )


class _EndRecord:
    """Publishes how a programme has ended, for the recording: END, or ERROR with the reason, at the step under way."""

    def __init__(self, rig: RigClient, experiment: str) -> None:
        self._rig, self._experiment = rig, experiment
        self._publisher = rig.node.create_publisher(StepStatus, PROGRAMME, LATCHED)

    def publish(self, step: int, reason: str = "", error_code: int = 0) -> None:
        """Publish it, and wait until the recorder has it."""
        message = StepStatus(experiment=self._experiment, step=step, stage=StepStatus.END)
        message.header.stamp = to_msg(time.time_ns())
        if reason:
            message.stage, message.error_code, message.error_message = StepStatus.ERROR, error_code, reason
        self._publisher.publish(message)
        self._publisher.wait_for_all_acked(Duration(seconds=RECEIVED_S))
        with suppress(FringedicError):
            self._rig.sleep(HEARTBEATS_S)


def _code_of(error: Exception) -> int:
    """Return the code of an action that belongs to an error, 0 when there is none."""
    if isinstance(error, MachineError):
        return int(MoveCrosshead.Result.MACHINE_FAULT)
    return error.error_code if isinstance(error, StepFailedError) else 0


class _Driver:
    """Executes the steps one after the other.

    Attributes
    ----------
    reports
        Reports of the steps that are measured.
    has_reference
        A step was measured, so that the following ones have a reference.
    number
        Number that the step under way has, or will have, in the recording.
    interrupted
        A node has ended: results of its step are missing, or it lost the reference that it kept in memory.
    """

    def __init__(
        self,
        running: RunningGraph,
        rig: RigClient,
        progress: Progress,
        control: RunControl,
        last: int,
        *,
        needs_strain: bool = False,
    ) -> None:
        self.reports: list[StepReport] = []
        self.has_reference = False
        self._running, self._rig, self._progress, self._control = running, rig, progress, control
        self.number, self._last, self._needs_strain = 0, last, needs_strain
        self.interrupted = False
        self.sensors_again: set[str] = set()  # whose nodes have ended
        self._begun = False  # the programme has begun its first step
        self._between_steps = False  # no step is under way that is repeated
        self._restarted = False  # a node was started again since the last successful step
        self._is_new_reference = False  # the step under way sets the reference, and the zero of the strain
        self._stop: MoveStoppedError | None = None  # of a move that ended while a node was being started again
        self._deaths: Counter[str] = Counter()  # without a measured step in between
        self._silences = 0
        self._awaited: dict[str, int] = {}  # nodes that were started again, and when [ns]

    def begin(self, signals: set[str]) -> None:
        """Wait until all is ready for the first step, also the signals of the conditions and the strain, if needed.

        Raises
        ------
        NodeDiedError
            A node has ended by itself, or was killed more than `MOST_DEATHS` times.
        WaitTimeoutError
            The nodes are not ready in time, or the strain or a signal has no publisher.
        """
        while True:
            try:
                self._rig.wait_until_ready(self._running.graph.names)
                if self._needs_strain:
                    self._rig.wait_for_strain()
                return self._rig.wait_for_signals(signals)
            except NodeDiedError as death:
                if any((self._running.exit_code(name) or 0) >= 0 for name in self._running.dead()):
                    raise
                self._restart(death)
                self.interrupted = False  # nothing was measured yet
                self.sensors_again.clear()

    def do(self, step: ProgrammeStep) -> Reading | None:
        """Execute a step, and repeat it when a node ends meanwhile; return the readings for the conditions."""
        self._begun = True
        self.number = self._rig.last_step + 1  # the number that the step gets in the recording
        self._is_new_reference = step.set_reference
        self._last = max(self._last, self.number)
        if isinstance(self._rig, SensorsClient):
            self._mend()
        if not self._control.may_begin():
            self._tell("paused")
            self._with_restarts(lambda: self._rig.wait_for(self._control.may_begin, PAUSE_S, lambda: "resume"))
        return self._with_restarts(lambda: self._move_and_measure(step))

    def _mend(self) -> None:
        """Start the nodes again that have ended during the last step, which the other sensors have measured."""
        self._between_steps = True
        self._with_restarts(self._running.check)
        self._between_steps = False

    def finish(self) -> None:
        """Wait until everything is recorded."""
        self._needs_strain = False
        self._with_restarts(self._rig.wait_until_recorded)
        if self._rig.recorder is not None and self._rig.recorder.error_message:
            self._progress.note(f"recorder: {self._rig.recorder.error_message}")

    def _move_and_measure(self, step: ProgrammeStep) -> Reading | None:
        moved = ""
        try:
            if step.mode == "moving":
                return self._measure_moving(step)
            if step.position is not None:
                moved = self._move(step)
            if step.hold_s:
                self._tell("hold")
                self._rig.sleep(step.hold_s)
            if step.mode == "none":
                return self._rig.reading
            result = self._rig.measure(step.mode, set_reference=step.set_reference, feedback=self._show)
        except RigBusyError:
            raise
        except MoveStoppedError as error:
            is_fault = error.error_code == MoveCrosshead.Result.MACHINE_FAULT
            if is_fault and LOAD_FRAME in self._running.dead():  # that is why
                self._running.check()
            raise
        except StepFailedError as error:
            self._running.check()  # raises when a node has ended: then the step is repeated
            self._progress.note(str(error))
            if self._restarted:
                # restarted nodes may not have discovered each other yet
                self._restarted = False
                self._progress.note(f"step {self.number} is repeated")
                return self._move_and_measure(step)
            begun = step.mode != "none" and self._rig.last_step >= self.number
            self._report_failure(self._rig.last_step if begun else -1, str(error))
            return None
        if moved:
            self._progress.note(moved)
        return self._take(step, result)

    def _measure_moving(self, step: ProgrammeStep) -> Reading | None:
        """Measure stack after stack while the crosshead moves; return the readings of the last one that succeeded."""
        reading: Reading | None = None

        def take(result: MeasureStep.Result, ended: bool) -> None:
            nonlocal reading
            if result.error_code:
                self._running.check()  # raises when a node has ended
                text = f"{result.error_message} (error {result.error_code})"
                if result.error_code == MeasureStep.Result.BUSY:
                    self._progress.note(text)
                    self._rig.sleep(BUSY_S)
                elif ended:
                    self._progress.note(f"{text}; the move ended during this stack, which is left out")
                else:
                    self._progress.note(text)
                    self._report(StepReport(result.step, error=text))
            else:
                if result.position_range < STANDSTILL:
                    self._progress.note(f"step {result.step}: the crosshead stood still")
                reading = self._take(step, result)
            self.number = self._rig.last_step + 1
            self._last = max(self._last, self.number)

        self._progress.note(self._move(step, take))
        return reading

    def _take(self, step: ProgrammeStep, result: MeasureStep.Result) -> Reading:
        """Report a measured step."""
        self._restarted, self._silences = False, 0
        self._deaths.clear()
        replaced = self.has_reference and not step.set_reference and result.step == self._rig.reference
        self.has_reference = True
        if isinstance(self._rig, SensorsClient):
            self._report_sensors(step, self._rig.results)
        else:
            self._report(_report(step, result))
        if replaced:  # by the experiment node
            self.interrupted = True
            self.sensors_again |= set(self._running.graph.sensors)
            self._require_zero_of_strain(f"step {result.step} became the reference")
        of_step = self._rig.reading_of_step
        signals = {**of_step.signals, FORCE.name: result.force_mean}
        return of_step._replace(signals=signals, valid_fraction=result.valid_fraction)

    def _report_sensors(self, step: ProgrammeStep, results: Mapping[str, MeasureStep.Result | str]) -> None:
        """Report what each sensor has measured, and why it has not."""
        for sensor, result in results.items():
            if isinstance(result, str):
                self._progress.note(f"step {self.number}, sensor {sensor}: {result}")
                self._report(StepReport(self.number, error=result, sensor=sensor))
            else:
                self._report(replace(_report(step, result), sensor=sensor))

    def _report_failure(self, number: int, error: str) -> None:
        """Report a step that failed, for all sensors."""
        if not isinstance(self._rig, SensorsClient):
            self._report(StepReport(number, error=error))
            return
        for sensor in self._running.graph.sensors:
            reason = self._rig.results.get(sensor, error) if number >= 0 else error
            self._report(StepReport(number, error=str(reason), sensor=sensor))

    def _report(self, report: StepReport) -> None:
        self.reports.append(report)
        self._control.measured(report)

    def _move(self, step: ProgrammeStep, take: Callable[[MeasureStep.Result, bool], None] | None = None) -> str:
        """Move, and return the reason when the move ended before its position; empty otherwise.

        Parameters
        ----------
        step
            With a position.
        take
            Called with the results of the stacks that are measured meanwhile, and whether the move has ended; None:
            nothing is measured.
        """
        position, until = step.position, step.until
        assert position is not None, "checked by the caller"
        if until is None and take is None:
            self._tell(f"move to {position * 1e3:.3f} mm")
            self._rig.move(position, step.speed)
            return ""
        self._tell(f"move towards {position * 1e3:.3f} mm")
        until = until or Until.model_construct()
        others, conditions = until.without_force(), list[MetCondition]()

        def met(reading: Reading) -> bool:
            condition = None if others is None else others.met(reading)
            if condition is not None:
                conditions.append(condition)
            return bool(conditions)

        limits = {"force_above": until.force_above_n, "force_below": until.force_below_n}
        if take is None:
            ended = self._rig.move(position, step.speed, **limits, until=None if others is None else met)
        else:
            ended = self._rig.measure_while_moving(
                position, step.speed, **limits, until=met, every_s=step.every_s, measured=take, feedback=self._show
            )
        if ended.force_reached and (condition := until.met(Reading({FORCE.name: ended.reached_force}))) is not None:
            conditions.insert(0, condition)
        where = f"step {self.number}: move ended at {ended.position * 1e3:.4f} mm, {ended.force:.1f} N"
        if conditions:
            return f"{where}: {condition_sentence(conditions[0])}"
        if ended.error_code == MoveCrosshead.Result.CANCELLED:
            return f"{where}: the machine stood still, and the end of its move was requested"
        return f"{where}: no condition was met before its position"

    def _tell(self, text: str) -> None:
        self._progress.step(self.number, self._last, text)

    def _show(self, feedback: MeasureStep.Feedback) -> None:
        self._progress.step(self.number, self._last, feedback.stage, feedback.frame, feedback.frames)

    def _with_restarts(self, work: Callable[[], Any]) -> Any:
        """Call a function; when nodes end or do not answer meanwhile, mend that and call it once more.

        While another controller uses the rig, the programme waits, and then moves again: the machine may have moved.
        """
        waits_for = ""
        while True:
            if self._stop is not None:
                raise self._stop
            try:
                if waits_for:
                    self._rig.sleep(BUSY_S)
                return work()
            except RigBusyError as busy:
                if str(busy) != waits_for:
                    self._progress.note(f"the programme waits: {busy}")
                waits_for = str(busy)
            except NodeDiedError as death:
                self._restart(death)
            except WaitTimeoutError as silence:
                self._silences += 1
                if self._silences > MOST_SILENCES:
                    raise
                self._progress.note(f"{silence}; step {self.number} is repeated")
                self.interrupt()

    def end(self) -> str:
        """Interrupt the machine, however often a person interrupts this; return what `interrupt` returns."""
        while True:
            with suppress(KeyboardInterrupt, OperatorError, MachineError):
                return self.interrupt()

    def interrupt(self) -> str:
        """Request a hold, and the end of the move or step under way; return why no hold was accepted, if it was not."""
        not_held = ""
        try:
            self._rig.hold(INTERRUPTION_S)
        except (StepFailedError, WaitTimeoutError, NodeDiedError) as error:
            not_held = f"no hold was accepted: {error}" if self._has_load_frame() else "no load frame to hold"
        try:
            self._rig.cancel(INTERRUPTION_S)
        except MoveStoppedError as stop:
            self._stop = stop
        except (StepFailedError, WaitTimeoutError, NodeDiedError):
            pass  # the node that should answer may have ended
        return not_held

    def _has_load_frame(self) -> bool:
        return LOAD_FRAME in self._running.graph.names

    def _restart(self, death: NodeDiedError) -> None:
        begin, names = time.monotonic(), set[str]()
        while True:
            try:
                names.update(self._running.dead())
                self._start_again(death)
                self._rig.wait_until_ready(self._running.graph.names)
                self._awaited.clear()
                self._restarted = True
                self._progress.note(f"{_in_words(names)} ready again after {time.monotonic() - begin:.0f} s")
                without_reference = {name for name in names if own_name(name) in WITH_REFERENCE}
                if EXTENSOMETER in names and self._begun:
                    self._require_zero_of_strain("the extensometer was started again")
                without_reference = {name for name in without_reference if self._rig.of_node(name).reference >= 0}
                if without_reference:
                    if self.has_reference and not self._is_new_reference:
                        self._require_zero_of_strain(f"{_in_words(without_reference)} lost the reference")
                    for client in dict.fromkeys(map(self._rig.of_node, sorted(without_reference))):
                        self._set_reference(client)
                    self._progress.note(
                        f"{_in_words(without_reference)} lost the reference: until the end of the programme, or the "
                        "next reference in it, displacements count from the next step; afterwards all steps are "
                        "measured again from the recorded frames against the references of before"
                    )
                return
            except NodeDiedError as another:
                if another is death:
                    raise  # a node has died too often
                death = another
            except WaitTimeoutError as silence:
                death = self._end_silent(silence)

    def _require_zero_of_strain(self, why: str) -> None:
        """End the programme when the strain would count from another state than its conditions mean.

        Raises
        ------
        StepFailedError
            The programme has conditions on the strain of an extensometer of this rig.
        """
        if self._needs_strain and EXTENSOMETER in self._running.graph.names:
            raise StepFailedError(
                f"{why}: the strain would count from the present load, and the conditions of the programme would come "
                "too late; unload, and start a new run"
            )

    def _set_reference(self, client: RigClient) -> None:
        """Make the next step the reference, after the end of a step of another controller."""
        waits_for = ""
        while True:
            try:
                return client.set_reference(previous_lost=True)
            except StepFailedError as refusal:
                if str(refusal) != waits_for:
                    self._progress.note(f"the programme waits: {refusal}")
                waits_for = str(refusal)
            self._rig.sleep(BUSY_S)

    def _end_silent(self, silence: WaitTimeoutError) -> NodeDiedError:
        """End the nodes that were started again and did not become ready, so that they are started once more."""
        self._silences += 1
        if self._silences > MOST_SILENCES:
            raise silence
        self._progress.note(str(silence))
        self._running.kill(self._awaited)
        return NodeDiedError(str(silence))

    def _start_again(self, death: NodeDiedError) -> None:
        """Request a hold and start the nodes that have ended again."""
        dead, self.interrupted = self._running.dead(), True
        sensors = set(map(sensor_of_node, dead))
        self.sensors_again |= set(self._running.graph.sensors) if "" in sensors else sensors
        self._deaths.update(dead.keys())
        if any(self._deaths[name] > MOST_DEATHS for name in dead):
            raise death
        self._awaited |= dict.fromkeys(dead, time.time_ns())
        for name, how in dead.items():
            self._running.restart(name, **self._changes(name))
            repeated = f", and step {self.number} is repeated" if self._begun and not self._between_steps else ""
            self._progress.note(f"{name} {how} (see {self._running.log(name)}); it is started again{repeated}")
        if self._begun:
            self.interrupt()
        self._rig.wait_until_started(self._awaited, RESTART_S)

    def _changes(self, name: str) -> dict[str, Any]:
        """Return the parameters with which a restarted node continues where it ended.

        Raises
        ------
        StepFailedError
            It cannot continue there.
        """
        entry = next(each for each in self._running.graph.nodes if each.name == name)
        if name == "recorder" and Path(entry.parameters["bag_path"] or "none").exists():
            return {"bag_path": str(next_part(Path(entry.parameters["bag_path"]).with_name(BAG)))}
        if not self._begun:
            return {}  # it begins
        own = own_name(name)
        if own == "experiment" and own != name:  # the number of the next step of the other sensors
            return {"first_step": self._rig.last_step + 1, "reference_step": self._rig.of_node(name).reference}
        if own == "experiment":
            # the interrupted step has a number already, which may not have been published
            number = max(self._rig.highest_step(entry.parameters["experiment"]), self._rig.last_step + 1)
            return {"first_step": number + 1, "reference_step": self._rig.reference}
        if own == "camera" and entry.parameters.get("files"):
            raise StepFailedError(
                f"the {name} ended (see {self._running.log(name)}) and would read its files from the first image "
                "again; start a new run"
            )
        if own == "camera" and entry.parameters.get("truth_folder"):
            return {"truth_folder": ""}  # a new file would start with another reference
        return {}


def _in_words(names: Iterable[str]) -> str:
    """Return names as they stand in a sentence."""
    return " and ".join(sorted(names))


def _report(step: ProgrammeStep, result: MeasureStep.Result) -> StepReport:
    return StepReport(
        result.step,
        position=result.position_mean,
        force=result.force_mean,
        force_range=result.force_range,
        rms_displacement=result.rms_displacement,
        rms_displacement_px=result.rms_displacement_px,
        white=step.mode == "white",
        valid_fraction=result.valid_fraction,
        processing_time=result.processing_time,
    )
