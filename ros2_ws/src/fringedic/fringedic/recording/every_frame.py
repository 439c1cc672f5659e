"""A recording of stacks in motion read as if a stack began with every frame: windows that slide by one frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from fringedic.frames.pairing import FramePairs
from fringedic.frames.records import FrameRecord, frame_record, stamp_of
from fringedic.patterns.pattern import PatternKind, moving_frames
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import EXPOSURE, IMAGE, RawMessage

STEPS_PER_STACK = 100
"""Step 12 of the recording is step 1200; 1203 is the window that begins three frames later."""
EVERY_FRAME = "every-frame"
"""Part of the names of datasets with such windows; the name of a sensor has no hyphen."""
_CAPACITY = 64  # images and exposures that may wait for each other


class EveryFrameReader(BagReader):
    """Reads the stacks in motion of a recording with further ones between them, one for every frame.

    Between two stacks that follow each other the frames of the finest pitch are exchanged one after the other, the
    first of the earlier stack for the first of the later one: their shifts are the same, so that each window is a whole
    stack whose middle is later by one frame. Its coarser pitches and the uniform light before are those of the earlier
    stack, the uniform light after is that of the later one. Neighbouring windows share frames: their errors are
    correlated.

    The numbers of all steps are multiplied by `STEPS_PER_STACK`. Other steps are left as they are.

    Parameters
    ----------
    path, check, sensor
        See `BagReader`.
    """

    def published(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """Iterate over the messages in the order of publishing, with those of the windows before the later stack."""
        return self._with_windows(super().published(topics), topics)

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[tuple[str, Any, int]]:
        """Iterate over (topic, decoded message, log time [ns])."""
        for raw in self._with_windows(self.raw(topics), topics):
            yield raw.topic, self.decode(raw.topic, raw.data), raw.log_time

    def decode(self, topic: str, data: bytes) -> Any:
        """Return one message, with the number that its step has here."""
        message = super().decode(topic, data)
        if isinstance(data, _OfWindow):
            message.step, message.index, message.count = data.place
        elif hasattr(message, "experiment") and getattr(message, "step", -1) > 0:  # an image has a step in bytes
            message.step *= STEPS_PER_STACK
        return message

    def _with_windows(self, messages: Iterable[RawMessage], topics: Iterable[str] | None) -> Iterator[RawMessage]:
        names = self.find_optional(IMAGE, EXPOSURE)
        wanted = self.topics.keys() if topics is None else set(topics)
        if EXPOSURE not in names or names[EXPOSURE] not in wanted:
            yield from messages
            return
        with_images = names.get(IMAGE) in wanted
        pairs: FramePairs[RawMessage, tuple[FrameRecord, RawMessage]] = FramePairs(_CAPACITY)
        stacks = _Stacks()
        for raw in messages:
            if raw.topic not in names.values():
                yield raw
                continue
            message = super().decode(raw.topic, raw.data)
            if raw.topic == names[EXPOSURE]:
                record = frame_record(message)
                if not with_images:
                    yield from stacks.take(_Frame(record, raw, None))
                    continue
                pair = pairs.add_record(record.stamp, (record, raw))
            else:
                pair = pairs.add_image(stamp_of(message), raw)
            if pair is not None:
                image, (record, exposure) = pair
                yield from stacks.take(_Frame(record, exposure, image))
        yield from stacks.rest()


def stacks_of(step: int) -> tuple[int, ...]:
    """Return the steps whose frames a step of an `EveryFrameReader` consists of.

    Examples
    --------
    >>> stacks_of(1200), stacks_of(1203)
    ((1200,), (1200, 1300))
    """
    first = step - step % STEPS_PER_STACK
    return (first,) if step == first else (first, first + STEPS_PER_STACK)


class _OfWindow(bytes):
    """The data of an exposure record as a frame of a window: (step, index, count)."""

    place: tuple[int, int, int]


class _Frame(NamedTuple):
    record: FrameRecord
    exposure: RawMessage
    image: RawMessage | None

    def messages(self) -> Iterator[RawMessage]:
        yield self.exposure
        if self.image is not None:
            yield self.image

    def at(self, place: tuple[int, int, int]) -> Iterator[RawMessage]:
        data = _OfWindow(self.exposure.data)
        data.place = place
        return self._replace(exposure=self.exposure._replace(data=data)).messages()


class _Stacks:
    """The stack that is being exposed, and the one in motion before it."""

    def __init__(self) -> None:
        self._before: list[_Frame] = []
        self._present: list[_Frame] = []

    def take(self, frame: _Frame) -> Iterator[RawMessage]:
        """Take the next frame; yield the messages of a stack that it completes, after those of the windows."""
        if frame.record.pattern.kind == PatternKind.OTHER:
            yield from frame.messages()
            return
        if self._present and self._present[0].record.step_key != frame.record.step_key:
            yield from self.rest()  # its last frames are lost
        self._present.append(frame)
        if len(self._present) == frame.record.count:
            for number, window in enumerate(_windows(self._before, self._present), start=1):
                step = STEPS_PER_STACK * self._before[0].record.step + number
                for index, each in enumerate(window):
                    yield from each.at((step, index, len(window)))
            complete = self._present
            yield from self.rest()
            self._before = complete

    def rest(self) -> Iterator[RawMessage]:
        """Yield the messages of the frames that have been taken."""
        present, self._present, self._before = self._present, [], []
        for each in present:
            yield from each.messages()


def _windows(earlier: Sequence[_Frame], later: Sequence[_Frame]) -> list[list[_Frame]]:
    """Return the windows between two stacks in motion, one for each frame of the finest pitch but the first.

    They are none when the stacks do not follow each other.
    """
    patterns = [each.record.pattern for each in earlier]
    finest = moving_frames(patterns)
    if not finest or patterns != [each.record.pattern for each in later]:
        return []
    if len(finest) > STEPS_PER_STACK or earlier[0].record.experiment != later[0].record.experiment:
        return []
    if later[0].record.step != earlier[0].record.step + 1:
        return []
    first, end = finest[0], finest[-1] + 1
    return [
        [*earlier[:first], *earlier[first + k : end], *later[first : first + k], *later[end:]]
        for k in range(1, len(finest))
    ]
