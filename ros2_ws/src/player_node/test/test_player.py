"""The player node: order of the messages, flow control, status, and errors."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue, SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.recording.topics import RawMessage
from fringedic.recording.writer import BagWriter
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import Exposure, NodeParameters, NodeStatus, Reference, RigCalibration, StepStatus
from fringedic_ros.images import image_message
from fringedic_ros.matching import offer_reader_counts
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY
from fringedic_ros.records import exposure_message
from fringedic_ros.spinning import Spinning
from fringedic_ros.topics import EXPOSURE, IMAGE, PROCESSING_INPUTS, PUBLISHED, STEP
from player_node.playback_nodes import PlaybackNodes
from player_node.recorded_steps import RecordedStep, split_steps

FRAMES = 40  # more than the player has on their way at once
FRINGES = ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 10.0, 1, 4)


class Bag:
    """A recording in the making; every message is published a millisecond after the one before."""

    def __init__(self, path: Path) -> None:
        self._writer = BagWriter(path)
        self._time = 1_000_000_000

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def add(self, name: str, message: Any) -> None:
        kind = type(message)
        package = kind.__module__.split(".")[0]
        self._writer.add_topic(f"/rig/{name}", f"{package}/msg/{kind.__name__}")
        self._time += 1_000_000
        self._writer.write(f"/rig/{name}", serialize_message(message), self._time, self._time)

    def stage(self, step: int, stage: int) -> None:
        self.add(STEP, StepStatus(experiment="test", step=step, stage=stage))

    def frame(self, step: int, index: int, count: int) -> None:
        stamp = 1_000_000 * (step + 1) + index
        pixels = np.full((6, 8), index, np.uint8)
        record = FrameRecord("test", step, index, count, FRINGES, stamp, 0.01)
        self.add(IMAGE, image_message(pixels, stamp_ns=stamp, frame_id="camera_optical_frame"))
        self.add(EXPOSURE, exposure_message(record, frame_id="camera_optical_frame"))

    def step(self, step: int, *, missing: int | None = None, count: int = FRAMES) -> None:
        self.stage(step, StepStatus.BEGIN)
        for index in range(count):
            if index != missing:
                self.frame(step, index, count)
        self.stage(step, StepStatus.PROCESS)
        self.stage(step, StepStatus.ERROR if missing is not None else StepStatus.END)


class ScriptedNode(Node):
    """Substitute for a processing node: subscribes to its inputs and answers a step after its last exposure record.

    `journal` lists the actions of all nodes in their order.
    """

    def __init__(self, name: str, journal: list[tuple[str, str, int]], silent: bool = False) -> None:
        super().__init__(name, namespace="rig")
        self._journal = journal
        self._silent = silent
        for topic in PUBLISHED[name]:
            publisher = self.create_publisher(NodeStatus, topic, EVENTS)
            if topic == f"{name}/status":
                self._status = publisher
        offer_reader_counts(self, name)
        self.declare_parameter("window", 0)
        self.add_on_set_parameters_callback(self._set)
        kinds: dict[str, tuple[type, Callable[[Any], None], Any]] = {
            "calibration": (RigCalibration, lambda _: self._note("calibration"), LATCHED),
            "experiment/reference": (Reference, lambda message: self._note("reference", message.step), LATCHED),
            STEP: (StepStatus, self._take_step, EVENTS),
            IMAGE: (Image, lambda message: self._note("image", message.data[0]), IMAGES),
            EXPOSURE: (Exposure, self._take_exposure, IMAGES),
        }
        for topic in PROCESSING_INPUTS[name]:
            kind, callback, qos = kinds.get(topic, (NodeStatus, lambda _: None, EVENTS))
            self.create_subscription(kind, topic, callback, qos)

    def _note(self, what: str, number: int = 0) -> None:
        self._journal.append((self.get_name(), what, number))

    def _set(self, parameters: list[Any]) -> SetParametersResult:
        self._note("window", parameters[0].value)
        return SetParametersResult(successful=True)

    def _take_exposure(self, message: Exposure) -> None:
        if message.index == message.count - 1 and self.get_name() != "coupling":
            self._answer(message.experiment, message.step)

    def _take_step(self, message: StepStatus) -> None:
        self._note(("begin", "capture", "process", "end", "error")[message.stage], message.step)
        if message.stage == StepStatus.ERROR or (message.stage == StepStatus.PROCESS and self.get_name() == "coupling"):
            self._answer(message.experiment, message.step)

    def _answer(self, experiment: str, step: int) -> None:
        if not self._silent and (self.get_name(), "answer", step) not in self._journal:
            self._note("answer", step)
            self._status.publish(NodeStatus(node=self.get_name(), experiment=experiment, step=step))


@pytest.fixture
def graph(spinning: Spinning) -> Callable[..., list[tuple[str, str, int]]]:
    """Start the processing nodes and return their journal."""

    def start(silent: str = "") -> list[tuple[str, str, int]]:
        journal: list[tuple[str, str, int]] = []
        for name in PROCESSING_INPUTS:
            spinning.add(ScriptedNode(name, journal, silent=name == silent))
        return journal

    return start


@pytest.fixture
def statuses(spinning: Spinning) -> list[StepStatus]:
    """The statuses that the player has published."""
    received: list[StepStatus] = []
    node = spinning.add(Node("progress", namespace="rig"))
    node.create_subscription(StepStatus, "player/status", received.append, LATCHED_BY_MANY)
    return received


def play(bag: Path, **parameters: Any) -> subprocess.CompletedProcess[str]:
    values = {"bag_path": str(bag), "timeout_s": 30.0} | parameters
    arguments = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return subprocess.run(
        [
            *(sys.executable, "-c", "import sys; from player_node.player_node import main; sys.exit(main())"),
            *("--ros-args", "-r", "__ns:=/rig", *arguments),
        ],
        capture_output=True,
        text=True,
        timeout=300,
    )


def of(journal: list[tuple[str, str, int]], node: str, *kinds: str) -> list[tuple[str, int]]:
    return [(what, number) for name, what, number in journal if name == node and what in kinds]


def test_steps_follow_each_other_and_no_frame_is_lost(graph: Callable[..., Any], tmp_path: Path) -> None:
    journal = graph()
    with Bag(tmp_path / "bag") as bag:
        bag.add("calibration", RigCalibration())
        bag.add("experiment/reference", Reference(experiment="test", step=0))
        bag.step(0)
        bag.add("experiment/reference", Reference(experiment="test", step=1))
        bag.step(1)
    played = play(tmp_path / "bag")
    assert played.returncode == 0, played.stderr
    assert f"2 steps, {2 * FRAMES} frames, 0 problems" in played.stdout
    assert of(journal, "phase", "image") == 2 * [("image", index) for index in range(FRAMES)]
    assert of(journal, "dic", "reference", "answer") == [
        ("reference", 0),
        ("answer", 0),
        ("reference", 1),
        ("answer", 1),
    ]
    assert of(journal, "coupling", "calibration", "answer")[0] == ("calibration", 0)
    assert of(journal, "coupling", "begin", "process", "end") == [
        ("begin", 0),
        ("process", 0),
        ("end", 0),
        ("begin", 1),
        ("process", 1),
        ("end", 1),
    ]
    dic = of(journal, "dic", "reference", "image")
    assert dic.index(("reference", 1)) == 1 + FRAMES  # before the first image of its step
    ends = [place for place, entry in enumerate(journal) if entry[1:] == ("begin", 1)]
    answers = [place for place, entry in enumerate(journal) if entry[1:] == ("answer", 0)]
    assert max(answers) < min(ends)


def test_a_step_that_failed_is_played_as_such_and_the_next_one_follows(
    graph: Callable[..., Any], tmp_path: Path
) -> None:
    journal = graph()
    with Bag(tmp_path / "bag") as bag:
        bag.step(0, missing=2, count=4)  # its last frame is there: nodes answer by themselves
        bag.step(1, missing=3, count=4)  # its last frame is not: nodes answer when the experiment gives up
        bag.step(2, count=4)
    played = play(tmp_path / "bag")
    assert played.returncode == 0, played.stderr
    assert "3 steps, 10 frames, 0 problems" in played.stdout
    assert [step for _, step in of(journal, "phase", "answer")] == [0, 1, 2]
    assert journal.index(("phase", "error", 1)) < journal.index(("phase", "answer", 1))


def test_a_recording_that_was_cut_off_is_reported(
    graph: Callable[..., Any], statuses: list[StepStatus], tmp_path: Path
) -> None:
    graph()
    with Bag(tmp_path / "bag") as bag:
        bag.step(0, count=4)
        bag.stage(1, StepStatus.BEGIN)
        bag.frame(1, 0, 4)
    played = play(tmp_path / "bag")
    assert played.returncode == 0, played.stderr
    message = "the recording ends within this step, no results"
    assert f"experiment 'test', step 1: {message}" in played.stdout
    assert [(each.step, each.stage, each.frame, each.frames) for each in statuses] == [
        (0, StepStatus.BEGIN, 0, 4),
        (0, StepStatus.END, 4, 4),
        (1, StepStatus.BEGIN, 0, 1),
        (1, StepStatus.ERROR, 1, 1),
    ]
    assert (statuses[-1].error_code, statuses[-1].error_message) == (MeasureStep.Result.RECORDER_FAILED, message)


def test_recorded_parameters_reach_the_nodes_unless_overridden(graph: Callable[..., Any], tmp_path: Path) -> None:
    journal = graph()
    with Bag(tmp_path / "bag") as bag:
        for step, window in enumerate((24, 48)):
            value = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=window)
            # serialize_message appends bytes to a message with empty lists, which no publisher sends
            value.integer_array_value, value.double_array_value = [0], [0.0]
            for node in ("phase", "dic"):
                names = ("window", "parameter_of_another_version")
                parameters = [Parameter(name=name, value=value) for name in names]
                bag.add("node_parameters", NodeParameters(node=node, parameters=parameters))
            bag.step(step, count=4)
    assert play(tmp_path / "bag", overrides="[phase.window]").returncode == 0
    assert of(journal, "phase", "window") == []
    assert of(journal, "dic", "window", "begin") == [("window", 24), ("begin", 0), ("window", 48), ("begin", 1)]


def test_a_node_that_does_not_answer_is_named(graph: Callable[..., Any], tmp_path: Path) -> None:
    graph(silent="dic")
    with Bag(tmp_path / "bag") as bag:
        bag.step(0, count=4)
    played = play(tmp_path / "bag", timeout_s=5.0)
    assert played.returncode == 1
    assert "experiment 'test', step 0: no status from dic" in played.stderr


def test_statuses_that_came_while_the_player_stood_still_are_taken(spinning: Spinning) -> None:
    """The player takes one message per turn, and its limit is over before the first."""
    nodes = spinning.add(Node("nodes"))
    player = Node("player")
    playback = PlaybackNodes(player, recorder=False, timeout_s=0.6)
    publishers = {name: nodes.create_publisher(NodeStatus, f"{name}/status", EVENTS) for name in PROCESSING_INPUTS}
    for publisher in publishers.values():
        while not publisher.get_subscription_count():
            time.sleep(0.01)

    def stand_still() -> None:
        stop.cancel()
        for name, publisher in publishers.items():
            publisher.publish(NodeStatus(node=name, experiment="test", step=4))
            assert publisher.wait_for_all_acked(Duration(seconds=60))
        time.sleep(1.0)

    stop = player.create_timer(0.0, stand_still)
    assert playback.await_statuses(StepStatus(experiment="test", step=4)).keys() == publishers.keys()
    player.destroy_node()


@pytest.mark.usefixtures("graph")
def test_nodes_that_are_not_there_are_named(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag") as bag:
        bag.step(0, count=4)
    played = play(tmp_path / "bag", timeout_s=2.0)
    assert played.returncode == 1
    assert "phase" in played.stderr
    assert "coupling" in played.stderr


def test_a_bag_without_frames_is_refused_with_words(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag") as bag:
        bag.stage(0, StepStatus.BEGIN)
    played = play(tmp_path / "bag")
    assert played.returncode == 1
    assert "camera/image_raw" in played.stderr
    assert "Traceback" not in played.stderr


def test_a_reference_is_that_of_one_experiment(tmp_path: Path) -> None:
    """The second experiment would be measured against a step of its own."""
    with Bag(tmp_path / "bag") as bag:
        bag.step(0)
        bag.add(STEP, StepStatus(experiment="later", step=0, stage=StepStatus.BEGIN))
    played = play(tmp_path / "bag", reference_step=0)
    assert played.returncode == 1
    assert "holds the experiments later, test: replay it without a reference" in played.stderr


def test_messages_are_cut_into_steps_at_each_begin() -> None:
    def stage(step: int, stage: int) -> RawMessage:
        return RawMessage(STEP, serialize_message(StepStatus(step=step, stage=stage)), 0, 0)

    messages = [
        RawMessage("calibration", b"", 0, 0),
        stage(0, StepStatus.BEGIN),
        stage(0, StepStatus.END),
        stage(1, StepStatus.BEGIN),
    ]
    before, first, second = split_steps(messages)
    assert before.begin is None
    assert before.messages == messages[:1]
    assert first.begin is not None
    assert first.begin.step == 0
    assert first.messages == messages[1:3]
    assert second.begin is not None
    assert second.begin.step == 1
    assert second.messages == messages[3:]


def test_a_step_is_complete_with_the_image_and_the_record_of_its_last_frame() -> None:
    record = exposure_message(FrameRecord("test", 0, 3, 4, FRINGES, 77, 0.01), frame_id="")
    image = image_message(np.zeros((2, 2), np.uint8), stamp_ns=77, frame_id="")
    messages = [
        RawMessage(EXPOSURE, serialize_message(record), 0, 0),
        RawMessage(IMAGE, serialize_message(image), 0, 0),
    ]
    assert RecordedStep(None, messages).is_complete
    assert not RecordedStep(None, messages[:1]).is_complete
    assert not RecordedStep(None, messages[1:]).is_complete
