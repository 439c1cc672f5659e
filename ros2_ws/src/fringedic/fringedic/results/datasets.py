"""From a recording to one labelled dataset, and the opening of datasets."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from fringedic.errors import DatasetError, MissingTopicError
from fringedic.recording import BagReader
from fringedic.results.derived import Collected
from fringedic.results.measuring import Chain
from fringedic.results.quantities import PHASE_TOPICS
from fringedic.results.rows import Row, Settings
from fringedic.results.timeline import Timeline
from fringedic.results.writer import DatasetWriter


def process_bag(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    steps: Iterable[int] | None = None,
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
        The NetCDF file to write; by default beside the recording with its name.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    steps
        Numbers of the steps to measure; all by default. The reference steps are measured anyway. The displacement of
        a step starts from that of its predecessors, so that results without them agree within the noise, not exactly.
    experiment
        Which experiment, where the recording holds several.
    overwrite
        Replace an existing output.
    progress
        Called after each step with its number and its error message, empty when it succeeded.

    Returns
    -------
    Path
        The NetCDF file.

    Raises
    ------
    MissingTopicError
        The recording lacks images or exposure records.
    RecordingError
        It is damaged somewhere in between; `fringedic.recording.recover` saves the rest.
    ParameterError
        An override is unknown or not allowed.
    DatasetError
        The output exists, or the recording holds no frame of the experiment, or several experiments.
    """
    reader = BagReader(path)
    names = reader.find("camera/image_raw", "camera/exposure")
    names |= reader.find_optional(
        "experiment/step", "experiment/reference", "calibration", "node_parameters", "load_frame/state"
    )
    chain = Chain(overrides or {})
    timeline = Timeline(reader, names, experiment)
    wanted = None if steps is None else set(steps) | timeline.references
    target = _output(path, output, overwrite)
    topics = {full: name for name, full in names.items() if name != "load_frame/state"}

    def rows() -> Iterator[Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from chain.take(name, message, wanted)
        yield from chain.finish()

    _write(target, timeline, rows(), chain.settings, progress)
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
        The NetCDF file.

    Raises
    ------
    MissingTopicError
        The recording holds no derived topics.
    RecordingError
        It is damaged.
    DatasetError
        The output exists, or the recording holds no step of the experiment, or several experiments.
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
    target = _output(path, output, overwrite)
    collected = Collected(set(derived) | {"phase/status", "dic/status"})
    topics = {full: name for name, full in names.items() if name not in ("load_frame/state", "camera/exposure")}

    def rows() -> Iterator[Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from collected.take(name, message)
        yield from collected.finish()

    _write(target, timeline, rows(), collected.settings, None)
    return target


def open_experiment(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open a recorded experiment as one labelled dataset; maps are read from the disk when they are used.

    Parameters
    ----------
    path
        A NetCDF file, or a recording: then its dataset beside it, which is made from the derived topics when there is
        none yet.

    Returns
    -------
    Dataset
        Maps over (step, row, column) in SI units, with force, position, time and error of each step.

    Raises
    ------
    MissingTopicError
        The recording has neither a dataset nor derived topics; `process_bag` measures it.
    DatasetError
        The file is no dataset of this library.
    RecordingError
        There is no such recording.
    """
    path = Path(path)
    file = path
    if path.suffix != ".nc":
        file = _output(path, None, overwrite=True)
        if not file.exists():
            try:
                dataset_from_derived(path)
            except MissingTopicError as error:
                raise MissingTopicError(f"{error}; 'fringedic process {path}' measures it") from error
    try:
        dataset = xr.open_dataset(file, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: cannot be read as NetCDF: {error}") from error
    if not {"step", "row", "column"} <= set(dataset.sizes):
        dataset.close()
        raise DatasetError(f"{file}: is no experiment; it lacks the dimensions step, row and column")
    return dataset


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


def _output(path: str | os.PathLike[str], output: str | os.PathLike[str] | None, overwrite: bool) -> Path:
    source = Path(path)
    beside = source.with_suffix(".nc") if source.is_file() else source.with_name(f"{source.name}.nc")
    target = beside if output is None else Path(output)
    if target.exists() and not overwrite:
        raise DatasetError(f"{target} exists already; choose another output or ask to overwrite it")
    return target
