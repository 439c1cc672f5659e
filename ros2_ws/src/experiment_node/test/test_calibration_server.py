"""Calibration by the experiment node against a scripted rig of exact phases: results, and the end of every fault."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import Image

from fringedic.calibration import RigCalibration as Calibrated
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig, MeasureStep
from fringedic_msgs.msg import Exposure, NodeStatus, ReferencePlane, RigCalibration, StepStatus
from fringedic_msgs.srv import CaptureFrame, PlaceReferencePlane, ShowPattern
from fringedic_ros.images import image_message
from fringedic_ros.matching import offer_reader_counts
from fringedic_ros.qos import DERIVED, EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import NodeProcess, Peer, await_readers, killed_stage

PITCHES = [100.0, 20.0, 5.0]
SHIFTS = [3, 3, 3]
GRID_PITCH = 3.0e-3
SIGMA = 2 * math.pi * 0.002
TWIN = VirtualRigConfiguration.from_dict(
    {"preset": "plate", "size": "tiny", "stage": {"grid_pitch_mm": 1e3 * GRID_PITCH, "grid_blur_um": 170.0}}
)
EXACT = RigModel(**VirtualRig(TWIN).optics(), identifier="exact")
ANGLES = np.radians([0.0, -18.0, -9.0, 6.0, 12.0, 18.0])
PARAMETERS = {
    "projector_width_px": EXACT.projector_width,
    "projector_height_px": EXACT.projector_height,
    "camera_first_column_px": 64,
    "camera_first_row_px": 32,
    "pitches_px": PITCHES,
    "shifts": SHIFTS,
    "camera_timeout_s": 2.0,
    "projector_timeout_s": 2.0,
    "processing_timeout_s": 5.0,
    "start_timeout_s": 3.0,
    "placing_timeout_s": 20.0,
}


def plane_phase(angle: float, height: float, seed: int) -> np.ndarray:
    """Phase [rad] of the plane z = height + x tan(angle) at every pixel, with noise."""
    row, column = np.mgrid[: EXACT.camera_height, : EXACT.camera_width]
    rays = EXACT.ray_matrix @ np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    reach = (height - EXACT.camera_distance) / (rays[2] - math.tan(angle) * rays[0])
    x, y, z = rays * reach
    phase = EXACT.phase(x, y, z + EXACT.camera_distance, PITCHES[-1]).reshape(column.shape)
    return (phase + np.random.default_rng(seed).normal(0.0, SIGMA, phase.shape)).astype(np.float32)


class Rig(Peer):
    """Projector, camera, phase node and stage that follow the script of a test."""

    def __init__(self) -> None:
        super().__init__("rig")
        self.clock_ns = 1_000_000_000_000
        twin = VirtualRig(TWIN).with_specimen({"kind": "reference_plane", "surface": "grid"})
        self.grid = twin.expose(np.full(twin.projector_shape, 250, np.uint8), 0.0, 0)
        self.blank = np.full_like(self.grid, 100)
        self.placed: list[PlaceReferencePlane.Request] = []
        self.turn = 1.0  # -1: the stage turns the other way
        self.refusal, self.hang, self.zero = "", None, 0.0
        self.grid_there, self.stuck, self.silent_map = True, False, False
        self.patterns: list[tuple[int, ...]] = []
        self.states: Any = None  # publisher of the stage
        self.goes_to_zero = False  # after the first frame of a plane
        self.set_parameters = self.create_client(SetParameters, "experiment/set_parameters")
        self.steps = self.listen(StepStatus, "experiment/step", EVENTS)
        self.planes = self.listen(ReferencePlane, "experiment/plane", EVENTS)
        self.calibrations = self.listen(RigCalibration, "calibration", LATCHED)
        self.images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self.exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self.status = self.create_publisher(NodeStatus, "phase/status", EVENTS)
        offer_reader_counts(self, "phase")
        self.map = self.create_publisher(Image, "phase/map", DERIVED)
        self.sigma = self.create_publisher(Image, "phase/sigma", DERIVED)
        self.group = ReentrantCallbackGroup()
        self.create_service(ShowPattern, "projector/show", self._show, callback_group=self.group)
        self.create_service(CaptureFrame, "camera/capture", self._capture, callback_group=self.group)
        self.stage: Any = None
        self.distortion = ActionClient(self, CalibrateDistortion, "calibrate_distortion")
        self.rig = ActionClient(self, CalibrateRig, "calibrate_rig")
        self.measure = ActionClient(self, MeasureStep, "measure_step")
        self.feedback: list[Any] = []

    def install_stage(self) -> None:
        self.stage = self.create_service(
            PlaceReferencePlane, "reference_plane/place", self._place, callback_group=self.group
        )

    def _show(self, _: ShowPattern.Request, response: ShowPattern.Response) -> ShowPattern.Response:
        self.clock_ns += 1_000_000
        response.shown = to_msg(self.clock_ns)
        return response

    async def _place(
        self, request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response
    ) -> PlaceReferencePlane.Response:
        self.placed.append(request)
        if self.hang is not None and request.kind != ReferencePlane.SPECIMEN:
            await self.hang
        response.success, response.message = not self.refusal, self.refusal
        response.angle, response.height = request.angle, request.height + self.zero
        if self.states is not None:
            response.placed = self.report_place(request.kind, request.angle)
        return response

    def report_place(self, kind: int, angle: float) -> Time:
        """Publish the state of the stage and return its stamp."""
        state = ReferencePlane(kind=kind, angle=angle)
        state.header.stamp = to_msg(time.time_ns())
        self.states.publish(state)
        return state.header.stamp

    def change(self, **values: Any) -> None:
        """Change parameters of the experiment node."""
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=changes)
        response = self.ask(self.set_parameters, request, "the change of parameters")
        assert all(result.successful for result in response.results), response

    def _capture(self, request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        if not request.count:
            return response
        await_readers(self.images, request.image_subscribers)
        await_readers(self.exposures, request.exposure_subscribers)
        self.patterns.append((request.kind, request.index, request.count, request.pitch))
        self.clock_ns += 10_000_000
        response.stamp = to_msg(self.clock_ns)
        there = self.placed[-1]
        if self.goes_to_zero and request.index == 0:
            self.report_place(there.kind, 0.0)
        shown = self.grid if there.kind == ReferencePlane.GRID and self.grid_there else self.blank
        self.images.publish(image_message(shown, stamp_ns=self.clock_ns, frame_id="camera_optical_frame"))
        exposure = Exposure(experiment=request.experiment, step=request.step, index=request.index, count=request.count)
        exposure.header.stamp, exposure.exposure_time = response.stamp, 0.01
        self.exposures.publish(exposure)
        if request.kind == Exposure.FRINGES and request.index == request.count - 1:
            angle = 0.0 if self.stuck else self.turn * there.angle
            phase = plane_phase(angle, there.height, request.step)
            if not self.silent_map:
                self.map.publish(image_message(phase, stamp_ns=self.clock_ns, frame_id="camera_optical_frame"))
            sigma = np.full_like(phase, SIGMA)
            self.sigma.publish(image_message(sigma, stamp_ns=self.clock_ns, frame_id="camera_optical_frame"))
            self.status.publish(NodeStatus(node="phase", experiment=request.experiment, step=request.step))
        return response

    def request(self, client: ActionClient, goal: Any) -> Any:
        future = client.send_goal_async(goal, feedback_callback=lambda message: self.feedback.append(message.feedback))
        self.wait(future.done, "the answer to the goal")
        return future.result()

    def result(self, handle: Any) -> tuple[int, Any]:
        future = handle.get_result_async()
        self.wait(future.done, "the result")
        return future.result().status, future.result().result

    def calibrate_distortion(self, folder: Path, **goal: Any) -> Any:
        goal = {"grid_pitch": GRID_PITCH, "frames": 2, "folder": str(folder)} | goal
        return self.result(self.request(self.distortion, CalibrateDistortion.Goal(**goal)))[1]

    def calibrate(self, folder: Path, **goal: Any) -> Any:
        goal = {"angles": list(ANGLES), "held_out": [3], "folder": str(folder)} | goal
        return self.result(self.request(self.rig, CalibrateRig.Goal(**goal)))[1]

    def behave(self) -> None:
        """Do everything right from now on, and clear the journals."""
        self.serve(0.1)
        for heard in (self.steps, self.planes, self.feedback, self.placed, self.patterns):
            heard.clear()
        self.turn, self.refusal, self.hang, self.zero = 1.0, "", None, 0.0
        self.grid_there, self.stuck, self.silent_map = True, False, False
        if self.stage is None:
            self.install_stage()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """The rig with an experiment node that serves all tests of this module and has no calibration yet."""
    rclpy.init()
    rig = Rig()
    folder = tmp_path_factory.mktemp("calibration")
    with NodeProcess("experiment_node.experiment_node", folder, PARAMETERS | {"calibration_folder": folder}):
        for client in (rig.distortion, rig.rig, rig.measure):
            rig.wait(client.server_is_ready, "an action server")
        rig.meet("experiment")
        yield rig
    rig.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.behave()
    return running


def test_nobody_places_the_plane(running: Rig, tmp_path: Path) -> None:
    """First of all tests: there is no stage yet."""
    result = running.calibrate_distortion(tmp_path)
    assert result.error_code == CalibrateDistortion.Result.PLACING_FAILED
    assert not result.go
    assert "reference_plane/place" in result.error_message
    assert "fringedic calibrate" in result.error_message
    assert not list(tmp_path.iterdir())


def test_planes_need_the_grid_first(rig: Rig, tmp_path: Path) -> None:
    result = rig.calibrate(tmp_path)
    assert result.error_code == CalibrateRig.Result.INVALID_GOAL
    assert "grid" in result.error_message


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ({"grid_pitch": 0.0}, "distance of the printed lines"),
        ({"grid_pitch": math.nan}, "distance of the printed lines"),
    ],
)
def test_distortion_goals_without_meaning(rig: Rig, tmp_path: Path, goal: dict[str, Any], words: str) -> None:
    result = rig.calibrate_distortion(tmp_path, **goal)
    assert result.error_code == CalibrateDistortion.Result.INVALID_GOAL
    assert words in result.error_message
    assert not [request for request in rig.placed if request.kind != ReferencePlane.SPECIMEN]


def test_an_image_without_grid(rig: Rig, tmp_path: Path) -> None:
    rig.grid_there = False
    result = rig.calibrate_distortion(tmp_path)
    assert result.error_code == CalibrateDistortion.Result.GRID_REJECTED, result
    assert rig.calibrate(tmp_path).error_code == CalibrateRig.Result.INVALID_GOAL  # there is still no scale


def test_calibration_from_begin_to_end(rig: Rig, tmp_path: Path) -> None:
    camera = rig.calibrate_distortion(tmp_path)
    assert (camera.error_code, camera.error_message, camera.go) == (0, "", True)
    assert camera.verdict
    assert (tmp_path / "distortion.yaml").exists()
    [grid] = rig.planes
    assert (grid.kind, grid.experiment, grid.step, grid.grid_pitch) == (0, camera.experiment, 0, GRID_PITCH)
    late = rig.listen(ReferencePlane, "experiment/plane", LATCHED_BY_MANY)
    rig.wait(lambda: grid in late, "the plane for a recorder that connects late")
    rig.behave()

    result = rig.calibrate(tmp_path)
    assert result.folder == str(tmp_path)
    assert (result.error_code, result.error_message, result.go) == (0, "", True)
    assert result.identifier == result.experiment != camera.experiment
    planes = [(plane.step, plane.angle, plane.held_out) for plane in rig.planes]
    assert planes == [
        *((step, angle, step == 3) for step, angle in enumerate(ANGLES)),
        (len(ANGLES), ANGLES[0], True),
    ]
    assert rig.placed[-1].kind == ReferencePlane.SPECIMEN
    words = [feedback.words for feedback in rig.feedback]
    assert any("+12.00 degree (right side towards the camera)" in each for each in words), words
    assert {feedback.plane for feedback in rig.feedback} == set(range(1, len(ANGLES) + 2))
    assert math.isfinite(result.drift)
    assert result.drift < 5e-6

    # the calibration in force is the one in the file, and measures a surface like the exact one
    rig.wait(lambda: rig.calibrations, "the calibration")
    published = RigModel.from_message(rig.calibrations[-1])
    kept = Calibrated.load(tmp_path)
    assert published.identifier == kept.model.identifier == result.identifier
    assert (published.camera_first_column, published.camera_first_row) == (64, 32)
    assert published.projector_position == kept.model.projector_position
    phase = plane_phase(math.radians(7.0), 2e-3, seed=99)
    measured, exact = (model.reconstruct(phase, PITCHES[-1]).z.values for model in (published, EXACT))
    difference = float(np.sqrt(np.mean((measured - exact) ** 2)))
    assert difference < 12e-6  # 1/30 of a pixel of 400 µm
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_a_wrong_sign_leaves_the_former_calibration_in_force(rig: Rig, tmp_path: Path) -> None:
    before = len(rig.calibrations)
    rig.turn = -1.0
    result = rig.calibrate(tmp_path)
    assert result.error_code in (CalibrateRig.Result.FIT_FAILED, CalibrateRig.Result.NO_GO)
    assert not result.go
    assert "sign" in result.error_message
    assert not (tmp_path / "calibration.yaml").exists()
    rig.serve(0.2)
    assert len(rig.calibrations) == before


def test_a_plane_that_was_not_turned_is_named_at_once(rig: Rig, tmp_path: Path) -> None:
    rig.stuck = True
    result = rig.calibrate(tmp_path)
    assert result.error_code == CalibrateRig.Result.PLANE_REJECTED
    assert "not moved" in result.error_message, result.error_message
    assert len(rig.planes) == 2


def test_a_rejected_plane_is_placed_and_measured_again_with_an_operator(rig: Rig, tmp_path: Path) -> None:
    """One bad position ended the calibration of twenty."""
    rig.change(placing_attempts=1000)
    rig.stuck = True
    handle = rig.request(rig.rig, CalibrateRig.Goal(angles=list(ANGLES), held_out=[3], folder=str(tmp_path)))
    rig.wait(lambda: any("not moved" in each.words for each in rig.feedback), "the rejection")
    rig.stuck = False
    result = rig.result(handle)[1]
    rig.change(placing_attempts=1)
    assert (result.error_code, result.error_message, result.go) == (0, "", True)
    angles = [plane.angle for plane in rig.planes]
    assert len(angles) > len(ANGLES) + 1
    assert [angle for angle, before in zip(angles, [None, *angles], strict=False) if angle != before] == [
        *ANGLES,
        ANGLES[0],
    ]


def test_cancelled_half_way(rig: Rig, tmp_path: Path) -> None:
    handle = rig.request(rig.rig, CalibrateRig.Goal(angles=list(ANGLES), folder=str(tmp_path)))
    rig.wait(lambda: len(rig.planes) == 2, "the second plane")
    rig.hang = Future()
    busy = rig.result(rig.request(rig.measure, MeasureStep.Goal(mode=MeasureStep.Goal.FRINGES)))[1]
    assert busy.error_code == MeasureStep.Result.BUSY
    assert "calibrated" in busy.error_message
    assert rig.calibrate(tmp_path).error_code == CalibrateRig.Result.BUSY
    cancelling = handle.cancel_goal_async()
    rig.wait(cancelling.done, "the answer to the cancelling")
    status, result = rig.result(handle)
    assert (status, result.error_code, result.go) == (GoalStatus.STATUS_CANCELED, CalibrateRig.Result.CANCELLED, False)
    rig.hang.set_result(None)
    rig.wait(lambda: rig.placed[-1].kind == ReferencePlane.SPECIMEN, "the specimen's return")
    rig.behave()
    assert rig.calibrate_distortion(tmp_path).error_code == 0  # the rig is free again


def test_a_stage_that_refuses_or_hangs(rig: Rig, tmp_path: Path) -> None:
    rig.refusal = "the stage turns to 15 degree at most"
    result = rig.calibrate(tmp_path)
    assert result.error_code == CalibrateRig.Result.PLACING_FAILED
    assert rig.refusal in result.error_message
    assert "+0.00 degree" in result.error_message
    rig.behave()
    rig.hang = Future()
    rig.change(placing_timeout_s=2.0)
    result = rig.calibrate(tmp_path)
    rig.change(placing_timeout_s=PARAMETERS["placing_timeout_s"])
    rig.hang.set_result(None)
    assert result.error_code == CalibrateRig.Result.PLACING_TIMEOUT
    assert "did not answer" in result.error_message


@pytest.mark.parametrize(("zero", "words"), [(5e-3, "+5.000 mm; the grid defines the scale"), (math.nan, "no number")])
def test_a_stage_whose_zero_is_not_that_of_the_grid(rig: Rig, tmp_path: Path, zero: float, words: str) -> None:
    """The scale would be wrong without a sign of it."""
    rig.zero = zero
    result = rig.calibrate_distortion(tmp_path)
    assert result.error_code == CalibrateDistortion.Result.PLACING_FAILED
    assert words in result.error_message


def test_a_height_that_is_no_number_ends_the_calibration_at_once(rig: Rig, tmp_path: Path) -> None:
    rig.zero = math.nan
    result = rig.calibrate(tmp_path)
    assert result.error_code == CalibrateRig.Result.PLACING_FAILED
    assert "no number" in result.error_message
    assert len(rig.planes) == 0


def test_pitches_that_are_changed_meanwhile_are_those_of_the_next_calibration(rig: Rig, tmp_path: Path) -> None:
    """The fit takes all phases as those of one pitch, and finds a wrong projector that fits them."""
    rig.hang = Future()
    handle = rig.request(rig.rig, CalibrateRig.Goal(angles=list(ANGLES), folder=str(tmp_path)))
    rig.wait(lambda: len(rig.placed) == 1, "the first plane")
    rig.change(pitches_px=[4 * each for each in PARAMETERS["pitches_px"]])
    released, rig.hang = rig.hang, None
    released.set_result(None)
    assert rig.result(handle)[1].go
    rig.change(pitches_px=PARAMETERS["pitches_px"])
    assert max(pitch for *_, pitch in rig.patterns) == max(PARAMETERS["pitches_px"])


def test_a_stage_that_leaves_its_place_during_the_frames(rig: Rig, tmp_path: Path) -> None:
    """Its driver was started again, and moves it to its zero."""
    rig.states = rig.create_publisher(ReferencePlane, "reference_plane/state", LATCHED)
    rig.wait(rig.states.get_subscription_count, "the experiment node")
    rig.meet("experiment")
    rig.goes_to_zero = True
    result = rig.calibrate(tmp_path, angles=[0.1, *ANGLES[1:]])
    rig.goes_to_zero = False
    rig.destroy_publisher(rig.states)
    rig.states = None
    assert result.error_code == CalibrateRig.Result.STEP_FAILED
    assert "it reports the plane at +0.00 degree and +0.000 mm instead of the plane at +5.73" in result.error_message
    assert len(rig.planes) == 1


def test_a_map_that_does_not_come(rig: Rig, tmp_path: Path) -> None:
    rig.silent_map = True
    result = rig.calibrate(tmp_path)
    assert result.error_code == CalibrateRig.Result.STEP_FAILED
    assert "phase/map" in result.error_message


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ({"angles": []}, "0 angles"),
        ({"heights": [0.0, 1e-3]}, "one of each"),
        ({"angles": [0.0, 10.0, 20.0]}, "radian"),
        ({"held_out": [6]}, "held_out"),
        ({"sigma_angle": -1.0}, "sigma_angle"),
    ],
)
def test_goals_without_meaning(rig: Rig, tmp_path: Path, goal: dict[str, Any], words: str) -> None:
    result = rig.calibrate(tmp_path, **goal)
    assert result.error_code == CalibrateRig.Result.INVALID_GOAL
    assert words in result.error_message
    assert not rig.planes


def test_a_folder_that_cannot_be_written(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = rig.calibrate_distortion(tmp_path / "file")
    assert result.error_code == CalibrateDistortion.Result.FILES_FAILED, result


@pytest.mark.parametrize("again", [False, True])
def test_a_stage_that_was_killed(rig: Rig, tmp_path: Path, again: bool) -> None:
    """Without it the plane fails long before the time of a slow stage; started again, it gets the request again."""
    rig.change(placing_timeout_s=90.0, start_timeout_s=60.0)
    rig.destroy_service(rig.stage)
    rig.stage = None
    killed = threading.Event()
    with killed_stage("", then=killed.set):
        rig.wait(lambda: rig.count_services("reference_plane/place"), "the stage")
        goal = CalibrateDistortion.Goal(grid_pitch=GRID_PITCH, frames=2, folder=str(tmp_path))
        handle = rig.request(rig.distortion, goal)
        rig.wait(killed.is_set, "the request to the stage")
        if again:
            rig.install_stage()
        result = rig.result(handle)[1]
    rig.change(**{name: PARAMETERS[name] for name in ("placing_timeout_s", "start_timeout_s")})
    if again:
        assert (result.error_code, result.error_message) == (0, "")
    else:
        assert result.error_code == CalibrateDistortion.Result.PLACING_FAILED
        assert "the service reference_plane/place is missing" in result.error_message
