"""Maps as numbers: CSV, MATLAB, TIFF, NetCDF and Zarr."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import tifffile
import xarray as xr

from fringedic.datasets.attributes import map_names, origin_of, origin_text, seconds, step_numbers
from fringedic.datasets.quantities import (
    MAP_DIMENSIONS,
    NANOSECONDS,
    STEP_NUMBERS,
    PeopleUnit,
    people_unit,
    strain_words,
)
from fringedic.datasets.signals import drift_name, has_drift, knows_sigma, sigma_name, signal_names
from fringedic.datasets.stores import save_netcdf, save_zarr
from fringedic.errors import ExportError
from fringedic.wording.path_names import path_name

MATLAB_LIMIT = 2**31 - 1  # bytes of one variable in a MATLAB 5 file
_WITH_MARK = "utf-8-sig"  # spreadsheets take µ for another character without a byte-order mark
_LIGHT = ("modulation", "texture")  # known of every pixel, measured or not
_SCALARS = ("valid_fraction", "rms_displacement")
_SCALAR_UNITS = {"valid_fraction": PeopleUnit("1", "1", 1.0)}  # the others have that of `people_unit`


def _scalars(dataset: xr.Dataset) -> list[str]:
    """Return the values of each step: the signals, their uncertainty and drift where known, then the results."""
    signals = signal_names(dataset)
    known = [sigma_name(name) for name in signals if knows_sigma(dataset, name)]
    known += [drift_name(name) for name in signals if has_drift(dataset, name)]
    return [*signals, *known, *(name for name in _SCALARS if name in dataset)]


def write_csv(dataset: xr.Dataset, folder: Path) -> list[str]:
    """Write a table of points per step, one of the steps, and the metadata as JSON.

    Units, and of the strain of images its measure, are in the headings.
    """
    folder.mkdir(parents=True)
    skipped = []
    names = map_names(dataset)
    units = {name: people_unit(dataset[name]) for name in names}
    titles = [f"{name} [{units[name].text}] {strain_words(dataset, name)}".rstrip() for name in names]
    heading = ",".join(["row [px]", "column [px]", *titles])
    rows, columns = np.meshgrid(dataset["row"].values, dataset["column"].values, indexing="ij")
    for number in dataset["step"].values:
        step = dataset.sel(step=number)
        maps = [step[name].values.astype(np.float64) / units[name].factor for name in names]
        measured = np.isfinite([values for name, values in zip(names, maps, strict=True) if name not in _LIGHT]).any(
            axis=0
        )
        if not measured.any():
            skipped.append(f"step {int(number)} has no measured point")
            continue
        table = np.stack([rows[measured], columns[measured], *(values[measured] for values in maps)], axis=-1)
        file = folder / f"step_{int(number):03d}.csv"
        np.savetxt(file, table, fmt="%.7g", delimiter=",", header=heading, comments="", encoding=_WITH_MARK)
    with open(folder / "steps.csv", "w", newline="", encoding=_WITH_MARK) as stream:
        scalars = _scalars(dataset)
        titles = ["step"]
        series: list[list[Any]] = [dataset["step"].values.tolist()]
        if "time" in dataset:
            titles.append("time [s]")
            series.append(seconds(dataset).tolist())
        if "image" in dataset:
            titles.append("image")
            series.append(dataset["image"].values.tolist())
        for name in scalars:
            unit = _SCALAR_UNITS.get(name) or people_unit(dataset[name])
            titles.append(f"{name} [{unit.text}]")
            series.append([float(f"{value / unit.factor:.9g}") for value in dataset[name].values])
        for name in (*STEP_NUMBERS, "error"):
            if name in dataset:
                titles.append(name)
                series.append(dataset[name].values.tolist())
        csv.writer(stream).writerows([titles, *(list(line) for line in zip(*series, strict=True))])
    write_origin(dataset, folder)
    return skipped


def write_origin(dataset: xr.Dataset, folder: Path) -> None:
    """Write ``metadata.json`` for files that cannot contain it."""
    (folder / "metadata.json").write_text(json.dumps(origin_of(dataset), indent=1), encoding="utf-8")


def write_matlab(dataset: xr.Dataset, file: Path) -> list[str]:
    """Write one ``.mat`` file in SI units: maps over (row, column, step), a structure of units, and the metadata.

    One map over all steps is in memory at a time.

    Raises
    ------
    ExportError
        A map over all steps is larger than the format allows.
    """
    names = map_names(dataset)
    for name in names:
        size = dataset[name].size * dataset[name].dtype.itemsize
        if size > MATLAB_LIMIT:
            raise ExportError(
                f"a .mat file cannot hold '{name}' of {size / 1e9:.1f} GB, its limit is {MATLAB_LIMIT / 1e9:.1f} GB "
                "per variable; choose fewer steps, or NetCDF, which MATLAB reads too (ncread)"
            )
    series = [*_scalars(dataset), *(name for name in STEP_NUMBERS if name in dataset), *MAP_DIMENSIONS]
    content: dict[str, Any] = {name: dataset[name].values.astype(float) for name in series}
    units = {name: dataset[name].attrs.get("units", "1") for name in (*names, *series)}
    if "time" in dataset:
        content["time"], units["time"] = seconds(dataset), "s"
    if "image" in dataset:
        content["image"] = dataset["image"].values.astype(object)  # a cell array
    content["units"] = units
    content["metadata"] = origin_text(dataset)
    with open(file, "wb") as stream:
        # savemat appends to an open stream, which its type stub does not contain
        append = partial(scipy.io.savemat, stream, do_compression=True, oned_as="column")  # type: ignore[arg-type]
        for name in names:
            # transposed after reading: xarray needs eight times the memory of the map to read it transposed
            append({name: np.moveaxis(dataset[name].transpose("step", "row", "column").values, 0, -1)})
        append(content)
    return []


def write_tiff(dataset: xr.Dataset, folder: Path) -> list[str]:
    """Write each map of each step as a plain 32-bit TIFF in the unit of its name; NaN is not measured."""
    folder.mkdir(parents=True)
    skipped = []
    origin = origin_of(dataset)
    for number in dataset["step"].values:
        step = dataset.sel(step=number)
        written = False
        for name in map_names(dataset):
            values = step[name].values
            if not np.isfinite(values).any():
                continue
            unit = people_unit(step[name])
            description = {
                "map": name,
                "unit": unit.text,
                "meaning": step[name].attrs.get("long_name", ""),
                "step": int(number),
                **({"image": str(step["image"].values)} if "image" in step else {}),
                **step_numbers(step),
                "first_row_px": int(dataset["row"][0]),
                "first_column_px": int(dataset["column"][0]),
                "spacing_px": int(dataset["column"][1] - dataset["column"][0]) if dataset.sizes["column"] > 1 else 1,
                **origin,
            }
            tifffile.imwrite(
                folder / f"step_{int(number):03d}_{path_name(name)}_{unit.identifier}.tif",
                (values / unit.factor).astype(np.float32),
                description=json.dumps(description),
                metadata=None,
            )
            written = True
        if not written:
            skipped.append(f"step {int(number)} has no measured point")
    return skipped


def write_netcdf(dataset: xr.Dataset, file: Path) -> list[str]:
    """Write a dataset as it is, as NetCDF."""
    sizes = (1, dataset.sizes["row"], dataset.sizes["column"])
    save_netcdf(dataset.drop_encoding(), file, _encoding(dataset, "chunksizes", sizes))
    return []


def write_zarr(dataset: xr.Dataset, folder: Path) -> list[str]:
    """Write a dataset as it is, as Zarr."""
    sizes = (1, dataset.sizes["row"], dataset.sizes["column"])
    save_zarr(dataset.drop_encoding(), folder, _encoding(dataset, "chunks", sizes))
    return []


def _encoding(dataset: xr.Dataset, chunks: str, sizes: tuple[int, int, int]) -> dict[str, dict[str, Any]]:
    """One map per chunk, times to the nanosecond."""
    encoding: dict[str, dict[str, Any]] = {name: {chunks: sizes} for name in map_names(dataset)}
    if "time" in dataset:
        encoding["time"] = {"units": NANOSECONDS, "dtype": "int64"}
    return encoding
