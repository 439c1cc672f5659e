"""The experiment node against a scripted rig: requests, results, and the end of every fault."""

from __future__ import annotations

import math
import re
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.rig.model import RigModel
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic.settings.parameters import from_parameters
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import (
    Exposure,
    LoadState,
    NodeParameters,
    NodeStatus,
    RecorderStatus,
    Reference,
    ReferencePlane,
    RigCalibration,
    StepStatus,
)
from fringedic_msgs.srv import CaptureFrame, CountReaders, QueryStep, SetReference, ShowPattern, StartExperiment
from fringedic_ros.matching import discovered_readers
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY, STATE
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer
from fringedic_ros.waiting import sleep

FRAMES = 7
EXPOSURE_NS = 100_000  # short: the clock of the rig, which adds exposures up, stays behind the real time
SAMPLES_NS = 500_000_000  # longest time between two samples of the load frame
START_TIMEOUT = 3.0  # [s]
PARAMETERS = {
    "projector_width_px": 64,
    "projector_height_px": 48,
    "pitches_px": [64.0, 8.0],
    "shifts": [3, 4],
    "camera_timeout_s": 4.0,
    "projector_timeout_s": 4.0,
    "processing_timeout_s": 2.0,
    "input_timeout_s": 0.2,
    "start_timeout_s": START_TIMEOUT,
}
CALIBRATION = RigModel(**VirtualRig.from_preset("plate", size="tiny").optics(), identifier="of today")
Result = MeasureStep.Result


class Rig(Peer):
    """Projector, camera, load frame, recorder and processing nodes that follow the script of a test."""

    def __init__(self) -> None:
        super().__init__("rig")
        self.clock_ns = 0  # runs ahead of real time while frames are taken faster than their exposures last
        self.capturing = False
        self.shown: list[ShowPattern.Request] = []
        self.on_screen = Exposure.OTHER
        self.captured: list[CaptureFrame.Request] = []
        self.show_error = self.capture_error = 0
        self.hang: Future | None = None
        self.answers: dict[str, int] = {}
        self.silent: set[str] = set()
        self.reaches_all = True
        self.received = True  # by every processing node
        self.load_mode: int | None = None
        self.force, self.force_per_frame = 100.0, 1.0  # [N]
        self.load_clock_ahead_ns = self.camera_clock_ahead_ns = 0
        self.moves_at_frame = self.last_sampled_frame = -1
        self.jump_before: int | None = None  # the frame before which the clock jumps back
        self.misnamed = ""  # the messages that get the name of another step
        self.load_jumps_at_frame = -1  # at which the clock of the load frame is set back
        self.holds = 0
        self.steps = self.listen(StepStatus, "experiment/step", EVENTS)
        self.references = self.listen(Reference, "experiment/reference", LATCHED)
        self.node_parameters = self.listen(NodeParameters, "node_parameters", LATCHED_BY_MANY)
        self.images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self.image_readers = [self.create_subscription(Image, "camera/image_raw", lambda _: None, IMAGES)]
        self.exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self.load: Any = None
        self.create_timer(0.01, self._sample_load)
        self.recorder: Any = None
        self.statuses = {
            name: self.create_publisher(NodeStatus, f"{name}/status", EVENTS) for name in ("phase", "dic", "coupling")
        }
        group = ReentrantCallbackGroup()
        self.create_service(ShowPattern, "projector/show", self._show, callback_group=group)
        self.capture = self.create_service(CaptureFrame, "camera/capture", self._capture, callback_group=group)
        self.create_service(Trigger, "load_frame/hold", self._hold, callback_group=group)
        for name in self.statuses:
            self.create_service(CountReaders, f"{name}/count_readers", self._count_readers, callback_group=group)
        self.queries = {
            name: self.create_service(QueryStep, f"{name}/query_step", self._query_step, callback_group=group)
            for name in self.statuses
        }
        self.measure = ActionClient(self, MeasureStep, "measure_step")
        self.start = self.create_client(StartExperiment, "experiment/start")
        self.set_reference = self.create_client(SetReference, "experiment/set_reference")
        self.set_parameters = self.create_client(SetParameters, "experiment/set_parameters")
        self.feedback: list[MeasureStep.Feedback] = []

    async def _show(self, request: ShowPattern.Request, response: ShowPattern.Response) -> ShowPattern.Response:
        self.on_screen = request.kind
        if request.kind != Exposure.WHITE:
            self.shown.append(request)
        response.error_code = self.show_error
        response.error_message = "no screen" if self.show_error else ""
        response.shown = to_msg(self.time())
        return response

    def time(self, passed_ns: int = EXPOSURE_NS) -> int:
        """Return the time of the rig after some time."""
        passed = self.clock_ns + passed_ns
        # even from frame to frame: a drift per frame is one per time on a busy computer, too
        self.clock_ns = passed if self.capturing else max(time.time_ns(), passed)
        return self.clock_ns

    def _sample_load(self) -> None:
        if self.load_mode is not None and not self.capturing:
            # a machine has samples of the time in which this process, or its clock during the frames, stood still
            while self.clock_ns + SAMPLES_NS < time.time_ns():
                self.clock_ns += SAMPLES_NS
                self.publish_load(self.load_mode, stamp=self.clock_ns)
            self.time(passed_ns=1)
            self.publish_load(self.load_mode)

    async def _capture(self, request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        if not request.count:
            return response
        self.captured.append(request)
        if self.hang is not None:
            await self.hang
        if self.capture_error:
            response.error_code, response.error_message = self.capture_error, "no frame"
            return response
        start = self.time(passed_ns=1) - 3_000_000_000 * (request.index == self.jump_before)
        self.capturing = request.index < request.count - 1
        self.clock_ns += EXPOSURE_NS
        exposure = Exposure(
            experiment=request.experiment,
            step=request.step,
            index=request.index,
            count=request.count,
            kind=request.kind,
            exposure_time=EXPOSURE_NS * 1e-9,
            image_crc=crc(request.index),
        )
        if self.misnamed == "records":
            exposure.step = 7
        middle = start + EXPOSURE_NS // 2 + self.camera_clock_ahead_ns
        exposure.header.stamp = response.stamp = self.last_stamp = to_msg(middle)
        self.exposures.publish(exposure)
        if request.index == self.moves_at_frame:
            self.load_mode = LoadState.MOVING
        if self.load_mode is not None:
            await self._sample_frame(request.index)
        if request.index == self.last_sampled_frame:
            self.load_mode = None
        if request.index == request.count - 1:
            self.publish_statuses(request.experiment, request.step, response.stamp)
        response.subscribers = 1
        return response

    async def _sample_frame(self, index: int) -> None:
        jumps = index == self.load_jumps_at_frame
        for back_ms in range(3000, 0, -500) if jumps else ():
            self.publish_load(self.load_mode, stamp=self.clock_ns - back_ms * 1_000_000)
        self.publish_load(self.load_mode, self.force_per_frame * index, self.clock_ns)
        if jumps:
            await sleep(self, 0.3)  # the samples are taken before the answer

    async def _count_readers(
        self, request: CountReaders.Request, response: CountReaders.Response
    ) -> CountReaders.Response:
        response.counts = [1000 * self.reaches_all] * len(request.topics)
        response.readers = [discovered_readers(self, topic) for topic in request.topics]
        return response

    async def _query_step(self, _: QueryStep.Request, response: QueryStep.Response) -> QueryStep.Response:
        response.received = self.received
        response.missing = "" if self.received else "no node publishes /phase/map"
        return response

    async def _hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.holds += 1
        response.success = True
        return response

    def publish_statuses(self, experiment: str, step: int, stamp: Any) -> None:
        for name, publisher in self.statuses.items():
            if name not in self.silent:
                status = NodeStatus(node=name, experiment=experiment, step=step, error_code=self.answers.get(name, 0))
                status.error_message = "scripted" if status.error_code else ""
                status.valid_fraction, status.rms_displacement_px, status.rms_displacement = 0.75, 2.0, 3.0
                status.skipped = name == "coupling" and self.captured[-1].kind == Exposure.WHITE
                if status.skipped:
                    status.valid_fraction = status.rms_displacement = math.nan
                status.header.stamp = stamp
                if self.misnamed == "statuses" and name != "phase":
                    status.step = 7
                publisher.publish(status)

    def publish_load(self, mode: int, more_force: float = 0.0, stamp: int = 0) -> None:
        if self.load is None:
            self.load = self.create_publisher(LoadState, "load_frame/state", STATE)
            self.wait(self.load.get_subscription_count, "a reader of the load frame")
        sample = LoadState(mode=mode, force=self.force + more_force, position=1e-3)
        sample.header.stamp = to_msg((stamp or self.time(passed_ns=0)) + self.load_clock_ahead_ns)
        self.load.publish(sample)

    def say_load(self, mode: int) -> None:
        """Publish samples from now on, and return when the experiment node has taken one."""
        self.load_mode = mode
        self.publish_load(mode)
        self.taken(self.load)

    def taken(self, publisher: Any) -> None:
        assert publisher.wait_for_all_acked(Duration(seconds=180))
        # subscriptions are served before services: after any answer the message has been taken
        self.call(self.set_reference, step=2**31)

    def publish_recorder(self, state: int, frames: int = 0) -> None:
        if self.recorder is None:
            self.recorder = self.create_publisher(RecorderStatus, "recorder/status", LATCHED)
            self.wait(self.recorder.get_subscription_count, "a reader of the recorder's status")
        self.recorder.publish(self.recorder_status(state, frames))

    def recorder_status(self, state: int, frames: int) -> RecorderStatus:
        """Return the status of a recorder that has the first frames of the latest step."""
        if state == RecorderStatus.FAILED:
            return RecorderStatus(state=state, error_code=RecorderStatus.DISK_FULL, error_message="disk full")
        if not frames:
            return RecorderStatus(state=state)
        crcs = struct.pack(f"<{frames}I", *map(crc, range(frames)))
        latest = self.captured[-1]
        return RecorderStatus(
            state=state,
            experiment=latest.experiment,
            step=latest.step,
            step_frames=frames,
            step_crc=zlib.crc32(crcs),
        )

    def request(self, **goal: Any) -> Any:
        """Goal handle of an accepted goal."""
        future = self.measure.send_goal_async(
            MeasureStep.Goal(**goal), feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self.wait(future.done, "the answer to the goal")
        assert future.result().accepted
        return future.result()

    def result(self, handle: Any) -> tuple[int, MeasureStep.Result]:
        """Status and result of a goal."""
        future = handle.get_result_async()
        self.wait(future.done, "the result")
        return future.result().status, future.result().result

    def step(self, **goal: Any) -> MeasureStep.Result:
        return self.result(self.request(**goal))[1]

    def call(self, client: Any, **request: Any) -> Any:
        future = client.call_async(client.srv_type.Request(**request))
        self.wait(future.done, client.srv_name)
        return future.result()

    def stages_of(self, step: int) -> list[int]:
        self.wait(
            lambda: any(message.step == step and message.stage >= StepStatus.END for message in self.steps), "the end"
        )
        return [message.stage for message in self.steps if message.step == step]

    def change(self, **values: Any) -> None:
        """Change parameters of the experiment node."""
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = self.call(self.set_parameters, parameters=changes)
        assert all(result.successful for result in answer.results), answer

    def reset(self) -> None:
        """Clear the journals and do everything right."""
        self.serve(0.1)
        for heard in (self.shown, self.captured, self.steps, self.references, self.feedback):
            heard.clear()
        self.holds = 0
        self.behave()  # before the load frame ends, which would otherwise be started again
        for topic in ("load", "recorder"):
            if getattr(self, topic) is not None:
                self.destroy_publisher(getattr(self, topic))
                setattr(self, topic, None)
        self.meet("experiment")

    def behave(self) -> None:
        """Do everything right from now on."""
        self.show_error = self.capture_error = 0
        self.hang = self.load_mode = self.jump_before = None
        self.moves_at_frame = self.last_sampled_frame = self.load_jumps_at_frame = -1
        self.capturing = False
        self.force, self.force_per_frame = 100.0, 1.0
        self.load_clock_ahead_ns = self.camera_clock_ahead_ns = 0
        self.answers, self.silent, self.received, self.misnamed = {}, set(), True, ""


def crc(index: int) -> int:
    """Return the checksum that the camera sends for a frame."""
    return 0xDEAD0000 + index


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """The rig with an experiment node that serves all tests of this module."""
    rclpy.init()
    rig = Rig()
    folder = tmp_path_factory.mktemp("experiment")
    CALIBRATION.to_yaml(folder / "rig_model.yaml")
    parameters = {**PARAMETERS, "calibration_file": str(folder / "rig_model.yaml")}
    with NodeProcess("experiment_node.experiment_node", folder, parameters):
        rig.wait(rig.measure.server_is_ready, "the action server")
        for client in (rig.start, rig.set_reference, rig.set_parameters):
            rig.wait(client.service_is_ready, client.srv_name)
        rig.meet("experiment")
        yield rig
    rig.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def rig(running: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The rig at the beginning of a new experiment, which has the name of the test."""
    running.reset()
    assert running.call(running.start, experiment=request.node.name).success
    yield running
    between = {"white_between_steps": False, "dark_between_steps": False}
    running.change(projector=True, recording_required=False, start_timeout_s=START_TIMEOUT, **between)


def test_a_step_from_begin_to_end(rig: Rig, request: pytest.FixtureRequest) -> None:
    rig.say_load(LoadState.HOLD)
    rig.wait(lambda: rig.node_parameters, "the node's parameters")
    assert "pitches_px" in [parameter.name for parameter in rig.node_parameters[0].parameters]

    rig.silent = {"coupling"}  # no feedback arrives after the result, which waits for this node
    goal = rig.request(mode=MeasureStep.Goal.FRINGES)
    rig.wait(lambda: rig.feedback and rig.feedback[-1].stage == "process", "the last feedback")
    rig.silent = {"phase", "dic"}
    rig.publish_statuses(request.node.name, 0, rig.last_stamp)
    status, result = rig.result(goal)
    rig.behave()
    rig.load_mode = LoadState.HOLD
    assert (status, result.error_code, result.error_message) == (GoalStatus.STATUS_SUCCEEDED, Result.NONE, "")
    assert (result.experiment, result.step) == (request.node.name, 0)
    assert [(shown.pitch, shown.shift, shown.shifts) for shown in rig.shown] == [
        *((64.0, k, 3) for k in (1, 2, 3)),
        *((8.0, k, 4) for k in (1, 2, 3, 4)),
    ]
    assert [captured.index for captured in rig.captured] == list(range(FRAMES))
    assert {captured.count for captured in rig.captured} == {FRAMES}
    assert all(to_nanoseconds(captured.shown) > 0 for captured in rig.captured)
    assert [captured.image_subscribers for captured in rig.captured] == [1] + [0] * (FRAMES - 1)
    assert rig.stages_of(0) == [StepStatus.BEGIN, *[StepStatus.CAPTURE] * FRAMES, StepStatus.PROCESS, StepStatus.END]
    assert rig.steps[0].reference
    assert [message.step for message in rig.references] == [0]
    last = to_nanoseconds(result.stamp)
    assert last == to_nanoseconds(rig.last_stamp)
    assert [to_nanoseconds(message.header.stamp) for message in rig.steps[-2:]] == [last, last]
    assert (result.valid_fraction, result.rms_displacement, result.rms_displacement_px) == (0.75, 3.0, 2.0)
    assert (result.load_samples, result.force_mean, result.force_range) == (FRAMES, 103.0, 6.0)
    assert (result.position_mean, result.position_range) == (pytest.approx(1e-3), 0.0)
    assert 0 <= result.processing_time < result.duration
    assert rig.holds == 0

    second = rig.step()
    assert (second.error_code, second.step) == (Result.NONE, 1)
    assert not rig.steps[-1].reference
    assert len(rig.references) == 1


def test_white_without_projector(rig: Rig) -> None:
    rig.change(projector=False)
    result = rig.step(mode=MeasureStep.Goal.WHITE)
    assert (result.error_code, result.valid_fraction, result.rms_displacement_px) == (Result.NONE, 0.75, 2.0)
    assert math.isnan(result.rms_displacement)
    assert not rig.shown
    assert [captured.kind for captured in rig.captured] == [Exposure.WHITE]
    assert to_nanoseconds(rig.captured[0].shown) == 0
    assert result.load_samples == 0
    assert math.isnan(result.force_mean)
    assert math.isnan(result.position_range)
    refused = rig.step(mode=MeasureStep.Goal.FRINGES)
    assert (refused.error_code, len(rig.captured)) == (Result.INVALID_GOAL, 1)
    assert "projector" in refused.error_message
    assert rig.step(mode=7).error_code == Result.INVALID_GOAL


def test_references_follow_steps_services_and_failures(rig: Rig, request: pytest.FixtureRequest) -> None:
    first, second = request.node.name, "another experiment"

    def published() -> list[tuple[str, int]]:
        rig.serve(0.1)
        return [(message.experiment, message.step) for message in rig.references]

    rig.answers = {"phase": NodeStatus.FRAME_MISSING, "dic": NodeStatus.INPUT_FAILED}
    assert rig.step().error_code == Result.PHASE_FAILED
    rig.behave()
    assert rig.step().step == 1  # the first step that succeeds is the reference
    assert published() == [(first, 0), (first, 1)]
    rig.answers = {"coupling": NodeStatus.TOO_FEW_VALID}
    assert rig.step(set_reference=True).error_code == Result.COUPLING_FAILED
    assert published()[2:] == [(first, 2), (first, 1)]  # back to the one that holds
    rig.behave()
    assert not rig.call(rig.set_reference, step=2).success
    assert rig.step().step == 3
    assert rig.call(rig.set_reference, step=3).success
    assert published()[4:] == [(first, 3)]
    assert rig.call(rig.set_reference, next=True).success
    assert rig.step().step == 4
    assert published()[5:] == [(first, 4)]

    assert not any(message.previous_lost for message in rig.references), "all were asked for"
    rig.answers = {"dic": NodeStatus.NO_REFERENCE, "coupling": NodeStatus.INPUT_FAILED}
    assert rig.step().error_code == Result.DIC_FAILED
    rig.behave()
    assert rig.step().step == 6
    assert rig.call(rig.set_reference, next=True, previous_lost=True).success
    assert rig.call(rig.set_reference, next=True).success
    assert rig.call(rig.set_reference, next=True, previous_lost=True).success
    assert rig.step().step == 7
    assert published()[6:] == [(first, 6), (first, 7)]
    lost = [message.previous_lost for message in rig.references[6:]]
    assert lost == [True, False], "a reference that was asked for remains one when the present one is lost, too"

    assert not rig.call(rig.start, experiment=first).success
    assert rig.call(rig.start, experiment=second).success
    begun = rig.step()
    assert (begun.experiment, begun.step) == (second, 0)
    assert published()[8:] == [(second, 0)]


def test_one_step_at_a_time_and_cancel(rig: Rig) -> None:
    rig.hang = Future()
    running = rig.request(controller="tension")
    rig.wait(lambda: rig.captured, "the first exposure")
    status, busy = rig.result(rig.request(controller="fatigue"))
    assert (status, busy.error_code, busy.step) == (GoalStatus.STATUS_ABORTED, Result.BUSY, 0)
    assert busy.error_message == "step 0 is being measured for tension; fatigue has to wait until it has ended"
    assert rig.holds == 0, "a controller that was refused must not stop the machine of the other"
    assert not rig.call(rig.start, experiment="other").success
    assert not rig.call(rig.set_reference, next=True).success
    cancelling = running.cancel_goal_async()
    rig.wait(cancelling.done, "the answer to the cancel request")
    status, cancelled = rig.result(running)
    assert (status, cancelled.error_code) == (GoalStatus.STATUS_CANCELED, Result.CANCELLED)
    assert rig.stages_of(0) == [StepStatus.BEGIN, StepStatus.ERROR]
    assert rig.steps[-1].error_code == Result.CANCELLED
    rig.wait(lambda: rig.holds == 1, "the request to hold")
    rig.hang.set_result(None)
    rig.behave()
    after = rig.step()
    assert (after.error_code, after.step) == (Result.NONE, 1)


def test_cancel_while_the_machine_settles(rig: Rig) -> None:
    rig.change(settle_time_s=60.0)
    try:
        running = rig.request()
        rig.wait(lambda: rig.feedback, "the beginning")
        rig.serve(1.5)
        assert not rig.captured
        cancelling = running.cancel_goal_async()
        rig.wait(cancelling.done, "the answer to the cancel request")
        assert rig.result(running)[1].error_code == Result.CANCELLED
    finally:
        rig.change(settle_time_s=0.0)


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        ({"show_error": ShowPattern.Request.SCREEN_FAILED}, Result.PROJECTOR_FAILED, "no screen"),
        ({"capture_error": CaptureFrame.Request.CAMERA_FAILED}, Result.CAMERA_FAILED, "no frame"),
        ({"capture_error": CaptureFrame.Request.CAMERA_TIMEOUT}, Result.CAMERA_TIMEOUT, "no frame"),
        ({"capture_error": CaptureFrame.Request.NO_SUBSCRIBER}, Result.NO_SUBSCRIBER, "no frame"),
        ({"hang": True}, Result.CAMERA_TIMEOUT, "camera/capture did not answer in 7 s"),
        ({"answers": {"dic": NodeStatus.NO_CORRELATION}}, Result.DIC_FAILED, "dic: scripted"),
        ({"answers": {"phase": NodeStatus.PATTERN_NOT_SEEN}}, Result.PATTERN_NOT_SEEN, "phase: scripted"),
        ({"jump_before": 4}, Result.CAMERA_FAILED, "s before frame 3: the clock jumped back"),
        ({"silent": {"dic", "coupling"}}, Result.PROCESSING_TIMEOUT, "no result from dic, coupling"),
        (
            {"silent": {"dic", "coupling"}, "received": False},
            Result.PROCESSING_TIMEOUT,
            "dic has not received the inputs of the step: no node publishes /phase/map",
        ),
    ],
)
def test_a_fault_ends_the_step_with_its_code_and_the_next_one_works(
    rig: Rig, script: dict[str, Any], code: int, words: str
) -> None:
    for name, value in script.items():
        setattr(rig, name, Future() if name == "hang" else value)
    status, failed = rig.result(rig.request())
    assert (status, failed.error_code) == (GoalStatus.STATUS_ABORTED, code)
    assert words in failed.error_message
    assert "step 0" in failed.error_message
    assert rig.stages_of(0)[-1] == StepStatus.ERROR
    assert rig.steps[-1].error_code == code
    rig.wait(lambda: rig.holds == 1, "the request to hold")
    rig.behave()
    assert rig.step().error_code == Result.NONE


def test_a_node_that_took_its_inputs_after_the_first_question_does_not_end_the_step(rig: Rig) -> None:
    """One that stood still answers after one message of each topic."""
    asked: list[bool] = []

    async def lacks_at_first(request: QueryStep.Request, response: QueryStep.Response) -> QueryStep.Response:
        response.received = bool(asked)
        asked.append(response.received)
        if response.received:
            rig.silent = set()
            rig.publish_statuses(request.experiment, request.step, rig.last_stamp)
        return response

    query, rig.queries["dic"].callback = rig.queries["dic"].callback, lacks_at_first
    rig.change(processing_timeout_s=60.0)
    rig.silent = {"dic", "coupling"}
    try:
        assert rig.step().error_code == Result.NONE
    finally:
        rig.queries["dic"].callback = query
        rig.change(processing_timeout_s=PARAMETERS["processing_timeout_s"])
    assert asked[:2] == [False, True]


@pytest.mark.parametrize(
    ("script", "code"),
    [
        ({}, Result.NONE),
        ({"capture_error": CaptureFrame.Request.CAMERA_FAILED}, Result.CAMERA_FAILED),
        ({"moves_at_frame": 3}, Result.LOAD_NOT_HELD),
        ({"show_error": ShowPattern.Request.SCREEN_FAILED}, Result.PROJECTOR_FAILED),
        ({"hang": True}, Result.CANCELLED),
    ],
)
def test_every_step_leaves_white_light_for_the_free_run(rig: Rig, script: dict[str, Any], code: int) -> None:
    """Also a failed one, with its own failure; the free run continues with its last record."""
    rig.change(white_between_steps=True)
    rig.say_load(LoadState.HOLD)
    for name, value in script.items():
        setattr(rig, name, Future() if name == "hang" else value)
    goal = rig.request()
    if rig.hang is not None:
        rig.wait(lambda: rig.captured, "the first exposure")
        goal.cancel_goal_async()
    assert rig.result(goal)[1].error_code == code
    rig.wait(lambda: rig.on_screen == Exposure.WHITE, "white light")  # after a failure nobody waits for it
    assert rig.shown, "a pattern was on the screen before"


@pytest.mark.parametrize(
    ("script", "code"),
    [({}, Result.NONE), ({"capture_error": CaptureFrame.Request.CAMERA_FAILED}, Result.CAMERA_FAILED)],
)
def test_a_step_ends_in_the_dark_for_other_sensors(rig: Rig, script: dict[str, Any], code: int) -> None:
    rig.change(dark_between_steps=True)
    rig.say_load(LoadState.HOLD)
    for name, value in script.items():
        setattr(rig, name, value)
    goal = rig.request()
    if code == Result.NONE:
        rig.wait(lambda: rig.feedback and rig.feedback[-1].stage == "process", "the last feedback")
        assert rig.on_screen == Exposure.OTHER, "dark before the next sensor begins"
    assert rig.result(goal)[1].error_code == code
    rig.wait(lambda: rig.on_screen == Exposure.OTHER, "dark screen")
    assert rig.shown, "a pattern was on the screen before"


def test_a_sensor_continues_with_the_number_of_the_others(rig: Rig) -> None:
    assert rig.step().step == 0
    rig.change(first_step=4)
    assert rig.step().step == 4
    rig.change(first_step=2)
    assert rig.step().step == 5, "no number is used twice"
    rig.change(first_step=0)


def test_a_failed_node_ends_the_sequence_early(rig: Rig) -> None:
    rig.change(white_between_steps=True)
    rig.answers = dict.fromkeys(("phase", "dic", "coupling"), NodeStatus.FRAME_DOUBLED)
    capture = rig.capture.callback

    async def doubled(request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        response = await capture(request, response)
        if request.step == 0 and request.index == 2:
            rig.publish_statuses(request.experiment, request.step, response.stamp)
        return response

    rig.capture.callback = doubled
    assert rig.step().error_code == Result.PHASE_FAILED
    assert 3 <= len(rig.captured) < FRAMES
    rig.wait(lambda: rig.on_screen == Exposure.WHITE, "white light")
    assert StepStatus.PROCESS not in rig.stages_of(0)
    rig.capture.callback = capture
    rig.behave()
    assert rig.step().error_code == Result.NONE


def test_the_machine_has_to_hold(rig: Rig) -> None:
    rig.say_load(LoadState.MOVING)
    failed = rig.step()
    assert failed.error_code == Result.LOAD_NOT_HELD
    assert not rig.captured
    rig.say_load(LoadState.HOLD)
    rig.moves_at_frame = 3
    assert rig.step().error_code == Result.LOAD_NOT_HELD
    rig.behave()
    rig.say_load(LoadState.IDLE)
    assert rig.step().error_code == Result.NONE


def test_a_step_in_motion_needs_no_hold_and_requests_none_when_it_fails(rig: Rig) -> None:
    rig.say_load(LoadState.MOVING)
    measured = rig.step(mode=MeasureStep.Goal.MOVING)
    assert measured.error_code == Result.NONE, measured.error_message
    kinds = [captured.kind for captured in rig.captured]
    first, last = (index for index, kind in enumerate(kinds) if kind == Exposure.GREY)
    assert last == len(kinds) - 1, "uniform light before and after the finest pitch"
    middle = (first + last) / 2  # the force grows by 1 N with each frame, sampled at its end
    assert measured.force_mean == pytest.approx(rig.force + middle, abs=1.0)
    rig.answers = {"phase": NodeStatus.FRAME_MISSING}
    assert rig.step(mode=MeasureStep.Goal.MOVING).error_code == Result.PHASE_FAILED
    rig.serve(0.2)
    assert rig.holds == 0, "the test goes on"


def test_only_fresh_samples_prove_a_hold(rig: Rig) -> None:
    """A process that is stopped or killed leaves its last sample, whatever the machine does meanwhile."""
    rig.say_load(LoadState.HOLD)
    assert rig.step().error_code == Result.NONE
    rig.load_mode = None
    before = rig.step()
    assert before.error_code == Result.LOAD_NOT_HELD
    assert "whether the machine holds is unknown" in before.error_message
    rig.say_load(LoadState.HOLD)
    rig.last_sampled_frame = 2
    during = rig.step()
    assert during.error_code == Result.LOAD_NOT_HELD
    assert "whether the machine holds is unknown" in during.error_message
    rig.behave()
    rig.destroy_publisher(rig.load)
    rig.load = None
    rig.wait(lambda: not rig.count_publishers("load_frame/state"), "the end of the load frame")
    assert rig.step().error_code == Result.LOAD_NOT_HELD
    rig.say_load(LoadState.HOLD)
    assert rig.step().error_code == Result.NONE


def test_the_load_must_not_drift_over_the_exposures(rig: Rig) -> None:
    rig.change(load_drift_n=5.0)
    try:
        rig.say_load(LoadState.HOLD)
        drifted = rig.step()  # 1 N per frame
        assert drifted.error_code == Result.LOAD_DRIFT
        told = re.search(r"the force drifted by (\S+) N during the exposures, 5 N are allowed", drifted.error_message)
        assert told is not None, drifted.error_message
        assert float(told[1]) == pytest.approx(6.0, abs=0.01)  # a sample at the end of each exposure
        rig.wait(lambda: rig.holds == 1, "the request to hold")
        rig.force_per_frame = -0.5
        assert rig.step().error_code == Result.NONE
        rig.change(hold_required=False)
        rig.load_mode = None
        silent = rig.step()
        assert silent.error_code == Result.LOAD_DRIFT
        assert "the drift of the force is unknown" in silent.error_message
        rig.load_mode, rig.last_sampled_frame = LoadState.HOLD, 0  # one sample says nothing about a drift
        assert rig.step().error_code == Result.LOAD_DRIFT
    finally:
        rig.change(load_drift_n=0.0, hold_required=True)


def test_a_limit_of_the_force_needs_a_force_sensor(rig: Rig) -> None:
    rig.force = math.nan
    rig.say_load(LoadState.HOLD)
    rig.change(position_drift_um=10.0)
    try:
        assert rig.step().error_code == Result.NONE
        rig.change(load_drift_n=5.0)
        unknown = rig.step()
        assert unknown.error_code == Result.LOAD_DRIFT
        assert "the drift of the force is unknown" in unknown.error_message
        assert "set load_drift_n to 0" in unknown.error_message
    finally:
        rig.change(load_drift_n=0.0, position_drift_um=0.0)


def test_a_load_frame_with_a_clock_ahead_proves_nothing(rig: Rig) -> None:
    """Its samples seem to be from after the exposures while these still run."""
    rig.load_clock_ahead_ns = 3_000_000_000
    rig.say_load(LoadState.HOLD)
    not_held = rig.step()
    assert (not_held.error_code, rig.captured) == (Result.LOAD_NOT_HELD, [])
    told = re.search(r"the clock of the load frame is (\S+) s ahead", not_held.error_message)
    assert told is not None, not_held.error_message
    assert float(told[1]) == pytest.approx(3.0, abs=0.5)
    try:
        for limit in (50.0, 0.0):  # without a limit, force and position of the step would be those of another time
            rig.change(hold_required=False, load_drift_n=limit)
            drifted = rig.step()
            assert drifted.error_code == Result.LOAD_DRIFT
            assert "the clock of the load frame is" in drifted.error_message
        rig.load_clock_ahead_ns = -1_500_000_000
        behind = re.search(r"the clock of the load frame is (\S+) s behind", rig.step().error_message)
        assert behind is not None
        assert float(behind[1]) == pytest.approx(1.5, abs=0.5)  # a busy computer delays a sample
        rig.load_clock_ahead_ns = 0
        assert rig.step().error_code == Result.NONE
    finally:
        rig.change(hold_required=True, load_drift_n=0.0)


def test_a_clock_that_is_set_back_during_a_step_proves_no_hold(rig: Rig) -> None:
    """While the camera waits for a sample of its exposure, the stamps reach their old values again, without a gap."""
    rig.say_load(LoadState.HOLD)
    rig.load_jumps_at_frame = 3
    not_held = rig.step()
    assert not_held.error_code == Result.LOAD_NOT_HELD
    assert "a sample of the load frame is stamped 3.0 s before the previous one" in not_held.error_message
    rig.behave()
    rig.say_load(LoadState.HOLD)
    assert rig.step().error_code == Result.NONE


UNRELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.parametrize(
    ("stamp_ns", "words"),
    [
        (lambda _now: 0, r"\d+ messages came in \S+ s, none usable: \d+ with a stamp of 0 s.*set header\.stamp"),
        (
            lambda now: now % 1_000_000_000_000,
            r"behind the clock of this computer \(the latest by \d+ days\); .*use_sim_time",
        ),
        (lambda now: now - 60_000_000_000, r"behind the clock of this computer \(the latest by 60 s\); synchronise"),
        (lambda _now: 1_000_000_000_000_000_000, r"with the stamp of the message before.*; give each message the time"),
        (lambda now: 2 * 1_700_000_000_000_000_000 - now, r"with a stamp (before that of|ahead of|behind)"),
    ],
    ids=["zero", "simulated time", "late", "constant", "backwards"],
)
def test_samples_that_prove_nothing_are_counted_with_the_reason(
    rig: Rig, stamp_ns: Callable[[int], int], words: str
) -> None:
    """They were reported as a load frame that publishes no sample."""
    publisher = rig.create_publisher(LoadState, "load_frame/state", STATE)

    def publish() -> None:
        sample = LoadState(mode=LoadState.HOLD)
        sample.header.stamp = to_msg(stamp_ns(time.time_ns()))
        publisher.publish(sample)

    timer = rig.create_timer(0.02, publish)
    try:
        failed = rig.step()
    finally:
        rig.destroy_timer(timer)
        rig.destroy_publisher(publisher)
    assert (failed.error_code, rig.captured) == (Result.LOAD_NOT_HELD, [])
    assert re.search(rf"whether the machine holds is unknown: /load_frame/state: .*{words}", failed.error_message), (
        failed.error_message
    )


@pytest.mark.parametrize(
    ("kind", "qos", "words"),
    [
        (LoadState, UNRELIABLE, r"/rig publishes /load_frame/state, but its QoS does not reach .*RELIABLE"),
        (String, STATE, "with the type std_msgs/msg/String; fringedic_msgs/msg/LoadState is needed"),
        (LoadState, STATE, r"/rig publishes /load_frame/state, but no message came in \S+ s"),
        (None, STATE, "no node publishes /load_frame/state; start its node"),
    ],
    ids=["best effort", "another type", "silent", "absent"],
)
def test_a_load_frame_without_samples_is_described_by_its_publisher(
    rig: Rig, kind: type[Any] | None, qos: QoSProfile, words: str
) -> None:
    rig.change(load_frame=True)
    publisher = None if kind is None else rig.create_publisher(kind, "load_frame/state", qos)
    timer = rig.create_timer(0.02, lambda: publisher.publish(kind()) if publisher and qos is UNRELIABLE else None)
    try:
        rig.meet("experiment")
        failed = rig.step()
    finally:
        rig.destroy_timer(timer)
        if publisher is not None:
            rig.destroy_publisher(publisher)
        rig.change(load_frame=False)
    assert failed.error_code == Result.LOAD_NOT_HELD
    assert re.search(words, failed.error_message), failed.error_message


def test_an_unknown_mode_is_reported_with_its_reason(rig: Rig) -> None:
    publisher = rig.create_publisher(LoadState, "load_frame/state", STATE)

    def publish() -> None:
        sample = LoadState(mode=LoadState.UNKNOWN, reason="its status is 'Hold'")
        sample.header.stamp = to_msg(time.time_ns())
        publisher.publish(sample)

    timer = rig.create_timer(0.02, publish)
    failed = rig.step()
    rig.destroy_timer(timer)
    rig.destroy_publisher(publisher)
    assert failed.error_code == Result.LOAD_NOT_HELD
    assert "the load frame reports the mode UNKNOWN: its status is 'Hold'" in failed.error_message


@pytest.mark.parametrize(
    ("misnamed", "code", "words"),
    [
        ("records", Result.CAMERA_FAILED, r"/camera/exposure: 7 messages came in .*none usable: 7 of another step"),
        ("statuses", Result.PROCESSING_TIMEOUT, r"/dic/status: 1 message came in .*1 of another step.*step 7"),
    ],
)
def test_messages_of_another_step_are_counted(rig: Rig, misnamed: str, code: int, words: str) -> None:
    rig.misnamed = misnamed
    failed = rig.step()
    assert failed.error_code == code
    assert re.search(words, failed.error_message), failed.error_message


@pytest.mark.parametrize(("ahead_s", "words"), [(-3, "behind"), (3, "ahead of")])
def test_a_camera_with_another_clock_proves_no_hold(rig: Rig, ahead_s: int, words: str) -> None:
    """Samples that seem to be from after its exposures are from before their end, or those before from after it."""
    rig.camera_clock_ahead_ns = ahead_s * 1_000_000_000
    rig.say_load(LoadState.HOLD)
    not_held = rig.step()
    assert not_held.error_code == Result.LOAD_NOT_HELD
    assert re.search(rf"the clock of the camera is [23]\.\d s {words} the clock of the", not_held.error_message)
    rig.camera_clock_ahead_ns = 0
    assert rig.step().error_code == Result.NONE


def test_a_hold_lasts_until_the_camera_has_answered(rig: Rig) -> None:
    """The clock of the camera may be a little behind, so that an exposure ends later than its stamp."""
    rig.say_load(LoadState.HOLD)
    rig.last_sampled_frame = FRAMES - 1
    not_held = rig.step()
    assert not_held.error_code == Result.LOAD_NOT_HELD
    assert "whether the machine holds is unknown" in not_held.error_message


def test_a_failed_node_does_not_replace_the_proof_of_the_hold(rig: Rig) -> None:
    """The frames are recorded, and a later measurement of them takes the stage PROCESS as the proof."""
    rig.say_load(LoadState.HOLD)
    rig.answers, rig.last_sampled_frame = {"phase": NodeStatus.PATTERN_NOT_SEEN}, FRAMES - 1
    assert rig.step().error_code == Result.LOAD_NOT_HELD
    assert StepStatus.PROCESS not in rig.stages_of(0)
    rig.behave()
    rig.answers = {"phase": NodeStatus.PATTERN_NOT_SEEN}
    rig.say_load(LoadState.HOLD)
    assert rig.step().error_code == Result.PATTERN_NOT_SEEN
    assert StepStatus.PROCESS in rig.stages_of(1)


def test_a_hold_that_is_published_late_counts(rig: Rig) -> None:
    """The machine has just reached its hold; the latest sample still shows its motion."""
    rig.say_load(LoadState.MOVING)
    rig.load_mode = None
    running = rig.request()
    rig.serve(0.1)
    assert not rig.captured
    rig.load_mode = LoadState.HOLD
    assert rig.result(running)[1].error_code == Result.NONE


def test_no_step_without_the_recorder(rig: Rig) -> None:
    rig.change(recording_required=True, start_timeout_s=1.0)
    failed = rig.step()
    assert (failed.error_code, rig.captured) == (Result.RECORDER_FAILED, [])
    rig.change(start_timeout_s=60.0)
    rig.publish_recorder(RecorderStatus.STARTING)
    running = rig.request()
    rig.serve(0.3)
    assert not rig.captured
    rig.publish_recorder(RecorderStatus.RECORDING)
    rig.wait(lambda: StepStatus.PROCESS in [message.stage for message in rig.steps], "the end of the frames")
    rig.publish_recorder(RecorderStatus.RECORDING, frames=FRAMES - 1)
    rig.serve(0.3)
    rig.publish_recorder(RecorderStatus.RECORDING, frames=FRAMES)
    result = rig.result(running)[1]
    assert (result.error_code, result.recorded_frames) == (Result.NONE, FRAMES)
    assert result.recorded_crc == rig.recorder_status(RecorderStatus.RECORDING, FRAMES).step_crc
    rig.change(start_timeout_s=1.0)
    silent = rig.step()  # as if killed: its last status was good, but it does not answer
    assert silent.error_code == Result.RECORDER_FAILED
    assert "does not answer" in silent.error_message
    rig.publish_recorder(RecorderStatus.FAILED)
    rig.taken(rig.recorder)
    stopped = rig.step()
    assert stopped.error_code == Result.DISK_FULL
    assert "disk full" in stopped.error_message


def test_a_recorder_of_results_that_stops_is_no_longer_waited_for(rig: Rig) -> None:
    """Its disk is full before it reads the results."""
    rig.change(recording_required=True, start_timeout_s=600.0)
    rig.publish_recorder(RecorderStatus.IDLE)
    assert rig.recorder is not None
    rig.recorder.publish(RecorderStatus(state=RecorderStatus.RECORDING, derived=True))
    rig.taken(rig.recorder)
    rig.destroy_publisher(rig.statuses.pop("phase"))  # a change makes the experiment node check all connections again
    rig.statuses["phase"] = rig.create_publisher(NodeStatus, "phase/status", EVENTS)
    rig.wait(rig.statuses["phase"].get_subscription_count, "the experiment node")
    begun, running = len(rig.captured), rig.request()
    rig.serve(2.5)
    assert len(rig.captured) == begun
    rig.publish_recorder(RecorderStatus.FAILED)
    stopped = rig.result(running)[1]
    assert (stopped.error_code, len(rig.captured)) == (Result.DISK_FULL, begun)
    rig.change(start_timeout_s=START_TIMEOUT)


def test_absent_node_is_named(rig: Rig) -> None:
    rig.change(start_timeout_s=1.0)
    rig.destroy_publisher(rig.statuses.pop("coupling"))
    rig.meet("experiment")
    failed = rig.step()
    assert failed.error_code == Result.NO_SUBSCRIBER
    assert "no node publishes /coupling/status; start its node" in failed.error_message
    unfit = rig.create_publisher(NodeStatus, "coupling/status", UNRELIABLE)
    rig.meet("experiment")
    assert "/rig publishes /coupling/status, but its QoS does not reach" in rig.step().error_message
    rig.destroy_publisher(unfit)
    rig.statuses["coupling"] = rig.create_publisher(NodeStatus, "coupling/status", EVENTS)
    rig.change(start_timeout_s=60.0)
    assert rig.step().error_code == Result.NONE


def test_the_camera_waits_for_what_the_stage_has_placed(rig: Rig) -> None:
    stage = rig.create_publisher(ReferencePlane, "reference_plane/state", LATCHED)
    state = ReferencePlane(kind=ReferencePlane.PLANE)
    state.header.stamp = to_msg(rig.time())
    stage.publish(state)
    rig.wait(stage.get_subscription_count, "the experiment node")
    rig.taken(stage)
    assert rig.step().error_code == Result.NONE
    assert {to_nanoseconds(each.placed) for each in rig.captured[-FRAMES:]} == {to_nanoseconds(state.header.stamp)}
    rig.destroy_publisher(stage)


def test_samples_that_arrive_late_prove_a_hold(rig: Rig) -> None:
    """Their publisher had to wait for the memory of a process that had been killed."""
    rig.say_load(LoadState.HOLD)
    assert rig.step().error_code == Result.NONE
    rig.captured.clear()
    rig.load_mode = None
    running = rig.request()
    rig.serve(3.5)
    assert not rig.captured
    rig.load_mode = LoadState.HOLD  # all samples of the time in which none came, too
    assert rig.result(running)[1].error_code == Result.NONE


def test_the_camera_waits_for_the_sample_that_showed_the_hold(rig: Rig) -> None:
    rig.say_load(LoadState.HOLD)
    begin = rig.time(passed_ns=0)
    assert rig.step().error_code == Result.NONE
    assert all(to_nanoseconds(each.loaded) >= begin for each in rig.captured)


def test_a_subscriber_that_ends_after_it_was_counted_costs_one_request(rig: Rig) -> None:
    """A killed recorder is counted until its lease ends; a viewer may be closed at any time."""
    viewer = rig.create_subscription(Image, "camera/image_raw", lambda _: None, IMAGES)
    rig.meet("experiment")
    capture = rig.capture.callback

    async def ended(request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        """Answer like a camera whose subscriber has ended since the request."""
        if request.image_subscribers != 2:
            return await capture(request, response)
        rig.captured.append(request)
        rig.destroy_subscription(viewer)
        response.error_code, response.error_message = CaptureFrame.Request.NO_SUBSCRIBER, "1 of 2"
        return response

    rig.capture.callback = ended
    try:
        assert rig.step().error_code == Result.NONE
    finally:
        rig.capture.callback = capture
    counted = [each.image_subscribers for each in rig.captured if each.index == 0]
    assert (counted[0], counted[-1]) == (2, 1)


def test_a_node_that_appears_beside_its_predecessor_while_connections_are_awaited_is_noticed(rig: Rig) -> None:
    rig.change(start_timeout_s=60.0)
    publisher = rig.statuses.pop("phase")  # a new publisher makes the experiment node check all connections again
    rig.destroy_publisher(publisher)
    rig.statuses["phase"] = rig.create_publisher(NodeStatus, "phase/status", EVENTS)
    rig.wait(rig.statuses["phase"].get_subscription_count, "the experiment node")
    rig.reaches_all = False  # until the successor is there
    running = rig.request()
    successor = rig.create_publisher(NodeStatus, "phase/status", EVENTS)
    rig.meet("experiment")
    rig.reaches_all = True
    rig.serve(3.0)
    assert not rig.captured
    rig.destroy_publisher(successor)
    assert rig.result(running)[1].error_code == Result.NONE
    rig.change(start_timeout_s=START_TIMEOUT)


def test_results_that_would_not_reach_the_next_node_are_waited_for(rig: Rig) -> None:
    rig.reaches_all = False
    publisher = rig.statuses.pop("phase")  # a new publisher makes the experiment node check all connections again
    rig.destroy_publisher(publisher)
    rig.statuses["phase"] = rig.create_publisher(NodeStatus, "phase/status", EVENTS)
    rig.wait(rig.statuses["phase"].get_subscription_count, "the experiment node")
    failed = rig.step()
    assert failed.error_code == Result.NO_SUBSCRIBER, failed.error_message
    assert "/phase/status" in failed.error_message
    rig.change(start_timeout_s=60.0)
    running = rig.request(mode=MeasureStep.Goal.FRINGES)
    rig.serve(1.5)
    assert not any(each.stage == StepStatus.BEGIN and each.step == failed.step + 1 for each in rig.steps)
    rig.reaches_all = True
    assert rig.result(running)[1].error_code == Result.NONE
    rig.change(start_timeout_s=START_TIMEOUT)


def test_calibration_comes_from_the_file(rig: Rig) -> None:
    heard = rig.listen(RigCalibration, "calibration", LATCHED)
    rig.wait(lambda: heard, "the calibration")
    published = RigModel.from_message(heard[0])
    assert published.source == "rig_model.yaml"
    for field in fields(RigModel):
        read, written = getattr(published, field.name), getattr(CALIBRATION, field.name)
        assert field.name == "source" or read == written or read == pytest.approx(written, rel=1e-12), field.name


def test_unreadable_calibration_ends_the_start(tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text("camera_distance_mm: far")
    process = NodeProcess(
        "experiment_node.experiment_node", tmp_path, {"calibration_file": str(tmp_path / "broken.yaml")}
    )
    with pytest.raises(AssertionError, match=r"broken\.yaml"), process:
        process.process.wait(300)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"shifts": [4, 4, 4]}, "3 numbers of shifts for 4 pitches"),
        ({"first_step": 3, "reference_step": 3}, "reference_step 3 is not before first_step 3"),
        ({"exposures_ms": [4.0, 4.0]}, "exposures_ms must differ"),
        ({"record_only": True, "later_parameters": "{dic: {window: 3}}"}, "window"),
        ({"record_only": True, "later_parameters": "{camera: {}}"}, "Extra inputs"),
        ({"record_only": True, "later_parameters": "{dic: ["}, "later_parameters is not valid YAML: line 1"),
    ],
)
def test_impossible_parameters_are_refused(parameters: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        from_parameters(ExperimentNodeSettings, parameters)


def test_every_pattern_is_asked_for_at_every_exposure_time() -> None:
    parameters = ExperimentNodeSettings(pitches_px=[800.0, 40.0], shifts=[3, 4], exposures_ms=[4.0, 16.0])
    shown = parameters.step_patterns()
    assert len(shown) == 14
    assert shown[::2] == shown[1::2]
    asked = [parameters.exposure_time(index, pattern) for index, pattern in enumerate(shown)]
    assert asked == [0.004, 0.016] * 7
    assert parameters.exposure_time(0, ProjectedPattern(PatternKind.WHITE)) == 0.0, "as the camera is set up"
