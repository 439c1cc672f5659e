"""Image and cloud messages as any library decodes them: layouts of other publishers, and contradictions."""

from __future__ import annotations

import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fringedic.errors import ImageError
from fringedic.frames.messages import cloud_arrays, image_array


def image_message(**changes: Any) -> SimpleNamespace:
    values = {
        "height": 3,
        "width": 4,
        "encoding": "mono8",
        "is_bigendian": 0,
        "step": 4,
        "data": np.arange(12, dtype=np.uint8),
    }
    return SimpleNamespace(**{**values, **changes})


def cloud_message(**changes: Any) -> SimpleNamespace:
    points = np.arange(12, dtype="<f4").reshape(2, 3, 2)
    values = {
        "height": 2,
        "width": 3,
        "fields": [SimpleNamespace(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xz")],
        "is_bigendian": False,
        "point_step": 8,
        "row_step": 24,
        "data": array.array("B", points.tobytes()),
    }
    return SimpleNamespace(**{**values, **changes})


@pytest.mark.parametrize("kind", [bytes, np.array, lambda values: array.array("B", values)])
def test_pixels_are_a_read_only_view_of_any_buffer(kind: Any) -> None:
    data = kind(np.arange(12, dtype=np.uint8).tobytes()) if kind is bytes else kind(np.arange(12, dtype=np.uint8))
    pixels = image_array(image_message(data=data))
    assert pixels.tolist()[1] == [4, 5, 6, 7]
    assert np.shares_memory(pixels, np.asarray(memoryview(data)))
    with pytest.raises(ValueError, match="read-only"):
        pixels[0, 0] = 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"encoding": "bayer_rggb8"}, "encoding 'bayer_rggb8' is not supported; known encodings: mono8"),
        ({"step": 9}, "image of 4x3 px"),
        ({"step": 3}, "rows need at least 4 bytes"),
        ({"height": 4}, "4x4 px"),
    ],
)
def test_images_that_contradict_themselves_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ImageError, match=words):
        image_array(image_message(**change))


def test_big_endian_and_padded_rows_are_read() -> None:
    pixels = np.array([[1, 258], [3, 65535]], dtype=">u2")
    data = np.zeros((2, 6), np.uint8)
    data[:, :4] = pixels.view(np.uint8)
    read = image_array(image_message(height=2, width=2, encoding="mono16", is_bigendian=1, step=6, data=data.ravel()))
    assert read.tolist() == [[1, 258], [3, 65535]]
    assert read.dtype == np.uint16


def test_channels_are_the_last_axis() -> None:
    colours = image_array(image_message(width=1, encoding="bgr8", step=4))
    assert colours.tolist() == [[[0, 1, 2]], [[4, 5, 6]], [[8, 9, 10]]]


@pytest.mark.parametrize("big_endian", [False, True])
def test_clouds_of_both_byte_orders_are_read(big_endian: bool) -> None:
    points = np.arange(12, dtype=">f4" if big_endian else "<f4").reshape(2, 3, 2)
    fields = cloud_arrays(cloud_message(is_bigendian=big_endian, data=points.tobytes()))
    assert {name: values.tolist() for name, values in fields.items()} == {
        "x": [[0, 2, 4], [6, 8, 10]],
        "z": [[1, 3, 5], [7, 9, 11]],
    }
    assert not fields["x"].flags.writeable


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"height": 3}, "3x3 points"),
        ({"point_step": 12}, "points of 12 bytes"),
        ({"fields": [SimpleNamespace(name="rgb", offset=0, datatype=6, count=1)]}, "rgb are not single float32"),
    ],
)
def test_clouds_that_contradict_themselves_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ImageError, match=words):
        cloud_arrays(cloud_message(**change))
