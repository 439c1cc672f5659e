"""Decoded messages as arrays and models, whatever library decoded them."""

from __future__ import annotations

from typing import Any

import numpy as np

from fringedic.errors import FrameMismatchError

_PIXELS = {"mono8": ("u1", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "32FC2": ("f4", 2)}


def image_array(message: Any) -> np.ndarray:
    """Return the pixels of a decoded ``sensor_msgs/Image``, shape (row, column) or (row, column, channel).

    Raises
    ------
    FrameMismatchError
        The encoding is not known, or the data have another size than the header says.
    """
    if message.encoding not in _PIXELS:
        raise FrameMismatchError(f"an image has the encoding '{message.encoding}'; known are {', '.join(_PIXELS)}")
    kind, channels = _PIXELS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize
    if message.step < row_bytes or message.data.size != message.step * message.height:
        raise FrameMismatchError(
            f"an image of {message.width}x{message.height} px ({message.encoding}) holds {message.data.size} bytes in "
            f"rows of {message.step}"
        )
    rows = message.data.reshape(message.height, message.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return pixels if channels == 1 else pixels.reshape(message.height, message.width, channels)


def cloud_arrays(message: Any) -> dict[str, np.ndarray]:
    """Return the float32 fields of a decoded organised ``sensor_msgs/PointCloud2`` by name, shape (row, column)."""
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [each.name for each in message.fields],
            "formats": [f"{order}f4"] * len(message.fields),
            "offsets": [each.offset for each in message.fields],
            "itemsize": message.point_step,
        }
    )
    points = message.data.view(layout).reshape(message.height, message.width)
    return {name: points[name] for name in layout.names or ()}
