"""Images on a topic of a recording, written as files to be measured without a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fringedic.errors import ImageError, RecordingError
from fringedic.frames.messages import image_array
from fringedic.recording.reader import BagReader
from fringedic.recording.sentences import IMAGE_TYPES

_PNG = b"\x89PNG"


def save_images(bag: Path, topic: str, folder: Path) -> list[Path]:
    """Write the images on a topic of a recording as files, in their order.

    Parameters
    ----------
    bag
        Any recording with the topic, of whatever camera.
    topic
        Full name of a topic of `sensor_msgs/Image` or `sensor_msgs/CompressedImage`.
    folder
        Of the files; those of the same name are replaced.

    Returns
    -------
    list of Path
        ``image_0.png``, ``image_1.png``, ...

    Raises
    ------
    RecordingError
        There is no such recording, or it has no images on this topic; the message names the topics with images.
    ImageError
        An image has an encoding that is not supported; the message names it.
    """
    reader = BagReader(bag)
    present = [
        each.name for each in reader.topics.values() if each.type_name in IMAGE_TYPES and reader.counts[each.name]
    ]
    if topic not in present:
        known = ", ".join(present) or "no topic"
        raise RecordingError(f"{bag}: no images on {topic or 'the topic'}; there are images on {known}")
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for number, (_, message, _) in enumerate(reader.messages([topic])):
        content, suffix = _encoded(message, f"{topic}, image {number}")
        files.append(folder / f"image_{number}{suffix}")
        files[-1].write_bytes(content)
    return files


def _encoded(message: Any, place: str) -> tuple[bytes, str]:
    """Return the bytes of an image file without loss, and the suffix of its name."""
    if hasattr(message, "format"):
        content = bytes(memoryview(message.data))
        return content, ".png" if content.startswith(_PNG) else ".jpg"
    try:
        pixels = image_array(message)
    except ImageError as error:
        raise ImageError(f"{place}: {error}", code=error.code) from error
    if pixels.dtype.kind != "u":
        raise ImageError(f"{place}: {message.encoding} are no grey levels; choose the topic of a camera's images")
    if message.encoding == "rgb8":
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    return cv2.imencode(".png", pixels)[1].tobytes(), ".png"
