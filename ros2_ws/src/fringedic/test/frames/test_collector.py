"""Joining frames into stacks, and every way in which a sequence can be wrong."""

from dataclasses import replace

import numpy as np
import pytest

from fringedic.errors import ErrorCode, ImageError, StepError
from fringedic.frames.collector import FrameCollector
from fringedic.frames.records import FrameRecord, StepKey
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern


def records(step=0, pitches=(80.0, 10.0), shifts=4, experiment="plate"):
    patterns = [
        ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, pitch, shift, shifts)
        for pitch in pitches
        for shift in range(1, shifts + 1)
    ]
    return [
        FrameRecord(experiment, step, index, len(patterns), pattern, 1000 * step + index, 0.01)
        for index, pattern in enumerate(patterns)
    ]


def image(record, size=(3, 4), dtype=np.uint8):
    return np.full(size, 10 * record.step + record.index, dtype)


def feed(collector, sequence):
    return [collector.add(record, image(record)) for record in sequence]


def test_a_complete_sequence_gives_one_stack_in_the_order_of_the_index():
    sequence = records()
    swapped = [sequence[index] for index in (1, 0, 2, 3, 4, 6, 5, 7)]
    *earlier, stack = feed(FrameCollector(), swapped)
    assert earlier == [None] * 7
    assert stack.frames.shape == (8, 3, 4)
    assert stack.frames.dtype == np.uint8
    assert stack.frames[:, 0, 0].tolist() == list(range(8))
    assert stack.records == sequence
    assert stack.stamp == sequence[-1].stamp
    assert stack.kind == PatternKind.FRINGES


def test_the_stack_does_not_alias_the_callers_buffer():
    collector, buffer = FrameCollector(), np.zeros((3, 4), np.uint8)
    for record in records():
        buffer[:] = record.index
        stack = collector.add(record, buffer)
    buffer[:] = 99
    assert stack.frames[:, 0, 0].tolist() == list(range(8))


def test_missing_frames_are_all_named_when_the_last_one_arrives():
    collector, sequence = FrameCollector(), records(step=2)
    with pytest.raises(StepError, match=r"experiment 'plate', step 2: frames 3, 5 of 8 never arrived") as caught:
        feed(collector, [record for record in sequence if record.index not in (3, 5)])
    assert (caught.value.experiment, caught.value.step, caught.value.index) == ("plate", 2, 3)
    with pytest.raises(StepError, check=lambda e: e.code is ErrorCode.FRAME_LATE):
        collector.add(sequence[3], image(sequence[3]))
    assert feed(collector, records(step=3))[-1] is not None


def test_a_doubled_frame_fails_its_step_once_and_not_the_next():
    collector, sequence = FrameCollector(), records()
    feed(collector, sequence[:3])
    with pytest.raises(StepError, match="frame 2 arrived twice"):
        collector.add(sequence[2], image(sequence[2]))
    assert feed(collector, sequence[3:]) == [None] * 5
    assert collector.discarded == 5
    assert feed(collector, records(step=1))[-1].step == 1


def test_a_late_frame_of_a_finished_step_is_refused_and_the_open_step_stays():
    collector = FrameCollector()
    feed(collector, records(step=0))
    feed(collector, records(step=1)[:4])
    late = records(step=0)[2]
    with pytest.raises(StepError, match="step 0: frame 2 arrived after the step had ended"):
        collector.add(late, image(late))
    assert feed(collector, records(step=1)[4:])[-1].frames[:, 0, 0].tolist() == list(range(10, 18))


@pytest.mark.parametrize(
    ("change", "picture", "message"),
    [
        ({}, np.zeros((3, 5), np.uint8), "is 5x3 px, the step began with 4x3 px"),
        ({}, np.zeros((3, 4), np.uint16), "pixels of type uint16, the step began with uint8"),
        ({}, np.zeros((3, 4, 3), np.uint8), r"has the shape \(3, 4, 3\)"),
        ({"count": 9}, np.zeros((3, 4), np.uint8), "sequence of 9 frames, the step began with 8"),
        ({"count": 2**31}, np.zeros((3, 4), np.uint8), "sequence of 2147483648 frames, 1000 are possible"),
        ({"index": 8}, np.zeros((3, 4), np.uint8), "index outside 0 to 7"),
        ({"pattern": ProjectedPattern(PatternKind.WHITE)}, np.zeros((3, 4), np.uint8), "shows WHITE"),
    ],
)
def test_a_frame_that_does_not_fit_fails_its_step_and_not_the_next(change, picture, message):
    collector, sequence = FrameCollector(), records()
    feed(collector, sequence[:4])
    with pytest.raises(StepError, match=message):
        collector.add(replace(sequence[4], **change), picture)
    assert collector.open_steps == []
    assert feed(collector, records(step=1))[-1] is not None


def test_unequal_shifts_are_a_mismatch_that_names_the_pitch():
    sequence = records()
    sequence[6] = replace(sequence[6], pattern=sequence[5].pattern)
    with pytest.raises(StepError, match="pitch 10 px do not cover whole periods: shifts 1, 2, 2, 4 of 4"):
        feed(FrameCollector(), sequence)


def test_two_periods_of_shifts_are_whole():
    sequence = [
        FrameRecord(
            "plate", 0, k - 1, 8, ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 20.0, k, 4), k, 0.01
        )
        for k in range(1, 9)
    ]
    assert feed(FrameCollector(), sequence)[-1] is not None


def test_abandoning_a_step_tells_what_was_missing_and_makes_the_rest_late():
    collector, sequence = FrameCollector(), records(step=4)
    feed(collector, sequence[:6])
    assert collector.open_steps == [StepKey("plate", 4)]
    error = collector.abandon(StepKey("plate", 4))
    assert error is not None
    assert error.code is ErrorCode.FRAME_MISSING
    assert "frames 6, 7 of 8" in str(error)
    assert collector.open_steps == []
    with pytest.raises(StepError, check=lambda e: e.code is ErrorCode.FRAME_LATE):
        collector.add(sequence[6], image(sequence[6]))
    assert collector.abandon(StepKey("plate", 5)) is None


def test_the_same_numbers_in_another_experiment_are_another_step():
    collector = FrameCollector()
    feed(collector, records(experiment="plate"))
    assert feed(collector, records(experiment="skin"))[-1].experiment == "skin"


def test_the_same_step_of_another_sensor_is_another_stack():
    collector = FrameCollector()
    left, right = ([replace(each, sensor=sensor) for each in records()] for sensor in ("left", "right"))
    pairs = list(zip(left, right, strict=True))
    assert feed(collector, [each for pair in pairs[:-1] for each in pair])[-1] is None
    assert collector.open_steps == [StepKey("plate", 0, "left"), StepKey("plate", 0, "right")]
    stacks = feed(collector, pairs[-1])
    assert [(stack.sensor, {each.sensor for each in stack.records}) for stack in stacks] == [
        ("left", {"left"}),
        ("right", {"right"}),
    ]


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a.b", "2nd", "a__b", "left\n", "é", "x" * 61, None])
def test_a_name_of_a_sensor_that_would_be_no_topic_or_no_file_is_refused(name):
    white = ProjectedPattern(PatternKind.WHITE)
    with pytest.raises(ImageError, match=r"^sensor is .*: it has to be a name of letters, digits and single under"):
        FrameRecord("plate", 0, 0, 1, white, 5, 0.01, sensor=name)


def test_a_white_step_is_a_stack_of_one():
    record = FrameRecord("plate", 0, 0, 1, ProjectedPattern(PatternKind.WHITE), 5, 0.01)
    stack = FrameCollector().add(record, np.ones((3, 4), np.uint16))
    assert stack.kind == PatternKind.WHITE
    assert stack.frames.dtype == np.uint16
