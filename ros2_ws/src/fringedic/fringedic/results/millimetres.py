"""Positions of columns and rows in millimetres, for pictures and tables."""

from __future__ import annotations

import json
from collections.abc import Mapping

import xarray as xr


def with_millimetres(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the coordinates ``x_mm`` (right) and ``y_mm`` (up) of its columns and rows.

    They are positions on the reference plane: the model of the rig projects pixels on z = 0. Without a calibration the
    dataset is returned as it is.

    Parameters
    ----------
    dataset
        With the coordinates ``row`` and ``column`` [px]; the attribute ``calibration`` contains the scale.
    """
    if "calibration" not in dataset.attrs:
        return dataset
    rig: Mapping[str, float] = json.loads(dataset.attrs["calibration"])
    scale = 1e3 * rig["pixel_size"]
    x = scale / rig["pixel_aspect"] * (dataset["column"].values - rig["principal_column"])
    y = -scale * (dataset["row"].values - rig["principal_row"])
    return dataset.assign_coords(
        x_mm=("column", x, {"units": "mm", "long_name": "x (right)"}),
        y_mm=("row", y, {"units": "mm", "long_name": "y (up)"}),
    )
