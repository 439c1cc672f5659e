"""The live view on frames of the twin, whose blur, light, noise and pattern are known exactly."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

from fringedic.errors import ImageError
from fringedic.figures.live_preview import BLUE, RED, preview
from fringedic.patterns.pattern import WHITE
from fringedic.patterns.render import render_pattern
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig_setup.live_figures import LiveView
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

FULL_WIDTH = 4 * math.sqrt(math.log(2))  # of the autocorrelation of Gaussian spots, over their standard deviation
READ, SHOT = 1.5, 0.04


@lru_cache
def rig(**sensor: float) -> VirtualRig:
    """The middle of the plate at 240x180 px, 50 µm/px."""
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "plate",
                "size": "small",
                "camera": {"columns": 240, "rows": 180, "pixel_size_um": 50.0},
                "texture": {"feature_um": 200.0},
                "sensor": {"read_noise_grey_level": READ, "shot_noise_grey_level": SHOT, **sensor},
            }
        )
    )


def white(twin: VirtualRig, frame: int, *, position: float = 0.0, light: float = 1.0) -> np.ndarray:
    rows, columns = twin.projector_shape
    return twin.expose(render_pattern(WHITE, columns, rows), position, frame, exposure_factor=light)


def test_focus_falls_as_the_lens_blurs_whatever_the_exposure() -> None:
    view = LiveView()
    blurs = (0.0, 0.5, 1.0, 1.5, 2.5, 4.0)
    focus = []
    for blur in blurs:
        for frame in range(2):
            figures = view.look(white(rig(lens_blur_px=blur), frame), WHITE)
        focus.append(figures.focus)
    assert focus[0] == 1.0
    assert all(later < 0.9 * earlier for earlier, later in pairwise(focus)), focus
    dark, bright = LiveView(), LiveView()
    for frame in range(2):
        dim = dark.look(white(rig(lens_blur_px=1.0), frame, light=0.4), WHITE)
        light = bright.look(white(rig(lens_blur_px=1.0), frame), WHITE)
    view.look(white(rig(lens_blur_px=1.0), 8, light=0.4), WHITE)
    same = view.look(white(rig(lens_blur_px=1.0), 9, light=0.4), WHITE).focus
    assert dim.mean < 0.45 * light.mean
    assert same == pytest.approx(focus[2], rel=0.02), "four tenths of the light, the same focus"


def test_the_best_focus_is_kept_until_it_is_reset() -> None:
    view = LiveView()
    for frame in range(2):
        view.look(white(rig(), frame), WHITE)
    for frame in range(2, 4):
        blurred = view.look(white(rig(lens_blur_px=1.5), frame), WHITE)
    assert blurred.focus < 0.5
    view.reset()
    assert math.isnan(view.look(white(rig(lens_blur_px=1.5), 4), WHITE).focus), "one frame tells no noise"
    assert view.look(white(rig(lens_blur_px=1.5), 5), WHITE).focus == 1.0


def test_saturated_and_dark_pixels_are_counted_exactly() -> None:
    """The twin without noise: what a sensor of 16 bits sees at a 257th of the light tells which pixels clip."""
    quiet = {"read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0}
    bright = white(rig(**quiet, white_level=1.3), 0)
    unclipped = white(rig(**quiet, white_level=0.65, bits=16), 0) * (2 * 255 / 65535)
    saturated, dark = np.mean(unclipped >= 254.5), np.mean(unclipped < 0.5)
    assert saturated > 0.05
    figures = LiveView().look(bright, WHITE)
    assert figures.saturated == pytest.approx(saturated, abs=1.5 / bright.size), "16 bits round, too"
    assert figures.dark == dark
    assert figures.full_scale == 255
    assert figures.histogram.sum() == bright.size
    assert figures.histogram[255] == round(figures.saturated * bright.size)
    np.testing.assert_array_equal(figures.histogram, np.bincount(bright.ravel(), minlength=256))
    black = bright.copy()
    black[10:20, 30:70] = 0
    assert LiveView().look(black, WHITE).dark == 400 / black.size


def test_cameras_of_12_bits() -> None:
    twin = rig(bits=12, read_noise_grey_level=20.0, shot_noise_grey_level=0.5)
    view = LiveView(full_scale=4095)
    for frame in range(2):
        image = white(twin, frame)
        figures = view.look(image, WHITE)
    assert figures.full_scale == 4095
    expected = math.sqrt(20.0**2 + 0.5 * figures.mean + 1 / 12)
    assert figures.noise == pytest.approx(expected, rel=0.02)
    np.testing.assert_array_equal(figures.histogram, np.histogram(image, 256, (0, 4096))[0])


def test_speckle_size(speckle, expose) -> None:
    """Gaussian spots of known size, and the twin's pattern against the correlation of its noiseless image."""
    for radius in (1.2, 1.9):
        view = LiveView()
        for frame in range(2):
            grey = speckle((240, 320), 77, radius=radius).grey()
            size = view.look(np.clip(expose(grey, 60, frame), 0, 65535).astype(np.uint16), WHITE).speckle_size
        assert size == pytest.approx(FULL_WIDTH * radius, rel=0.05)
    view = LiveView()
    for frame in range(2):
        size = view.look(white(rig(), frame), WHITE).speckle_size
    exact = half_height_width(white(rig(bits=16, read_noise_grey_level=0.0, shot_noise_grey_level=0.0), 0))
    assert size == pytest.approx(exact, rel=0.05)


def half_height_width(image: np.ndarray) -> float:
    """Mean of both directions [px], by products of the image with itself moved by whole pixels."""
    flat = image - image.mean()

    def width(axis: int) -> float:
        length = flat.shape[axis]
        moved = [(flat.take(range(length - k), axis) * flat.take(range(k, length), axis)).mean() for k in range(12)]
        return 2 * float(np.interp(-0.5, -np.array(moved) / moved[0], np.arange(12)))

    return (width(0) + width(1)) / 2


def test_noise_is_that_of_the_sensor_and_unknown_while_something_moves() -> None:
    view = LiveView()
    assert math.isnan(view.look(white(rig(), 0), WHITE).noise)
    figures = view.look(white(rig(), 1), WHITE)
    expected = math.sqrt(READ**2 + SHOT * figures.mean + 1 / 12)
    assert figures.noise == pytest.approx(expected, rel=0.02)
    moved = view.look(white(rig(), 2, position=0.3e-3), WHITE)
    assert math.isnan(moved.noise), "the plate has moved by some pixels"
    assert moved.focus == pytest.approx(1.0, abs=0.02), "the noise before it moved counts on"
    flicker = view.look(white(rig(), 3, position=0.3e-3, light=0.97), WHITE)
    assert flicker.noise == pytest.approx(expected, rel=0.03), "flicker is no noise of the pixels"


def test_fringes() -> None:
    """Modulation, and the size of the speckles under the fringes, over cycles of shifts."""
    twin = rig()
    rows, columns = twin.projector_shape
    sequence = fringe_sequence(columns, rows, [10.0], 4)
    view = LiveView()
    seen = []
    for frame in range(8):
        pattern = sequence.patterns[frame % 4]
        seen.append(view.look(twin.expose(sequence.image(pattern), 0.0, frame), pattern))
    plain = LiveView()
    for frame in range(2):
        size = plain.look(white(twin, frame), WHITE).speckle_size
    quiet = rig(read_noise_grey_level=0.0, shot_noise_grey_level=0.0, bits=16)
    stack = np.stack([quiet.expose(image, 0.0, 0) * (255 / 65535) for image in sequence])
    turn = np.exp(2j * np.pi * np.arange(1, 5) / 4)
    exact = np.median(np.abs(np.tensordot(turn, stack, 1)) / 2)
    assert math.isnan(seen[2].modulation)
    assert seen[-1].modulation == pytest.approx(exact, rel=0.02)
    assert seen[-1].speckle_size == pytest.approx(size, rel=0.05)
    assert all(figures.focus > 0.98 for figures in seen[4:]), "each shift has a best focus of its own"
    assert math.isnan(view.look(white(twin, 9), WHITE).modulation)


def test_region_and_preview() -> None:
    image = np.full((240, 1300), 100, np.uint8)
    image[50:60, 400:420] = 255
    image[100, 600:606] = 0
    view = LiveView(region=(400, 40, 100, 50))
    figures = view.look(image)
    assert figures.saturated == 200 / 5000
    picture = preview(image, figures)
    assert picture.shape == (80, 433, 3)
    assert tuple(picture[18, 135]) == RED
    assert tuple(picture[33, 201]) == BLUE
    assert tuple(picture[70, 400]) == (100, 100, 100)
    assert picture[13, 150, 0] > picture[13, 150, 2], "the region's frame"
    with pytest.raises(ImageError, match="1300x240"):
        LiveView(region=(1250, 40, 100, 50)).look(image)
