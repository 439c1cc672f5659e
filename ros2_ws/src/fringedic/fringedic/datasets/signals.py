"""Signals in a dataset: which variables they are, their series, and their values at the steps.

A signal ``force`` has the variables ``force``, ``force_sigma`` and ``force_drift`` over (step), and its samples
``force_series`` and ``force_series_sigma`` over a time axis of their own, ``force_time``.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.signals import Channel, Signal


def sigma_name(name: str) -> str:
    """Return the variable with the standard uncertainty of a signal or its series."""
    return f"{name}_sigma"


def drift_name(name: str) -> str:
    """Return the variable with the change of a signal during the exposures of each step."""
    return f"{name}_drift"


def series_name(name: str) -> str:
    """Return the variable with the samples of a signal."""
    return f"{name}_series"


def time_name(name: str) -> str:
    """Return the time axis of the samples of a signal."""
    return f"{name}_time"


def signal_names(dataset: xr.Dataset) -> list[str]:
    """Return the names of the signals of a dataset, or of a selection of its steps.

    Examples
    --------
    >>> force = xr.DataArray([250.0], dims="step", attrs={"units": "N", "quantity": "force"})
    >>> signal_names(xr.Dataset({"force": force, "valid_fraction": ("step", [0.9])}))
    ['force']
    """
    return [str(name) for name, variable in dataset.data_vars.items() if _is_signal(variable)]


def _is_signal(variable: xr.DataArray) -> bool:
    return "quantity" in variable.attrs and variable.dims in ((), ("step",))


def knows_sigma(dataset: xr.Dataset, name: str) -> bool:
    """Return whether the standard uncertainty of a signal is known at any step."""
    return sigma_name(name) in dataset and bool(np.isfinite(dataset[sigma_name(name)].values).any())


def has_drift(dataset: xr.Dataset, name: str) -> bool:
    """Return whether the drift of a signal during the exposures is known at any step."""
    return drift_name(name) in dataset and bool(np.isfinite(dataset[drift_name(name)].values).any())


def signal_series(dataset: xr.Dataset, name: str) -> Signal:
    """Return the samples of a signal.

    Raises
    ------
    DatasetError
        The dataset has no samples of this signal: none were recorded, or an earlier version wrote it.
    """
    if series_name(name) not in dataset:
        present = ", ".join(each for each in signal_names(dataset) if series_name(each) in dataset) or "none"
        raise DatasetError(
            f"the dataset has no samples of a signal '{name}', only those of: {present}; process its recording again "
            "if an earlier version wrote it"
        )
    variable = dataset[series_name(name)]
    attributes = {key: str(variable.attrs.get(key, "")) for key in ("quantity", "positive", "source")}
    stamps = dataset[time_name(name)].values.astype("datetime64[ns]").astype(np.int64)
    sigmas = dataset[sigma_name(series_name(name))].values
    return Signal(Channel(name, unit=variable.attrs["units"], **attributes), stamps, variable.values, sigmas)
