"""The time of each step's exposures, and the signals of the rig during them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fringedic.datasets.rows import Row
from fringedic.errors import DatasetError
from fringedic.frames.records import FrameRecord, stamp_of, time_of
from fringedic.metadata import FIRST_STEP, SpecimenMetadata
from fringedic.patterns.pattern import PatternKind, middle_two, moving_frames
from fringedic.recording.bag_files import recorded_bytes
from fringedic.recording.frames import records, repeated_steps
from fringedic.recording.reader import BagReader
from fringedic.signals import (
    FORCE,
    SIGNAL_TOPICS,
    Signal,
    SignalValue,
    attachment_digests,
    signals_of,
    with_attachments,
)
from fringedic.steps.recorded_parameters import of_specimen, recorded_metadata, with_specimen
from fringedic.steps.recorded_references import REFERENCE_TOPICS, STEP, RecordedReferences, is_reference_known
from fringedic.steps.recorded_rig import EXPERIMENT, missing_settings

# Stages of fringedic_msgs/StepStatus; at PROCESS the hold during the exposures is proven.
_PROCESS, _END, _ERROR = 2, 3, 4
_OF_PROCESSING = {108, 109, 110, 111, 115}  # errors of fringedic_msgs/MeasureStep that another processing may not have
_WHOLE = "put all files of the recording into its folder"


class Timeline:
    """The exposures of the steps of one experiment, and the signals of the rig meanwhile.

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
    overrides
        Settings that replace recorded ones; those of the specimen are used here.

    Attributes
    ----------
    experiment, sensor
        Name of the experiment and of the sensor.
    source, source_bytes, damage, missing_parts
        Name of the recording, size of its files [byte], the description of its damage, and the names of later parts of
        the same run that were not joined with it.
    attachments
        SHA-256 of the descriptions of attached files by their names.
    missing_settings
        Nodes whose settings are not in the recording, so that defaults are used.
    references
        Numbers of the reference steps, see `RecordedReferences`.
    replaced_references
        Step that the nodes measured against instead of a reference that they had lost -> this reference.
    later_references
        Reference steps that took the place of one which the recording does not contain.
    signals
        The signals of the rig and of the attachments by their name; sign and tare of the specimen's metadata apply to
        the force.
    rejected
        Step -> why it failed, of steps whose frames cannot be trusted: no hold was proven, or they are not complete.

    Raises
    ------
    DatasetError
        The recording contains no frame of the experiment, several experiments and none is named, or several
        measurements of a step; or sign or tare of its force are unknown.
    """

    def __init__(
        self,
        reader: BagReader,
        names: Mapping[str, str],
        experiment: str | None,
        *,
        steps: AbstractSet[int] | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        def messages(name: str) -> Iterable[Any]:
            topics = [names[name]] if name in names else []
            return (message for _, message, _ in reader.messages(topics))

        exposed = [record for record in records(reader) if record.pattern.kind != PatternKind.OTHER]
        self.experiment = _chosen_experiment(reader, exposed, experiment)
        self.source, self.source_bytes = reader.path.name, recorded_bytes(reader.path)
        self.damage = reader.lost
        self.missing_parts = [part.name for part in reader.parts]
        exposed = [record for record in exposed if record.experiment == self.experiment]
        self.sensor = exposed[0].sensor
        references, stages = self._references_and_stages(reader, names)
        self._exposed = _exposure_times(exposed, [each for each in stages if each.stage == _END])
        self._moving = _moving_times(exposed)
        recorded = signals_of((topic, message) for topic in SIGNAL_TOPICS for message in messages(topic))
        observed = recorded[FORCE.name].stamps.size > 0
        self.attachments = attachment_digests(reader.path)
        recorded = with_attachments(recorded, reader.path)
        self.rejected = (_interrupted(stages) if observed else {}) | {
            each.step: each.error_message
            for each in stages
            if each.stage == _ERROR and each.error_code not in _OF_PROCESSING
        }
        self._begun = self._exposed.keys() | {each.step for each in stages}
        self._reference_known = is_reference_known(reader, self.experiment)
        self._announced = references.of(self.experiment)
        self.later_references = sorted(step for _, step in references.unreplaced)
        self.replaced_references = {step: reference for (_, step), reference in references.replaced.items()}
        # a reference step that failed before its first frame was announced, too, and the next one after it
        self.references = (self._announced & self._exposed.keys()) | {min(self._exposed)}
        read = None if steps is None else steps | self.references
        refuse_repeated_steps((each for each in exposed if read is None or each.step in read), reader.path)
        self._recorded = recorded
        entries = of_specimen(overrides or {})
        specimen = with_specimen(recorded_metadata(messages("node_parameters")), entries).specimen
        self.missing_settings = missing_settings(reader, exposed)
        if recorded[FORCE.name].stamps.size:
            self._require_sign_and_tare(entries, specimen)
        self._sign, self._tare = specimen.force_sign, self._force_tare(specimen)
        self.signals = {name: self._corrected(signal) for name, signal in recorded.items()}

    def _references_and_stages(
        self, reader: BagReader, names: Mapping[str, str]
    ) -> tuple[RecordedReferences, list[Any]]:
        """Return the references of the experiment, and the stages of its steps."""
        relative = {names[name]: name for name in REFERENCE_TOPICS if name in names}
        references, stages = RecordedReferences(), []
        for raw in reader.published(relative):
            topic, message = relative[raw.topic], reader.decode(raw.topic, raw.data)
            if getattr(message, "experiment", self.experiment) != self.experiment:
                continue
            references.take(topic, message)
            if topic == STEP:
                stages.append(message)
        return references, stages

    def _require_sign_and_tare(self, given: Mapping[str, Any], specimen: SpecimenMetadata) -> None:
        names = ("force_sign", "force_tare_newton") if EXPERIMENT in self.missing_settings else ()
        unknown = [name for name in names if name not in given]
        if specimen.force_tare_newton == FIRST_STEP and min(self._begun) > 0:
            unknown.append("force_tare_newton")
            reason = f"the first step, whose force is the tare, is missing (the first one is step {min(self._begun)})"
        else:
            reason = "the settings of the experiment node, with sign and tare of the force, are missing"
        if unknown:
            options = " ".join(f"--set specimen.{name}=..." for name in unknown)
            raise DatasetError(f"{self.source}: {reason}; {_WHOLE}, or give them: {options}")

    def require_reference(self) -> None:
        """Raise DatasetError if it is not known which step the displacements are relative to, or if it is missing."""
        if not self._reference_known:
            reason = "which step is the reference of the first frames is not recorded (experiment/reference)"
        elif not self._announced & self._exposed.keys():
            reason = f"the reference step {', '.join(map(str, sorted(self._announced)))} is missing"
        else:
            return
        present = ", ".join(map(str, self.steps))
        raise DatasetError(f"{self.source}: {reason}; {_WHOLE}, or give one of the steps {present}: --reference STEP")

    def _force_tare(self, specimen: SpecimenMetadata) -> float:
        if specimen.force_tare_newton == FIRST_STEP:
            first = min(self._exposed.keys() - self.rejected.keys(), default=min(self._exposed))
            return self._recorded[FORCE.name].value_over(*self._exposed[first]).mean
        return float(specimen.force_tare_newton)

    def _corrected(self, signal: Signal) -> Signal:
        """Return a signal with the sign and the tare of the specimen's metadata, which are those of the force."""
        if signal.channel.name != FORCE.name:
            return signal
        return replace(signal, values=self._sign * (signal.values - self._tare))

    def _value_at(self, step: int, name: str) -> SignalValue:
        """Return the value of a signal over the exposures of a step, or at the time of a stack in motion."""
        signal, moving = self._recorded[name], self._moving.get(step)
        value = signal.value_over(*self._exposed[step])
        if moving is not None:  # its drift, as that of others, is the change during all exposures
            value = signal.value_at(*moving)._replace(drift=value.drift)
        if name != FORCE.name:
            return value
        return value._replace(mean=self._sign * (value.mean - self._tare), drift=self._sign * value.drift)

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
        """Enter the signals during the exposures of a step, and the stamp of a step without frames.

        A step that was rejected has its error and no maps.
        """
        if row.step in self.rejected:
            row.reject(self.rejected[row.step])
        if row.step not in self._exposed:
            return
        row.signals = {name: self._value_at(row.step, name) for name in self._recorded}
        if row.stamp is None:
            row.stamp = int(self._exposed[row.step][1])
        if row.step in self._moving:
            row.stamp = self._moving[row.step].time


class _Moving(NamedTuple):
    """Time of a stack in motion, and the begin and end of the two exposures around it [ns]."""

    time: int
    begin: float
    end: float


def _moving_times(exposed: Iterable[FrameRecord]) -> dict[int, _Moving]:
    """Return the times of the steps that were taken in motion."""
    records_of = defaultdict[int, list[FrameRecord]](list)
    for record in exposed:
        records_of[record.step].append(record)
    times = {}
    for step, records_of_step in records_of.items():
        if finest := [records_of_step[k] for k in moving_frames([each.pattern for each in records_of_step])]:
            first, last = middle_two(finest)
            begin, end = first.stamp - 0.5e9 * first.exposure_time, last.stamp + 0.5e9 * last.exposure_time
            times[step] = _Moving(time_of(records_of_step), begin, end)
    return times


def _interrupted(stages: Iterable[Any]) -> dict[int, str]:
    """Return the steps that were begun and not seen to hold, with the reason."""
    last: dict[int, int] = {}
    for each in stages:
        last[each.step] = max(each.stage, last.get(each.step, each.stage))
    reason = "the step was interrupted before it was known that the machine held during its exposures"
    return {step: reason for step, stage in last.items() if stage < _PROCESS}


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
