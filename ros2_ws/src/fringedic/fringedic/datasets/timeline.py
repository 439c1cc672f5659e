"""The time of each step's exposures, and force and position of the load frame during them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fringedic.datasets.rows import Row
from fringedic.errors import DatasetError
from fringedic.frames.records import FrameRecord, stamp_of
from fringedic.metadata import FIRST_STEP, SpecimenMetadata
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.bag_files import recorded_bytes
from fringedic.recording.frames import records, repeated_steps
from fringedic.recording.load_samples import samples_over, summarise_load
from fringedic.recording.reader import BagReader
from fringedic.steps.recorded_parameters import recorded_metadata

# Stages of fringedic_msgs/StepStatus; at PROCESS the hold during the exposures is proven.
_PROCESS, _END, _ERROR = 2, 3, 4
_OF_PROCESSING = {108, 109, 110, 111, 115}  # errors of fringedic_msgs/MeasureStep that another processing may not have
_NO_LOAD = (float("nan"), float("nan"))


@dataclass(frozen=True)
class _LoadSamples:
    """Force [N] and position [m] of the load frame, shape (n, 2), with their stamps [ns], shape (n,)."""

    stamps: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, messages: Iterable[Any]) -> _LoadSamples:
        """Take the samples from ``fringedic_msgs/LoadState``."""
        samples = [(stamp_of(message), message.force, message.position) for message in messages]
        stamps = np.array([sample[0] for sample in samples], dtype=np.int64)
        return cls(stamps, np.array([sample[1:] for sample in samples], dtype=float).reshape(-1, 2))

    def mean_over(self, begin: float, end: float) -> tuple[float, float]:
        """Return mean force and position over a time [ns], NaN without a sample near it."""
        within = samples_over(self.stamps, begin, end)
        if not within.any():
            return _NO_LOAD
        stamps = self.stamps[within].tolist()
        force, position = (summarise_load(stamps, values).mean for values in self.values[within].T)
        return force, position


class Timeline:
    """The exposures of the steps of one experiment, and its load frame meanwhile.

    Parameters
    ----------
    reader
        The recording.
    names
        Relative name -> full name of its topics.
    experiment
        Name of the experiment; None for the only one.
    steps
        The steps that are read, None for all; reference steps are read, too.

    Attributes
    ----------
    experiment
        Name of the experiment.
    source, source_bytes, damage
        Name of the recording, size of its files [byte], and the description of its damage.
    references
        Numbers of the reference steps.
    rejected
        Step -> why it failed, of steps whose frames cannot be trusted: no hold was proven, or they are not complete.

    Raises
    ------
    DatasetError
        The recording contains no frame of the experiment, several experiments and none is named, or several
        measurements of a step.
    """

    def __init__(
        self,
        reader: BagReader,
        names: Mapping[str, str],
        experiment: str | None,
        *,
        steps: AbstractSet[int] | None = None,
    ) -> None:
        def messages(name: str) -> Iterable[Any]:
            topics = [names[name]] if name in names else []
            return (message for _, message, _ in reader.messages(topics))

        exposed = [record for record in records(reader) if record.pattern.kind != PatternKind.OTHER]
        self.experiment = _chosen_experiment(reader, exposed, experiment)
        self.source, self.source_bytes = reader.path.name, recorded_bytes(reader.path)
        self.damage = reader.lost
        exposed = [record for record in exposed if record.experiment == self.experiment]
        stages = [each for each in messages("experiment/step") if each.experiment == self.experiment]
        self._exposed = _exposure_times(exposed, [each for each in stages if each.stage == _END])
        self._load = _LoadSamples.of(messages("load_frame/state"))
        self.rejected = self._interrupted(stages) | {
            each.step: each.error_message
            for each in stages
            if each.stage == _ERROR and each.error_code not in _OF_PROCESSING
        }
        announced = {each.step for each in messages("experiment/reference") if each.experiment == self.experiment}
        # a reference step that failed before its first frame was announced, too, and the next one after it
        self.references = (announced & self._exposed.keys()) | {min(self._exposed)}
        read = None if steps is None else steps | self.references
        refuse_repeated_steps((each for each in exposed if read is None or each.step in read), reader.path)
        specimen = recorded_metadata(messages("node_parameters")).specimen
        self._force_sign = specimen.force_sign
        self._force_tare = self._tare(specimen)

    def _interrupted(self, stages: Iterable[Any]) -> dict[int, str]:
        """Return the steps that were begun and not seen to hold, with the reason; none without a load frame."""
        last: dict[int, int] = {}
        for each in stages:
            last[each.step] = max(each.stage, last.get(each.step, each.stage))
        reason = "the step was interrupted before it was known that the machine held during its exposures"
        return {step: reason for step, stage in last.items() if stage < _PROCESS and self._load.stamps.size}

    def _tare(self, specimen: SpecimenMetadata) -> float:
        if specimen.force_tare_newton == FIRST_STEP:
            first = min(self._exposed.keys() - self.rejected.keys(), default=min(self._exposed))
            return self._load.mean_over(*self._exposed[first])[0]
        return float(specimen.force_tare_newton)

    @property
    def exposed(self) -> list[int]:
        """Numbers of all exposed steps in the order of their exposures."""
        return list(self._exposed)

    @property
    def steps(self) -> list[int]:
        """Numbers of all exposed steps in their order."""
        return sorted(self._exposed)

    def require_steps(self, steps: set[int]) -> None:
        """Raise DatasetError if no frame of one of these steps was exposed."""
        absent = sorted(steps - self._exposed.keys())
        if absent:
            present = ", ".join(map(str, sorted(self._exposed)))
            raise DatasetError(
                f"{self.source}: experiment '{self.experiment}' has no step {', '.join(map(str, absent))}; "
                f"it has {present}"
            )

    def complete(self, row: Row) -> None:
        """Enter force and position, averaged over the exposures of a step, and the stamp of a step without frames.

        A step that was rejected has its error and no maps.
        """
        if row.step in self.rejected:
            row.reject(self.rejected[row.step])
        if row.step not in self._exposed:
            return
        force, row.position = self._load.mean_over(*self._exposed[row.step])
        row.force = self._force_sign * (force - self._force_tare)
        if row.stamp is None:
            row.stamp = int(self._exposed[row.step][1])


def _chosen_experiment(reader: BagReader, exposed: Iterable[FrameRecord], name: str | None) -> str:
    """Return the experiment that is asked for, or the only one."""
    present = list(dict.fromkeys(record.experiment for record in exposed))
    if name is None and len(present) > 1:
        raise DatasetError(f"{reader.path} holds the experiments {', '.join(present)}: say which one")
    if not present or (name is not None and name not in present):
        wanted = "any experiment" if name is None else f"experiment '{name}'"
        raise DatasetError(f"{reader.path} holds no frame of {wanted}; it has {', '.join(present) or 'none'}")
    return present[0] if name is None else name


def refuse_repeated_steps(exposed: Iterable[FrameRecord], path: Path) -> None:
    """Refuse a recording with several measurements under one number, whose frames and forces would be mixed.

    Raises
    ------
    DatasetError
        The message names the first such step.
    """
    repeated = repeated_steps((each.experiment, each.step, each.index, each.stamp) for each in exposed if each.count)
    if repeated:
        experiment, step = repeated[0]
        raise DatasetError(
            f"{path}: step {step} of experiment '{experiment}' was measured more than once under this number; "
            "use the separate recordings of the measurements, or choose the other steps (--step)"
        )


def _exposure_times(exposed: Iterable[FrameRecord], ends: Iterable[Any]) -> dict[int, tuple[float, float]]:
    """Return begin of the first and end of the last exposure of each step [ns], in the order of the ends.

    Of a step whose frames are all lost only the stamp of its last exposure is known, from ``StepStatus`` at its end.
    """
    times: dict[int, tuple[float, float]] = {}
    for record in exposed:
        begin, end = times.get(record.step, (np.inf, -np.inf))
        half = 0.5e9 * record.exposure_time
        times[record.step] = min(begin, record.stamp - half), max(end, record.stamp + half)
    for end_of_step in ends:
        if end_of_step.frames:
            times.setdefault(end_of_step.step, (stamp_of(end_of_step), stamp_of(end_of_step)))
    return dict(sorted(times.items(), key=lambda item: item[1][1]))
