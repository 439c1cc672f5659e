"""Faults injected into the running system: a named error, everybody lives on, and the next step works."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import CONFIG, Told, processes_of, segments, wait_until
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image

import fringedic
from fringedic.errors import MissingTopicError, NodeDiedError, RecordingError, StepFailedError
from fringedic.recording import BagReader, BagWriter, recover
from fringedic_bringup.client import RigClient
from fringedic_bringup.graph import Graph, NodeEntry, rig_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.replay import replay
from fringedic_bringup.report import RunReport
from fringedic_bringup.run import load_rig, run_experiment
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import Exposure
from fringedic_ros.images import image_message
from fringedic_ros.qos import IMAGES
from fringedic_ros.stamps import to_msg, to_nanoseconds


class Rig:
    """A running tiny virtual rig and its client."""

    def __init__(self, running: RunningGraph, client: RigClient, folder: Path) -> None:
        self.running, self.client, self.folder = running, client, folder
        self.node = client._node
        self.exposures: list[Exposure] = []
        self.images = self.node.create_publisher(Image, "camera/image_raw", IMAGES)
        self.records = self.node.create_publisher(Exposure, "camera/exposure", IMAGES)
        self.node.create_subscription(Exposure, "camera/exposure", self.exposures.append, IMAGES)

    def measure(self) -> MeasureStep.Result:
        """Measure a step that must work."""
        result = self.client.measure()
        assert result.valid_fraction > 0.85
        return result

    def inject(self, index: int, image: np.ndarray, *, after: int) -> MeasureStep.Result:
        """Measure a step into which a stranger sends a frame with this index, after the real frame ``after``."""
        done = []

        def interfere(feedback: MeasureStep.Feedback) -> None:
            mine = [each for each in self.exposures if each.index == after and each.step == self.exposures[-1].step]
            if feedback.frame > after and mine and not done:
                done.append(mine[-1])
                record = mine[-1]
                record.index = index
                stamp = to_nanoseconds(record.header.stamp) + 1000
                record.header.stamp = to_msg(stamp)
                self.images.publish(image_message(image, stamp_ns=stamp, frame_id="camera_optical_frame"))
                self.records.publish(record)

        try:
            return self.client.measure(feedback=interfere)
        finally:
            assert done, "the frame was not injected"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("faults")
    path = CONFIG / "tiny.yaml"
    rig_file, _ = load_rig(path, None, None)
    graph = _with(rig_graph(rig_file, path, folder, experiment="faults"), "experiment", camera_timeout_s=4.0)
    with (
        RunningGraph(graph, folder / "logs") as running,
        RigClient(graph.namespace, watch=lambda: None) as client,
    ):
        client.wait_until_ready(graph.names)
        rig = Rig(running, client, folder)
        rig.measure()
        yield rig
        running.check()


def _with(graph: Graph, name: str, **parameters: object) -> Graph:
    """Return the graph with further parameters of one node."""
    nodes = [
        NodeEntry(each.name, each.package, each.executable, {**each.parameters, **parameters})
        if each.name == name
        else each
        for each in graph.nodes
    ]
    return Graph(graph.namespace, tuple(nodes))


def test_a_second_step_while_one_runs_is_refused(rig: Rig) -> None:
    goal = MeasureStep.Goal(mode=MeasureStep.Goal.FRINGES)
    first, second = (rig.client._measure.send_goal_async(goal) for _ in range(2))
    rig.client._wait(lambda: first.done() and second.done(), 20.0, lambda: "goals")
    results = [each.result().get_result_async() for each in (first, second)]
    rig.client._wait(lambda: all(each.done() for each in results), 60.0, lambda: "results")
    codes = [each.result().result.error_code for each in results]
    assert codes == [MeasureStep.Result.NONE, MeasureStep.Result.BUSY]
    assert "is being measured" in results[1].result().result.error_message
    rig.measure()


def test_doubled_frame(rig: Rig) -> None:
    with pytest.raises(StepFailedError, match=r"step \d+.*phase: .*frame 3 arrived twice"):
        rig.inject(3, np.zeros((120, 160), np.uint8), after=3)
    rig.measure()


def test_frame_of_another_size(rig: Rig) -> None:
    with pytest.raises(StepFailedError, match=r"step \d+.*frame 9 is 100x80 px, the step began with 160x120 px"):
        rig.inject(9, np.zeros((80, 100), np.uint8), after=3)
    rig.measure()


def test_frame_of_another_pixel_type(rig: Rig) -> None:
    with pytest.raises(StepFailedError, match=r"step \d+.*frame 9 has pixels of type uint16"):
        rig.inject(9, np.zeros((120, 160), np.uint16), after=3)
    rig.measure()


def test_late_frame_is_counted_and_changes_nothing(rig: Rig) -> None:
    result = rig.measure()
    late = next(each for each in rig.exposures if each.step == result.step and each.index == 2)
    late.header.stamp = to_msg(to_nanoseconds(late.header.stamp) + 1000)
    image = np.zeros((120, 160), np.uint8)
    stamp = to_nanoseconds(late.header.stamp)
    rig.images.publish(image_message(image, stamp_ns=stamp, frame_id="camera_optical_frame"))
    rig.records.publish(late)
    assert rig.measure().step == result.step + 1


@pytest.mark.parametrize(
    ("node", "name", "value"), [("coupling", "z_filter_px", float("nan")), ("dic", "window", 1), ("dic", "window", -5)]
)
def test_unusable_parameters_are_refused(rig: Rig, node: str, name: str, value: float) -> None:
    client = rig.node.create_client(SetParametersAtomically, f"{node}/set_parameters_atomically")
    rig.client._wait(client.service_is_ready, 10.0, lambda: "parameter service")
    request = SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    result = rig.client._call(client, request).result
    assert not result.successful
    assert name in result.reason
    rig.measure()


def test_camera_that_stops_answering(rig: Rig) -> None:
    os.kill(rig.running.pid("camera"), signal.SIGSTOP)
    try:
        with pytest.raises(StepFailedError, match=r"step \d+: frame 0: .*camera/capture did not answer in 4 s"):
            rig.client.measure()
    finally:
        os.kill(rig.running.pid("camera"), signal.SIGCONT)
    rig.measure()


def test_camera_that_was_killed_and_started_again(rig: Rig) -> None:
    os.kill(rig.running.pid("camera"), signal.SIGKILL)
    wait_until(lambda: rig.running.exit_code("camera") is not None, "the end of the camera")
    with pytest.raises(StepFailedError, match=r"step \d+.*camera/capture"):
        rig.client.measure()
    rig.running.restart("camera")
    rig.client.wait_until_ready(["camera", "recorder"])
    rig.measure()


def test_what_was_recorded_stays_readable_while_faults_go_on(rig: Rig) -> None:
    """Last in this module: the recorder itself is killed; what it had flushed is whole."""
    result = rig.measure()
    wait_until(lambda: BagReader(rig.folder / "bag").counts, "something on the disk")
    os.kill(rig.running.pid("recorder"), signal.SIGKILL)
    wait_until(lambda: rig.running.exit_code("recorder") is not None, "the end of the recorder")
    with pytest.raises(StepFailedError, match="recorder"):
        rig.client.measure()
    reader = BagReader(rig.folder / "bag")
    ends = [
        message.step for _, message, _ in reader.messages(reader.find("experiment/step").values()) if message.stage == 3
    ]
    print(f"steps that ended well before the recorder was killed: {ends}; damage: {reader.lost or 'none'}")
    assert result.step in ends
    whole = recover(rig.folder / "bag", rig.folder / "recovered")
    with fringedic.open_experiment(fringedic.process_bag(whole, output=rig.folder / "recovered.nc")) as dataset:
        last = dataset.sel(step=result.step)
        assert np.isfinite(last.w.values).mean() > 0.85
    rig.running.expect_end("recorder")
    rig.running.restart("recorder")  # its folder exists: it says so, and the others go on


def test_a_node_that_dies_fails_the_run_with_its_log(tiny: Path, tmp_path: Path) -> None:
    rig_file, _ = load_rig(tiny, None, None)
    graph = rig_graph(rig_file, tiny, tmp_path, experiment="dying")
    with (
        RunningGraph(graph, tmp_path / "logs") as running,
        RigClient(graph.namespace, watch=running.check) as client,
        pytest.raises(NodeDiedError, match=r"dic was ended by SIGKILL[\s\S]*dic\.log"),
    ):
        client.wait_until_ready(graph.names)
        os.kill(running.pid("dic"), signal.SIGKILL)
        client.measure()


def test_unreadable_image_fails_one_step(tmp_path: Path) -> None:
    """Of five images one is no image: its step fails with the file's name, the others are measured."""
    import cv2

    images = tmp_path / "images"
    images.mkdir()
    generator = np.random.default_rng(7)
    speckle = cv2.GaussianBlur(generator.normal(128, 120, (140, 180)), (0, 0), 1.5)
    for number in range(5):
        cv2.imwrite(str(images / f"load_{number}.png"), np.clip(speckle[5:125, number : 160 + number], 0, 255))
    (images / "load_2.png").write_bytes(b"this is no image")
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump({"camera": {"source": "files", "files": "images"}}))
    rig_file, programme = load_rig(path, None, None)
    told = Told()
    report = run_experiment(rig_file, path, programme, tmp_path / "run", told)
    errors = [step.error for step in report.steps]
    assert "load_2.png" in errors[2]
    assert not any(errors[:2] + errors[3:])
    with fringedic.open_experiment(report.folder / "bag") as dataset:
        # the window moves right over the pattern, so the pattern moves left by one pixel per image
        moved = dataset.displacement_x.sel(step=4).median().item()
    print(f"moved by {moved:.4f} px, true -4")
    assert abs(moved + 4.0) < 0.01


def test_recording_without_frames_is_refused(experiment: RunReport, tmp_path: Path) -> None:
    reader = BagReader(experiment.folder / "bag")
    step = reader.find("experiment/step")["experiment/step"]
    target = tmp_path / "bag"
    writer = BagWriter(target)
    writer.add_recorded_topic(reader.topics[step])
    for message in reader.raw([step]):
        writer.write(message.topic, message.data, message.log_time, message.publish_time)
    writer.close()
    with pytest.raises(MissingTopicError, match="camera/image_raw"):
        fringedic.process_bag(target)
    with pytest.raises((MissingTopicError, NodeDiedError), match="camera/image_raw"):
        replay(target, tmp_path / "replayed", Told())


def test_truncated_recording(experiment: RunReport, tmp_path: Path) -> None:
    """Cut off in the middle: it says what is lost, and the steps before the cut can be measured."""
    bag = tmp_path / "bag"
    shutil.copytree(experiment.folder / "bag", bag)
    [file] = bag.glob("*.mcap")
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size * 6 // 10)
    assert BagReader(bag).lost
    whole = recover(bag, tmp_path / "recovered")
    with fringedic.open_experiment(fringedic.process_bag(whole, output=tmp_path / "cut.nc")) as dataset:
        assert np.isfinite(dataset.u.sel(step=0).values).mean() > 0.85
        assert dataset.sizes["step"] < 3 or str(dataset.error.values[-1])
    assert replay(whole, tmp_path / "replayed", Told()).exists()


def test_text_file_instead_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match=r"bag_0\.mcap"):
        fringedic.process_bag(tmp_path / "bag")


def test_nothing_is_left_behind(tiny: Path, tmp_path: Path, domain: str) -> None:
    """Neither by nodes that end as told nor by one that was killed."""
    rig_file, _ = load_rig(tiny, None, None)
    graph = rig_graph(rig_file, tiny, tmp_path, experiment="leftovers")
    before = segments()
    with RunningGraph(graph, tmp_path / "logs") as running:
        wait_until(lambda: len(processes_of(domain)) >= len(graph.nodes), "the start of all nodes")
        wait_until(lambda: segments() - before, "shared memory of the nodes")
        os.kill(running.pid("phase"), signal.SIGKILL)
    assert not processes_of(domain)
    assert not segments() - before


def test_command_says_what_is_wrong_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nprojektor: {}\n")
    done = subprocess.run(
        ["fringedic", "run", str(tmp_path / "rig.yaml")], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    [sentence] = done.stderr.strip().splitlines()
    assert "rig.yaml" in sentence and "projektor: unknown key" in sentence
