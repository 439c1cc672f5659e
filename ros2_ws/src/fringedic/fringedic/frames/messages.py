"""Decodes image and point cloud messages into arrays, from any library that has decoded their fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from fringedic.errors import ErrorCode, ImageError

# (type of a channel, channels per pixel) of each encoding of sensor_msgs/Image
ENCODINGS: dict[str, tuple[np.dtype[Any], int]] = {
    "mono8": (np.dtype(np.uint8), 1),
    "mono16": (np.dtype(np.uint16), 1),
    "32FC1": (np.dtype(np.float32), 1),
    "32FC2": (np.dtype(np.float32), 2),
    "rgb8": (np.dtype(np.uint8), 3),
    "bgr8": (np.dtype(np.uint8), 3),
}
FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32


class ImageMessage(Protocol):
    """Fields of ``sensor_msgs/Image``; the data are bytes in any object with the buffer protocol."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Any


class FieldMessage(Protocol):
    """Fields of ``sensor_msgs/PointField``."""

    name: str
    offset: int
    datatype: int
    count: int


class CloudMessage(Protocol):
    """Fields of ``sensor_msgs/PointCloud2``; the data are bytes in any object with the buffer protocol."""

    height: int
    width: int
    fields: Sequence[FieldMessage]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any


def image_array(message: ImageMessage) -> np.ndarray:
    """Return the pixels of a ``sensor_msgs/Image`` without copying them.

    Parameters
    ----------
    message
        The message, decoded by rclpy or by `BagReader.decode`. Rows may be padded.

    Returns
    -------
    ndarray
        uint8, uint16 or float32, shape (row, column), or (row, column, channel) for several channels; read-only. It is
        a view of the message's data where the byte order is that of this computer.

    Raises
    ------
    ImageError
        The encoding is not supported, or the length of rows or data contradicts width, height and encoding.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> image_array(Message(height=1, width=2, encoding="mono16", is_bigendian=1, step=4, data=bytes([1, 2, 3, 4])))
    array([[258, 772]], dtype=uint16)
    """
    if message.encoding not in ENCODINGS:
        raise ImageError(
            f"image encoding '{message.encoding}' is not supported; known encodings: {', '.join(ENCODINGS)}",
            code=ErrorCode.FRAME_MISMATCH,
        )
    native, channels = ENCODINGS[message.encoding]
    row_bytes = message.width * channels * native.itemsize
    if message.step < row_bytes or len(message.data) != message.step * message.height:
        raise ImageError(
            f"image of {message.width}x{message.height} px ({message.encoding}) has rows of {message.step} bytes and "
            f"{len(message.data)} bytes in all; rows need at least {row_bytes} bytes, and step x height in all",
            code=ErrorCode.FRAME_MISMATCH,
        )
    pixels = _view(
        message,
        native,
        shape=(message.height, message.width, channels),
        strides=(message.step, channels * native.itemsize, native.itemsize),
    )
    return pixels[:, :, 0] if channels == 1 else pixels


def cloud_arrays(message: CloudMessage) -> dict[str, np.ndarray]:
    """Return the float32 fields of an organised ``sensor_msgs/PointCloud2`` without copying them.

    Parameters
    ----------
    message
        The message, decoded by rclpy or by `BagReader.decode`.

    Returns
    -------
    dict
        Name of the field -> float32, shape (row, column); read-only, NaN where not measured.

    Raises
    ------
    ImageError
        A field is not one float32, or the length of rows or data contradicts the cloud's size.
    """
    other = [field.name for field in message.fields if field.datatype != FLOAT32 or field.count != 1]
    if other:
        raise ImageError(f"cloud fields {', '.join(other)} are not single float32 values")
    needed = message.row_step * message.height
    if message.row_step < message.point_step * message.width or len(message.data) != needed:
        raise ImageError(
            f"cloud of {message.width}x{message.height} points of {message.point_step} bytes has rows of "
            f"{message.row_step} bytes and {len(message.data)} bytes in all"
        )
    shape, strides = (message.height, message.width), (message.row_step, message.point_step)
    return {
        field.name: _view(message, np.dtype(np.float32), shape=shape, strides=strides, offset=field.offset)
        for field in message.fields
    }


def _view(
    message: ImageMessage | CloudMessage,
    native: np.dtype[Any],
    *,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
    offset: int = 0,
) -> np.ndarray:
    """Return values of a message's data, read-only and in native byte order."""
    stored = native.newbyteorder(">" if message.is_bigendian else "<")
    # memoryview: NumPy would take every byte of an array.array as an object
    values = np.ndarray(shape, stored, buffer=memoryview(message.data), offset=offset, strides=strides)
    values = values.astype(native, copy=False)
    values.flags.writeable = False
    return values
