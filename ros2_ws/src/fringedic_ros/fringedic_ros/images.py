"""Encodes arrays as image messages; the decoder is `fringedic.frames.messages.image_array`.

The bytes are passed as `array.array`, the only type that rclpy accepts without a check of every byte.
"""

from __future__ import annotations

import array

import numpy as np
from sensor_msgs.msg import Image

from fringedic.errors import ImageError
from fringedic.frames.messages import ENCODINGS
from fringedic.frames.messages import image_array as image_array
from fringedic_ros.stamps import to_msg

_DEFAULT_ENCODINGS = {layout: encoding for encoding, layout in ENCODINGS.items() if encoding != "bgr8"}


def image_message(pixels: np.ndarray, *, stamp_ns: int, frame_id: str, encoding: str | None = None) -> Image:
    """Return the image message of an array.

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
    ImageError
        The array's shape or type does not fit an encoding.
    """
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if encoding is None:
        encoding = _DEFAULT_ENCODINGS.get((pixels.dtype, channels))
    if encoding not in ENCODINGS or pixels.ndim not in (2, 3) or (pixels.dtype, channels) != ENCODINGS[encoding]:
        raise ImageError(
            f"an array of shape {pixels.shape} and type {pixels.dtype} does not make an image of encoding {encoding}; "
            f"known encodings: {', '.join(ENCODINGS)}"
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


def as_bytes(values: np.ndarray) -> array.array[int]:
    """Return a copy of a C-contiguous array's bytes in the type that rclpy's byte sequences accept unchecked."""
    data = array.array("B")
    data.frombytes(values.data.cast("B") if values.size else b"")
    return data
