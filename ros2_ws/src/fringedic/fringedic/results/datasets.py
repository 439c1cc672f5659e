"""From a recording to one labelled dataset."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fringedic.recording import BagReader
from fringedic.results.derived import Collected
from fringedic.results.measuring import Chain
from fringedic.results.quantities import PHASE_TOPICS
from fringedic.results.rows import Row, Settings, in_order_of_steps
from fringedic.results.stores import dataset_path
from fringedic.results.timeline import Timeline
from fringedic.results.writer import DatasetWriter
from fringedic.rig import RigModel


def process_bag(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    steps: Iterable[int] | None = None,
    reference: int | None = None,
    calibration: RigModel | None = None,
    experiment: str | None = None,
    overwrite: bool = False,
    progress: Callable[[int, str], None] | None = None,
) -> Path:
    """Measure a recorded experiment again from its raw topics, by the same step functions that the nodes call.

    With the recorded parameters the maps equal those of the nodes bit by bit. A step that fails keeps its row, without
    maps, and says why in the variable ``error``. Of a recording that is cut off all whole steps are measured; the
    attribute ``damage`` says what is lost.

    Parameters
    ----------
    path
        The recording.
    output
        The dataset to write, ``.nc`` for NetCDF or ``.zarr`` for Zarr; by default NetCDF beside the recording with its
        name.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    steps
        Numbers of the steps to measure; all by default. The reference steps are measured anyway. The displacement of
        a step starts from that of its predecessors, so that results without them agree within the noise, not exactly.
    reference
        A step that all others are measured against, earlier ones too; by default as recorded.
    calibration
        Of the rig, instead of the recorded one.
    experiment
        Which experiment, where the recording holds several.
    overwrite
        Replace an existing output.
    progress
        Called after each step with its number and its error message, empty when it succeeded.

    Returns
    -------
    Path
        The dataset.

    Raises
    ------
    MissingTopicError
        The recording lacks images or exposure records.
    RecordingError
        It is damaged somewhere in between; `fringedic.recording.recover` saves the rest.
    ParameterError
        An override is unknown or not allowed.
    DatasetError
        The output exists or cannot be written, or the recording holds no frame of the experiment or of a step that is
        asked for, or several experiments.
    """
    reader = BagReader(path)
    names = reader.find("camera/image_raw", "camera/exposure")
    names |= reader.find_optional(
        "experiment/step", "experiment/reference", "calibration", "node_parameters", "load_frame/state"
    )
    timeline = Timeline(reader, names, experiment)
    chain = Chain(overrides or {}, timeline.experiment, reference, calibration)
    references = timeline.references if reference is None else {reference}
    asked = references if reference is not None else set()
    wanted = None if steps is None else set(steps) | references
    timeline.require_steps(asked | (wanted or set()))
    target = dataset_path(path, output, overwrite)
    topics = {full: name for name, full in names.items() if name != "load_frame/state"}

    def passing(numbers: set[int] | None) -> Iterator[Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from chain.take(name, message, numbers)

    def rows() -> Iterator[Row]:
        if reference is not None:
            yield from passing(references)
        yield from passing(wanted)
        yield from chain.finish()

    _write(target, timeline, in_order_of_steps(rows()), chain.settings, progress)
    return target


def dataset_from_derived(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    experiment: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the dataset of an experiment from what the nodes published, without measuring anything again.

    Parameters
    ----------
    path, output, experiment, overwrite
        As for `process_bag`, and the maps can be compared with those of `process_bag` one by one.

    Returns
    -------
    Path
        The dataset.

    Raises
    ------
    MissingTopicError
        The recording holds no derived topics.
    RecordingError
        It is damaged.
    DatasetError
        The output exists or cannot be written, or the recording holds no step of the experiment, or several
        experiments.
    """
    reader = BagReader(path)
    names = reader.find("phase/status", "dic/status", "camera/exposure")
    derived = reader.find_optional(
        *(f"phase/{topic}" for topic in PHASE_TOPICS),
        *("dic/displacement", "dic/sigma", "coupling/shape", "coupling/displacement", "coupling/status"),
    )
    names |= derived
    names |= reader.find_optional("experiment/reference", "calibration", "node_parameters", "load_frame/state")
    timeline = Timeline(reader, names, experiment)
    target = dataset_path(path, output, overwrite)
    collected = Collected(set(derived) | {"phase/status", "dic/status"})
    topics = {full: name for name, full in names.items() if name not in ("load_frame/state", "camera/exposure")}

    def rows() -> Iterator[Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from collected.take(name, message)
        yield from collected.finish()

    _write(target, timeline, in_order_of_steps(rows()), collected.settings, None)
    return target


def _messages(reader: BagReader, topics: Mapping[str, str], experiment: str) -> Iterator[tuple[str, Any]]:
    """Iterate over (relative topic, message) of one experiment in the order of publishing."""
    for raw in reader.published(topics):
        message = reader.decode(raw.topic, raw.data)
        if getattr(message, "experiment", experiment) == experiment:
            yield topics[raw.topic], message


def _write(
    target: Path,
    timeline: Timeline,
    rows: Iterator[Row],
    settings: Callable[[], Settings],
    progress: Callable[[int, str], None] | None,
) -> None:
    attributes = {"experiment": timeline.experiment, "source": timeline.source}
    if timeline.damage:
        attributes["damage"] = timeline.damage
    with DatasetWriter(target, attributes) as writer:
        for row in rows:
            timeline.complete(row)
            writer.add(row, settings())
            if progress is not None:
                progress(row.step, row.error)
