"""The phase node in a process of its own: the same maps as the library, and one status per step whatever happens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from sensor_msgs.msg import Image

from fringedic.figures.previews import phase_preview
from fringedic.frames.collector import FrameCollector
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import fringe_sequence, one_image_sequence
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.step_results import PhaseResult
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import NodeStatus
from fringedic_ros.images import image_array, image_message
from fringedic_ros.processing import JOINED_STEPS
from fringedic_ros.qos import DERIVED
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import Bench, Frame, connected_bench, fringe_step, of_stamp, white_step

MAPS = ("map", "sigma", "modulation", "texture")
Frames = list[Frame]


class PhaseBench(Bench):
    """Hears what the phase node publishes."""

    def __init__(self) -> None:
        super().__init__("phase")
        self.rig = VirtualRig.from_preset("plate", size="tiny")
        self.maps = {name: self.listen(Image, f"phase/{name}", DERIVED) for name in MAPS}

    def published(self, stamp: int) -> dict[str, np.ndarray]:
        return {name: image_array(message) for name, heard in self.maps.items() for message in of_stamp(heard, stamp)}


def expected(frames: Frames, parameters: PhaseParameters) -> PhaseResult:
    collector = FrameCollector()
    stack = [collector.add(record, image) for record, image in frames][-1]
    assert stack is not None
    return phase_step(stack, parameters)


def assert_identical(bench: PhaseBench, result: PhaseResult) -> None:
    bench.wait(lambda: len(bench.published(result.stamp)) == len(MAPS), "the maps")  # they may be later than the status
    published = bench.published(result.stamp)
    for name, array in zip(MAPS, (result.phase, result.sigma, result.modulation, result.texture), strict=True):
        assert published[name].dtype == array.dtype == np.float32
        assert published[name].tobytes() == array.tobytes(), name


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PhaseBench]:
    with connected_bench(PhaseBench, "phase_node.phase_node", tmp_path_factory.mktemp("phase")) as bench:
        yield bench


@pytest.fixture
def name(bench: PhaseBench, request: pytest.FixtureRequest) -> str:
    """An experiment of its own for every test."""
    bench.forget()
    return request.node.name


def test_maps_are_those_of_the_library_bit_by_bit(bench: PhaseBench, name: str) -> None:
    for step, exposures_first in enumerate((False, True)):
        frames = fringe_step(bench.rig, 1e-4 * step, name, step)
        bench.send(frames, exposures_first=exposures_first)
        status = bench.status_of(name, step)
        result = expected(frames, PhaseParameters())
        assert (status.node, status.error_code, status.error_message) == ("phase", NodeStatus.NONE, "")
        assert to_nanoseconds(status.header.stamp) == frames[-1][0].stamp == result.stamp
        assert (status.valid_fraction, status.frames) == (result.valid_fraction, len(frames))
        assert status.phase_sigma == result.rms
        assert status.duration > 0
        assert result.valid_fraction > 0.5
        assert_identical(bench, result)


def test_parameters_change_from_the_next_step_on(bench: PhaseBench, name: str) -> None:
    bench.change(read_noise_grey_level=3.0)
    frames = fringe_step(bench.rig, 0.0, name, 0)
    bench.send(frames)
    bench.status_of(name, 0)
    assert_identical(bench, expected(frames, PhaseParameters(read_noise_grey_level=3.0)))
    republished = {each.name: each.value.double_value for each in bench.node_parameters[-1].parameters}
    assert republished["read_noise_grey_level"] == 3.0
    bench.change(read_noise_grey_level=PhaseParameters().read_noise_grey_level)


def test_preview_is_published_to_subscribers(bench: PhaseBench, name: str) -> None:
    previews: list[Image] = []
    viewer = bench.create_subscription(Image, "phase/preview", previews.append, DERIVED)
    bench.until_read("phase/preview")
    frames = fringe_step(bench.rig, 0.0, name, 0)
    bench.send(frames)
    bench.status_of(name, 0)
    bench.wait(lambda: previews, "the preview")
    bench.destroy_subscription(viewer)
    assert [message.encoding for message in previews] == ["rgb8"]
    np.testing.assert_array_equal(image_array(previews[0]), phase_preview(expected(frames, PhaseParameters()).phase))


def test_white_step_has_nothing_to_measure(bench: PhaseBench, name: str) -> None:
    bench.send(white_step(bench.rig, 0.0, name, 0))
    status = bench.status_of(name, 0)
    assert (status.error_code, status.frames) == (NodeStatus.NONE, 0)
    assert np.isnan(status.valid_fraction)
    assert not bench.published(to_nanoseconds(status.header.stamp))


def missing(frames: Frames) -> Frames:
    return frames[:5] + frames[6:]


def doubled(frames: Frames) -> Frames:
    record, image = frames[5]
    again = replace(record, stamp=record.stamp + 1_000_000)  # another exposure claims the same index
    return [*frames[:6], (again, image), *frames[6:]]


def late(frames: Frames) -> Frames:
    return [*missing(frames), frames[5]]


def other_size(frames: Frames) -> Frames:
    return [(record, image[:-2] if record.index == 5 else image) for record, image in frames]


def other_type(frames: Frames) -> Frames:
    return [(record, image.astype(np.uint16) if record.index == 5 else image) for record, image in frames]


@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [
        (missing, NodeStatus.FRAME_MISSING, "frame 5 of 16 never arrived"),
        (doubled, NodeStatus.FRAME_DOUBLED, "frame 5 arrived twice"),
        (late, NodeStatus.FRAME_MISSING, "frame 5 of 16 never arrived"),
        (other_size, NodeStatus.FRAME_MISMATCH, "160x118 px"),
        (other_type, NodeStatus.FRAME_MISMATCH, "uint16"),
    ],
)
def test_bad_frames_end_their_step_and_the_next_one_works(
    bench: PhaseBench, name: str, fault: object, code: int, words: str
) -> None:
    bench.send(fault(fringe_step(bench.rig, 0.0, name, 0)))  # type: ignore[operator]
    status = bench.status_of(name, 0)
    assert (status.error_code, status.frames) == (code, 0)
    assert words in status.error_message
    assert status.step == 0
    assert not bench.published(to_nanoseconds(status.header.stamp))
    after = fringe_step(bench.rig, 0.0, name, 1)
    bench.send(after)
    assert bench.status_of(name, 1).error_code == NodeStatus.NONE
    assert_identical(bench, expected(after, PhaseParameters()))


def test_unreadable_image_ends_its_step(bench: PhaseBench, name: str) -> None:
    frames = fringe_step(bench.rig, 0.0, name, 0)
    bench.send(frames[:3])
    record, image = frames[3]
    message = image_message(image, stamp_ns=record.stamp, frame_id="")
    message.encoding = "yuv422"
    bench.send_message(message, record)
    bench.send(frames[4:])
    status = bench.status_of(name, 0)
    assert status.error_code == NodeStatus.FRAME_MISMATCH
    assert "yuv422" in status.error_message
    bench.send(fringe_step(bench.rig, 0.0, name, 1))
    assert bench.status_of(name, 1).error_code == NodeStatus.NONE


def swapped(frames: Frames) -> Frames:
    images = [image for _, image in frames]
    images[9], images[10] = images[10], images[9]
    return [(record, image) for (record, _), image in zip(frames, images, strict=True)]


def alien(frames: Frames) -> Frames:
    return [(record, frames[4][1] if record.index == 5 else image) for record, image in frames]


def frozen(frames: Frames) -> Frames:
    return [(record, frames[0][1]) for record, _ in frames]


def overexposed(frames: Frames) -> Frames:
    return [(record, np.full_like(image, 255)) for record, image in frames]


def foreign(frames: Frames) -> Frames:
    return [(replace(record, sensor="right"), image) for record, image in frames]


@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [
        (foreign, NodeStatus.FRAME_MISMATCH, "frame 0 is of the sensor 'right', this node is of 'sensor': start both"),
        (swapped, NodeStatus.PATTERN_NOT_SEEN, "frames 9 and 10 are interchanged"),
        (alien, NodeStatus.PATTERN_NOT_SEEN, "frame 5 does not show its pattern"),
        (frozen, NodeStatus.PATTERN_NOT_SEEN, "the projector does not change its pattern"),
        (overexposed, NodeStatus.TOO_FEW_VALID, "100% of the image saturates: shorten the exposure"),
    ],
)
def test_faulty_stacks_are_named(bench: PhaseBench, name: str, fault: object, code: int, words: str) -> None:
    bench.send(fault(fringe_step(bench.rig, 0.0, name, 0)))  # type: ignore[operator]
    status = bench.status_of(name, 0)
    assert status.error_code == code
    assert words in status.error_message
    assert status.step == 0


def test_coarsest_fringes_that_repeat_in_view_fail_the_step(bench: PhaseBench, name: str) -> None:
    """The plate shows about 60 of the projector's 100 columns: fringes of 40 px repeat."""
    rows, columns = bench.rig.projector_shape
    for step, (coarsest, code) in enumerate(((40.0, NodeStatus.FRAME_MISMATCH), (80.0, NodeStatus.NONE))):
        sequence = fringe_sequence(columns, rows, [coarsest, 8.0], 4)
        bench.send(
            [
                (
                    FrameRecord(name, step, index, len(sequence), pattern, (90 + step) * 10**9 + index, 0.005),
                    bench.rig.expose(sequence.frame(index), 0.0, frame=index),
                )
                for index, pattern in enumerate(sequence.patterns)
            ]
        )
        status = bench.status_of(name, step)
        assert status.error_code == code, status.error_message
        assert ("the coarsest fringes of 40 px repeat" in status.error_message) == (code != NodeStatus.NONE)


def test_one_image_is_measured_and_said_to_be_relative(bench: PhaseBench, name: str) -> None:
    rows, columns = bench.rig.projector_shape
    sequence = one_image_sequence(columns, rows, 10.0, grey=True)
    frames = [
        (
            FrameRecord(name, 0, index, 2, pattern, 77_000_000_000 + index, 0.005),
            bench.rig.expose(sequence.frame(index), 0.0, frame=index),
        )
        for index, pattern in enumerate(sequence.patterns)
    ]
    bench.change(relative_phase="accept")
    bench.send(frames)
    status = bench.status_of(name, 0)
    bench.change(relative_phase="refuse")
    assert status.error_code == NodeStatus.NONE
    assert [each.code for each in status.remarks] == ["relative_one_image"]
    assert status.error_message == ""
    assert status.relative
    assert_identical(bench, expected(frames, PhaseParameters(relative_phase="accept")))


def test_exposures_are_merged_bit_by_bit_as_by_the_library(bench: PhaseBench, name: str) -> None:
    short, long = (fringe_step(bench.rig, 0.0, name, 0) for _ in range(2))
    frames = []
    for (record, image), (_, again) in zip(short, long, strict=True):
        brighter = np.minimum(2 * again.astype(int), 255).astype(np.uint8)
        for number, (time, grey_levels) in enumerate(((0.005, image), (0.01, brighter))):
            index = 2 * record.index + number
            stamp = record.stamp + 1_000_000 * number
            frames.append(
                (replace(record, index=index, count=32, stamp=stamp, exposure_time=time), grey_levels),
            )
    bench.send(frames)
    status = bench.status_of(name, 0)
    assert (status.error_code, status.frames, status.relative) == (NodeStatus.NONE, 32, False), status.error_message
    assert_identical(bench, expected(frames, PhaseParameters()))


def test_dark_frames_have_too_little_phase(bench: PhaseBench, name: str) -> None:
    frames = [(record, np.zeros_like(image)) for record, image in fringe_step(bench.rig, 0.0, name, 0)]
    bench.send(frames)
    assert bench.status_of(name, 0).error_code == NodeStatus.TOO_FEW_VALID


def test_steps_that_never_end_are_given_up(bench: PhaseBench, name: str) -> None:
    for step in range(JOINED_STEPS + 1):
        bench.send(fringe_step(bench.rig, 0.0, name, step)[:1])
    status = bench.status_of(name, 0)
    assert status.error_code == NodeStatus.FRAME_MISSING
    assert "of 16 never arrived" in status.error_message
    assert len(bench.statuses) == 1
    for step in range(1, JOINED_STEPS + 1):
        bench.abort(name, step)
        assert bench.status_of(name, step).error_code == NodeStatus.STEP_ABORTED


def test_abort_answers_an_unfinished_step_once(bench: PhaseBench, name: str) -> None:
    frames = fringe_step(bench.rig, 0.0, name, 0)
    bench.send(frames[:4])
    bench.taken(messages=4)
    bench.abort(name, 0)
    status = bench.status_of(name, 0)
    assert status.error_code == NodeStatus.STEP_ABORTED
    assert "the camera stopped" in status.error_message
    assert "frames 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15 of 16 never arrived" in status.error_message
    bench.send(frames[4:])
    bench.abort(name, 0)
    assert bench.status_of(name, 0) is status
    complete = fringe_step(bench.rig, 0.0, name, 1)
    bench.send(complete)
    assert bench.status_of(name, 1).error_code == NodeStatus.NONE
    bench.abort(name, 1)
    assert bench.status_of(name, 1).error_code == NodeStatus.NONE
