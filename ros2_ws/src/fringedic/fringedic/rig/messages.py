"""The rig model as the fields of the message ``fringedic_msgs/RigCalibration``."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from fringedic.camera.distortion import DistortionMap
from fringedic.errors import CalibrationError
from fringedic.frames.sensor import SENSOR
from fringedic.rig.geometry import ADDED, RigGeometry


def fields_of_rig(geometry: RigGeometry) -> dict[str, Any]:
    """Return the fields of the message as plain numbers and lists, without its header.

    The fields of the distortion are omitted when the camera has none.
    """
    content: dict[str, Any] = {}
    for each in fields(RigGeometry):
        if each.name != "camera_distortion":
            value = getattr(geometry, each.name)
            content[each.name] = list(value) if isinstance(value, tuple) else value
    distortion = geometry.camera_distortion
    if distortion is not None:
        content["distortion_order"] = distortion.order
        content["distortion_columns"] = distortion.columns.ravel().tolist()
        content["distortion_rows"] = distortion.rows.ravel().tolist()
    return content


def rig_of_fields(message: Any) -> dict[str, Any]:
    """Return the fields of the `RigGeometry` in a message.

    Parameters
    ----------
    message
        Any object with the attributes of ``fringedic_msgs/RigCalibration``, also of older recordings.

    Raises
    ------
    CalibrationError
        The number of the distortion's coefficients does not fit its order.
    """
    values: dict[str, Any] = {}
    for each in fields(RigGeometry):
        if each.name not in ("sensor", "camera_distortion") and not (
            each.name in ADDED and not hasattr(message, each.name)
        ):
            value = getattr(message, each.name)
            has_many = hasattr(value, "__len__") and not isinstance(value, str)
            values[each.name] = tuple(np.asarray(value).tolist()) if has_many else value
    values["sensor"] = getattr(message, "sensor", "") or SENSOR
    # messages that are older than the measurement of the distortion lack its fields
    columns, rows = (np.asarray(getattr(message, f"distortion_{name}", ()), float) for name in ("columns", "rows"))
    if columns.size or rows.size:
        count = int(message.distortion_order) + 1
        if not columns.size == rows.size == count**2:
            raise CalibrationError(
                f"distortion of order {count - 1} with {columns.size} and {rows.size} coefficients: "
                f"{count**2} are needed"
            )
        width, height = int(message.camera_width), int(message.camera_height)
        values["camera_distortion"] = DistortionMap(
            width, height, columns.reshape(count, count), rows.reshape(count, count)
        )
    return values
