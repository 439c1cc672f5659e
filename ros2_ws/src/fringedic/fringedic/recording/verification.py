"""Proves that a recording is complete: checksums, the publishers' own counts, and the frames of every step."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fringedic.frames.records import stamp_of
from fringedic.recording.frames import newly_dropped, repeated_steps
from fringedic.recording.manifest import ManifestCheck, check_manifest
from fringedic.recording.order import ClockCheck, PublisherCounts
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import EXPOSURE, IMAGE, RawMessage, is_named

STEP = "experiment/step"
_END = 3  # stage of a step that succeeded, in fringedic_msgs/StepStatus

Step = tuple[str, int]  # experiment and number


@dataclass(frozen=True)
class Verification:
    """Outcome of a verification.

    Attributes
    ----------
    path
        The recording.
    files, messages
        Numbers of its MCAP files and of its readable messages.
    manifest
        Comparison of the files with the manifest.
    damage
        Description of the damage; empty if every chunk and every index fits its checksum.
    unchecked
        Number of readable chunks without a checksum.
    gaps
        Messages of each topic that are missing in the count of its publisher, between the first and the last recorded.
    uncounted
        Topics whose messages have no sequence numbers, so that a missing one cannot be noticed.
    frames, lost_frames
        Frames with image and exposure record, and frames that lack one of them or both.
    unfinished_steps
        Experiment and number of each step without a successful end -> (frames recorded, frames of the step).
    repeated_steps
        Experiment and number of each step that was measured more than once under this number.
    dropped
        Frames that the camera dropped before it published them.
    """

    path: Path
    files: int
    messages: int
    manifest: ManifestCheck
    damage: str
    unchecked: int
    gaps: dict[str, int]
    uncounted: list[str]
    frames: int
    lost_frames: int
    unfinished_steps: dict[Step, tuple[int, int]]
    repeated_steps: list[Step]
    dropped: int

    @property
    def complete(self) -> bool:
        """Whether nothing is damaged, lost or ambiguous.

        It is proved by the checksums of all chunks or by the manifest, and by the numbers of the messages.
        """
        unconfirmed = self.unchecked and not self.manifest.present
        problems = self.damage, self.gaps, self.uncounted, self.lost_frames, self.repeated_steps, unconfirmed
        return self.manifest.fits and not any(problems)


def verify(path: str | os.PathLike[str]) -> Verification:
    """Check that a recording is complete.

    Every file is compared with the manifest that was written when the recording was closed, every chunk with its
    checksum, every topic with the sequence numbers of its publisher, and the images with the exposure records.

    Parameters
    ----------
    path
        A rosbag2 folder with MCAP files, or one MCAP file.

    Raises
    ------
    RecordingError
        There is no such recording, or it has another format.

    Examples
    --------
    >>> verify("recordings/plate-7/bag").complete
    True
    """
    reader = BagReader(path, check=True)
    counts, frames, clock = PublisherCounts(reader.topics), _Frames(reader), ClockCheck(reader.topics.values())
    for message in reader.stored():
        counts.add(message)
        frames.add(message)
        clock.add(message)
    known = reader.set_back or reader.unlisted  # files of other recordings have times of their own
    set_back = "" if known else clock.description
    without_manifest = reader.is_converted or reader.path.is_file()
    gaps = counts.missing(in_file_order=bool(reader.set_back or set_back))
    return Verification(
        path=reader.path,
        files=len(reader.files),
        messages=sum(reader.counts.values()),
        manifest=ManifestCheck(present=False) if without_manifest else check_manifest(reader.path),
        damage="; ".join(filter(None, (reader.lost, set_back))),
        unchecked=reader.chunks_without_checksum,
        gaps=gaps,
        uncounted=counts.unknown,
        frames=frames.complete,
        lost_frames=frames.lost(gaps, reader.missing),
        unfinished_steps=frames.unfinished_steps(),
        repeated_steps=frames.repeated_steps(),
        dropped=frames.dropped,
    )


class _Frames:
    """Images, exposure records and stages of steps of a recording."""

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        known = reader.topics.keys() | reader.missing.keys()  # no message of a counted topic may be readable
        types = {full: topic.type_name for full, topic in reader.topics.items()}
        self._topics = {
            full: name
            for full in known
            for name in (IMAGE, EXPOSURE, STEP)
            if is_named(full, types.get(full, ""), name)
        }
        self._dropped: defaultdict[str, list[int]] = defaultdict(list)  # topic -> count of its camera at each record
        self._images: set[int] = set()
        self._records: set[int] = set()
        self._indices: defaultdict[Step, set[int]] = defaultdict(set)
        self._exposures: defaultdict[str, set[tuple[str, int, int, int]]] = defaultdict(set)  # by topic
        self._sizes: dict[Step, int] = {}
        self._finished: set[Step] = set()

    def add(self, raw: RawMessage) -> None:
        """Take a message of any topic."""
        topic = self._topics.get(raw.topic)
        if topic is None:
            return
        message = self._reader.decode(raw.topic, raw.data)
        if topic == IMAGE:
            self._images.add(stamp_of(message))
        elif topic == EXPOSURE:
            step = message.experiment, message.step
            self._records.add(stamp_of(message))
            if message.count:  # 0 in a free run, whose frames belong to no step
                self._indices[step].add(message.index)
                self._exposures[raw.topic].add((*step, message.index, stamp_of(message)))
                self._sizes[step] = message.count
            self._dropped[raw.topic].append(message.dropped)
        elif message.stage == _END:
            step = message.experiment, message.step
            self._finished.add(step)
            self._sizes.setdefault(step, message.frames)  # all records of the step may be lost

    @property
    def dropped(self) -> int:
        """Frames that the camera dropped before it published them."""
        return sum(sum(newly_dropped(counts)) for counts in self._dropped.values())

    @property
    def complete(self) -> int:
        """Frames with image and record; images, if there are no records at all."""
        return len(self._images & self._records) if self._has_records else len(self._images)

    @property
    def _has_records(self) -> bool:
        return EXPOSURE in self._topics.values()

    def lost(self, *missing: Mapping[str, int]) -> int:
        """Return the largest number of lost frames for which there is evidence.

        Parameters
        ----------
        missing
            Missing messages of each topic by other evidence.
        """
        without_image = len(self._records - self._images)
        without_record = len(self._images - self._records) if self._has_records else 0
        absent = sum(size - len(self._indices[step]) for step, size in self._sizes.items() if step in self._finished)
        others = (each.get(full, 0) for each in missing for full, name in self._topics.items() if name != STEP)
        return max(without_image + max(without_record, absent), *others, 0)

    def unfinished_steps(self) -> dict[Step, tuple[int, int]]:
        """Return (frames recorded, frames of the step) of each step without a successful end."""
        return {
            step: (len(self._indices[step]), size) for step, size in self._sizes.items() if step not in self._finished
        }

    def repeated_steps(self) -> list[Step]:
        """Return each step that was measured more than once under its number."""
        return sorted({step for exposures in self._exposures.values() for step in repeated_steps(exposures)})
