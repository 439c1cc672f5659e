"""Positions of columns and rows in millimetres, for pictures and tables."""

from __future__ import annotations

import json
from collections.abc import Mapping

import xarray as xr


def origin_in_image(dataset: xr.Dataset) -> tuple[float, float]:
    """Return column and row of the origin of measured images: their middle, or the first pixel if the size is unknown.

    Examples
    --------
    >>> origin_in_image(xr.Dataset(attrs={"image_width": 320, "image_height": 241}))
    (159.5, 120.0)
    """
    width, height = (float(dataset.attrs.get(name, 1)) for name in ("image_width", "image_height"))
    return 0.5 * (width - 1), 0.5 * (height - 1)


def with_millimetres(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the coordinates ``x_mm`` (right) and ``y_mm`` (up) of its columns and rows.

    They are positions on the reference plane: the model of the rig projects pixels on z = 0. Of images alone the origin
    is the middle of the image. Without a scale the dataset is returned as it is.

    Parameters
    ----------
    dataset
        With the coordinates ``row`` and ``column`` [px]; the scale is that of the attribute ``calibration``, or
        ``pixel_size`` [m].
    """
    attributes = dataset.attrs
    if "calibration" in attributes:
        rig: Mapping[str, float] = json.loads(attributes["calibration"])
    elif {"pixel_size", "image_width", "image_height"} <= attributes.keys():
        rig = {
            "pixel_size": float(attributes["pixel_size"]),
            "pixel_aspect": 1.0,
            **dict(zip(("principal_column", "principal_row"), origin_in_image(dataset), strict=True)),
        }
    else:
        return dataset
    scale = 1e3 * rig["pixel_size"]
    x = scale / rig["pixel_aspect"] * (dataset["column"].values - rig["principal_column"])
    y = -scale * (dataset["row"].values - rig["principal_row"])
    return dataset.assign_coords(
        x_mm=("column", x, {"units": "mm", "long_name": "x (right)"}),
        y_mm=("row", y, {"units": "mm", "long_name": "y (up)"}),
    )
