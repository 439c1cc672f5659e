"""Collects single frames into complete stacks, one per step.

An exposure is identified by (sensor, experiment, step, index). Frames are joined by these, never by time.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.exposure_groups import exposure_groups
from fringedic.frames.records import FrameRecord, StepKey, time_of
from fringedic.frames.sensor import SENSOR
from fringedic.patterns.pattern import PHASE_KINDS, Orientation, PatternKind, ProjectedPattern, moving_frames

MOST_FRAMES = 1000  # of a step, which are in memory together; far more than a sequence has


@dataclass
class Stack:
    """All frames of one step in the order of their index.

    Attributes
    ----------
    experiment, step
        Identity of the step, with the sensor.
    records
        One record per frame, in the order of ``index``.
    frames
        Grey levels, shape (count, row, column), type of the camera's pixels.
    stamp
        Stamp of the last exposure [ns]: the stamp of every message computed from this step.
    sensor
        Name of the camera with its projector.
    """

    experiment: str
    step: int
    records: list[FrameRecord]
    frames: np.ndarray
    stamp: int
    sensor: str = SENSOR

    @property
    def patterns(self) -> list[ProjectedPattern]:
        """Pattern of each frame, in the order of the frames."""
        return [record.pattern for record in self.records]

    @property
    def kind(self) -> PatternKind:
        """Kind of the whole step: FRINGES also for a step with a Gray code or uniform grey beside the fringes."""
        return _kind_of_step(self.records[-1].pattern)

    @property
    def is_moving(self) -> bool:
        """Whether the stack was taken to be measured while the surface moves, see `moving_frames`."""
        return bool(moving_frames(self.patterns))

    @property
    def time(self) -> int:
        """Time that the results belong to [ns], see `time_of`."""
        return time_of(self.records)

    @property
    def exposure_times(self) -> list[float]:
        """Exposure time of each frame [s], in the order of the frames."""
        return [record.exposure_time for record in self.records]


@dataclass
class _OpenStep:
    frames: np.ndarray
    records: dict[int, FrameRecord] = field(default_factory=dict)


class FrameCollector:
    """Joins single frames into stacks, one per step and sensor.

    The collector uses no clock. Missing frames are detected when the last index arrives, because one publisher over
    reliable transport keeps the order. When the last frame itself is lost, the experiment ends the step and the owner
    calls `abandon`. Several steps may be open at once. A step that fails does not affect the others: its remaining
    frames are dropped and counted in `discarded`.

    Attributes
    ----------
    discarded
        Frames that arrived for a step that had failed before its last frame.

    Examples
    --------
    >>> from fringedic.patterns import PatternKind, ProjectedPattern
    >>> white = ProjectedPattern(PatternKind.WHITE)
    >>> collector = FrameCollector()
    >>> for index in range(2):
    ...     record = FrameRecord("plate", 0, index, 2, white, stamp=index, exposure_time=0.01)
    ...     stack = collector.add(record, np.zeros((3, 4), np.uint8))
    >>> stack.frames.shape
    (2, 3, 4)
    """

    def __init__(self) -> None:
        self._open: dict[StepKey, _OpenStep] = {}
        self._failed: set[StepKey] = set()
        self._ended: set[StepKey] = set()
        self.discarded = 0

    @property
    def open_steps(self) -> list[StepKey]:
        """The steps of which some but not all frames have arrived, oldest first."""
        return list(self._open)

    def add(self, record: FrameRecord, image: np.ndarray) -> Stack | None:
        """Add one frame and return the whole stack when it was the last one of its step.

        Parameters
        ----------
        record
            Exposure record of the frame.
        image
            Grey levels, shape (row, column); copied.

        Returns
        -------
        Stack or None
            None while frames are outstanding.

        Raises
        ------
        StepError
            With the code FRAME_DOUBLED: two frames have the same index; FRAME_MISMATCH: size, pixel type, count or
            pattern differs from the other frames of the step; FRAME_MISSING: the last frame has arrived and others have
            not. The step has failed in these cases. FRAME_LATE: the step has ended already and its result is unchanged.
        """
        key = record.step_key
        identity: dict[str, Any] = {"experiment": record.experiment, "step": record.step, "index": record.index}
        if key in self._ended:
            raise StepError(
                f"frame {record.index} arrived after the step had ended", **identity, code=ErrorCode.FRAME_LATE
            )
        if key in self._failed:
            self.discarded += 1
            self._end_if_last(key, record)
            return None

        problem = self._mismatch(record, image)
        if problem:
            self._fail(key, record)
            raise StepError(f"frame {record.index} {problem}", **identity, code=ErrorCode.FRAME_MISMATCH)
        if key not in self._open:
            self._open[key] = _OpenStep(np.empty((record.count, *image.shape), image.dtype))
        step = self._open[key]
        if record.index in step.records:
            self._fail(key, record)
            raise StepError(f"frame {record.index} arrived twice", **identity, code=ErrorCode.FRAME_DOUBLED)
        step.records[record.index] = record
        step.frames[record.index] = image
        if record.index < record.count - 1:
            return None

        del self._open[key]
        self._ended.add(key)
        missing = [index for index in range(record.count) if index not in step.records]
        if missing:
            raise _missing(missing, record.count, record.experiment, record.step)
        records = [step.records[index] for index in range(record.count)]
        incomplete = _incomplete(records)
        if incomplete:
            raise StepError(incomplete, **identity, code=ErrorCode.FRAME_MISMATCH)
        return Stack(record.experiment, record.step, records, step.frames, records[-1].stamp, record.sensor)

    def abandon(self, key: StepKey) -> StepError | None:
        """End a step before its last frame has arrived, because the experiment has given it up.

        Returns
        -------
        StepError or None
            The error to report, which lists the missing frames; None when no frame of the step has arrived.
        """
        opened = self._open.pop(key, None)
        self._failed.discard(key)
        self._ended.add(key)
        if opened is None:
            return None
        count = next(iter(opened.records.values())).count
        missing = [index for index in range(count) if index not in opened.records]
        return _missing(missing, count, key.experiment, key.step)

    def _mismatch(self, record: FrameRecord, image: np.ndarray) -> str:
        """Return how a frame contradicts itself or the others of its step; empty when it does not."""
        if not 0 <= record.index < record.count:
            return f"has an index outside 0 to {record.count - 1}"
        if record.count > MOST_FRAMES:
            return f"belongs to a sequence of {record.count} frames, {MOST_FRAMES} are possible"
        if image.ndim != 2:
            return f"has the shape {image.shape}, not (row, column)"
        opened = self._open.get(record.step_key)
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
        if _kind_of_step(record.pattern) != _kind_of_step(first.pattern):
            kinds = record.pattern.kind.name, first.pattern.kind.name
            return "shows {}, the step began with {}".format(*kinds)
        return ""

    def _fail(self, key: StepKey, record: FrameRecord) -> None:
        self._open.pop(key, None)
        self._failed.add(key)
        self._end_if_last(key, record)

    def _end_if_last(self, key: StepKey, record: FrameRecord) -> None:
        if record.index >= record.count - 1:
            self._failed.discard(key)
            self._ended.add(key)


def _kind_of_step(pattern: ProjectedPattern) -> PatternKind:
    """Return the kind of the step to which a frame belongs."""
    return PatternKind.FRINGES if pattern.kind in PHASE_KINDS else pattern.kind


def _missing(missing: list[int], count: int, experiment: str, step: int) -> StepError:
    names = ", ".join(map(str, missing))
    return StepError(
        f"frame{'s' if len(missing) > 1 else ''} {names} of {count} never arrived",
        experiment=experiment,
        step=step,
        index=missing[0],
        code=ErrorCode.FRAME_MISSING,
    )


def _incomplete(records: list[FrameRecord]) -> str:
    """Return what a fringe step lacks, an exposure of a pattern or shifts; empty for a complete step."""
    if _kind_of_step(records[-1].pattern) != PatternKind.FRINGES:
        return ""
    groups = exposure_groups([record.exposure_time for record in records])
    shown = {time: [records[index].pattern for index in group] for time, group in groups.items()}
    wanted = max(shown.values(), key=len)
    for time, patterns in shown.items():
        lacking = list((Counter(wanted) - Counter(patterns)).elements())
        if lacking:
            return f"{lacking[0]} was not exposed for {1e3 * time:g} ms, other patterns were"
    times = list(shown)
    for time, patterns in shown.items():
        words = _incomplete_periods(patterns)
        if words:
            return words if len(times) == 1 else f"{words} (exposed for {1e3 * time:g} ms)"
        if patterns != wanted:
            return f"the frames exposed for {1e3 * time:g} ms show the patterns in another order than the others"
    return ""


def _incomplete_periods(patterns: list[ProjectedPattern]) -> str:
    """Return which pitch lacks frames of a whole period; empty when all shifts occur equally often.

    With unequal numbers the mean and the modulation leak into the arctangent of eq. 11. A single fringe image is not
    phase stepped and has no periods to cover.
    """
    if [each.kind for each in patterns].count(PatternKind.FRINGES) == 1:
        return ""
    shifts_of: defaultdict[tuple[Orientation, float, int], Counter[int]] = defaultdict(Counter)
    for pattern in patterns:
        if pattern.kind == PatternKind.FRINGES:
            if pattern.shifts < 3 or pattern.pitch <= 0:
                return f"{pattern}: fringes need a pitch above 0 and at least 3 shifts"
            group = shifts_of[pattern.orientation, pattern.pitch, pattern.shifts]
            group[pattern.shift % pattern.shifts] += 1
    for (orientation, pitch, shifts), counted in shifts_of.items():
        if len(counted) < shifts or len(set(counted.values())) > 1:
            present = ", ".join(map(str, sorted(shift or shifts for shift in counted.elements())))
            return (
                f"{orientation.name.lower()} fringes of pitch {pitch:g} px do not cover whole periods: "
                f"shifts {present} of {shifts}"
            )
    return ""
