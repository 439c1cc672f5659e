"""The Cramer-Rao bound of the displacement against a texture whose gradients are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.correlation import measure_displacement, noise_gain
from fringedic.correlation.limit import displacement_limit
from fringedic.errors import CorrelationError

SIZE, NOISE = 256, 12.0


def texture(width: float, shift: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return a periodic texture of spots of a width [px], displaced exactly, and its exact derivative along x."""
    spectrum = np.fft.fft2(np.random.default_rng(4).standard_normal((SIZE, SIZE)))
    y, x = np.fft.fftfreq(SIZE)[:, None], np.fft.fftfreq(SIZE)[None]
    spectrum *= np.exp(-((np.pi * width) ** 2) * (x**2 + y**2) / 2)
    spectrum[SIZE // 2] = spectrum[:, SIZE // 2] = 0
    scale = 300 / np.fft.ifft2(spectrum).real.std()
    moved = np.fft.ifft2(spectrum * np.exp(-2j * np.pi * (x * shift[0] + y * shift[1]))).real
    return 2048 + scale * moved, scale * np.fft.ifft2(2j * np.pi * x * spectrum).real


@pytest.mark.parametrize("window", [32, 48])  # several spots in each
def test_limit_of_a_known_texture(window: int) -> None:
    """Of wide spots the central differences are exact enough, and the noise in them is subtracted."""
    exact, slope = texture(6.0)
    noisy = exact + np.random.default_rng(1).normal(0, NOISE, exact.shape)
    limit = displacement_limit(noisy, np.full(exact.shape, NOISE**2), window)[0]
    bound = np.sqrt(2 * NOISE**2 * noise_gain(window) / np.mean(slope**2))
    assert np.sqrt(np.mean(limit[40:-40, 40:-40] ** -2.0)) == pytest.approx(1 / bound, rel=0.05)


def test_no_measurement_is_better_than_its_limit() -> None:
    still, moved = texture(4.0)[0], texture(4.0, (0.27, -0.41))[0]
    random = np.random.default_rng(2)
    images = [image + random.normal(0, NOISE, image.shape) for image in (still, moved)]
    field = measure_displacement(*images, window=32)
    inside = (slice(40, -40), slice(40, -40))
    limit = displacement_limit(images[0], np.full(still.shape, NOISE**2), 32)[0][inside]
    error = (field.displacement_x.values[inside] - 0.27) / limit
    assert 0.9 < np.sqrt(np.nanmean(error**2)) < 1.25


def test_a_texture_of_one_direction_has_no_limit_along_it() -> None:
    stripes = np.broadcast_to(100 * np.sin(np.arange(64) / 2.0), (64, 64))
    right, down = displacement_limit(stripes, np.ones((64, 64)), 16)[:, 32, 32]
    assert np.isinf(right)
    assert np.isinf(down)
    holes = np.where(np.arange(64) < 20, np.nan, texture(6.0)[0][:64, :64])
    limits = displacement_limit(holes, np.ones((64, 64)), 16)
    assert np.isnan(limits[:, :, :20]).all()
    assert np.isfinite(limits[:, 10:-10, 24:-10]).all()


def test_shapes_have_to_agree() -> None:
    with pytest.raises(CorrelationError, match="give one shape"):
        displacement_limit(np.zeros((8, 8)), np.zeros((8, 9)), 16)
