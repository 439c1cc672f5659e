"""What only the recording tells: exposures, and textures at full resolution."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fringedic.recording import BagReader
from fringedic.results.messages import image_array
from fringedic.sequence import FrameRecord, PatternKind, frame_record, stamp_of

PHASE_TEXTURE = "phase/texture"
EXPOSURE = "camera/exposure"


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
        Direction of the fringes.
    """

    frames: int
    exposure_time: float
    frame_rate: float
    dropped: int
    pitches: tuple[float, ...]
    shifts: tuple[int, ...]
    orientation: str


def read_exposures(recording: Path, experiment: str) -> Exposures | None:
    """Return how an experiment was exposed; None when the recording holds nothing of it."""
    reader = BagReader(recording)
    names = reader.find_optional(EXPOSURE)
    steps: defaultdict[int, list[FrameRecord]] = defaultdict(list)
    for _, message, _ in reader.messages(names.values()):
        record = frame_record(message)
        if record.experiment == experiment and record.projection.kind != PatternKind.OTHER:
            steps[record.step].append(record)
    if not steps:
        return None
    records = [record for step in steps.values() for record in step]
    distances = [np.diff([record.stamp for record in step]) for step in steps.values() if len(step) > 1]
    dropped = [record.dropped for record in records]
    fringes = max(steps.values(), key=len)
    counted: dict[float, int] = {}
    for record in fringes:
        if record.projection.kind == PatternKind.FRINGES:
            counted[record.projection.pitch] = counted.get(record.projection.pitch, 0) + 1
    return Exposures(
        frames=len(fringes),
        exposure_time=float(np.median([record.exposure_time for record in records])),
        frame_rate=1e9 / float(np.median(np.concatenate(distances))) if distances else float("nan"),
        dropped=max(dropped) - min(dropped),
        pitches=tuple(sorted(counted, reverse=True)),
        shifts=tuple(counted[pitch] for pitch in sorted(counted, reverse=True)),
        orientation=fringes[0].projection.orientation.name.lower(),
    )


def read_textures(recording: Path, stamps: Sequence[int]) -> list[np.ndarray]:
    """Return the recorded textures with these stamps [ns] in their order; empty unless all are there."""
    reader = BagReader(recording)
    found = {}
    for _, message, _ in reader.messages(reader.find_optional(PHASE_TEXTURE).values()):
        if stamp_of(message) in stamps:
            found[stamp_of(message)] = image_array(message)
    return [found[stamp] for stamp in stamps] if len(found) == len(set(stamps)) else []
