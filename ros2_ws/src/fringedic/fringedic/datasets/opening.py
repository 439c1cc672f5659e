"""Opening of datasets without reading them: maps are read from the disk when they are used."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import JSON_ATTRIBUTES, sensor_of
from fringedic.datasets.checksums import open_checked
from fringedic.datasets.earlier_versions import translate
from fringedic.datasets.millimetres import with_millimetres
from fringedic.datasets.quantities import (
    ATTACHMENTS,
    MAP_DIMENSIONS,
    MISSING_PARTS,
    RECORDING,
    SOURCE_BYTES,
    STEP_NUMBERS,
    TIME_ZERO,
    layout_of_images,
)
from fringedic.datasets.stores import SUFFIXES, dataset_path
from fringedic.errors import DatasetError, ErrorCode, RecordingError
from fringedic.frames.sensor import JOINED, SENSOR, choice_of_sensors
from fringedic.recording.bag_files import BAG, parts_of_run, recorded_bytes, recording_of
from fringedic.recording.remote import file_system, is_remote, named_errors
from fringedic.signals import FORCE, POSITION, attachment_digests
from fringedic.wording.arguments import check_arguments
from fringedic.wording.arguments import path as file_path
from fringedic.wording.optional_packages import optional_import

_GROUP = "zarr.json"  # in the group of a recording in the store of a campaign
_OF_EVERY_EXPERIMENT = ("step", "error")  # variables
_LAYOUTS = (RECORDING, layout_of_images(scaled=True))
_WHOLE, _NUMBER, _TEXT, _TIME = ("iu", "whole numbers"), ("iuf", "numbers"), ("OSTU", "text"), ("M", "times")
# Dimensions of each variable, kinds of its type in NumPy and their name in messages
_VARIABLES: dict[str, tuple[tuple[str, ...], tuple[str, str]]] = {
    "row": (("row",), _NUMBER),
    "column": (("column",), _NUMBER),
    "time": (("step",), _TIME),
    **dict.fromkeys((FORCE.name, POSITION.name), (("step",), _NUMBER)),
    **dict.fromkeys(("step", *STEP_NUMBERS), (("step",), _WHOLE)),
    **{name: (("step",), _NUMBER) for layout in _LAYOUTS for name in layout.scalars},
    **{name: (("step",), _TEXT) for layout in _LAYOUTS for name in layout.texts},
    **{name: (MAP_DIMENSIONS, _NUMBER) for layout in _LAYOUTS for name in layout.maps},
}
RESULTS = "results"
"""Name of the dataset of a run, without suffix."""
_OF_A_RUN = tuple(f"{RESULTS}{suffix}" for suffix in SUFFIXES)
_OF_A_FOLDER = (*_OF_A_RUN, "displacement.nc")  # of a run, or of measured images


@check_arguments(DatasetError, path=file_path)
def open_experiment(path: str | os.PathLike[str], *, sensor: str | None = None) -> xr.Dataset:
    """Open a recorded experiment as one labelled dataset; it may be larger than memory.

    Opening reads only coordinates. Every access to a map reads it from the disk, and nothing is cached; select the step
    first (``dataset.w.sel(step=3).values``) to read one step. ``dataset[["u", "v"]].load()`` keeps maps in memory.

    Parameters
    ----------
    path
        A NetCDF file or Zarr folder, also one in the store of a campaign, the folder of a run or of measured images, or
        a recording. For a recording the
        dataset beside it is opened: the one with its name, or the ``results`` of the run that recorded it. If there is
        none, it is made from the derived topics. Also the address of a dataset, a run or a recording in an object store
        (``s3://...`` or another one that fsspec knows), whose maps are fetched when they are used.
    sensor
        Name of the sensor, if there are several, each with a dataset of its own; by default the joined surface of all,
        if there is one (``joined``).

    Returns
    -------
    Dataset
        Maps over (step, row, column) in SI units, float32, NaN where not measured, with force, position, time and error
        of each step. ``x_mm`` and ``y_mm`` are coordinates for pictures: the positions of columns and rows on the
        reference plane, with y upwards; the maps ``x``, ``y``, ``z`` are those of the surface. The attributes contain
        calibration, parameters, rig, metadata (``facts``), software and commit; see docs/results.md. Metadata of
        earlier versions have the present keys. `ExperimentAccessor` describes the methods ``dataset.fringedic``.

    Raises
    ------
    RecordingError
        There is no such recording, it has neither a dataset nor derived topics (`process_bag` measures it), or it
        contains several sensors and none is chosen.
    DatasetError
        There are datasets of several sensors and none is chosen, or the dataset is that of another one. Or the file is
        no dataset of this library, has no step or a step number twice, or a variable or an attribute is
        damaged or of another program. Also when something has changed since it was written: the checksums of a map are
        compared when it is read, all others at once.
    FringedicError
        The dataset is a Zarr folder and the package ``zarr`` is not installed.
    """
    if is_remote(path):
        return _of_sensor(_open_remote(str(path).rstrip("/"), sensor), path, sensor)
    path = Path(path) if Path(path).name else Path(path).absolute()
    named = path.suffix in SUFFIXES or (path / _GROUP).is_file()
    file = path if named else _dataset_in(path, sensor)
    if file is None:
        path = recording_of(path)
        file = find_dataset(path, sensor)
    if file is None:
        # not at the top: it loads all measuring rooms
        from fringedic.datasets.processing import dataset_from_derived

        try:
            file = dataset_from_derived(path, sensor=sensor)
        except RecordingError as error:
            if error.code is not ErrorCode.MISSING_TOPIC:
                raise
            raise RecordingError(
                f"{error}; 'fringedic process {path}' measures it", code=ErrorCode.MISSING_TOPIC
            ) from error
    return _of_sensor(_open(file), file, sensor)


def _of_sensor(dataset: xr.Dataset, place: object, sensor: str | None) -> xr.Dataset:
    """Return a dataset after a check that it is that of the chosen sensor."""
    found = sensor_of(dataset)
    if sensor not in (None, found):
        dataset.close()
        raise DatasetError(f"{place} is the dataset of the sensor '{found}'; give that of '{sensor}', or its recording")
    return dataset


def _dataset_in(folder: Path, sensor: str | None) -> Path | None:
    """Return the dataset in the folder of a run, None if there is none, or the path is no such folder.

    Raises
    ------
    DatasetError
        As of `find_dataset`.
    """
    recording = folder / BAG
    if recording.exists():
        return _current(recording, _of_run(recording) + _named(recording), sensor)
    return _chosen(folder, [folder / name for name in _OF_A_FOLDER], sensor)


def find_dataset(recording: Path, sensor: str | None = None) -> Path | None:
    """Return the dataset of a sensor beside a recording, None if there is none.

    Raises
    ------
    DatasetError
        The recording has become longer since its dataset was made, a dataset is damaged, or there are datasets of
        several sensors and none is chosen.
    """
    return _current(recording, _named(recording) + _of_run(recording), sensor)


def sensors_of_results(folder: Path) -> list[str]:
    """Return the names of the sensors whose results are in the folder of a run; `SENSOR` of one that was given none."""
    groups = _by_named_sensor(folder / name for name in _OF_A_FOLDER)
    return sorted(name or SENSOR for name, files in groups.items() if files)


def _named(recording: Path) -> list[Path]:
    """Return where the datasets with the name of a recording are."""
    beside = dataset_path(recording, overwrite=True)
    return [beside, beside.with_suffix(".zarr")]


def _of_run(recording: Path) -> list[Path]:
    """Return where the results of the run that made a recording are, or those of another one."""
    return [recording.with_name(name) for name in _OF_A_RUN]


def _current(recording: Path, files: Iterable[Path], sensor: str | None) -> Path | None:
    """Return the dataset with everything that was recorded, None if there is no dataset at all."""

    def fault(file: Path, attributes: Mapping[str, Any]) -> str | None:
        of_a_run = file.name.removesuffix(file.suffix).split(".")[0] == RESULTS
        return None if of_a_run and attributes.get("source") != recording.name else _missing_part(recording, attributes)

    return _chosen(recording, files, sensor, fault)


def _chosen(
    place: Path,
    files: Iterable[Path],
    sensor: str | None,
    fault: Callable[[Path, Mapping[str, Any]], str | None] = lambda _file, _attributes: "",
) -> Path | None:
    """Return the first dataset of a sensor out of files, and of those with the name of a sensor in theirs.

    Parameters
    ----------
    place
        Recording or folder, for messages.
    files
        Without the name of a sensor; they need not exist.
    sensor
        Name of the sensor; None for the only one.
    fault
        Returns why a dataset cannot be used, from its path and attributes; None for one that is to be passed over.

    Raises
    ------
    DatasetError
        No dataset can be used, or there are those of several sensors and none is chosen.
    """
    outdated, found = "", dict[str, Path]()
    for named, group in _by_named_sensor(files).items():
        for file in group:
            with _open(file) as dataset:
                name, reason = sensor_of(dataset), fault(file, dataset.attrs)
            if reason is None or sensor not in (None, name) or named not in ("", name):
                continue
            if not reason:
                found.setdefault(name, file)
                break
            outdated = outdated or f"{file}: {reason}"
    if outdated and not found:
        raise DatasetError(outdated)
    if sensor is None and JOINED in found:  # the surface of all sensors
        return found[JOINED]
    if len(found) > 1:
        raise DatasetError(choice_of_sensors(place, found))
    return next(iter(found.values()), None)


def _by_named_sensor(files: Iterable[Path]) -> dict[str, list[Path]]:
    """Return the files that exist, and those with the name of a sensor in theirs, by this name, empty for none."""
    groups: dict[str, list[Path]] = {"": []}
    for file in files:
        if file.exists():
            groups[""].append(file)
        for named in sorted(file.parent.glob(f"{escape(file.stem)}.*{file.suffix}")):
            groups.setdefault(named.stem.removeprefix(f"{file.stem}."), []).append(named)
    return groups


def _missing_part(recording: Path, attributes: Mapping[str, Any]) -> str:
    """Return why a dataset may lack steps of its recording; empty if it does not, or says so itself."""
    known = json.loads(attributes.get(MISSING_PARTS, "[]"))
    parts = [part.name for part in parts_of_run(recording) if part.name not in known]
    if parts:
        return (
            f"lacks what {', '.join(parts)}, later parts of the same run, contain: 'fringedic run --continue' goes on "
            f"with the run, 'fringedic recover {recording}' writes one recording of all parts, to be processed"
        )
    size = str(recorded_bytes(recording))
    if size not in ("0", attributes.get(SOURCE_BYTES, size)):
        return f"was made when {recording} had another size; 'fringedic process {recording} --overwrite' makes it again"
    if json.loads(attributes.get(ATTACHMENTS, "{}")) != attachment_digests(recording):
        return (
            f"was made before files were attached to {recording}, or removed; 'fringedic process {recording} "
            "--overwrite' makes it with the signals of those that are attached now"
        )
    return ""


def _open_remote(address: str, sensor: str | None) -> xr.Dataset:
    """Open a dataset in an object store, or that of a run or recording there."""
    beside = address.removesuffix(f"/{BAG}")
    candidates = [address] if address.endswith(SUFFIXES) else [f"{beside}/{name}" for name in _OF_A_FOLDER]
    candidates += [f"{address}{suffix}" for suffix in SUFFIXES if not address.endswith(SUFFIXES)]
    if sensor not in (None, SENSOR) and not address.endswith(SUFFIXES):
        candidates = [f"{stem}.{sensor}.{suffix}" for stem, _, suffix in (each.rpartition(".") for each in candidates)]
    with named_errors(address):
        for candidate in candidates:
            files, place = file_system(candidate)
            files.invalidate_cache()
            if files.exists(place):
                netcdf = candidate.endswith(".nc")
                return _open(candidate, files.open(place, "rb") if netcdf else candidate)
    raise RecordingError(f"{address}: has no dataset; 'fringedic process {address}' measures it")


def _open(file: Path | str, source: Any = None) -> xr.Dataset:
    """Open a file of this computer, or an object in an object store by what xarray reads there."""
    netcdf = str(file).endswith(".nc")
    if not netcdf:
        with optional_import("zarr"):
            import zarr  # noqa: F401 (xarray loads it)
    dataset = open_checked(file if source is None else source, str(file), netcdf=netcdf)
    fault = _fault(dataset)
    if fault:
        dataset.close()
        raise DatasetError(f"{file}: {fault}")
    translate(dataset)
    return with_millimetres(dataset)


def _fault(dataset: xr.Dataset) -> str:
    """Return why a dataset cannot be used, nothing if it can."""
    lacking = (set(MAP_DIMENSIONS) - set(dataset.sizes)) | (set(_OF_EVERY_EXPERIMENT) - set(dataset.variables))
    if lacking:
        return (
            f"is no experiment, because it has no {' and no '.join(sorted(lacking))}: give the dataset that "
            "'fringedic run' or 'fringedic process' wrote, or a recording"
        )
    if dataset.sizes["step"] == 0:
        return "contains no step; process its recording again"
    fault = _fault_of_variables(dataset)
    if fault:
        return f"{fault}; process its recording again"
    if np.unique(dataset["step"].values).size < dataset.sizes["step"]:
        return "contains a step number twice; process its recording again"
    for name, kind in JSON_ATTRIBUTES.items():
        if name in dataset.attrs and not _is_json(dataset.attrs[name], kind):
            return f"the attribute '{name}' is damaged or of another program; process its recording again"
    if TIME_ZERO in dataset.attrs and not _is_time(dataset.attrs[TIME_ZERO]):
        return f"the attribute '{TIME_ZERO}' is damaged or of another program; process its recording again"
    return ""


def _fault_of_variables(dataset: xr.Dataset) -> str:
    """Return which variable has other dimensions or another type than `DatasetWriter` gives it, nothing if none has."""
    for name, (dimensions, (kinds, words)) in _VARIABLES.items():
        if name not in dataset.variables:
            continue
        variable = dataset[name]
        if variable.dims != dimensions or variable.dtype.kind not in kinds:
            found = f"{variable.dtype} over ({', '.join(map(str, variable.dims))})"
            return f"'{name}' contains {found} instead of {words} over ({', '.join(dimensions)})"
        if not isinstance(variable.attrs.get("units", ""), str):
            return f"the attribute 'units' of '{name}' is no text"
    for name in ("row", "column"):
        if not np.isfinite(dataset[name].values).all():
            return f"'{name}' contains a position that is no finite number"
    return ""


def _is_time(text: Any) -> bool:
    try:
        return isinstance(text, str) and bool(np.isfinite(np.datetime64(text)))
    except ValueError:
        return False


def _is_json(text: Any, kind: type) -> bool:
    try:
        return isinstance(json.loads(text), kind)
    except (TypeError, ValueError):
        return False
