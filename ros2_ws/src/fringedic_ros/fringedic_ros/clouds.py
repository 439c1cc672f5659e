"""Organised float32 point clouds: one point per pixel, NaN where nothing was measured."""

from __future__ import annotations

import array
from collections.abc import Mapping

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from fringedic.errors import CloudMessageError
from fringedic_ros.stamps import to_msg

_ROWS = 16  # of a cloud that are filled at once


def cloud_message(fields: Mapping[str, np.ndarray], *, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Organised cloud of named float32 images, interleaved in the given order.

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
    CloudMessageError
        No field, or fields of different shapes.
    """
    shapes = {np.shape(values) for values in fields.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise CloudMessageError(
            f"a cloud needs at least one field, all (row, column) of one shape; got {shapes or 'none'}"
        )
    rows, columns = shapes.pop()
    # the only type that rclpy takes over without looking at every byte
    data = array.array("B", b"\0") * (4 * rows * columns * len(fields))
    points = np.frombuffer(data, dtype="<f4").reshape(rows, columns, len(fields))
    # rows by rows: interleaving whole images would fetch each line of memory once per field
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


def cloud_arrays(message: PointCloud2) -> dict[str, np.ndarray]:
    """Read-only (row, column) views of a cloud's float32 fields, by name.

    Raises
    ------
    CloudMessageError
        A field that is not one float32, or an amount of data that contradicts the cloud's size.
    """
    strange = [field.name for field in message.fields if field.datatype != PointField.FLOAT32 or field.count != 1]
    if strange:
        raise CloudMessageError(f"cloud fields {', '.join(strange)} are not single float32 values")
    needed = message.row_step * message.height
    if message.row_step < message.point_step * message.width or len(message.data) != needed:
        raise CloudMessageError(
            f"cloud of {message.width} x {message.height} points of {message.point_step} bytes has rows of "
            f"{message.row_step} bytes and {len(message.data)} bytes in all"
        )
    dtype = np.dtype(">f4" if message.is_bigendian else "<f4")
    buffer = memoryview(message.data)
    arrays = {}
    for field in message.fields:
        values = np.ndarray(
            (message.height, message.width),
            dtype=dtype,
            buffer=buffer,
            offset=field.offset,
            strides=(message.row_step, message.point_step),
        )
        values.flags.writeable = False
        arrays[field.name] = values
    return arrays
