"""Parts of a report that only the recording contains: exposures, and textures at full resolution."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fringedic.frames.messages import image_array
from fringedic.frames.records import FrameRecord, stamp_of
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.frames import records, with_losses
from fringedic.recording.reader import BagReader

PHASE_TEXTURE = "phase/texture"


@dataclass(frozen=True)
class Exposures:
    """The exposures of an experiment.

    Attributes
    ----------
    frames
        Frames of one step.
    exposure_time
        Median [s].
    frame_rate
        Within a step [1/s], from the median distance of the stamps.
    dropped
        Frames that the camera lost.
    pitches, shifts
        Fringe pitches, coarse to fine [projector px], and frames of each.
    orientation
        Direction of the fringes: ``vertical`` or ``horizontal``.
    """

    frames: int
    exposure_time: float
    frame_rate: float
    dropped: int
    pitches: tuple[float, ...]
    shifts: tuple[int, ...]
    orientation: str


def read_exposures(recording: Path, experiment: str) -> Exposures | None:
    """Return the exposures of an experiment, None if the recording contains none."""
    steps: defaultdict[int, list[FrameRecord]] = defaultdict(list)
    dropped = 0
    for record, lost in with_losses(records(BagReader(recording), experiment)):
        dropped += lost if steps else 0  # those before the first frame belong to no step
        steps[record.step].append(record)
    if not steps:
        return None
    exposed = [record for step in steps.values() for record in step]
    longest = max(steps.values(), key=len)
    fringes = Counter(record.pattern.pitch for record in longest if record.pattern.kind == PatternKind.FRINGES)
    pitches = tuple(sorted(fringes, reverse=True))
    return Exposures(
        frames=len(longest),
        exposure_time=float(np.median([record.exposure_time for record in exposed])),
        frame_rate=_frame_rate(steps.values()),
        dropped=dropped,
        pitches=pitches,
        shifts=tuple(fringes[pitch] for pitch in pitches),
        orientation=longest[0].pattern.orientation.name.lower(),
    )


def _frame_rate(steps: Iterable[Sequence[FrameRecord]]) -> float:
    """Return the frames per second within a step, NaN for steps of one frame."""
    distances = [np.diff([record.stamp for record in step]) for step in steps if len(step) > 1]
    return 1e9 / float(np.median(np.concatenate(distances))) if distances else float("nan")


def read_textures(recording: Path, stamps: Sequence[int]) -> list[np.ndarray]:
    """Return the recorded textures with these stamps [ns] in their order; empty unless all are recorded."""
    reader = BagReader(recording)
    found = {}
    for _, message, _ in reader.messages(reader.find_optional(PHASE_TEXTURE).values()):
        if stamp_of(message) in stamps:
            found[stamp_of(message)] = image_array(message)
    return [found[stamp] for stamp in stamps] if len(found) == len(set(stamps)) else []
