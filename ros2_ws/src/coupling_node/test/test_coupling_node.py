"""The coupling node in a process of its own: the same clouds as the library, and one status per step."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import xarray as xr
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from fringedic.figures.arrows import displacement_arrows
from fringedic.frames.collector import FrameCollector
from fringedic.frames.records import FrameRecord
from fringedic.rig.model import RigModel
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import CouplingResult, DicResult, PhaseResult
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import Exposure, NodeStatus, RigCalibration
from fringedic_ros.clouds import cloud_arrays
from fringedic_ros.images import image_message
from fringedic_ros.qos import DERIVED, EVENTS, LATCHED
from fringedic_ros.records import calibration_message, exposure_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import Bench, connected_bench, fringe_step, of_stamp, white_step

POSITIONS = (0.0, 1.0e-4, 2.0e-4)  # crosshead of each step [m]
SPACING = 2
FIELDS = ["x", "y", "z", "u", "v", "w", "sigma_u", "sigma_v", "sigma_w", "noise_z", "noise_z_deformed"]
FIELDS += ["u_t", "v_t", "w_n", "e_11", "e_22", "e_12"]
STRAIN_ERRORS = [f"{kind}_{name}" for kind in ("sigma", "resolution") for name in ("e_11", "e_22", "e_12")]


@dataclass
class Measured:
    """What the coupling node needs of one step."""

    last: FrameRecord
    phase: PhaseResult
    dic: DicResult


def measure(rig: VirtualRig) -> list[Measured]:
    collector, tracker = FrameCollector(), DisplacementTracker(DicParameters(spacing=SPACING))
    steps = []
    for step, position in enumerate(POSITIONS):
        frames = fringe_step(rig, position, "", step)
        stack = [collector.add(record, image) for record, image in frames][-1]
        assert stack is not None
        phase = phase_step(stack, PhaseParameters())
        steps.append(Measured(frames[-1][0], phase, tracker.step("", step, stack.stamp, phase.texture)))
    return steps


class CouplingBench(Bench):
    """Plays the phase and dic nodes as well, and hears the coupling node."""

    unread = ("camera/image_raw",)

    def __init__(self) -> None:
        super().__init__("coupling")
        rig = VirtualRig.from_preset("plate", size="tiny")
        self.calibration = RigModel(**rig.optics())
        self.window_known = True  # whether the dic node states how it measured
        self.reference = 0  # of the dic node
        self.measured = measure(rig)
        self.images = {
            topic: self.create_publisher(Image, topic, DERIVED)
            for topic in ("phase/map", "phase/sigma", "phase/texture", "dic/displacement", "dic/sigma")
        }
        self.grid = self.create_publisher(CameraInfo, "dic/camera_info", DERIVED)
        self.inputs = {name: self.create_publisher(NodeStatus, f"{name}/status", EVENTS) for name in ("phase", "dic")}
        self.calibrations = self.create_publisher(RigCalibration, "calibration", LATCHED)
        self.shape = self.listen(PointCloud2, "coupling/shape", DERIVED)
        self.displacement = self.listen(PointCloud2, "coupling/displacement", DERIVED)

    def stamp(self, step: int) -> int:
        return self.measured[step].last.stamp

    def publish_calibration(self) -> None:
        self.calibrations.publish(calibration_message(self.calibration, stamp_ns=1, frame_id="reference_plane"))
        self.taken()

    def send_status(self, name: str, experiment: str, step: int, error_code: int = NodeStatus.NONE) -> None:
        status = NodeStatus(node=name, experiment=experiment, step=step, error_code=error_code, frames=16)
        status.error_message = "scripted" if error_code else ""
        status.header.stamp = to_msg(self.stamp(step))
        if name == "dic":
            status.reference_step = self.reference
        if name == "dic" and self.window_known:
            status.window, status.method = DicParameters().window, DicParameters().method
        self.inputs[name].publish(status)

    def parts(self, experiment: str, step: int) -> list[Callable[[], None]]:
        """One call for each message of a step."""
        measured, stamp = self.measured[step], self.stamp(step)
        phase, dic = measured.phase, measured.dic
        arrays = (phase.phase, phase.sigma, phase.texture, dic.displacement, dic.sigma)
        images = [
            (publisher, image_message(array, stamp_ns=stamp, frame_id="camera_optical_frame"))
            for publisher, array in zip(self.images.values(), arrays, strict=True)
        ]
        grid = CameraInfo(height=120, width=160, binning_x=SPACING, binning_y=SPACING)
        grid.header.stamp = to_msg(stamp)
        grid.roi.x_offset, grid.roi.y_offset = measured.dic.origin
        exposure: Exposure = exposure_message(replace(measured.last, experiment=experiment), frame_id="")
        return [
            *(lambda publisher=publisher, image=image: publisher.publish(image) for publisher, image in images),
            lambda: self.grid.publish(grid),
            lambda: self._exposures.publish(exposure),
            lambda: self.send_status("phase", experiment, step),
            lambda: self.send_status("dic", experiment, step),
        ]

    def send_step(self, experiment: str, step: int, seed: int | None = None) -> NodeStatus:
        """Publish everything of a step, in the usual or a random order; returns the answer."""
        parts = self.parts(experiment, step)
        if seed is not None:
            random.Random(seed).shuffle(parts)
        for part in parts:
            part()
            if seed is not None:
                self.serve(0.02)
        return self.status_of(experiment, step)

    def assert_identical(self, result: CouplingResult) -> None:
        for heard, fields in ((self.shape, result.shape), (self.displacement, result.displacement)):
            self.wait(partial(of_stamp, heard, result.stamp), "the clouds")
            (message,) = of_stamp(heard, result.stamp)
            assert message.header.frame_id == "reference_plane"
            clouds = cloud_arrays(message)
            assert list(clouds) == list(fields)
            for name, array in fields.items():
                assert clouds[name].tobytes() == array.values.tobytes(), name


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CouplingBench]:
    with connected_bench(CouplingBench, "coupling_node.coupling_node", tmp_path_factory.mktemp("coupling")) as bench:
        yield bench


@pytest.fixture
def name(bench: CouplingBench, request: pytest.FixtureRequest) -> str:
    """An experiment of its own for every test."""
    bench.forget()
    bench.reference = 0
    return request.node.name


def expected(bench: CouplingBench, tracker: ShapeTracker, experiment: str, step: int) -> CouplingResult:
    measured = bench.measured[step]
    phase = replace(measured.phase, experiment=experiment)
    displacement = replace(measured.dic, experiment=experiment, reference_step=bench.reference)
    return tracker.step(phase, displacement)


def tracker_of(bench: CouplingBench, **parameters: float) -> ShapeTracker:
    tracker = ShapeTracker(CouplingParameters(**parameters))  # type: ignore[arg-type]
    tracker.set_calibration(bench.calibration)
    return tracker


def test_calibration_is_needed(bench: CouplingBench, name: str) -> None:
    status = bench.send_step(name, 0)
    assert status.error_code == NodeStatus.NO_CALIBRATION
    assert "calibration" in status.error_message
    bench.publish_calibration()
    bench.reference = 1
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE


def test_clouds_are_those_of_the_library_bit_by_bit(bench: CouplingBench, name: str) -> None:
    bench.publish_calibration()
    tracker = tracker_of(bench)
    for step in range(3):
        status = bench.send_step(name, step, seed=step)
        result = expected(bench, tracker, name, step)
        assert (status.node, status.error_code) == ("coupling", NodeStatus.NONE)
        assert to_nanoseconds(status.header.stamp) == result.stamp
        assert (status.valid_fraction, status.frames) == (result.valid_fraction, 16)
        assert status.rms_displacement == result.rms
        bench.assert_identical(result)
        assert list(result.shape) == ["x", "y", "z", "sigma_z"]
        assert list(result.displacement) == [*FIELDS, *STRAIN_ERRORS]
    assert (bench.shape[-1].height, bench.shape[-1].width) == (120, 160)
    assert np.nanmax(np.abs(result.displacement["u"])) > 1e-6, "the plate has moved"


def test_viewers_find_a_value_at_every_point(bench: CouplingBench, name: str) -> None:
    """A NaN at a point with a position would spoil the automatic range of the colours."""
    strains = bench.listen(PointCloud2, "coupling/strain", DERIVED)
    bench.until_read("coupling/strain")
    bench.publish_calibration()
    for step in range(2):
        assert bench.send_step(name, step).error_code == NodeStatus.NONE
    bench.wait(lambda: of_stamp(strains, bench.stamp(1)) and of_stamp(bench.displacement, bench.stamp(1)), "the clouds")
    strain, displacement = (cloud_arrays(of_stamp(each, bench.stamp(1))[0]) for each in (strains, bench.displacement))
    strain_fields = [field for field in strain if field not in ("x", "y", "z")]
    assert set(strain_fields) == {"e_11", "e_22", "e_12", *STRAIN_ERRORS}
    for cloud, fields in ((displacement, FIELDS[3:14]), (strain, strain_fields)):
        shown = np.isfinite(cloud["x"]) & np.isfinite(cloud["y"]) & np.isfinite(cloud["z"])
        assert shown.mean() > 0.5
        for field in fields:
            assert np.isfinite(cloud[field][shown]).all(), field
            np.testing.assert_array_equal(cloud[field][shown], displacement[field][shown])


def test_arrows_point_along_the_displacement(bench: CouplingBench, name: str) -> None:
    messages = pytest.importorskip("visualization_msgs.msg", reason="arrows need visualization_msgs")
    arrows = bench.listen(messages.MarkerArray, "coupling/arrows", DERIVED)
    bench.until_read("coupling/arrows")
    bench.publish_calibration()
    for step in range(2):
        assert bench.send_step(name, step).error_code == NodeStatus.NONE
    bench.wait(lambda: len(arrows) == 2, "the arrows")
    first, *markers = arrows[-1].markers
    assert first.action == messages.Marker.DELETEALL
    assert len(markers) > 100
    expected_result = displacement_arrows(expected_of(bench, name))
    for marker, start, end in zip(markers, expected_result.starts, expected_result.ends, strict=True):
        assert marker.header.frame_id == "reference_plane"
        assert marker.ns == f"displacement x {expected_result.magnification:g}"
        np.testing.assert_allclose([[p.x, p.y, p.z] for p in marker.points], [start, end])


def expected_of(bench: CouplingBench, name: str) -> xr.Dataset:
    """Return the displacement of the second step."""
    tracker = tracker_of(bench)
    return [expected(bench, tracker, name, step) for step in range(2)][-1].displacement


def test_the_window_travels_with_the_displacement(bench: CouplingBench, name: str) -> None:
    """The strain has a standard deviation because the status of the dic node states window and method."""
    bench.publish_calibration()
    bench.change(strain_window_px=41)
    tracker = tracker_of(bench, strain_window_px=41)
    try:
        for step in range(2):
            assert bench.send_step(name, step).error_code == NodeStatus.NONE
            result = expected(bench, tracker, name, step)
            bench.assert_identical(result)
        assert list(result.displacement) == [*FIELDS, *STRAIN_ERRORS]
        assert 1e-7 < np.nanmedian(result.displacement["sigma_e_11"]) < 1e-2
        bench.window_known = False
        assert bench.send_step(f"{name} without", 0).error_code == NodeStatus.NONE
        (cloud,) = of_stamp(bench.displacement, bench.stamp(0))[-1:]
        assert list(cloud_arrays(cloud)) == FIELDS
    finally:
        bench.window_known = True
        bench.change(strain_window_px=CouplingParameters().strain_window_px)


def test_fields_that_nobody_asks_for_are_left_out(bench: CouplingBench, name: str) -> None:
    bench.publish_calibration()
    changed = {"local_frame_window_px": 0, "strain_window_px": 0}
    bench.change(**changed)
    try:
        tracker = tracker_of(bench, **changed)
        bench.send_step(name, 0)
        result = expected(bench, tracker, name, 0)
        assert list(result.displacement) == FIELDS[:11]
        bench.assert_identical(result)
    finally:
        bench.change(**{each: getattr(CouplingParameters(), each) for each in changed})


def test_reference_is_that_of_the_displacement(bench: CouplingBench, name: str) -> None:
    bench.publish_calibration()
    tracker = tracker_of(bench)
    for step, bench.reference in ((0, 0), (1, 1), (2, 1)):
        bench.send_step(name, step)
        result = expected(bench, tracker, name, step)
        assert result.reference_step == bench.reference
        bench.assert_identical(result)
    bench.reference = 7
    assert bench.send_step(f"{name}_later", 2).error_code == NodeStatus.NO_REFERENCE


@pytest.mark.parametrize("failed", ["phase", "dic"])
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (NodeStatus.FRAME_MISSING, NodeStatus.INPUT_FAILED),
        (NodeStatus.STEP_ABORTED, NodeStatus.STEP_ABORTED),
    ],
)
def test_failed_input_fails_the_step(bench: CouplingBench, name: str, failed: str, error: int, code: int) -> None:
    bench.publish_calibration()
    for part in bench.parts(name, 0)[:-2]:
        part()
    bench.send_status(failed, name, 0, error)
    status = bench.status_of(name, 0)
    assert (status.error_code, status.error_message) == (code, f"{failed}: scripted")
    bench.send_status("dic" if failed == "phase" else "phase", name, 0)
    assert bench.status_of(name, 0) is status
    bench.reference = 1
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE


def test_white_step_has_nothing_to_couple(bench: CouplingBench, name: str) -> None:
    bench.send(white_step(VirtualRig.from_preset("plate", size="tiny"), 0.0, name, 0))
    status = bench.status_of(name, 0)
    assert (status.error_code, status.frames) == (NodeStatus.NONE, 0)
    assert np.isnan(status.valid_fraction)


def test_abort_answers_a_step_that_waits(bench: CouplingBench, name: str) -> None:
    bench.publish_calibration()
    for part in bench.parts(name, 0)[:-1]:
        part()
    bench.taken()
    bench.abort(name, 0, bench.stamp(0))
    status = bench.status_of(name, 0)
    assert status.error_code == NodeStatus.STEP_ABORTED
    assert "the camera stopped (here: waiting for dic/status)" in status.error_message
    bench.send_status("dic", name, 0)
    assert bench.status_of(name, 0).error_code == NodeStatus.STEP_ABORTED
    bench.reference = 1
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera_width": 1280, "camera_height": 960, "pixel_size": 50e-6}, "1280 x 960 px, this camera has 160 x 120"),
        ({"pixel_size": 0.4}, "refused: calibration: a pixel_size of 400 mm"),
    ],
)
def test_calibration_of_another_rig_fails_the_step(
    bench: CouplingBench, name: str, changes: dict[str, float], words: str
) -> None:
    bench.calibrations.publish(
        calibration_message(replace(bench.calibration, **changes), stamp_ns=1, frame_id="reference_plane")
    )
    bench.taken()
    status = bench.send_step(name, 0)
    assert status.error_code == NodeStatus.NO_CALIBRATION
    assert words in status.error_message
    bench.publish_calibration()
    bench.reference = 1
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE
