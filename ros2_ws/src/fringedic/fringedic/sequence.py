"""The frames of one load step: what was projected in each, and the joining of single frames into whole stacks.

One exposure is identified by (experiment, step, index). Frames are joined by these numbers and never by time.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from fringedic.errors import FrameDoubledError, FrameLateError, FrameMismatchError, FrameMissingError


class PatternKind(IntEnum):
    """What the projector showed during an exposure, numbered as in ``fringedic_msgs/Exposure``."""

    WHITE = 0
    FRINGES = 1
    OTHER = 2
    GRAY_CODE = 3
    GREY = 4


EQUAL_EXPOSURES = 0.01  # relative difference of exposure times that cameras make of one and the same
PHASE_KINDS = frozenset({PatternKind.FRINGES, PatternKind.GRAY_CODE, PatternKind.GREY})  # frames of a fringe step


class Orientation(IntEnum):
    """Direction of the fringes, numbered as in ``fringedic_msgs/Exposure``.

    ``VERTICAL`` fringes run along y and their phase grows with x, ``HORIZONTAL`` ones run along x and their phase
    grows with y.
    """

    VERTICAL = 0
    HORIZONTAL = 1


@dataclass(frozen=True)
class Projection:
    """What one frame showed: ``I = A + B cos(phi - 2 pi shift / shifts)`` for fringes.

    Attributes
    ----------
    kind
        White light, fringes, a bit of the Gray code that numbers them, uniform grey, or a set-up pattern.
    orientation
        Direction of the fringes.
    pitch
        Fringe pitch [projector pixel], 0 without fringes.
    shift
        k of eq. 11, from 1 on; which bit of a Gray code, 1 for the coarsest; of uniform grey the numerator of its
        brightness shift / shifts; else 0.
    shifts
        q of eq. 11; number of bits of a Gray code; denominator of a grey's brightness; else 0.
    """

    kind: PatternKind
    orientation: Orientation = Orientation.VERTICAL
    pitch: float = 0.0
    shift: int = 0
    shifts: int = 0

    def __str__(self) -> str:
        if self.kind == PatternKind.GREY:
            return f"uniform grey of {self.shift}/{self.shifts}"
        if self.kind == PatternKind.GRAY_CODE:
            fringes = f"{self.orientation.name.lower()} fringes of pitch {self.pitch:g} px"
            return f"bit {self.shift} of {self.shifts} of the Gray code for {fringes}"
        if self.kind != PatternKind.FRINGES:
            return self.kind.name.lower()
        return f"{self.orientation.name.lower()} fringes, pitch {self.pitch:g} px, shift {self.shift} of {self.shifts}"


@dataclass(frozen=True)
class FrameRecord:
    """The exposure record that belongs to one image.

    Attributes
    ----------
    experiment, step, index
        Identity of the exposure; ``index`` runs from 0 to ``count - 1``.
    count
        Frames in the step's sequence.
    projection
        What was projected.
    stamp
        Middle of the exposure on the acquisition clock [ns].
    exposure_time
        Length of the exposure [s].
    dropped
        Frames that the camera lost since it was started.
    """

    experiment: str
    step: int
    index: int
    count: int
    projection: Projection
    stamp: int
    exposure_time: float
    dropped: int = 0


@dataclass
class Stack:
    """All frames of one step in the order of their index.

    Attributes
    ----------
    records
        One record per frame, in the order of ``index``.
    frames
        Grey levels, shape (count, row, column), type of the camera's pixels.
    stamp
        Stamp of the last exposure [ns]: the stamp of everything computed from this step.
    """

    experiment: str
    step: int
    records: list[FrameRecord]
    frames: np.ndarray
    stamp: int

    @property
    def projections(self) -> list[Projection]:
        """What each frame showed, in the order of the frames."""
        return [record.projection for record in self.records]

    @property
    def kind(self) -> PatternKind:
        """What the whole step showed: FRINGES also when a Gray code or grey light belongs to them."""
        return _kind_of_step(self.records[-1].projection)

    @property
    def exposure_times(self) -> list[float]:
        """Exposure time of each frame [s], in the order of the frames."""
        return [record.exposure_time for record in self.records]


@dataclass
class _OpenStep:
    frames: np.ndarray
    records: dict[int, FrameRecord] = field(default_factory=dict)


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def projection_of(message: Any) -> Projection:
    """Return what a message with kind, orientation, pitch, shift and shifts (exposure or request) speaks of.

    Raises
    ------
    ValueError
        Kind or orientation is a number without meaning.
    """
    return Projection(
        kind=PatternKind(message.kind),
        orientation=Orientation(message.orientation),
        pitch=message.pitch,
        shift=message.shift,
        shifts=message.shifts,
    )


def frame_record(exposure: Any) -> FrameRecord:
    """Translate a ``fringedic_msgs/Exposure`` message, decoded by whatever library, into a record.

    Raises
    ------
    ValueError
        Kind or orientation is a number without meaning.
    """
    return FrameRecord(
        experiment=exposure.experiment,
        step=exposure.step,
        index=exposure.index,
        count=exposure.count,
        projection=projection_of(exposure),
        stamp=stamp_of(exposure),
        exposure_time=exposure.exposure_time,
        dropped=exposure.dropped,
    )


class FrameCollector:
    """Joins single frames into stacks, one per step.

    There is no clock in here. A missing frame is known when the last index arrives, because one publisher over
    reliable transport keeps the order; when the last frame itself never comes, the experiment ends the step and the
    owner calls `abandon`. Frames of several steps may be in work at once, and a step that failed leaves the others
    alone: what still arrives of it is dropped and counted in `discarded`.

    Attributes
    ----------
    discarded
        Frames that arrived for a step that had failed before its last frame.
    """

    def __init__(self) -> None:
        self._open: dict[tuple[str, int], _OpenStep] = {}
        self._failed: set[tuple[str, int]] = set()
        self._ended: set[tuple[str, int]] = set()
        self.discarded = 0

    @property
    def open_steps(self) -> list[tuple[str, int]]:
        """(experiment, step) of the steps of which some frames have arrived, oldest first."""
        return list(self._open)

    def add(self, record: FrameRecord, image: np.ndarray) -> Stack | None:
        """Take one frame and return the whole stack when it was the last one of its step.

        Parameters
        ----------
        record
            What the frame is.
        image
            Grey levels, shape (row, column); copied.

        Raises
        ------
        FrameDoubledError
            Two frames claim the same index. The step has failed.
        FrameMismatchError
            Size, pixel type, count or pattern differs from the other frames of the step. The step has failed.
        FrameMissingError
            The last frame is here and others are not. The step has failed.
        FrameLateError
            The step has ended already; its result stands.
        """
        key = (record.experiment, record.step)
        where = f"experiment '{record.experiment}', step {record.step}"
        identity: dict[str, Any] = {"experiment": record.experiment, "step": record.step, "index": record.index}
        if key in self._ended:
            raise FrameLateError(f"{where}: frame {record.index} arrived after the step had ended", **identity)
        if key in self._failed:
            self.discarded += 1
            self._end_if_last(key, record)
            return None

        problem = self._mismatch(record, image)
        if problem:
            self._fail(key, record)
            raise FrameMismatchError(f"{where}: frame {record.index} {problem}", **identity)
        step = self._open.setdefault(key, _OpenStep(np.empty((0,))))
        if not step.records:
            step.frames = np.empty((record.count, *image.shape), image.dtype)
        if record.index in step.records:
            self._fail(key, record)
            raise FrameDoubledError(f"{where}: frame {record.index} arrived twice", **identity)
        step.records[record.index] = record
        step.frames[record.index] = image
        if record.index < record.count - 1:
            return None

        del self._open[key]
        self._ended.add(key)
        missing = [index for index in range(record.count) if index not in step.records]
        if missing:
            raise _missing(where, missing, record.count, record.experiment, record.step)
        records = [step.records[index] for index in range(record.count)]
        incomplete = _incomplete(records)
        if incomplete:
            raise FrameMismatchError(f"{where}: {incomplete}", **identity)
        return Stack(record.experiment, record.step, records, step.frames, records[-1].stamp)

    def abandon(self, experiment: str, step: int) -> FrameMissingError | None:
        """End a step before its last frame arrived, because the experiment has given it up.

        Returns
        -------
        FrameMissingError or None
            What is missing of the step, to be reported; None when no frame of it is in work.
        """
        key = (experiment, step)
        opened = self._open.pop(key, None)
        self._failed.discard(key)
        self._ended.add(key)
        if opened is None:
            return None
        count = next(iter(opened.records.values())).count
        missing = [index for index in range(count) if index not in opened.records]
        return _missing(f"experiment '{experiment}', step {step}", missing, count, experiment, step)

    def _mismatch(self, record: FrameRecord, image: np.ndarray) -> str:
        """Return what is wrong with a frame by itself or beside the others of its step, empty when nothing is."""
        if not 0 <= record.index < record.count:
            return f"has an index outside 0 to {record.count - 1}"
        if image.ndim != 2:
            return f"has the shape {image.shape}, not (row, column)"
        opened = self._open.get((record.experiment, record.step))
        if opened is None:
            return ""
        first = next(iter(opened.records.values()))
        if image.shape != opened.frames.shape[1:]:
            rows, columns = opened.frames.shape[1:]
            return f"is {image.shape[1]}x{image.shape[0]} px, the step began with {columns}x{rows} px"
        if image.dtype != opened.frames.dtype:
            return f"has pixels of type {image.dtype}, the step began with {opened.frames.dtype}"
        if record.count != first.count:
            return f"belongs to a sequence of {record.count} frames, the step began with {first.count}"
        if _kind_of_step(record.projection) != _kind_of_step(first.projection):
            kinds = record.projection.kind.name, first.projection.kind.name
            return "shows {}, the step began with {}".format(*kinds)
        return ""

    def _fail(self, key: tuple[str, int], record: FrameRecord) -> None:
        self._open.pop(key, None)
        self._failed.add(key)
        self._end_if_last(key, record)

    def _end_if_last(self, key: tuple[str, int], record: FrameRecord) -> None:
        if record.index >= record.count - 1:
            self._failed.discard(key)
            self._ended.add(key)


def _kind_of_step(projection: Projection) -> PatternKind:
    """Return the kind of the step that a frame belongs to."""
    return PatternKind.FRINGES if projection.kind in PHASE_KINDS else projection.kind


def _missing(where: str, missing: list[int], count: int, experiment: str, step: int) -> FrameMissingError:
    names = ", ".join(map(str, missing))
    return FrameMissingError(
        f"{where}: frame{'s' if len(missing) > 1 else ''} {names} of {count} never arrived",
        experiment=experiment,
        step=step,
        index=missing[0],
    )


def exposure_groups(exposure_times: Sequence[float]) -> dict[float, list[int]]:
    """Return which frames were exposed equally long, by the time of the first of them, in the order of the frames."""
    groups: dict[float, list[int]] = {}
    for index, time in enumerate(exposure_times):
        alike = (known for known in groups if abs(time - known) <= EQUAL_EXPOSURES * known)
        groups.setdefault(next(alike, time), []).append(index)
    return groups


def _incomplete(records: list[FrameRecord]) -> str:
    """Return what the frames of a fringe step lack: an exposure of a pattern, or shifts; empty when they are whole."""
    if _kind_of_step(records[-1].projection) != PatternKind.FRINGES:
        return ""
    groups = exposure_groups([record.exposure_time for record in records])
    shown = {time: [records[index].projection for index in group] for time, group in groups.items()}
    patterns = max(shown.values(), key=len)
    for time, projections in shown.items():
        lacking = list((Counter(patterns) - Counter(projections)).elements())
        if lacking:
            return f"{lacking[0]} was not exposed for {1e3 * time:g} ms, other patterns were"
    times = list(shown)
    for time, projections in shown.items():
        words = _incomplete_periods(projections)
        if words:
            return words if len(times) == 1 else f"{words} (exposed for {1e3 * time:g} ms)"
        if projections != patterns:
            return f"the frames exposed for {1e3 * time:g} ms show the patterns in another order than the others"
    return ""


def _incomplete_periods(projections: list[Projection]) -> str:
    """Return which pitch lacks frames of a whole period, empty when all shifts are there equally often.

    Unequal numbers would leak the mean and the modulation into the arctangent of eq. 11. A single fringe image is not
    stepped and has no periods to cover.
    """
    if [each.kind for each in projections].count(PatternKind.FRINGES) == 1:
        return ""
    shifts_of: defaultdict[tuple[Orientation, float, int], Counter[int]] = defaultdict(Counter)
    for projection in projections:
        if projection.kind == PatternKind.FRINGES:
            if projection.shifts < 3 or projection.pitch <= 0:
                return f"{projection}: fringes need a pitch above 0 and at least 3 shifts"
            group = shifts_of[projection.orientation, projection.pitch, projection.shifts]
            group[projection.shift % projection.shifts] += 1
    for (orientation, pitch, shifts), counted in shifts_of.items():
        if len(counted) < shifts or len(set(counted.values())) > 1:
            present = ", ".join(map(str, sorted(shift or shifts for shift in counted.elements())))
            return (
                f"{orientation.name.lower()} fringes of pitch {pitch:g} px do not cover whole periods: "
                f"shifts {present} of {shifts}"
            )
    return ""
