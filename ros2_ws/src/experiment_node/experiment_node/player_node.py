"""Plays the raw topics of a recording to fresh processing nodes, as fast as these go and without losing a frame."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import rclpy
from pydantic import BaseModel, ConfigDict, Field
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from experiment_node.messages import header_stamp, message_type
from experiment_node.topics import (
    CALIBRATION,
    DERIVED_TOPICS,
    EXPOSURE,
    IMAGE,
    NODE_PARAMETERS,
    PROCESSING_INPUTS,
    PUBLISHED,
    RAW_TOPICS,
    READERS,
    REFERENCE,
    STEP,
)
from fringedic.errors import FringedicError, NotAnsweredError, ParameterError
from fringedic.recording import BagReader, RawMessage, type_hash
from fringedic.rig import RigModel
from fringedic.sequence import stamp_of
from fringedic_msgs.msg import Exposure, NodeParameters, NodeStatus, Reference, RigCalibration, StepStatus
from fringedic_ros.matching import Matching
from fringedic_ros.parameters import declare
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY, STATE
from fringedic_ros.records import calibration_message
from fringedic_ros.stamps import to_nanoseconds

PROFILES = {
    IMAGE: IMAGES,
    EXPOSURE: IMAGES,
    "load_frame/state": STATE,
    "load_frame/wrench": STATE,
    "load_frame/joint_states": STATE,
    REFERENCE: LATCHED,
    CALIBRATION: LATCHED,
    NODE_PARAMETERS: LATCHED_BY_MANY,
}

# What nodes must know before they take the next frame.
ANNOUNCEMENTS = (REFERENCE, CALIBRATION)


# What belongs to a step alone.
OF_ONE_STEP = (IMAGE, "camera/camera_info", EXPOSURE, STEP)


class PlayerParameters(BaseModel):
    """Parameters of the player."""

    model_config = ConfigDict(frozen=True)

    bag_path: str = Field("", description="Folder of the recording to play.")
    recorder: bool = Field(False, description="Wait for a recorder of raw and derived topics before playing.")
    overrides: list[str] = Field(
        [], description="Parameters that keep the nodes' values instead of the recorded ones, such as dic.window."
    )
    steps: list[int] = Field([], description="Only these steps and their references; empty plays all.")
    reference_step: int = Field(
        -1, ge=-1, description="Step that all others are measured against, played first; -1 is as recorded."
    )
    calibration_file: str = Field(
        "", description="YAML file of a rig's pin-hole model that replaces the recorded one; empty: the recorded one."
    )
    timeout_s: float = Field(
        300.0, gt=0, le=86400, description="Longest wait for nodes to appear and for the answers to one step [s]."
    )


@dataclass
class RecordedStep:
    """Messages of one step in the order of publishing, from its BEGIN to the BEGIN of the next.

    What comes before the first step of a recording has no ``begin``.
    """

    begin: StepStatus | None
    messages: list[RawMessage] = field(default_factory=list)


class PlayerNode(Node):
    """Plays one recording, step by step.

    The next step begins when phase, displacement and coupling have answered the present one. Reference, calibration
    and parameters reach every node before the frames that follow them: each node is asked for a parameter in between,
    and it answers after the messages it got before. Serialised messages are published unchanged.
    """

    def __init__(self) -> None:
        super().__init__("player")
        self.parameters = declare(self, PlayerParameters)
        self._overrides = set(self.parameters.value.overrides)
        self._publishers_by_topic: dict[str, Publisher] = {}
        self._answers: dict[str, NodeStatus] = {}
        self._ahead: Counter[str] = Counter()
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)
        for node in PROCESSING_INPUTS:
            self.create_subscription(NodeStatus, f"{node}/status", self._answered, EVENTS)
        self._get = {
            node: self.create_client(GetParameters, f"{node}/get_parameters") for node in self._expected_nodes()
        }
        self._set = {
            node: self.create_client(SetParametersAtomically, f"{node}/set_parameters_atomically")
            for node in PROCESSING_INPUTS
        }
        self._matching = Matching(self, PUBLISHED, READERS)
        self.problems: list[str] = []

    def play(self) -> str:
        """Play the recording and return one line that says what was played.

        Raises
        ------
        MissingTopicError
            The recording lacks frames, exposures or steps.
        NotAnsweredError
            A node did not appear, or did not answer a step, in time.
        """
        bag = BagReader(Path(self.parameters.value.bag_path))
        bag.find(IMAGE, EXPOSURE, STEP)
        chosen = self._chosen_steps(bag)
        names = {full: name for name, full in bag.find_optional(*RAW_TOPICS).items()}
        calibration = self._calibration()
        if calibration is not None:
            names = {full: name for full, name in names.items() if name != CALIBRATION}
            self._publishers_by_topic[CALIBRATION] = self.create_publisher(RigCalibration, CALIBRATION, LATCHED)
        for full, name in names.items():
            kind = message_type(bag.topics[full].type_name)
            self._publishers_by_topic[name] = self.create_publisher(kind, name, PROFILES.get(name, EVENTS))
        if self._reference is not None and REFERENCE not in self._publishers_by_topic:
            self._publishers_by_topic[REFERENCE] = self.create_publisher(Reference, REFERENCE, LATCHED)
        self._wait_for_nodes()
        if calibration is not None:
            self._publishers_by_topic[CALIBRATION].publish(calibration)
            self._ahead[CALIBRATION] += 1

        def recorded() -> Iterator[RecordedStep]:
            return split_steps(_played(bag, names))

        steps = frames = 0
        if self._reference is not None:
            self._publish_reference(bag)
            for step in recorded():
                frames += self._play_step(step, step.begin is not None and step.begin.step == self._reference)
                if step.begin is not None and step.begin.step == self._reference:
                    steps += 1
                    break
        for step in recorded():
            number = None if step.begin is None else step.begin.step
            wanted = (chosen is None or number in chosen) and (number is None or number != self._reference)
            frames += self._play_step(step, wanted)
            steps += wanted and number is not None
        self._barrier()
        return f"{steps} steps, {frames} frames, {len(self.problems)} problems"

    def _calibration(self) -> RigCalibration | None:
        """Return the calibration that replaces the recorded one."""
        file = self.parameters.value.calibration_file
        if not file:
            return None
        return calibration_message(RigModel.from_yaml(file), stamp_ns=self.get_clock().now().nanoseconds)

    @property
    def _reference(self) -> int | None:
        number = self.parameters.value.reference_step
        return None if number < 0 else number

    def _chosen_steps(self, bag: BagReader) -> set[int] | None:
        """Return which steps are asked for, with those that they are measured against; None for all."""
        names = bag.find_optional(STEP, REFERENCE)
        present, references = [], set()
        for topic, message, _ in bag.messages(names.values()):
            if topic == names[STEP]:
                present.append(message.step)
            else:
                references.add(message.step)
        asked = set(self.parameters.value.steps) | ({self._reference} if self._reference is not None else set())
        absent = sorted(asked - set(present))
        if absent:
            there = ", ".join(map(str, sorted(set(present))))
            raise ParameterError(f"{bag.path} has no step {', '.join(map(str, absent))}; it has {there}")
        if not self.parameters.value.steps:
            return None
        return asked if self._reference is not None else asked | references | {min(present)}

    def _publish_reference(self, bag: BagReader) -> None:
        """Announce the reference step that replaces the recorded ones."""
        topic = bag.find(STEP)[STEP]
        experiment = next(message.experiment for _, message, _ in bag.messages([topic]))
        self._publishers_by_topic[REFERENCE].publish(Reference(experiment=experiment, step=self._reference))
        self._ahead[REFERENCE] += 1

    def _play_step(self, step: RecordedStep, wanted: bool) -> int:
        """Play one step, wait for its answers and return the number of its frames.

        Of a step that is not wanted only what later steps need is played: parameters, calibration, references, load.
        """
        if self._reference is not None:
            step.messages = [message for message in step.messages if message.topic != REFERENCE]
        if not wanted:
            step = RecordedStep(None, [message for message in step.messages if message.topic not in OF_ONE_STEP])
        self._answers.clear()
        complete = step.begin is not None and is_complete(step)
        if step.begin is not None:
            self.get_logger().info(f"{_name(step.begin)}")
        for message in step.messages:
            if message.topic == NODE_PARAMETERS and self._give_parameters(message):
                continue
            if message.topic == STEP and _ends(message):
                if complete:
                    self._wait_for_answers(step.begin)
                else:
                    self._barrier()
            self._publish(message)
        if complete:
            self._wait_for_answers(step.begin)
        elif step.begin is not None:
            self._end_incomplete(step)
        return sum(message.topic == IMAGE for message in step.messages)

    def _publish(self, message: RawMessage) -> None:
        """Publish one message, when everybody has taken those that it depends on and those that it could push out."""
        name = message.topic
        announced = any(self._ahead[each] for each in ANNOUNCEMENTS)
        if (name == IMAGE and announced) or self._ahead[name] >= _depth(name) / 2:
            self._barrier()
        self._publishers_by_topic[name].publish(message.data)
        self._ahead[name] += 1

    def _end_incomplete(self, step: RecordedStep) -> None:
        """Settle a step whose last frame is not in the recording: nodes answer it only if its end was an error."""
        ends = [deserialize_message(each.data, StepStatus) for each in step.messages if each.topic == STEP]
        if any(each.stage == StepStatus.ERROR for each in ends):
            self._wait_for_answers(step.begin)
        elif any(each.stage == StepStatus.END for each in ends):
            self.problems.append(f"{_name(step.begin)}: frames are missing in the recording, no results")
        else:
            self.problems.append(f"{_name(step.begin)}: the recording ends within this step, no results")
        self._barrier()

    def _wait_for_nodes(self) -> None:
        """Wait until everybody who should listen has matched every topic he listens to."""

        def deaf() -> list[str]:
            missing = []
            for node, inputs in self._inputs().items():
                topics = [name for name in inputs if node not in self._listeners(name)]
                if topics:
                    missing.append(f"{node} (to {', '.join(topics)})")
            missing += [
                f"{node} (no parameter service)" for node, client in self._get.items() if not client.service_is_ready()
            ]
            return missing

        self._wait(lambda: not deaf(), lambda: f"these nodes do not listen: {'; '.join(deaf())}")
        for name, publisher in self._publishers_by_topic.items():
            listeners = sum(name in inputs for inputs in self._inputs().values())
            self._wait(
                partial(_has_subscribers, publisher, listeners), f"{name} has not reached everybody who listens".format
            )
        matching = self._matching.unmatched
        self._wait(
            lambda: not matching(PUBLISHED), lambda: f"{', '.join(matching(PUBLISHED))}: not everybody is reached"
        )

    def _inputs(self) -> dict[str, list[str]]:
        """Return which topics each expected node must listen to."""
        played = self._publishers_by_topic
        inputs = {
            node: [name for name in names if name in played or name in DERIVED_TOPICS]
            for node, names in PROCESSING_INPUTS.items()
        }
        if self.parameters.value.recorder:
            inputs["recorder"] = [*played, *DERIVED_TOPICS]
        return inputs

    def _listeners(self, name: str) -> set[str]:
        return {each.node_name for each in self.get_subscriptions_info_by_topic(self.resolve_topic_name(name))}

    def _expected_nodes(self) -> list[str]:
        return [*PROCESSING_INPUTS, *(["recorder"] if self.parameters.value.recorder else [])]

    def _barrier(self) -> None:
        """Return when every node has handled what was published so far.

        The acknowledgements say that everything has reached them; and a node's executor takes messages before service
        requests, so that its answer to a request follows the handling of all of it.
        """
        for name in self._ahead:
            self._publishers_by_topic[name].wait_for_all_acked()
        calls = {node: client.call_async(GetParameters.Request()) for node, client in self._get.items()}
        self._wait_for_calls(calls)
        self._ahead.clear()

    def _give_parameters(self, message: RawMessage) -> bool:
        """Set recorded parameters in the processing node that they belong to; False when it is not among them."""
        recorded = deserialize_message(message.data, NodeParameters)
        if recorded.node not in self._set:
            return False
        chosen = [each for each in recorded.parameters if f"{recorded.node}.{each.name}" not in self._overrides]
        if not chosen:
            return True
        request = SetParametersAtomically.Request(parameters=chosen)
        call = self._set[recorded.node].call_async(request)
        self._wait_for_calls({recorded.node: call})
        result = call.result().result
        if not result.successful:
            self.problems.append(f"{recorded.node} refuses its recorded parameters: {result.reason}")
        return True

    def _wait_for_calls(self, calls: dict[str, Future]) -> None:
        def silent() -> str:
            return ", ".join(node for node, call in calls.items() if not call.done())

        self._wait(lambda: not silent(), lambda: f"no answer from {silent()}")

    def _answered(self, status: NodeStatus) -> None:
        self._answers[status.node] = status
        if status.error_code != NodeStatus.NONE:
            self.get_logger().warning(f"{status.node}, step {status.step}: {status.error_message}")

    def _wait_for_answers(self, step: StepStatus) -> None:
        def silent() -> list[str]:
            return [
                node
                for node in PROCESSING_INPUTS
                if node not in self._answers
                or (self._answers[node].experiment, self._answers[node].step) != (step.experiment, step.step)
            ]

        def words() -> str:
            said = ", ".join(f"{node}: {each.error_message or 'done'}" for node, each in self._answers.items())
            return f"{_name(step)}: no status from {', '.join(silent())} (from others: {said or 'none'})"

        self._wait(lambda: not silent(), words)

    def _wait(self, done: Callable[[], bool], words: Callable[[], str]) -> None:
        """Spin until `done`; the time-out only ends a replay that would never end."""
        timeout = self.parameters.value.timeout_s
        end = self.get_clock().now().nanoseconds + int(timeout * 1e9)
        while not done():
            self._spinner.spin_once(timeout_sec=0.05)
            if self.get_clock().now().nanoseconds > end:
                raise NotAnsweredError(f"{words()} after {timeout:g} s")


def _played(bag: BagReader, names: Mapping[str, str]) -> Iterator[RawMessage]:
    """Yield the messages under their relative names; calibrations of an older definition become those of today's."""
    for message in bag.published(names):
        name, data = names[message.topic], message.data
        if name == CALIBRATION and bag.topics[message.topic].hash != type_hash("fringedic_msgs/msg/RigCalibration"):
            recorded = bag.decode(message.topic, data)
            model, frame = RigModel.from_message(recorded), recorded.header.frame_id
            data = serialize_message(calibration_message(model, stamp_ns=stamp_of(recorded), frame_id=frame))
        yield message._replace(topic=name, data=data)


def split_steps(messages: Iterable[RawMessage]) -> Iterator[RecordedStep]:
    """Cut messages with relative topic names, in the order of publishing, at the BEGIN of each step."""
    current = RecordedStep(None)
    for message in messages:
        if message.topic == STEP:
            status = deserialize_message(message.data, StepStatus)
            if status.stage == StepStatus.BEGIN:
                yield current
                current = RecordedStep(status)
        current.messages.append(message)
    yield current


def is_complete(step: RecordedStep) -> bool:
    """Return whether the last frame of a step's sequence is there with its exposure record.

    Then the nodes answer by themselves, with an error if an earlier frame is missing.
    """
    images = {header_stamp(each.data) for each in step.messages if each.topic == IMAGE}
    for message in step.messages:
        if message.topic == EXPOSURE:
            exposure = deserialize_message(message.data, Exposure)
            if exposure.index == exposure.count - 1 and to_nanoseconds(exposure.header.stamp) in images:
                return True
    return False


def _depth(name: str) -> int:
    return PROFILES.get(name, EVENTS).depth


def _has_subscribers(publisher: Publisher, count: int) -> bool:
    return publisher.get_subscription_count() >= count


def _ends(message: RawMessage) -> bool:
    return deserialize_message(message.data, StepStatus).stage in (StepStatus.END, StepStatus.ERROR)


def _name(step: StepStatus) -> str:
    return f"experiment '{step.experiment}', step {step.step}"


def main() -> None:
    """Play the recording named by the parameter ``bag_path``; the exit code is 0 when everybody answered."""
    rclpy.init()
    player = None
    try:
        player = PlayerNode()
        print(player.play(), flush=True)
        for problem in player.problems:
            print(problem, flush=True)
        code = 0
    except FringedicError as error:
        print(error, file=sys.stderr, flush=True)
        code = 1
    except (KeyboardInterrupt, ExternalShutdownException):
        print("the replay was interrupted", file=sys.stderr, flush=True)
        code = 1
    finally:
        if player:
            player.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)
