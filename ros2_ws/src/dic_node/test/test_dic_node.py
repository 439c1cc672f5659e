"""The dic node in a process of its own: the same displacement as the library, and one status per step."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image

from fringedic.figures.previews import displacement_preview
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import DicParameters
from fringedic.steps.step_results import DicResult
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import NodeStatus, Reference
from fringedic_msgs.srv import QueryStep
from fringedic_ros.images import image_array, image_message
from fringedic_ros.qos import DERIVED, EVENTS, LATCHED
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import Bench, connected_bench, of_stamp, white_step

POSITIONS = (0.0, 1.0e-4, 2.0e-4, 3.0e-4)  # crosshead of each step [m]


class DicBench(Bench):
    """Plays the phase node as well, and hears the dic node."""

    def __init__(self) -> None:
        super().__init__("dic")
        rig = VirtualRig.from_preset("plate", size="tiny")
        self.white = [white_step(rig, position, "", step)[0] for step, position in enumerate(POSITIONS)]
        self.textures = [white_texture(image) for _, image in self.white]
        self._texture = self.create_publisher(Image, "phase/texture", DERIVED)
        self._phase_status = self.create_publisher(NodeStatus, "phase/status", EVENTS)
        self._reference = self.create_publisher(Reference, "experiment/reference", LATCHED)
        self.displacement = self.listen(Image, "dic/displacement", DERIVED)
        self.sigma = self.listen(Image, "dic/sigma", DERIVED)
        self.grid = self.listen(CameraInfo, "dic/camera_info", DERIVED)

        self._query = self.create_client(QueryStep, "dic/query_step")

    def received(self, experiment: str, step: int) -> bool:
        request = QueryStep.Request(experiment=experiment, step=step)
        return bool(self.ask(self._query, request, "the state of a step").received)

    def stamp(self, step: int) -> int:
        return self.white[step][0].stamp

    def send_texture(self, step: int, texture: np.ndarray | None = None) -> None:
        image = self.textures[step] if texture is None else texture
        self._texture.publish(image_message(image, stamp_ns=self.stamp(step), frame_id="camera_optical_frame"))

    def send_phase_status(self, experiment: str, step: int, error_code: int = NodeStatus.NONE) -> None:
        status = NodeStatus(node="phase", experiment=experiment, step=step, error_code=error_code, frames=16)
        status.error_message = "scripted" if error_code else ""
        status.header.stamp = to_msg(self.stamp(step))
        self._phase_status.publish(status)

    def send_step(self, experiment: str, step: int, texture: np.ndarray | None = None) -> NodeStatus:
        """What the phase node sends of a fringe step; returns the answer."""
        self.send_texture(step, texture)
        self.send_phase_status(experiment, step)
        return self.status_of(experiment, step)

    def set_reference(self, experiment: str, step: int) -> None:
        self._reference.publish(Reference(experiment=experiment, step=step))

    def assert_identical(self, result: DicResult) -> None:
        for heard, array in ((self.displacement, result.displacement), (self.sigma, result.sigma)):
            self.wait(partial(of_stamp, heard, result.stamp), "the images")
            (message,) = of_stamp(heard, result.stamp)
            assert message.encoding == "32FC2"
            assert image_array(message).tobytes() == array.tobytes()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DicBench]:
    with connected_bench(DicBench, "dic_node.dic_node", tmp_path_factory.mktemp("dic")) as bench:
        yield bench


@pytest.fixture
def name(bench: DicBench, request: pytest.FixtureRequest) -> str:
    """An experiment of its own for every test."""
    bench.forget()
    return request.node.name


@pytest.fixture
def tracker() -> DisplacementTracker:
    return DisplacementTracker(DicParameters())


def test_displacement_is_that_of_the_library_bit_by_bit(
    bench: DicBench, name: str, tracker: DisplacementTracker
) -> None:
    for step, texture in enumerate(bench.textures):
        if step % 2:  # either order
            bench.send_phase_status(name, step)
            bench.taken()
            bench.send_texture(step)
        else:
            bench.send_texture(step)
            bench.taken()
            bench.send_phase_status(name, step)
        status = bench.status_of(name, step)
        result = tracker.step(name, step, bench.stamp(step), texture)
        assert (status.node, status.error_code) == ("dic", NodeStatus.NONE)
        assert to_nanoseconds(status.header.stamp) == result.stamp
        assert (status.valid_fraction, status.frames) == (result.valid_fraction, 16)
        assert status.rms_displacement_px == result.rms
        bench.assert_identical(result)
    assert result.rms > 0.1, "the plate has moved"


def test_a_step_is_received_when_all_its_messages_are(bench: DicBench, name: str) -> None:
    bench.send_texture(0)
    bench.taken()
    assert not bench.received(name, 0)
    bench.send_phase_status(name, 0)
    bench.status_of(name, 0)
    assert bench.received(name, 0)
    assert not bench.received(name, 1)


def test_preview_is_published_to_subscribers(bench: DicBench, name: str, tracker: DisplacementTracker) -> None:
    previews: list[Image] = []
    viewer = bench.create_subscription(Image, "dic/preview", previews.append, DERIVED)
    bench.until_read("dic/preview")
    bench.send_step(name, 0)
    bench.wait(lambda: previews, "the preview")
    bench.destroy_subscription(viewer)
    assert [message.encoding for message in previews] == ["rgb8"]
    itself = tracker.step(name, 0, bench.stamp(0), bench.textures[0])
    np.testing.assert_array_equal(image_array(previews[0]), displacement_preview(itself.displacement))


def test_white_steps_come_from_the_camera(bench: DicBench, name: str, tracker: DisplacementTracker) -> None:
    for step in (0, 1):
        bench.send(white_step(VirtualRig.from_preset("plate", size="tiny"), POSITIONS[step], name, step))
        status = bench.status_of(name, step)
        assert (status.error_code, status.frames) == (NodeStatus.NONE, 1)
        bench.assert_identical(tracker.step(name, step, bench.stamp(step), bench.textures[step]))


def test_status_says_which_step_the_texture_was_compared_with(
    bench: DicBench, name: str, tracker: DisplacementTracker
) -> None:
    first, last = bench.textures[0], np.ascontiguousarray(bench.textures[0][::-1])
    for step, share in enumerate((0.0, 0.25, 0.5, 0.75)):
        texture = ((1 - share) * first + share * last).astype(np.float32)
        status = bench.send_step(name, step, texture)
        result = tracker.step(name, step, bench.stamp(step), texture)
        assert (status.error_code, status.correlated_step) == (NodeStatus.NONE, result.correlated_step), step
    assert result.correlated_step > 0, "the last image shows little of the first"


def test_reference_of_the_following_steps(bench: DicBench, name: str, tracker: DisplacementTracker) -> None:
    for step in (0, 1):
        assert bench.send_step(name, step).error_code == NodeStatus.NONE
        tracker.step(name, step, bench.stamp(step), bench.textures[step])
    bench.set_reference(name, 2)  # before the step itself
    bench.taken()
    bench.send_step(name, 2)
    tracker.set_reference(name, 2)
    itself = tracker.step(name, 2, bench.stamp(2), bench.textures[2])
    bench.assert_identical(itself)
    assert np.nanmax(np.abs(itself.displacement)) == 0
    assert np.isfinite(itself.displacement).any()
    bench.set_reference(name, 1)  # one that was measured earlier
    bench.taken()
    bench.send_step(name, 3)
    tracker.set_reference(name, 1)
    bench.assert_identical(tracker.step(name, 3, bench.stamp(3), bench.textures[3]))


def test_missing_reference(bench: DicBench, name: str) -> None:
    bench.set_reference(name, 7)
    bench.taken()
    status = bench.send_step(name, 0)
    assert status.error_code == NodeStatus.NO_REFERENCE
    assert "step 7" in status.error_message
    bench.set_reference(name, 1)
    bench.taken()
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE


def test_window_and_grid_change_from_the_next_step_on(bench: DicBench, name: str) -> None:
    changed = DicParameters(window=24, spacing=4)
    tracker = DisplacementTracker(changed)
    bench.change(window=changed.window, spacing=changed.spacing)
    try:
        for step in (0, 1):
            bench.send_step(name, step)
            result = tracker.step(name, step, bench.stamp(step), bench.textures[step])
            bench.assert_identical(result)
        (grid,) = of_stamp(bench.grid, bench.stamp(1))
        rows, columns = result.displacement.shape[:2]
        assert (grid.height, grid.width, grid.binning_x, grid.binning_y) == (120, 160, 4, 4)
        assert (grid.roi.y_offset, grid.roi.x_offset) == result.origin
        assert (grid.roi.height // 4, grid.roi.width // 4) == (rows, columns)  # as sensor_msgs defines the size
        republished = {each.name: each.value.integer_value for each in bench.node_parameters[-1].parameters}
        assert (republished["window"], republished["spacing"]) == (24, 4)
    finally:
        bench.change(window=DicParameters().window, spacing=DicParameters().spacing)


def test_failed_phase_fails_the_step(bench: DicBench, name: str) -> None:
    bench.send_phase_status(name, 0, NodeStatus.FRAME_MISSING)
    status = bench.status_of(name, 0)
    assert (status.error_code, status.error_message) == (NodeStatus.INPUT_FAILED, "phase: scripted")
    bench.send_phase_status(name, 1, NodeStatus.STEP_ABORTED)
    assert bench.status_of(name, 1).error_code == NodeStatus.STEP_ABORTED
    assert bench.send_step(name, 2).error_code == NodeStatus.NONE


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda texture: texture[:-20, :-20], NodeStatus.FRAME_MISMATCH),
        (lambda texture: np.full_like(texture, 100.0), NodeStatus.NO_CORRELATION),
        (lambda texture: np.full_like(texture, np.nan), NodeStatus.NO_CORRELATION),
    ],
    ids=["other size", "no texture", "nothing measured"],
)
def test_bad_texture_ends_its_step_and_the_next_one_works(
    bench: DicBench, name: str, tracker: DisplacementTracker, spoil: object, code: int
) -> None:
    bench.send_step(name, 0)
    tracker.step(name, 0, bench.stamp(0), bench.textures[0])
    status = bench.send_step(name, 1, spoil(bench.textures[1]))  # type: ignore[operator]
    assert status.error_code == code, status.error_message
    assert not of_stamp(bench.displacement, bench.stamp(1))
    assert bench.send_step(name, 2).error_code == NodeStatus.NONE
    bench.assert_identical(tracker.step(name, 2, bench.stamp(2), bench.textures[2]))


def test_unreadable_white_frame_ends_its_step(bench: DicBench, name: str) -> None:
    rig = VirtualRig.from_preset("plate", size="tiny")
    ((record, image),) = white_step(rig, 0.0, name, 0)
    message = image_message(image, stamp_ns=record.stamp, frame_id="")
    message.encoding = "yuv422"
    bench.send_message(message, record)
    assert bench.status_of(name, 0).error_code == NodeStatus.FRAME_MISMATCH
    bench.send(white_step(rig, 0.0, name, 1))
    assert bench.status_of(name, 1).error_code == NodeStatus.NONE


def test_abort_answers_a_step_that_waits(bench: DicBench, name: str) -> None:
    bench.send_texture(0)
    bench.abort(name, 0)
    assert bench.status_of(name, 0).error_code == NodeStatus.STEP_ABORTED
    bench.send_phase_status(name, 0)
    bench.abort(name, 0)
    assert bench.status_of(name, 0).error_code == NodeStatus.STEP_ABORTED
    assert bench.send_step(name, 1).error_code == NodeStatus.NONE
