"""Pictures and palettes for a browser."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fringedic.errors import ImageError
from fringedic.figures.live_preview import MOST_PIXELS, browser_picture
from fringedic.figures.palettes import PALETTES, palette


def decoded(picture: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[:, :, ::-1]


def test_small_image_keeps_its_size_and_grey_levels() -> None:
    ramp = np.tile(np.linspace(10, 240, 64), (48, 1)).astype(np.uint8)
    shown = decoded(browser_picture(ramp))
    assert shown.shape == (48, 64, 3)
    np.testing.assert_allclose(shown[:, :, 1], ramp, atol=6)


@pytest.mark.parametrize(("kind", "full"), [(np.uint8, 255), (np.uint16, 4095)])
def test_saturated_pixels_are_red_also_in_a_smaller_picture(kind: type, full: int) -> None:
    image = np.full((1200, 1600), full // 2, kind)
    image[600:608, 800:808] = full
    shown = decoded(browser_picture(image))
    assert shown.shape[0] * shown.shape[1] <= MOST_PIXELS
    factor = 1200 // shown.shape[0]
    red, green, blue = shown[604 // factor, 804 // factor].astype(int)
    assert red > 150
    assert max(green, blue) < 100
    grey = shown[100, 100].astype(int)
    assert np.ptp(grey) <= 2
    assert grey.mean() == pytest.approx(127, abs=3)


def test_one_saturated_pixel_is_seen_in_a_much_smaller_picture() -> None:
    image = np.full((4000, 6000), 100, np.uint8)
    image[2002, 3003] = 255
    shown = decoded(browser_picture(image)).astype(int)
    factor = 4000 // shown.shape[0]
    row, column = 2002 // factor, 3003 // factor
    assert shown[row, column, 0] - shown[row, column, 2] > 40
    assert shown[row - 20, column, 0] - shown[row - 20, column, 2] == 0


@pytest.mark.parametrize(
    "image", [np.zeros((4, 6, 3), np.uint8), np.zeros((4, 6), np.float32), np.zeros((0, 6), np.uint8)]
)
def test_what_no_camera_sends_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ImageError, match="has no grey levels of a camera"):
        browser_picture(image)


@pytest.mark.parametrize("name", PALETTES)
def test_palette_goes_from_low_to_high(name: str) -> None:
    colours = palette(name)
    assert (colours.dtype, colours.shape) == (np.uint8, (256, 3))
    assert len(np.unique(colours, axis=0)) > 200
