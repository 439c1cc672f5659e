"""Encodes maps as organised float32 point clouds: one point per pixel, NaN where not measured.

The decoder is `fringedic.frames.messages.cloud_arrays`.
"""

from __future__ import annotations

import array
from collections.abc import Mapping

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from fringedic.errors import ImageError
from fringedic.frames.messages import cloud_arrays as cloud_arrays
from fringedic_ros.stamps import to_msg

_ROWS = 16  # of a cloud that are filled at a time


def cloud_message(fields: Mapping[str, np.ndarray], *, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return the organised cloud of named float32 images, interleaved in the given order.

    Parameters
    ----------
    fields
        Name -> (row, column) array; all of one shape. SI units.
    stamp_ns
        Stamp [ns].
    frame_id
        Coordinate frame of x, y, z.

    Raises
    ------
    ImageError
        No field, or fields of different shapes.
    """
    shapes = {np.shape(values) for values in fields.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ImageError(f"a cloud needs at least one field, all (row, column) of one shape; got {shapes or 'none'}")
    rows, columns = shapes.pop()
    # the only type that rclpy accepts without a check of every byte
    data = array.array("B", b"\0") * (4 * rows * columns * len(fields))
    points = np.frombuffer(data, dtype="<f4").reshape(rows, columns, len(fields))
    # some rows at a time: interleaving whole images would fetch each line of memory once per field
    for first in range(0, rows, _ROWS):
        for channel, values in enumerate(fields.values()):
            points[first : first + _ROWS, :, channel] = values[first : first + _ROWS]
    message = PointCloud2()
    message.header.stamp = to_msg(stamp_ns)
    message.header.frame_id = frame_id
    message.height, message.width = int(rows), int(columns)
    message.fields = [
        PointField(name=name, offset=4 * channel, datatype=PointField.FLOAT32, count=1)
        for channel, name in enumerate(fields)
    ]
    message.is_bigendian = False
    message.point_step = 4 * len(fields)
    message.row_step = message.point_step * message.width
    message.is_dense = False
    message.data = data
    return message
