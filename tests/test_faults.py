"""Faults injected into the running system: a named error, no node ends, and the next step works."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from faulty_rig import action, set_parameters
from running_system import CONFIG, WORKING, Progress, wait_until
from sensor_msgs.msg import Image

import fringedic
from fringedic.configuration.programme import Programme
from fringedic.errors import StepFailedError
from fringedic.recording.reader import BagReader
from fringedic.recording.repair import recover
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import Graph, NodeEntry, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.driving import drive
from fringedic_bringup.procedures.run import load_rig
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import Exposure
from fringedic_ros.images import image_message
from fringedic_ros.qos import IMAGES
from fringedic_ros.stamps import to_msg, to_nanoseconds

AHEAD_NS = 60_000_000_000  # [ns] of frames of another node
SETTLE_S, LONG_S = 0.15, 0.6  # [s] before each frame: time for others to interfere, also on a busy computer


class Rig:
    """A running tiny virtual rig and its client."""

    def __init__(self, running: RunningGraph, client: RigClient, folder: Path) -> None:
        self.running, self.client, self.folder = running, client, folder
        self.exposures: list[Exposure] = []
        self.images = self.client.node.create_publisher(Image, "camera/image_raw", IMAGES)
        self.records = self.client.node.create_publisher(Exposure, "camera/exposure", IMAGES)
        self.client.node.create_subscription(Exposure, "camera/exposure", self.exposures.append, IMAGES)

    def measure(self) -> MeasureStep.Result:
        """Measure a step that has to succeed."""
        result = self.client.measure()
        assert result.valid_fraction > WORKING
        return result

    def inject(self, index: int, image: np.ndarray, *, after: int) -> MeasureStep.Result:
        """Measure a step into which another node sends a frame with this index, after the real frame ``after``."""
        done = []
        self.exposures.clear()  # those of earlier steps may still be in the queue of the client
        begun = time.time_ns()

        def interfere(feedback: MeasureStep.Feedback) -> None:
            new = [each for each in self.exposures if to_nanoseconds(each.header.stamp) > begun]
            mine = [each for each in new if each.index == after]
            if feedback.frame > after and mine and not done:
                done.append(mine[-1])
                record = mine[-1]
                record.index = index
                # later than the real frames that may overtake it: of frames that wait, those older than a pair are lost
                stamp = to_nanoseconds(record.header.stamp) + AHEAD_NS
                record.header.stamp = to_msg(stamp)
                self.images.publish(image_message(image, stamp_ns=stamp, frame_id="camera_optical_frame"))
                self.records.publish(record)

        assert set_parameters(self.client, "camera", {"settle_ms": 1e3 * LONG_S}).successful
        try:
            return self.client.measure(feedback=interfere)
        finally:
            assert set_parameters(self.client, "camera", {"settle_ms": 1e3 * SETTLE_S}).successful
            assert done, "the frame was not injected"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("faults")
    path = CONFIG / "tiny.yaml"
    rig_file, _ = load_rig(path, None, None)
    graph = rig_graph(rig_file, path, folder, experiment="faults")
    graph = _with(graph, "experiment", camera_timeout_s=10.0, start_timeout_s=10.0)
    graph = _with(graph, "camera", settle_ms=1e3 * SETTLE_S)
    with (
        RunningGraph(graph, folder / "logs") as running,
        RigClient(graph.namespace) as client,
    ):
        client.wait_until_ready(graph.names)
        rig = Rig(running, client, folder)
        rig.measure()
        yield rig


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
    with action(rig.client, MeasureStep, "measure_step", "experiment") as measure:
        first, second = (measure.send_goal_async(goal) for _ in range(2))
        rig.client.wait_for(lambda: first.done() and second.done(), 20.0, lambda: "goals")
        results = [each.result().get_result_async() for each in (first, second)]
        rig.client.wait_for(lambda: all(each.done() for each in results), 60.0, lambda: "results")
    codes = [each.result().result.error_code for each in results]
    assert codes == [MeasureStep.Result.NONE, MeasureStep.Result.BUSY]
    assert "is being measured" in results[1].result().result.error_message
    rig.measure()


def test_a_programme_waits_while_another_controller_measures(rig: Rig) -> None:
    goal = MeasureStep.Goal(mode=MeasureStep.Goal.FRINGES, controller="other")
    with action(rig.client, MeasureStep, "measure_step", "experiment") as measure:

        class Interfering(Progress):
            """Starts a step of the other controller when the programme holds before its own."""

            def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
                if text == "hold" and not self.lines:
                    sent = measure.send_goal_async(goal)
                    rig.client.wait_for(sent.done, 20.0, lambda: "the other goal")
                super().step(number, last, text, frame, frames)

        progress = Interfering()
        programme = Programme.model_validate({"experiment": "faults", "steps": [{"mode": "white", "hold_s": 0.1}]})
        (report,), *_ = drive(rig.running, programme, progress)
    assert not report.error
    [waits] = [line for line in progress.lines if line.startswith("the programme waits")]
    assert re.search(r": step \d+ is being measured for other; programme has to wait", waits)


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
    result = set_parameters(rig.client, node, {name: value})
    assert not result.successful
    assert name in result.reason
    rig.measure()


def test_camera_that_stops_answering(rig: Rig) -> None:
    os.kill(rig.running.pid("camera"), signal.SIGSTOP)
    try:
        with pytest.raises(StepFailedError, match=r"step \d+: frame 0: .*capture did not answer: its node has ended"):
            rig.client.measure()
    finally:
        os.kill(rig.running.pid("camera"), signal.SIGCONT)
    rig.measure()


def test_a_step_that_is_interrupted_before_its_acceptance_does_not_run_on(rig: Rig) -> None:
    """It would keep the rig busy, and the following steps of a programme would fail at once."""
    interrupted = False

    def watch() -> None:
        if interrupted:
            raise InterruptedError

    with RigClient(rig.running.graph.namespace, watch=watch, name="interrupted") as client:
        client.wait_until_ready(["experiment"])
        os.kill(rig.running.pid("experiment"), signal.SIGSTOP)
        try:
            interrupted = True
            with pytest.raises(InterruptedError):
                client.measure()
            with pytest.raises(InterruptedError):
                client.cancel()
        finally:
            os.kill(rig.running.pid("experiment"), signal.SIGCONT)
        interrupted = False
        client.cancel()
        assert client.measure().valid_fraction > WORKING


def test_camera_that_was_killed_and_started_again(rig: Rig) -> None:
    os.kill(rig.running.pid("camera"), signal.SIGKILL)
    wait_until(lambda: rig.running.exit_code("camera") is not None, "the end of the camera")
    with pytest.raises(StepFailedError, match=r"step \d+.*camera/capture"):
        rig.client.measure()
    rig.running.restart("camera")

    def works() -> bool:
        rig.running.check()
        try:
            rig.measure()
        except StepFailedError:  # the new node is starting, and the graph still lists the one that was killed
            return False
        return True

    wait_until(works, "a step with the new camera", timeout_s=300.0)


def test_recording_is_readable_after_the_recorder_was_killed(rig: Rig) -> None:
    """Last in this module, because no recorder is left."""
    result = rig.measure()
    wait_until(lambda: BagReader(rig.folder / "bag").counts, "something on the disk")
    os.kill(rig.running.pid("recorder"), signal.SIGKILL)
    wait_until(lambda: rig.running.exit_code("recorder") is not None, "the end of the recorder")
    with pytest.raises(StepFailedError, match=r"recorder (does not answer|stopped recording)"):
        rig.client.measure()
    reader = BagReader(rig.folder / "bag")
    ends = [
        message.step for _, message, _ in reader.messages(reader.find("experiment/step").values()) if message.stage == 3
    ]
    assert result.step in ends
    whole = recover(rig.folder / "bag", rig.folder / "recovered").path
    # an experiment node that was started again by hand has used some of the other numbers twice
    processed = fringedic.process_bag(whole, output=rig.folder / "recovered.nc", steps={result.step})
    with fringedic.open_experiment(processed) as dataset:
        last = dataset.sel(step=result.step)
        assert np.isfinite(last.w.values).mean() > WORKING
