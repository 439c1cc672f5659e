"""Rates of displacement and strain between neighbouring steps of a test without holds."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.wording.arguments import check_arguments
from fringedic.wording.arguments import dataset as dataset_of

QUANTITIES = ("u", "v", "w", "e_11", "e_22", "e_12")


@check_arguments(DatasetError, experiment=dataset_of(over=("step",)))
def rates(experiment: xr.Dataset) -> xr.Dataset:
    """Return the rates of displacement and strain between neighbouring steps, with their standard deviations.

    The noise of the reference is the same in both steps and cancels. That of its height is known (``noise_z``) and is
    subtracted from the variance of w: a reference at rest has fewer frames of the finest pitch than a step in motion.
    Of the other quantities it is taken as half of the variance, which is so where the reference is as noisy as the
    steps.

    Parameters
    ----------
    experiment
        Dataset of a recording; steps that failed have no rate on either side.

    Returns
    -------
    Dataset
        ``u_rate``, ``v_rate``, ``w_rate`` [m/s] and ``e_11_rate``, ``e_22_rate``, ``e_12_rate`` [1/s] with
        ``sigma_u_rate`` and so on, over (step, row, column): those of ``step`` n are from the step before it to it, and
        ``time`` is half way between their times. NaN where one of the two is not measured, or they have different
        references.

    Raises
    ------
    DatasetError
        The dataset has fewer than two steps, no times or no displacement.

    Examples
    --------
    >>> maps = ("step", "row", "column")
    >>> u = xr.DataArray([[[1e-6]], [[3e-6]]], dims=maps, attrs={"units": "m"})
    >>> times = np.array([0, 2 * 10**9], "datetime64[ns]")
    >>> experiment = xr.Dataset({"u": u, "sigma_u": (maps, [[[1e-7]], [[1e-7]]]), "reference_step": ("step", [0, 0])})
    >>> found = rates(experiment.assign_coords(step=[1, 2], time=("step", times)))
    >>> round(float(found.u_rate[0, 0, 0]), 12), float(found.sigma_u_rate[0, 0, 0])
    (1e-06, 5e-08)
    """
    present = [name for name in QUANTITIES if name in experiment and f"sigma_{name}" in experiment]
    known = {"time", "reference_step"} <= {*experiment.variables}
    if not present or not known or experiment.sizes["step"] < 2 or experiment["time"].dtype.kind not in "Mi":
        raise DatasetError("rates need the displacement of two steps or more, their times and their references")
    times = experiment["time"].values.astype("datetime64[ns]").astype(np.int64)
    seconds = 1e-9 * np.diff(times)
    reference = experiment["reference_step"].values
    valid = (seconds > 0) & (reference[1:] == reference[:-1])
    interval = xr.DataArray(np.where(valid, seconds, np.nan), dims="step")
    later, earlier = (
        experiment[present].isel(step=part).drop_vars("step") for part in (slice(1, None), slice(None, -1))
    )
    found = {}
    for name in present:
        unit = experiment[name].attrs.get("units", "")
        rate = (later[name] - earlier[name]) / interval
        own = _own_variance(experiment, name)
        variance = sum(own.isel(step=part).drop_vars("step") for part in (slice(1, None), slice(None, -1)))
        rate.attrs = {"units": "1/s" if unit in ("", "1") else f"{unit}/s", "long_name": f"rate of {name}"}
        found[f"{name}_rate"] = rate
        found[f"sigma_{name}_rate"] = (variance**0.5 / interval).assign_attrs(rate.attrs)
    middle = times[:-1] + np.diff(times) // 2
    return xr.Dataset(found).assign_coords(
        step=experiment["step"].values[1:], time=("step", middle.astype("datetime64[ns]"))
    )


def _own_variance(experiment: xr.Dataset, name: str) -> xr.DataArray:
    """Return the variance of a quantity in each step without that of the reference."""
    variance: xr.DataArray = experiment[f"sigma_{name}"] ** 2
    if name == "w" and "noise_z" in experiment:
        return (variance - experiment["noise_z"] ** 2).clip(min=0)
    return variance / 2
