"""Coarse speckle whose slopes do not stand out from the noise of single pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fringedic.correlation import measure_displacement
from fringedic.errors import CorrelationError, ErrorCode

SHAPE = (480, 640)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
CONTRAST = 614.0  # [grey level] of the surface of the fixture


@pytest.fixture(scope="module")
def surface(speckle):
    return speckle(SHAPE, 21, radius=6.0)


@pytest.mark.parametrize("noise", [1.0, 0.6, 0.35])
def test_coarse_and_faint_texture(surface, expose, noise):
    """Noise in units of the contrast; pixels are averaged, and the result says so and names the wider window."""
    exact = 3.25 + 0.01 * X, -1.5 - 0.005 * Y
    motion = lambda x, y: (3.25 + 0.01 * x, -1.5 - 0.005 * y)  # noqa: E731
    reference = 2048 + 0.5 * (surface.grey() - 2048)
    deformed = 2048 + 0.5 * (surface.grey(motion) - 2048)
    images = [expose(each, 0.5 * noise * CONTRAST, seed) for seed, each in enumerate((reference, deformed))]
    field = measure_displacement(*images, spacing=4)
    wrong = np.stack([field.displacement_x - exact[0][::4, ::4], field.displacement_y - exact[1][::4, ::4]])
    z = wrong / np.stack([field.sigma_x, field.sigma_y])
    binning = field.attrs["binning_px"]
    assert field.attrs["window_px"] == 32 * binning
    assert binning in (2, 4, 8)
    assert field.valid.mean() > 0.7  # windows beside the edges are half empty
    # few spots of 12 px in a window: 1.2 without noise and without averaging, too
    assert 0.8 < np.sqrt(np.nanmean(z**2)) < 1.35
    assert np.nanmax(np.abs(z)) < 6


def test_plain_background_is_no_faint_texture(speckle, expose):
    """Windows of the background contain noise alone; pixels of the specimen are not averaged."""
    grey = speckle((320, 400), 0).grey()
    grey[:, :120] = grey[:, 280:] = 300
    field = measure_displacement(expose(grey, 31, 1), expose(grey, 31, 2), spacing=4)
    assert "binning_px" not in field.attrs
    assert field.valid.values[:, 35:65].mean() > 0.9


def test_noise_alone_is_refused(expose):
    images = [expose(np.full(SHAPE, 2048.0), 300, seed) for seed in (1, 2)]
    with pytest.raises(CorrelationError) as error:
        measure_displacement(*images, spacing=4)
    assert error.value.code is ErrorCode.NO_CORRELATION


def jpeg(image, quality):
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize("quality", [70, 80])
def test_faint_texture_in_jpeg_images(quality):
    """Compression removes the fine noise by which the texture is compared: the refusal names it beside the surface."""
    random = np.random.default_rng(4)
    images = [np.rint(60 + random.normal(0, 4, SHAPE)).astype(np.uint8) for _ in "ab"]
    with pytest.raises(CorrelationError, match=r"same surface.*compression \(JPEG\) hides texture"):
        measure_displacement(*(jpeg(each, quality) for each in images), spacing=4)


def test_another_surface_is_named_where_averaged_pixels_would_show_the_texture(surface, expose):
    """The deformed image shows noise alone: either the texture or the surface may be the cause."""
    reference, deformed = 2048 + 0.5 * (surface.grey() - 2048), np.full(SHAPE, 2048.0)
    with pytest.raises(CorrelationError, match=r"same surface.*Besides, the texture of the reference"):
        measure_displacement(expose(reference, 300, 1), expose(deformed, 300, 2), spacing=4)


def test_noise_of_the_reference_is_no_texture(speckle, expose):
    """A third of the gradients of the reference is noise, whose energy would make sigma too small (z-scores of 1.2)."""
    surface = speckle((240, 320), 22, radius=2.5)
    motion = lambda x, y: (3.25 + 0 * x, -1.5 + 0 * y)  # noqa: E731
    images = [expose(surface.grey(), 0.2 * CONTRAST, 1), expose(surface.grey(motion), 0.2 * CONTRAST, 2)]
    field = measure_displacement(*images)
    z = np.stack([(field.displacement_x - 3.25) / field.sigma_x, (field.displacement_y + 1.5) / field.sigma_y])
    assert "binning_px" not in field.attrs
    assert 0.85 < np.sqrt(np.nanmean(z**2)) < 1.1
