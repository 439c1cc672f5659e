"""From a recording to one labelled dataset."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.datasets.derived import Collected
from fringedic.datasets.quantities import (
    ATTACHMENTS,
    LATER_REFERENCES,
    MISSING_PARTS,
    MISSING_SETTINGS,
    PHASE_TOPICS,
    SOURCE_BYTES,
)
from fringedic.datasets.rows import Row, in_order_of_steps, row_of, with_lost_steps
from fringedic.datasets.sentences import lost_references_sentence
from fringedic.datasets.stores import Store, dataset_path
from fringedic.datasets.timeline import Timeline
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import DatasetError
from fringedic.evidence.changes import noted
from fringedic.frames.records import FrameRecord, frame_record
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.bag_files import BAG, recording_of
from fringedic.recording.every_frame import EVERY_FRAME, EveryFrameReader, stacks_of
from fringedic.recording.frames import RecordedMessage, events, paired
from fringedic.recording.growing import FollowError, GrowingRecording
from fringedic.recording.reader import BagReader
from fringedic.recording.remote import is_remote, local_copy
from fringedic.rig.compatibility import check_calibration
from fringedic.rig.model import RigModel
from fringedic.signals import SIGNAL_TOPICS
from fringedic.steps.pipeline import OfflinePipeline
from fringedic.steps.recorded_parameters import StepSettings
from fringedic.steps.recorded_rig import recorded_setup
from fringedic.wording.arguments import check_arguments, optional
from fringedic.wording.arguments import path as file_path

PROCESSED_TOPICS = (
    "camera/image_raw",
    "camera/exposure",
    "experiment/step",
    "experiment/reference",
    "calibration",
    "node_parameters",
    *SIGNAL_TOPICS,
)
"""Topics that processing reads; a recording needs the first two."""
_LEAD_IN = 2  # steps before a segment
DATASETS = "datasets"
"""Detail of an entry in the log of a run: settings by the name of the dataset that was made with them."""


@check_arguments(DatasetError, path=file_path, output=optional(file_path))
def process_bag(  # noqa: PLR0913 (options of a public function, all by keyword)
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    steps: Iterable[int] | None = None,
    reference: int | Sequence[int] | None = None,
    calibration: RigModel | None = None,
    experiment: str | None = None,
    sensor: str | None = None,
    overwrite: bool = False,
    every_frame: bool = False,
    progress: Callable[[int, str], None] | None = None,
) -> Path:
    """Measure a recorded experiment again from its raw topics, by the same step functions that the nodes call.

    With the recorded parameters the maps equal those of the nodes bit by bit; independent checks of phase and
    displacement are added, see docs/results.md. A step that fails has a row without maps, and the variable ``error``
    contains the reason. Of a recording that is cut off all complete steps are measured; the attribute ``damage``
    describes the loss, and ``missing_parts`` names later parts of the same run that were not joined with it. Nodes of
    which no settings are recorded use the defaults and are listed in ``missing_settings``.

    Parameters
    ----------
    path
        The recording; ``s3://...`` or another address that fsspec knows for one in an object store, of which the index
        and the needed chunks are copied.
    output
        The dataset to write, ``.nc`` for NetCDF or ``.zarr`` for Zarr; by default NetCDF beside the recording with its
        name, and that of a sensor that was given one, in the working folder if the recording is in an object store.
        With `every_frame` ``bag.every-frame.nc``, which `open_experiment` does not take for the recording's results.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24, "specimen.force_sign": -1}``.
    steps
        Numbers of the steps to measure; all by default. The reference steps are always measured. The displacement of
        a step starts from that of its predecessors, so that results without them agree within the noise, not exactly.
    reference
        Number of the step that all others are measured against, also earlier ones. Several numbers: each step is
        measured against the latest of them before it, earlier ones against the first. By default as recorded; a step
        that took the place of a reference which the nodes had lost is none, see docs/results.md.
    calibration
        Model of the rig, instead of the recorded one.
    experiment, sensor
        Name of the experiment and of the sensor, if the recording contains several.
    overwrite
        Replace an existing output.
    every_frame
        Between the stacks of a surface in motion measure one for every frame, see `EveryFrameReader`; the numbers of
        all steps are multiplied by 100.
    progress
        Called after each step with its number and its error message, empty when it succeeded.

    Returns
    -------
    Path
        The dataset.

    Raises
    ------
    RecordingError
        The recording lacks images or exposure records, or is damaged before its end;
        `fringedic.recording.repair.recover` saves the rest. Or it contains several sensors and none is chosen.
    ConfigurationError
        An override is unknown or not allowed.
    CalibrationError
        The calibration belongs to another rig, or its lengths contradict each other.
    PatternError
        The coarsest fringes repeat in the view of `calibration`.
    DatasetError
        The output exists or cannot be written, or the recording contains no frame of the experiment or of a requested
        step, or several experiments; or sign or tare of its force or the reference are not recorded, as in a later
        file of a split recording, and not given.

    Examples
    --------
    >>> process_bag("recordings/plate-7/bag", overrides={"dic.window": 24})
    PosixPath('recordings/plate-7/bag.nc')
    """
    only = None if steps is None else frozenset(steps)
    several = () if reference is None else (reference,) if isinstance(reference, int) else tuple(sorted(reference))
    settings = ProcessingSettings(
        overrides or {}, several, calibration, experiment, sensor, only, every_frame=every_frame
    )
    source = _name_nearby(str(path)) if is_remote(path) else recording_of(Path(path))
    target = None if output is None else dataset_path(source, output, overwrite)  # refused before anything is copied
    with local_copy(path, PROCESSED_TOPICS) as nearby:
        if target is None:
            recorded = BagReader(nearby, sensor=sensor).sensor
            target = dataset_path(source, None, overwrite, recorded, EVERY_FRAME if every_frame else "")
        with noted(target, "process", details={DATASETS: {target.name: settings.as_details()}}):
            process_into(target, nearby, settings, progress)
    return target


def _name_nearby(address: str) -> Path:
    """Return the name of a recording in an object store, that of its run for the folder ``bag``, in the working folder.

    Examples
    --------
    >>> _name_nearby("s3://laboratory/plate-7/bag"), _name_nearby("s3://laboratory/plate-8")
    (PosixPath('plate-7'), PosixPath('plate-8'))
    """
    parts = [part for part in address.split("://")[1].split("/") if part]
    return Path(parts[-2] if parts[-1] == BAG and len(parts) > 1 else parts[-1])


@dataclass(frozen=True)
class ProcessingSettings:
    """What a recording is processed with; see `process_bag`.

    Attributes
    ----------
    segment
        (number from 0, count): only the steps of one of several equal parts of the recording, without those of its
        references.
    every_frame
        A stack in motion for every frame.
    """

    overrides: Mapping[str, Any] = field(default_factory=dict)
    references: tuple[int, ...] = ()
    calibration: RigModel | None = None
    experiment: str | None = None
    sensor: str | None = None
    steps: frozenset[int] | None = None
    segment: tuple[int, int] | None = None
    every_frame: bool = False

    def reader(self, path: str | os.PathLike[str]) -> BagReader:
        """Return the reader of a recording."""
        return (EveryFrameReader if self.every_frame else BagReader)(path, sensor=self.sensor)

    def as_details(self) -> dict[str, Any]:
        """Return the settings as the log of a run contains them; of a calibration its identifier."""
        return {
            "overrides": dict(self.overrides),
            "reference": list(self.references),
            "calibration": None if self.calibration is None else self.calibration.identifier,
            "experiment": self.experiment,
            "sensor": self.sensor,
            "steps": None if self.steps is None else sorted(self.steps),
            **({"every_frame": True} if self.every_frame else {}),
        }


class _Segment(NamedTuple):
    """Numbers of the steps of one of several equal parts of a recording, and of those measured before it.

    The displacement of a step is searched from the extrapolation of the two steps before: after as many, the history of
    the measurement does not matter.
    """

    lead_in: frozenset[int]
    steps: frozenset[int]

    @classmethod
    def of(cls, steps: Sequence[int], number: int, count: int) -> _Segment:
        first, end = (len(steps) * edge // count for edge in (number, number + 1))
        return cls(frozenset(steps[max(0, first - _LEAD_IN) : first]), frozenset(steps[first:end]))


def process_into(
    target: Path | Store,
    path: str | os.PathLike[str],
    settings: ProcessingSettings,
    progress: Callable[[int, str], None] | None = None,
) -> None:
    """Measure a recorded experiment into any store; `process_bag` with a path.

    Parameters
    ----------
    target
        Path of a dataset, or a store that takes it.
    path, settings, progress
        The recording, what it is processed with, and the call after each step, as of `process_bag`.

    Raises
    ------
    FringedicError
        See `process_bag`.
    """
    reader = settings.reader(path)
    names = _processed_topics(reader)
    asked = set(settings.references)
    read = None if settings.steps is None else settings.steps | asked
    timeline = Timeline(reader, names, settings.experiment, steps=read, overrides=settings.overrides)
    if settings.every_frame:  # frames that cannot be trusted are not trusted in a window
        timeline.rejected |= {
            step: timeline.rejected[stack]
            for step in timeline.steps
            for stack in stacks_of(step)
            if stack in timeline.rejected
        }
    if asked:
        timeline.later_references = []
    else:
        timeline.require_reference()
    if settings.calibration is not None:
        check_calibration(settings.calibration, recorded_setup(reader))
    pipeline = OfflinePipeline(settings.overrides, timeline.experiment, settings.references, settings.calibration)
    references = asked or timeline.references
    segment = None if settings.segment is None else _Segment.of(timeline.steps, *settings.segment)
    steps = settings.steps if segment is None else segment.lead_in | segment.steps
    wanted = None if steps is None else steps | references
    timeline.require_steps(asked | (wanted or set()))
    topics = {name: full for name, full in names.items() if name not in SIGNAL_TOPICS}

    def passing(numbers: AbstractSet[int] | None) -> Iterator[Row]:
        for event in events(reader, topics, timeline.experiment):
            yield from (row_of(each, pipeline.settings) for each in pipeline.take(event, numbers))

    def rows() -> Iterator[Row]:
        if settings.references:
            yield from passing({settings.references[0]})
        yield from passing(wanted)
        yield from (row_of(each, pipeline.settings) for each in pipeline.finish())

    exposed = [step for step in timeline.exposed if wanted is None or step in wanted]
    measured = with_lost_steps(in_order_of_steps(rows()), exposed, "the recording contains no image of this step")
    if segment is not None:
        measured = (row for row in measured if row.step in segment.steps)
    _write(target, timeline, measured, lambda: pipeline.settings, progress)


def _processed_topics(reader: BagReader) -> dict[str, str]:
    """Return the topics that processing reads and that are recorded: relative name -> full name."""
    return reader.find(*PROCESSED_TOPICS[:2]) | reader.find_optional(*PROCESSED_TOPICS[2:])


def follow_into(
    target: Store,
    recording: GrowingRecording,
    settings: ProcessingSettings,
    progress: Callable[[int, str], None] | None = None,
) -> None:
    """Measure a recorded experiment while it is recorded, each step as soon as it has ended.

    The results are those of `process_into` with the complete recording: steps pass through the same functions in the
    same order, and values that depend on later messages (signals) are entered at the end.

    Parameters
    ----------
    target
        Store that takes the steps.
    recording, settings, progress
        The recording, what it is processed with (all steps, with the recorded references), and the call after each
        step, as of `process_bag`.

    Raises
    ------
    FollowError
        The recording has to be processed when it is complete.
    FringedicError
        See `process_bag`.
    """
    if settings.sensor is not None:
        raise FollowError(f"{recording.path}: its sensors are known when it is complete")
    first = _first_frame(recording)
    experiment = first.experiment
    pipeline = OfflinePipeline(settings.overrides, experiment, calibration=settings.calibration)
    attributes = {"experiment": experiment, "sensor": first.sensor, "source": recording.path.name}
    topics = [name for name in PROCESSED_TOPICS if name not in SIGNAL_TOPICS]

    def rows() -> Iterator[Row]:
        for event in paired(recording.published(topics), experiment):
            for each in pipeline.take(event):
                if progress is not None:
                    progress(each.step, each.error)
                yield row_of(each, pipeline.settings)
        yield from (row_of(each, pipeline.settings) for each in pipeline.finish())

    kept: list[Row] = []
    with DatasetWriter(target, attributes) as writer:
        for row in in_order_of_steps(rows()):
            writer.add(replace(row, stamp=row.stamp or 0), row.settings or pipeline.settings)
            kept.append(replace(row, maps={}))
        timeline = _final_timeline(recording, attributes, settings, [row.step for row in kept])
        writer.attributes[SOURCE_BYTES] = str(timeline.source_bytes)
        if timeline.later_references:
            writer.attributes[LATER_REFERENCES] = json.dumps(timeline.later_references)
        writer.add_signals(timeline.signals.values())
        for index, row in enumerate(kept):
            timeline.complete(row)
            writer.enter_values(index, row)


def _first_frame(recording: GrowingRecording) -> FrameRecord:
    """Return the record of the first frame of a step, as soon as that has ended."""
    for topic, message in recording.published(["camera/exposure", "experiment/step"]):
        if topic == "camera/exposure" and (record := frame_record(message)).pattern.kind != PatternKind.OTHER:
            return record
    raise FollowError(f"{recording.path}: contains no frame of a step")


def _final_timeline(
    recording: GrowingRecording, attributes: Mapping[str, str], settings: ProcessingSettings, steps: list[int]
) -> Timeline:
    """Return the timeline of a recording that is complete, if it is what was assumed while it was made."""
    reader = BagReader(recording.path)
    timeline = Timeline(reader, _processed_topics(reader), None, overrides=settings.overrides)
    timeline.require_reference()
    if settings.calibration is not None:
        check_calibration(settings.calibration, recorded_setup(reader))
    found = {"experiment": timeline.experiment, "sensor": timeline.sensor, "source": timeline.source}
    differs = timeline.steps != steps or found != attributes
    if timeline.damage or differs or timeline.rejected:
        raise FollowError(f"{recording.path}: is not what was read while it was made")
    return timeline


@check_arguments(DatasetError, path=file_path, output=optional(file_path))
def dataset_from_derived(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    experiment: str | None = None,
    sensor: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the dataset of an experiment from the results that the nodes published, without measuring anything again.

    The displacement of each step is checked independently (`displacement_closure`); the phase is not, since that needs
    the frames.

    Parameters
    ----------
    path, output, experiment, sensor, overwrite
        As of `process_bag`. The maps have the same names, so that both datasets can be compared.

    Returns
    -------
    Path
        The dataset.

    Raises
    ------
    RecordingError
        The recording contains no derived topics, or is damaged.
    DatasetError
        The output exists or cannot be written, or the recording contains no step of the experiment, or several
        experiments; or results count from a step at which the nodes had lost the reference.
    """
    reader = BagReader(path, sensor=sensor)
    names = reader.find("phase/status", "dic/status", "camera/exposure")
    derived = reader.find_optional(
        *(f"phase/{topic}" for topic in PHASE_TOPICS),
        *("dic/displacement", "dic/sigma", "coupling/shape", "coupling/displacement", "coupling/status"),
    )
    names |= derived
    names |= reader.find_optional("experiment/reference", "calibration", "node_parameters")
    others = reader.find_optional(*SIGNAL_TOPICS, "experiment/step")
    timeline = Timeline(reader, names | others, experiment)
    if timeline.replaced_references:
        raise DatasetError(f"{path}: {lost_references_sentence(timeline.replaced_references, path)}")
    target = dataset_path(path, output, overwrite, timeline.sensor)
    collected = Collected(set(derived) | {"phase/status", "dic/status"})
    topics = {name: full for name, full in names.items() if name != "camera/exposure"}

    def rows() -> Iterator[Row]:
        for event in events(reader, topics, timeline.experiment):
            assert isinstance(event, RecordedMessage), "no frames were asked for"
            yield from collected.take(event.topic, event.message)
        yield from collected.finish()

    lost = "the recording contains no result of this step; measure it with fringedic process"
    measured = with_lost_steps(in_order_of_steps(rows()), timeline.exposed, lost)
    settings = ProcessingSettings(experiment=experiment, sensor=sensor)
    with noted(target, "dataset of the nodes' results", details={DATASETS: {target.name: settings.as_details()}}):
        _write(target, timeline, measured, collected.settings, None)
    return target


def _write(
    target: Path | Store,
    timeline: Timeline,
    rows: Iterator[Row],
    settings: Callable[[], StepSettings],
    progress: Callable[[int, str], None] | None,
) -> None:
    attributes = {"experiment": timeline.experiment, "sensor": timeline.sensor, "source": timeline.source}
    attributes[SOURCE_BYTES] = str(timeline.source_bytes)
    if timeline.damage:
        attributes["damage"] = timeline.damage
    if timeline.attachments:
        attributes[ATTACHMENTS] = json.dumps(timeline.attachments)
    if timeline.missing_parts:
        attributes[MISSING_PARTS] = json.dumps(timeline.missing_parts)
    if timeline.later_references:
        attributes[LATER_REFERENCES] = json.dumps(timeline.later_references)
    if timeline.missing_settings:
        attributes[MISSING_SETTINGS] = json.dumps(timeline.missing_settings)
    with DatasetWriter(target, attributes) as writer:
        writer.add_signals(timeline.signals.values())
        for row in rows:
            timeline.complete(row)
            writer.add(row, row.settings or settings())
            if progress is not None:
                progress(row.step, row.error)
