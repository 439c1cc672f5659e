"""Windows between stacks in motion: which frames they consist of, and when there are none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from fringedic.frames.records import FrameRecord
from fringedic.patterns import fringe_sequence
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.patterns.sequences import moving_sequence
from fringedic.recording.every_frame import _Frame, _OfWindow, _Stacks
from fringedic.recording.topics import RawMessage

MOVING = moving_sequence(160, 120, [160, 20], [4], order=[3, 2, 1, 4, 3, 2, 1, 4], parts=4).patterns
RESTING = fringe_sequence(160, 120, [160, 20], [4, 4]).patterns
COARSE, FINE = 5, 8  # frames before the finest pitch, and of it


def read(
    *steps: tuple[int, Iterable[int]], patterns: Sequence[ProjectedPattern] = MOVING
) -> list[tuple[int, int, bytes]]:
    """Return (step, index, content) of the exposures that follow from frames of these steps."""
    stacks, seen = _Stacks(), []

    def note(messages: Iterable[RawMessage]) -> None:
        for each in messages:
            if isinstance(each.data, _OfWindow):
                step, index, count = each.data.place
                assert count == len(patterns)
                seen.append((step, index, bytes(each.data)))
            else:
                number, frame = each.data.decode().split(".")
                seen.append((100 * int(number), int(frame), each.data))

    for step, frames in steps:
        for index in frames:
            record = FrameRecord("e", step, index, len(patterns), patterns[index], 1000 * step + index, 0.01)
            note(stacks.take(_Frame(record, RawMessage("exposure", f"{step}.{index}".encode(), 0, 0), None)))
    note(stacks.rest())
    return seen


def test_a_window_exchanges_one_frame_after_the_other() -> None:
    whole = range(len(MOVING))
    seen = read((3, whole), (4, whole))
    numbers = list(dict.fromkeys(step for step, _, _ in seen))
    assert numbers == [300, *range(301, 300 + FINE), 400], "in the order of their times"
    third = [content.decode() for step, _, content in seen if step == 303]
    coarse = [f"3.{index}" for index in range(COARSE)]
    fine = [f"3.{COARSE + k}" for k in range(3, FINE)] + [f"4.{COARSE + k}" for k in range(3)]
    assert third == [*coarse, *fine, f"4.{len(MOVING) - 1}"]
    assert [index for step, index, _ in seen if step == 303] == list(whole)


def test_there_is_no_window_between_stacks_that_do_not_follow_each_other() -> None:
    whole, cut = range(len(MOVING)), range(len(MOVING) - 1)
    for steps in (((3, whole), (5, whole)), ((3, whole), (4, cut), (5, whole)), ((3, cut), (4, whole))):
        seen = read(*steps)
        assert all(step % 100 == 0 for step, _, _ in seen)
        assert len(seen) == sum(len(frames) for _, frames in steps), "every frame once"
    assert all(step % 100 == 0 for step, _, _ in read((3, range(8)), (4, range(8)), patterns=RESTING))
