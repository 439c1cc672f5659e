"""Comparison of datasets with the ground truth of a virtual rig."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.wording.arguments import check_arguments, path
from fringedic.wording.arguments import dataset as dataset_of
from fringedic.wording.causes import cause_of

TRUTH = "truth.nc"  # file of the ground truth beside the recording of a virtual rig
MICRO = 1e-6
_AT_REST = 1e-9  # [m] largest displacement of the step from which a truth counts


@contextmanager
def _damage_named(file: object) -> Iterator[None]:
    """Raise DatasetError for what a file raises that is truncated or of another kind."""
    try:
        yield
    except DatasetError:
        raise
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        cause = cause_of(error)
        raise DatasetError(f"{file}: is no ground truth or is damaged ({cause}); repeat the run to write it") from error


def open_truth(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open the ground truth of a virtual rig: a NetCDF file, or a folder with ``truth.nc``.

    Raises
    ------
    DatasetError
        There is no such truth, or it is damaged.
    """
    file = Path(path) / TRUTH if Path(path).is_dir() else Path(path)
    with _damage_named(file):
        return xr.open_dataset(file, engine="h5netcdf")


def truth_errors(dataset: xr.Dataset, truth: xr.Dataset, step: int) -> xr.Dataset:
    """Return measured minus true values of one step, NaN where not measured or not visible in both images.

    Parameters
    ----------
    dataset
        From `open_experiment`.
    truth
        From `open_truth`; its step n belongs to step n of the dataset.
    step
        Number of the step.

    Returns
    -------
    Dataset
        ``error_u``, ``error_v``, ``error_w`` of the material points of the reference image and ``error_z``, of the
        height of this step's surface at each of its own pixels [m]; ``visible``, True where the material point is in
        both images, False everywhere when the truth counts displacements from another reference.

    Raises
    ------
    DatasetError
        The truth lacks the step or the pixels, or is damaged.
    """
    with _damage_named(truth.encoding.get("source", "the truth")):
        if not 0 <= step < truth.sizes["step"]:
            raise DatasetError(f"the truth has {truth.sizes['step']} steps, step {step} is not among them")
        try:
            exact = truth.isel(step=step).sel(row=dataset.row.values, column=dataset.column.values)
        except KeyError as error:
            raise DatasetError(f"the truth lacks pixels of the dataset: {error}") from error
        measured = dataset.sel(step=step)
        visible = exact["valid"].astype(bool).values & np.isfinite(exact["u"].values)
        if "reference_step" in measured and not _counts_from(truth, int(measured["reference_step"])):
            visible[:] = False
        errors = {name: np.where(visible, measured[name].values - exact[name].values, np.nan) for name in "uvw"}
        errors["z"] = measured["shape_z"].values - exact["z_deformed"].values
        coordinates = {"row": dataset.row, "column": dataset.column}
        maps = {
            f"error_{name}": (("row", "column"), values, {"units": "m", "long_name": f"error of {name}"})
            for name, values in errors.items()
        }
        return xr.Dataset(maps | {"visible": (("row", "column"), visible, {"units": "1"})}, coordinates)


def _counts_from(truth: xr.Dataset, step: int) -> bool:
    """Return whether the displacements of a truth are those against a step, so that this one has none."""
    if not 0 <= step < truth.sizes["step"]:
        return True  # the step was not measured against another one
    there = truth[list("uvw")].isel(step=step)
    return all(float(abs(there[name]).max()) < _AT_REST for name in "uvw")


@check_arguments(DatasetError, dataset=dataset_of(), truth_path=path)
def compare_with_truth(
    dataset: xr.Dataset,
    truth_path: str | os.PathLike[str],
    *,
    reconstruct: Callable[[xr.DataArray], xr.Dataset] | None = None,
) -> xr.Dataset:
    """Compare each step with the ground truth of the virtual rig.

    The comparison covers the displacement (u, v, w) of the material point at each reference pixel, and the height of
    the deformed surface at each of its pixels, where both the measurement and the truth have a value. The truth counts
    displacements from one step: those against another reference have no error.

    Parameters
    ----------
    dataset
        From `open_experiment`.
    truth_path
        See `open_truth`.
    reconstruct
        Returns the surface of a phase with the exact calibration of the rig, for the errors of the heights alone.

    Returns
    -------
    Dataset
        Over ``step``: ``error_u``, ``error_v``, ``error_w``, ``error_z`` RMS [µm], and ``measured_fraction``, the share
        of the points visible in both images that was measured [1]; with `reconstruct` also ``error_z_exact`` RMS [µm].

    Raises
    ------
    DatasetError
        The truth lacks steps or pixels of the dataset, or is damaged.
    """
    names = (*(f"error_{each}" for each in "uvwz"), *(["error_z_exact"] if reconstruct else []), "measured_fraction")
    table: dict[str, list[float]] = {name: [] for name in names}
    with open_truth(truth_path) as truth:
        for step in dataset.step.values:
            errors = truth_errors(dataset, truth, int(step))
            for name in "uvwz":
                table[f"error_{name}"].append(_rms(errors[f"error_{name}"].values) / MICRO)
            if reconstruct is not None:
                height = reconstruct(dataset.phase.sel(step=step)).z.values
                true = truth.z_deformed.isel(step=int(step)).sel(row=dataset.row.values, column=dataset.column.values)
                table["error_z_exact"].append(_rms(height - true.values) / MICRO)
            visible = errors["visible"].values
            measured = np.isfinite(errors["error_w"].values) & visible
            table["measured_fraction"].append(measured.sum() / visible.sum() if visible.any() else np.nan)
    units = {name: "1" if name == "measured_fraction" else "µm" for name in table}
    return xr.Dataset(
        {name: ("step", values, {"units": units[name]}) for name, values in table.items()},
        coords={"step": dataset.step},
    )


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)].astype(np.float64)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
