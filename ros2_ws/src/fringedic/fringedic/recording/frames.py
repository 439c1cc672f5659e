"""Iterates over the frames of a recording: the one place that pairs recorded images with their exposure records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fringedic.frames.messages import image_array
from fringedic.frames.pairing import FramePairs
from fringedic.frames.records import FrameRecord, frame_record, stamp_of
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import EXPOSURE, IMAGE

_CAPACITY = 64  # images or records that may wait for each other: more than the reader reorders


@dataclass(frozen=True)
class RecordedFrame:
    """One recorded image with its exposure record.

    Attributes
    ----------
    record
        What was exposed.
    message
        The decoded ``sensor_msgs/Image``.
    """

    record: FrameRecord
    message: Any

    @property
    def image(self) -> np.ndarray:
        """Grey levels (row, column), a read-only view.

        Raises
        ------
        ImageError
            The message has an unknown encoding or contradicts itself.
        """
        return image_array(self.message)


@dataclass(frozen=True)
class RecordedMessage:
    """A recorded message of another topic, with the topic's name relative to the rig's namespace."""

    topic: str
    message: Any


def frames(bag: BagReader, experiment: str | None = None) -> Iterator[RecordedFrame]:
    """Iterate over the frames of a recording in the order of publishing.

    Parameters
    ----------
    bag
        The recording.
    experiment
        Only frames of this experiment.

    Raises
    ------
    RecordingError
        The recording lacks images or exposure records, or is damaged.
    """
    for each in events(bag, bag.find(IMAGE, EXPOSURE), experiment):
        if isinstance(each, RecordedFrame):
            yield each


def records(bag: BagReader, experiment: str | None = None) -> Iterator[FrameRecord]:
    """Iterate over the exposure records of a recording, without its images.

    Parameters
    ----------
    bag
        The recording; one without exposure records gives none.
    experiment
        Only records of this experiment.

    Raises
    ------
    RecordingError
        The recording is damaged.
    """
    for _, message, _ in bag.messages(bag.find_optional(EXPOSURE).values()):
        record = frame_record(message)
        if experiment is None or record.experiment == experiment:
            yield record


def newly_dropped(counts: Iterable[int]) -> Iterator[int]:
    """Yield how many frames a camera dropped before each record, from its count, which a restarted camera begins again.

    Examples
    --------
    >>> list(newly_dropped([0, 2, 2, 1]))
    [0, 2, 0, 1]
    """
    before = 0
    for count in counts:
        yield count - before if count >= before else count
        before = count


def with_losses(exposures: Iterable[FrameRecord]) -> Iterator[tuple[FrameRecord, int]]:
    """Yield the exposures of steps, each with the number of frames that the camera dropped before it.

    Parameters
    ----------
    exposures
        All in the order of publishing; those of the free run belong to no step.
    """
    published = list(exposures)
    for record, lost in zip(published, newly_dropped(each.dropped for each in published), strict=True):
        if record.pattern.kind != PatternKind.OTHER:
            yield record, lost


def frame_losses(bag: BagReader) -> dict[int, tuple[int, int]]:
    """Return (frames that the camera dropped, exposures without image in the recording) of each step.

    Those of the free run belong to no step.
    """
    names = bag.find(IMAGE, EXPOSURE)
    images, exposures = set(), []
    for topic, message, _ in bag.messages(names.values()):
        if topic == names[IMAGE]:
            images.add(stamp_of(message))
        else:
            exposures.append(frame_record(message))
    dropped: Counter[int] = Counter()
    missing: Counter[int] = Counter()
    for record, lost in with_losses(exposures):
        dropped[record.step] += lost
        missing[record.step] += record.stamp not in images
    return {step: (dropped[step], missing[step]) for step in dropped}


def repeated_steps(exposures: Iterable[tuple[str, int, int, int]]) -> list[tuple[str, int]]:
    """Return experiment and number of the steps of which a frame was exposed more than once.

    Parameters
    ----------
    exposures
        Experiment, step, index and stamp [ns] of each exposure. A copy of a record has the same stamp and is no other
        exposure.

    Examples
    --------
    >>> repeated_steps([("plate", 0, 0, 10), ("plate", 0, 0, 10), ("plate", 1, 0, 20), ("plate", 1, 0, 90)])
    [('plate', 1)]
    """
    counted = Counter(each[:3] for each in set(exposures))
    return sorted({(experiment, step) for (experiment, step, _), count in counted.items() if count > 1})


def events(
    bag: BagReader, names: Mapping[str, str], experiment: str | None = None
) -> Iterator[RecordedFrame | RecordedMessage]:
    """Iterate over the frames and the other messages of a recording in the order of publishing.

    Parameters
    ----------
    bag
        The recording.
    names
        Relative name -> full name of the topics, from `BagReader.find`.
    experiment
        Messages that name another experiment are left out.

    Raises
    ------
    RecordingError
        The recording is damaged.
    """
    relative = {full: name for name, full in names.items()}
    decoded = ((relative[raw.topic], bag.decode(raw.topic, raw.data)) for raw in bag.published(relative))
    yield from paired(decoded, experiment)


def paired(
    messages: Iterable[tuple[str, Any]], experiment: str | None = None
) -> Iterator[RecordedFrame | RecordedMessage]:
    """Pair the images among decoded messages with their exposure records.

    Parameters
    ----------
    messages
        (relative name of the topic, message) in the order of publishing.
    experiment
        Messages that name another experiment are left out.
    """
    pairs: FramePairs[Any, FrameRecord] = FramePairs(_CAPACITY)
    for topic, message in messages:
        if experiment is not None and getattr(message, "experiment", experiment) != experiment:
            continue
        if topic == IMAGE:
            pair = pairs.add_image(stamp_of(message), message)
        elif topic == EXPOSURE:
            pair = pairs.add_record(stamp_of(message), frame_record(message))
        else:
            yield RecordedMessage(topic, message)
            continue
        if pair is not None:
            image, record = pair
            yield RecordedFrame(record, image)
