"""Opening of datasets without reading them: maps come from the disk when they are used."""

from __future__ import annotations

import os
from pathlib import Path

import xarray as xr

from fringedic.errors import DatasetError, MissingTopicError
from fringedic.results.netcdf import open_netcdf
from fringedic.results.quantities import MAP_DIMENSIONS
from fringedic.results.stores import SUFFIXES, dataset_path

_OF_A_RUN = ("results.nc", "results.zarr")


def open_experiment(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open a recorded experiment as one labelled dataset; it may be larger than memory.

    Nothing but coordinates is read at first. Each access to a map reads it from the disk anew and keeps nothing, one
    step at a time when one is selected before: ``dataset.w.sel(step=3).values``; ``dataset[["u", "v"]].load()`` keeps
    what is used often.

    Parameters
    ----------
    path
        A NetCDF file or Zarr folder, or a recording: then the dataset beside it (with its name, or the ``results`` of
        the run that recorded it), which is made from the derived topics when there is none yet.

    Returns
    -------
    Dataset
        Maps over (step, row, column) in SI units, with force, position, time and error of each step. Its attributes
        tell calibration, parameters, rig, facts, software and commit; see docs/results.md.

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
    file = path if path.suffix in SUFFIXES else find_dataset(path)
    if file is None:
        # not at the top: it loads everything that measures
        from fringedic.results.datasets import dataset_from_derived

        try:
            file = dataset_from_derived(path)
        except MissingTopicError as error:
            raise MissingTopicError(f"{error}; 'fringedic process {path}' measures it") from error
    return _open(file)


def find_dataset(recording: Path) -> Path | None:
    """Return the dataset that lies beside a recording, None when there is none."""
    beside = dataset_path(recording, overwrite=True)
    for candidate in (beside, beside.with_suffix(".zarr")):
        if candidate.exists():
            return candidate
    for name in _OF_A_RUN:
        candidate = recording.with_name(name)
        if candidate.exists():
            with _open(candidate) as dataset:
                if dataset.attrs.get("source") == recording.name:
                    return candidate
    return None


def _open(file: Path) -> xr.Dataset:
    try:
        dataset = open_netcdf(file) if file.suffix == ".nc" else xr.open_dataset(file, engine="zarr", cache=False)
    except (OSError, ValueError, KeyError) as error:
        raise DatasetError(
            f"{file}: cannot be read as {'NetCDF' if file.suffix == '.nc' else 'Zarr'}: {error}"
        ) from error
    if not set(MAP_DIMENSIONS) <= set(dataset.sizes):
        dataset.close()
        raise DatasetError(f"{file}: is no experiment; it lacks the dimensions step, row and column")
    return dataset
