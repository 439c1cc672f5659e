"""Plays the raw topics of a recording to new processing nodes, as fast as they work and without losing a frame."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import rclpy
from pydantic import BaseModel, ConfigDict, Field
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.publisher import Publisher
from rclpy.utilities import try_shutdown
from rosgraph_msgs.msg import Clock

from fringedic.errors import ConfigurationError, FringedicError
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import RawMessage
from fringedic.rig.model import RigModel
from fringedic.steps.recorded_references import recorded_steps_and_references
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import NodeParameters, NodeStatus, Reference, RigCalibration, StepStatus
from fringedic_ros.parameters import declare, report_unknown_parameters
from fringedic_ros.qos import CLOCK, EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY, STATE
from fringedic_ros.records import calibration_message
from fringedic_ros.result_codes import failed_node, failure_of
from fringedic_ros.rig_node import RIG_FRAME, RigNode, frame_id
from fringedic_ros.serialized import message_type, read
from fringedic_ros.stamps import to_msg
from fringedic_ros.topics import (
    CALIBRATION,
    EXPOSURE,
    IMAGE,
    NODE_PARAMETERS,
    PROCESSING_INPUTS,
    RAW_TOPICS,
    REFERENCE,
    SAMPLE_TOPICS,
    STEP,
)
from player_node.playback_nodes import PlaybackNodes, step_name
from player_node.recorded_steps import OF_ONE_STEP, RecordedStep, ends_step, recorded_messages, split_steps

PROFILES = {
    IMAGE: IMAGES,
    EXPOSURE: IMAGES,
    **dict.fromkeys(SAMPLE_TOPICS, STATE),
    REFERENCE: LATCHED,
    CALIBRATION: LATCHED,
    NODE_PARAMETERS: LATCHED_BY_MANY,
    "/tf_static": LATCHED,
}
CLOCK_PERIOD_NS = 10_000_000  # of the recorded time between two messages on /clock
ANNOUNCEMENTS = (REFERENCE, CALIBRATION)  # nodes have to handle these before the next frame
FAREWELL_S = 5  # for the last status to be received

Result = MeasureStep.Result


class PlayerParameters(BaseModel):
    """Parameters of the player."""

    model_config = ConfigDict(frozen=True)

    bag_path: str = Field("", description="Folder of the recording to play.")
    recorder: bool = Field(False, description="Wait for a recorder of raw and derived topics before playing.")
    overrides: list[str] = Field(
        [], description="Parameters that keep the value of the node instead of the recorded one, such as dic.window."
    )
    steps: list[int] = Field([], description="Only these steps and their references; empty: all steps.")
    reference_step: int = Field(
        -1, ge=-1, description="Step that all others are measured against, played first; -1: as recorded."
    )
    calibration_file: str = Field(
        "", description="YAML file of the pin-hole model that replaces the recorded one; empty: the recorded one."
    )
    timeout_s: float = Field(
        300.0, gt=0, le=86400, description="Longest wait for nodes to appear and for the answers to one step [s]."
    )


class PlayerNode(RigNode):
    """Plays one recording, step by step.

    The next step begins when phase, displacement and coupling have answered the present one. References, calibrations
    and parameters reach every node before the frames that follow them. Serialised messages are published unchanged.

    The topic `player/status` (latched) contains one StepStatus at the BEGIN of each step, and one at its end: END when
    all nodes have measured it, ERROR otherwise. The error code names the node that failed; RECORDER_FAILED stands for a
    step whose frames are not in the recording, INVALID_GOAL for recorded parameters that a node refused.

    Attributes
    ----------
    problems
        Steps without results, and parameters that were refused; a failure of a node is none.
    """

    def __init__(self) -> None:
        super().__init__("player")
        self.parameters = declare(self, PlayerParameters)
        parameters = self.parameters.value
        self._reference = None if parameters.reference_step < 0 else parameters.reference_step
        self._publishers_by_topic: dict[str, Publisher] = {}
        self._ahead: Counter[str] = Counter()  # messages that nodes may not have handled yet
        self._nodes = PlaybackNodes(self, recorder=parameters.recorder, timeout_s=parameters.timeout_s)
        self._statuses = self.create_publisher(StepStatus, "player/status", LATCHED_BY_MANY)
        self._times = self.create_publisher(Clock, "/clock", CLOCK)
        self._time_ns = 0  # on /clock
        self.problems: list[str] = []

    def destroy_node(self) -> None:
        """Wait until the last status has been received, then end the node."""
        if self.context.ok():
            self._statuses.wait_for_all_acked(Duration(seconds=FAREWELL_S))
        super().destroy_node()

    def play(self) -> str:
        """Play the recording and return a summary in one line.

        Raises
        ------
        RecordingError
            The recording lacks frames, exposures or steps.
        ConfigurationError
            The recording has no such step, or a reference is asked for and it contains several experiments.
        WaitTimeoutError
            A node did not appear, or did not answer a step, in time.
        """
        bag = BagReader(Path(self.parameters.value.bag_path), sensor=self.sensor)
        bag.find(IMAGE, EXPOSURE, STEP)
        chosen = self._chosen_steps(bag)
        experiment = _only_experiment(bag) if self._reference is not None else ""
        calibration = self._calibration()
        names = {full: name for name, full in bag.find_optional(*RAW_TOPICS).items()}
        if calibration is not None:
            names = {full: name for full, name in names.items() if name != CALIBRATION}
        self._create_publishers(bag, names, calibration is not None)
        self._nodes.await_subscriptions(self._publishers_by_topic.values(), self._publishers_by_topic)
        if calibration is not None:
            self._announce(CALIBRATION, calibration)
        if self._reference is not None:
            self._announce(REFERENCE, Reference(experiment=experiment, step=self._reference))
        steps = frames = 0
        for step, wanted in self._sequence(bag, names, chosen):
            frames += self._play_step(step, wanted)
            steps += wanted and step.begin is not None
        self._await_handled()
        return f"{steps} steps, {frames} frames, {len(self.problems)} problems"

    # what is played

    def _calibration(self) -> RigCalibration | None:
        """Return the calibration that replaces the recorded one."""
        file = self.parameters.value.calibration_file
        if not file:
            return None
        frame = frame_id(self, RIG_FRAME)
        return calibration_message(RigModel.from_yaml(file), stamp_ns=time.time_ns(), frame_id=frame)

    def _chosen_steps(self, bag: BagReader) -> set[int] | None:
        """Return the numbers of the requested steps and of their references; None for all steps."""
        present, references = recorded_steps_and_references(bag)
        requested = set(self.parameters.value.steps) | ({self._reference} if self._reference is not None else set())
        absent = sorted(requested - present)
        if absent:
            there = ", ".join(map(str, sorted(present)))
            raise ConfigurationError(f"{bag.path} has no step {', '.join(map(str, absent))}; it has {there}")
        if not self.parameters.value.steps:
            return None
        return requested if self._reference is not None else requested | references | {min(present)}

    def _create_publishers(self, bag: BagReader, names: dict[str, str], calibration: bool) -> None:
        kinds = {name: message_type(bag.topics[full].type_name) for full, name in names.items()}
        if calibration:
            kinds = {CALIBRATION: RigCalibration, **kinds}
        if self._reference is not None:
            kinds.setdefault(REFERENCE, Reference)
        for name, kind in kinds.items():
            self._publishers_by_topic[name] = self.create_publisher(kind, name, PROFILES.get(name, EVENTS))

    def _sequence(
        self, bag: BagReader, names: dict[str, str], chosen: set[int] | None
    ) -> Iterator[tuple[RecordedStep, bool]]:
        """Yield all steps of the recording, each with whether it is measured; a chosen reference comes first."""
        if self._reference is not None:
            for step in split_steps(recorded_messages(bag, names)):
                yield step.without(REFERENCE), step.number == self._reference
                if step.number == self._reference:
                    break
        for step in split_steps(recorded_messages(bag, names)):
            wanted = (chosen is None or step.number in chosen) and (
                step.number is None or step.number != self._reference
            )
            yield (step if self._reference is None else step.without(REFERENCE)), wanted

    # one step

    def _play_step(self, step: RecordedStep, wanted: bool) -> int:
        """Play one step, wait for its answers and return the number of its frames.

        Of a step that is not wanted, only the messages that later steps need are played: parameters, calibration,
        references and load.
        """
        if not wanted:
            step = RecordedStep(None, step.without(*OF_ONE_STEP).messages)
        complete = step.begin is not None and step.is_complete
        self._nodes.begin_step()
        if step.begin is not None:
            self.get_logger().info(step_name(step.begin))
            self._publish_status(step, StepStatus.BEGIN)
        for message in step.messages:
            if message.topic == NODE_PARAMETERS and self._set_parameters(step, message):
                continue
            if ends_step(message):
                if complete:
                    self._nodes.await_statuses(step.begin)
                else:
                    self._await_handled()
            self._publish(message)
        if step.begin is not None:
            self._conclude(step, complete)
        return step.frames

    def _conclude(self, step: RecordedStep, complete: bool) -> None:
        """Wait for the answers to a step and publish its outcome."""
        ends = [read(each.data, StepStatus).stage for each in step.messages if ends_step(each)]
        if complete or StepStatus.ERROR in ends:  # nodes answer an incomplete step only when its end was an error
            self._report(step, self._nodes.await_statuses(step.begin))
        else:
            reason = (
                "frames are missing in the recording, no results"
                if ends
                else "the recording ends within this step, no results"
            )
            self._report_problem(step, Result.RECORDER_FAILED, reason)
        if not complete:
            self._await_handled()

    def _report(self, step: RecordedStep, statuses: dict[str, NodeStatus]) -> None:
        for name, status in statuses.items():
            if status.error_code != NodeStatus.NONE:
                self.get_logger().warning(f"{name}, step {status.step}: {status.error_message}")
        failed = failed_node(PROCESSING_INPUTS, statuses)
        if failed is None:
            self._publish_status(step, StepStatus.END)
        else:
            self._publish_status(step, StepStatus.ERROR, *failure_of(failed, statuses[failed]))

    def _set_parameters(self, step: RecordedStep, message: RawMessage) -> bool:
        """Set recorded parameters of a processing node; False when they belong to another node."""
        recorded = read(message.data, NodeParameters)
        if recorded.node not in PROCESSING_INPUTS:
            return False
        refusal = self._nodes.set_parameters(recorded, self.parameters.value.overrides)
        if refusal:
            self._report_problem(step, Result.INVALID_GOAL, refusal)
        return True

    # messages

    def _announce(self, topic: str, message: Reference | RigCalibration) -> None:
        """Publish a message that replaces the recorded ones of its topic."""
        self._publishers_by_topic[topic].publish(message)
        self._ahead[topic] += 1

    def _publish(self, message: RawMessage) -> None:
        """Publish one message, after the nodes have handled all that it depends on or could displace."""
        name = message.topic
        announced = any(self._ahead[each] for each in ANNOUNCEMENTS)
        if (name == IMAGE and announced) or self._ahead[name] >= PROFILES.get(name, EVENTS).depth / 2:
            self._await_handled()
        self._set_clock(message.publish_time)
        self._publishers_by_topic[name].publish(message.data)
        self._ahead[name] += 1

    def _set_clock(self, time_ns: int) -> None:
        """Publish the recorded time, for nodes and viewers with `use_sim_time`; a reference played first is earlier."""
        if not 0 <= time_ns - self._time_ns < CLOCK_PERIOD_NS:
            self._time_ns = time_ns
            self._times.publish(Clock(clock=to_msg(time_ns)))

    def _await_handled(self) -> None:
        self._nodes.await_handled(self._publishers_by_topic[name] for name in self._ahead)
        self._ahead.clear()

    def _report_problem(self, step: RecordedStep, code: int, problem: str) -> None:
        self.problems.append(f"{step_name(step.begin)}: {problem}" if step.begin else problem)
        self._publish_status(step, StepStatus.ERROR, code, problem)

    def _publish_status(self, step: RecordedStep, stage: int, code: int = Result.NONE, message: str = "") -> None:
        begin = step.begin or StepStatus()
        status = StepStatus(
            experiment=begin.experiment,
            step=begin.step,
            stage=stage,
            frame=0 if stage == StepStatus.BEGIN else step.frames,
            frames=step.frames,
            reference=begin.reference,
            error_code=code,
            error_message=message,
        )
        status.header.stamp = self.get_clock().now().to_msg()
        self._statuses.publish(status)


def _only_experiment(bag: BagReader) -> str:
    """Return the name of the experiment of a recording; of several, each may have a step of the reference's number."""
    names = {str(message.experiment) for _, message, _ in bag.messages([bag.find(STEP)[STEP]])}
    if len(names) > 1:
        raise ConfigurationError(
            f"{bag.path} holds the experiments {', '.join(sorted(names))}: replay it without a reference, or measure "
            "one with fringedic process --experiment NAME --reference STEP"
        )
    return names.pop()


def main() -> None:
    """Play the recording of the parameter ``bag_path``; the exit code is 0 when all nodes answered."""
    rclpy.init()
    player = None
    code = 1
    try:
        player = PlayerNode()
        report_unknown_parameters(player)
        summary = player.play()
        sys.stdout.writelines(f"{line}\n" for line in (summary, *player.problems))
        code = 0
    except FringedicError as error:
        sys.stderr.write(f"{error}\n")
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.stderr.write("the replay was interrupted\n")
    finally:
        if player:
            player.destroy_node()
        try_shutdown()
    sys.exit(code)
