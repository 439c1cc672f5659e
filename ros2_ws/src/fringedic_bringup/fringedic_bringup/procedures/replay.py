"""Replays a recording through new processing nodes, in a ROS domain of its own, into a new recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from fringedic.command.outcome import Progress
from fringedic.datasets.sentences import missing_settings_sentence
from fringedic.datasets.timeline import refuse_repeated_steps
from fringedic.errors import ConfigurationError, NodeDiedError, RecordingError
from fringedic.recording.frames import records
from fringedic.recording.reader import BagReader
from fringedic.rig.compatibility import check_calibration
from fringedic.rig.model import RigModel
from fringedic.steps.recorded_references import recorded_steps_and_references
from fringedic.steps.recorded_rig import missing_settings, recorded_setup, require_calibration, require_reference
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import replay_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.participant import Participant
from fringedic_msgs.msg import RecorderStatus, StepStatus
from fringedic_ros.qos import LATCHED, LATCHED_BY_MANY

_LOOK_EVERY_S = 0.1
_REMAINING = 100  # callbacks after the end of the player, which leaves when its last status was received


def replay(  # noqa: PLR0913 (options of a public function, all by keyword)
    bag: Path,
    output: Path,
    progress: Progress,
    *,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    steps: Sequence[int] = (),
    reference: int | None = None,
    calibration: Path | None = None,
    sensor: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> Path:
    """Process a recording again by the nodes and return the new recording.

    With the recorded parameters the derived topics are bit-identical, for any number of threads; where nodes had lost
    the reference they differ, because the steps count from the reference of before (`RecordedReferences`).

    Parameters
    ----------
    bag
        Recording with raw topics.
    output
        New folder for the recording ``bag`` and the ``logs`` of the nodes.
    progress
        Receives each step, the errors of steps and a summary.
    overrides
        Parameters that replace the recorded ones, ``{"dic": {"window": 24}}``.
    steps
        Only these steps and their references; all when empty.
    reference
        A step that all others are measured against, earlier ones too; by default as recorded.
    calibration
        File that replaces the recorded calibration of the rig.
    sensor
        Name of the sensor, if the recording contains several.
    environment
        Further environment variables of the nodes, such as NUMBA_NUM_THREADS.

    Raises
    ------
    RecordingError
        The recording lacks frames, exposures or steps, or a calibration when none is given; the output contains a
        recording already; or the recorder stopped, such as on a full disk; or it contains several sensors and none is
        chosen; or the reference of its first frames is unknown and none is given.
    CalibrationError
        The calibration belongs to another rig, or its lengths contradict each other.
    PatternError
        The coarsest fringes repeat in the view of the calibration.
    ConfigurationError
        A chosen step is not in the recording.
    DatasetError
        The recording contains several measurements of a step under one number.
    NodeDiedError
        A node ended, or nodes did not answer the player; the message contains the end of its log.
    """
    target = output / "bag"
    if target.exists():
        raise RecordingError(f"{target} exists already; choose another --output")
    reader = BagReader(bag, sensor=sensor)
    if calibration is None:
        require_calibration(reader)
    else:
        check_calibration(RigModel.from_yaml(calibration), recorded_setup(reader))
    count = _count_steps(reader, set(steps), reference)
    if reference is None:
        require_reference(reader)
    refuse_repeated_steps(records(reader), bag)
    graph = replay_graph(reader, target, overrides or {}, steps=steps, reference=reference, calibration=calibration)
    with (
        private_domain() as domain,
        _PlayedSteps(graph.namespace, domain, count, progress) as played,
        RunningGraph(graph, output / "logs", domain=domain, environment=environment) as running,
    ):
        running.expect_end("player")
        progress.stage(f"replaying {bag}")
        missing = missing_settings(reader, records(reader))
        if missing:
            progress.note(missing_settings_sentence(missing))
        while running.exit_code("player") is None:
            running.check()
            played.report(_LOOK_EVERY_S)
            played.check()
        running.check()
        played.report_rest()
        played.check()
    if not target.exists():
        raise NodeDiedError(f"the recorder wrote no recording; see {running.log('recorder')}")
    return target


class _PlayedSteps:
    """Passes the topic ``player/status`` on as progress.

    Parameters
    ----------
    namespace, domain
        Of the player.
    steps
        Number of steps that it plays.
    progress
        Receives the steps.
    """

    def __init__(self, namespace: str, domain: int, steps: int, progress: Progress) -> None:
        self._participant = Participant("replay", namespace, domain=domain)
        self._participant.node.create_subscription(StepStatus, "player/status", self._take, LATCHED_BY_MANY)
        self._participant.node.create_subscription(RecorderStatus, "recorder/status", self._take_recorder, LATCHED)
        self._recorder = RecorderStatus()
        self._progress = progress
        self._steps, self._number = steps, 0
        self._frames: dict[tuple[str, int], int] = {}
        self._problems = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._participant.close()

    def report(self, timeout_s: float) -> None:
        """Report one status that has been received or is received in this time."""
        self._participant.spin_once(timeout_s)

    def check(self) -> None:
        """Raise RecordingError when the recorder has stopped."""
        if self._recorder.state == RecorderStatus.FAILED:
            raise RecordingError(f"the recorder stopped: {self._recorder.error_message}")

    def report_rest(self) -> None:
        """Report everything that was received, and a summary."""
        for _ in range(_REMAINING):
            self._participant.spin_once(0.0)
        whole, frames = self._number - self._problems, sum(self._frames.values())
        self._progress.note(f"whole: {whole} of {self._steps} steps, {frames} frames")

    def _take_recorder(self, status: RecorderStatus) -> None:
        self._recorder = status

    def _take(self, status: StepStatus) -> None:
        if status.stage == StepStatus.BEGIN:
            self._number += 1
            self._progress.part(self._number, self._steps, f"recorded step {status.step}")
            return
        self._frames[status.experiment, status.step] = status.frame
        if status.stage == StepStatus.ERROR:
            self._problems += 1
            self._progress.note(f"step {status.step}: {status.error_message} (error {status.error_code})")


def _count_steps(reader: BagReader, chosen: set[int], reference: int | None) -> int:
    """Return the number of steps that the player plays: all, or the chosen ones with their references.

    Raises
    ------
    RecordingError
        The recording lacks frames, exposures or steps.
    ConfigurationError
        A chosen step is not in the recording.
    """
    reader.find("camera/image_raw", "camera/exposure", "experiment/step")
    steps, references = recorded_steps_and_references(reader)
    requested = chosen if reference is None else chosen | {reference}
    absent = sorted(requested - steps)
    if absent:
        present = ", ".join(map(str, sorted(steps)))
        raise ConfigurationError(f"{reader.path} has no step {', '.join(map(str, absent))}; it has {present}")
    if not chosen:
        return len(steps)
    return len(requested if reference is not None else (requested | references | {min(steps)}) & steps)
