"""Image messages from arrays and arrays from image messages.

The bytes go through `array.array`, the only type that rclpy takes over without looking at every byte.
"""

from __future__ import annotations

import array

import numpy as np
from sensor_msgs.msg import Image

from fringedic.errors import ImageMessageError
from fringedic_ros.stamps import to_msg

_LAYOUTS: dict[str, tuple[np.dtype, int]] = {
    "mono8": (np.dtype(np.uint8), 1),
    "mono16": (np.dtype(np.uint16), 1),
    "32FC1": (np.dtype(np.float32), 1),
    "32FC2": (np.dtype(np.float32), 2),
    "rgb8": (np.dtype(np.uint8), 3),
    "bgr8": (np.dtype(np.uint8), 3),
}

_DEFAULT_ENCODINGS = {layout: encoding for encoding, layout in _LAYOUTS.items() if encoding != "bgr8"}


def image_message(pixels: np.ndarray, *, stamp_ns: int, frame_id: str, encoding: str | None = None) -> Image:
    """Image message of an array.

    Parameters
    ----------
    pixels
        (row, column) or (row, column, channel) array of uint8, uint16 or float32.
    stamp_ns
        Stamp [ns].
    frame_id
        Coordinate frame of the header.
    encoding
        One of mono8, mono16, 32FC1, 32FC2, rgb8, bgr8; by default the one that the array's type and channels suggest.

    Raises
    ------
    ImageMessageError
        The array's shape or type does not fit an encoding.
    """
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if encoding is None:
        encoding = _DEFAULT_ENCODINGS.get((pixels.dtype, channels))
    if encoding not in _LAYOUTS or pixels.ndim not in (2, 3) or (pixels.dtype, channels) != _LAYOUTS[encoding]:
        raise ImageMessageError(
            f"an array of shape {pixels.shape} and type {pixels.dtype} does not make an image of encoding {encoding}; "
            f"known encodings: {', '.join(_LAYOUTS)}"
        )
    message = Image()
    message.header.stamp = to_msg(stamp_ns)
    message.header.frame_id = frame_id
    message.height, message.width = int(pixels.shape[0]), int(pixels.shape[1])
    message.encoding = encoding
    message.is_bigendian = 0
    little_endian = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("<"))
    message.step = little_endian.nbytes // message.height if message.height else 0
    message.data = as_bytes(little_endian)
    return message


def image_array(message: Image) -> np.ndarray:
    """Read-only view of an image message's pixels: (row, column), or (row, column, channel) for several channels.

    Raises
    ------
    ImageMessageError
        Unknown encoding, or a row length or amount of data that contradicts width, height and encoding.
    """
    if message.encoding not in _LAYOUTS:
        raise ImageMessageError(
            f"image encoding '{message.encoding}' is not supported; known encodings: {', '.join(_LAYOUTS)}"
        )
    native, channels = _LAYOUTS[message.encoding]
    dtype = native.newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize
    if message.step < row_bytes or len(message.data) != message.step * message.height:
        raise ImageMessageError(
            f"image of {message.width} x {message.height} pixels ({message.encoding}) has rows of {message.step} bytes "
            f"and {len(message.data)} bytes in all; rows need at least {row_bytes} bytes, and step x height in all"
        )
    shape = (message.height, message.width, channels)
    strides = (message.step, channels * dtype.itemsize, dtype.itemsize)
    pixels = np.ndarray(shape, dtype=dtype, buffer=memoryview(message.data), strides=strides)
    pixels.flags.writeable = False
    return pixels[:, :, 0] if channels == 1 else pixels


def as_bytes(values: np.ndarray) -> array.array:
    """Copy of a C-contiguous array's bytes in the type that rclpy's byte sequences take over as it is."""
    data = array.array("B")
    data.frombytes(values.data.cast("B") if values.size else b"")
    return data
