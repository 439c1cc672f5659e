"""The settings advisor on exact images: what it says of them and of the noise to come, against what is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import fringedic.advice
from fringedic.errors import AdviceError, NoCorrelationError, ShapeMismatchError

FULL_WIDTH = 4 * np.sqrt(np.log(2))  # of the autocorrelation of Gaussian spots, over their standard deviation


@pytest.fixture(scope="module")
def grey(speckle):
    return speckle((320, 400), 501).grey()


@pytest.fixture(scope="module")
def advice(grey, expose):
    images = [expose(grey, 31, 10 + k) for k in range(3)]
    return fringedic.advise_settings(*images, wanted_noise=0.0095, pixel_size=50e-6)


def test_the_images_are_described(advice):
    print(
        f"image noise {advice.image_noise:.2f} (31), contrast {advice.contrast:.0f} (614), size {advice.feature_size}"
    )
    assert advice.full_scale == 4095 and advice.quantisation == 1
    assert advice.image_noise == pytest.approx(31, rel=0.02)
    assert advice.contrast == pytest.approx(0.15 * 4096, rel=0.05)  # of this piece of the surface
    assert advice.feature_size == pytest.approx((FULL_WIDTH * 1.4,) * 2, rel=0.05)
    assert advice.coverage == pytest.approx(0.5, abs=0.05)
    # A Gaussian gradient of standard deviation s along either axis has the mean magnitude s sqrt(pi / 2).
    slope = 0.15 * 4096 / (np.sqrt(2) * 1.4)
    assert advice.mean_gradient == pytest.approx(slope * np.sqrt(np.pi / 2), rel=0.15)  # central differences miss some


def test_the_recommended_window_has_the_noise_that_was_wanted(advice, grey, expose):
    """Twenty other pairs of images, measured with the settings that were recommended."""
    variance = []
    for k in range(20):
        field = fringedic.measure_displacement(
            expose(grey, 31, 100 + k), expose(grey, 31, 200 + k), window=advice.window, spacing=advice.spacing
        )
        inner = field.isel(row=slice(5, -5), column=slice(5, -5))
        variance.append([float(inner.displacement_x.var()), float(inner.displacement_y.var())])
    found = np.sqrt(np.mean(variance, axis=0))
    print(
        f"window {advice.window} px for 0.0095 px: measured {found.round(5)} over 20 pairs, predicted "
        f"{np.round(advice.noise_predicted, 5)}, two static images {np.round(advice.noise, 5)} px"
    )
    assert 0.0085 < found.max() < 0.0100
    assert advice.noise_predicted == pytest.approx(found, rel=0.06)
    assert advice.noise == pytest.approx(found, rel=0.1)
    # The noise of the reference is common to both images: over time it does not show.
    assert advice.noise_temporal == pytest.approx(found / np.sqrt(2), rel=0.1)
    assert max(np.abs(advice.bias)) < 0.002
    narrower = {window: noise for window, noise, _ in advice.table}
    assert narrower[16] > narrower[32] > narrower[64]
    field = fringedic.measure_displacement(expose(grey, 31, 1), expose(grey, 31, 2), window=64)
    wide = float(field.displacement_x.isel(row=slice(60, -60), column=slice(60, -60)).std())
    print(f"window 64 px: {narrower[64]:.5f} expected, {wide:.5f} px measured on one pair")
    assert narrower[64] == pytest.approx(wide, rel=0.25)


def test_the_period_is_the_one_with_ten_per_cent_loss(speckle, expose):
    surface = speckle((320, 320), 502)
    f = expose(surface.grey())
    window = 32
    for loss, factor in (("at the period", 1.0), ("a fifth below", 0.8)):
        period = fringedic.advice.shortest_period(window) * factor

        def wave(x, y, k=2 * np.pi / period):
            return 0.1 * np.sin(k * x), 0.1 * np.sin(k * x)

        field = fringedic.measure_displacement(f, expose(surface.grey(wave)), window=window)
        inner = field.isel(row=slice(45, -45), column=slice(45, -45))
        shape = np.sin(2 * np.pi / period * inner.column.to_numpy())
        gain = float((inner.displacement_x.mean("row").to_numpy() @ shape) / (shape @ shape) / 0.1)
        print(f"gain {loss} {period:.1f} px: {gain:.3f}")
        if factor == 1:
            assert gain == pytest.approx(0.9, abs=0.03)
        else:
            assert gain < 0.75


def test_strain_noise_is_that_of_other_pairs(advice, grey, expose):
    """Against slopes of planes fitted one by one to another pair."""
    field = fringedic.measure_displacement(
        expose(grey, 31, 300), expose(grey, 31, 301), window=advice.window, spacing=advice.spacing
    )
    n, half = advice.strain_window, advice.strain_window // 2
    y, x = np.mgrid[:n, :n] * advice.spacing
    basis = np.stack([np.ones(n * n), x.ravel(), y.ravel()], axis=1)
    both = np.stack([field.displacement_x, field.displacement_y])
    _, rows, columns = both.shape
    slopes = []
    for r in range(half, rows - half):
        for c in range(half, columns - half):
            part = both[:, r - half : r + half + 1, c - half : c + half + 1].reshape(2, -1)
            u, v = np.linalg.lstsq(basis, part.T, rcond=None)[0].T
            slopes.append((u[1], v[2], 0.5 * (u[2] + v[1])))
    found = np.nanstd(slopes, axis=0)
    print(f"strain noise {np.round(1e6 * np.array(advice.strain_noise))}, another pair {np.round(1e6 * found)} µstrain")
    assert advice.strain_noise == pytest.approx(found, rel=0.25)
    assert advice.gauge_length == 4 * advice.spacing + advice.window


def test_a_pattern_that_differs_along_the_axes(expose):
    """Features three times as wide as high: size and noise by axis are told apart."""
    rng = np.random.default_rng(7)
    texture = gaussian_filter(rng.normal(size=(360, 420)), (1.3, 3.9))
    grey = 2048 + 600 * texture / texture.std()
    advice = fringedic.advise_settings(*(expose(grey, 20, k) for k in range(3)))
    print(f"size {np.round(advice.feature_size, 2)}, of {FULL_WIDTH * 3.9:.2f} and {FULL_WIDTH * 1.3:.2f} px")
    assert advice.feature_size == pytest.approx((FULL_WIDTH * 3.9, FULL_WIDTH * 1.3), rel=0.08)
    ratio = advice.noise[0] / advice.noise[1]
    print(f"noise along x over noise along y: {ratio:.2f} (3)")
    assert ratio == pytest.approx(3, rel=0.2)
    assert any("large" in warning for warning in advice.warnings)


def test_wishes_that_contradict_each_other_are_told(grey, expose):
    images = [expose(grey, 31, k) for k in range(3)]
    both = fringedic.advise_settings(*images, wanted_noise=0.005, wanted_period=30)
    assert any("30 px lose more than 10 %" in warning for warning in both.warnings)
    period = fringedic.advise_settings(*images, wanted_period=50)
    assert period.period <= 50 < period.period + 2
    beyond = fringedic.advise_settings(*images, wanted_noise=0.0005)
    assert beyond.window == 160
    assert any("more than these images allow" in warning for warning in beyond.warnings)


def test_what_is_wrong_with_the_images_is_told(speckle, expose, grey):
    eight = [np.rint(grey / 16).clip(0, 255).astype(np.uint8)] * 3
    assert any("quantisation" in warning for warning in fringedic.advise_settings(*eight).warnings)
    bright = [np.clip(expose(1.2 * grey, 31, k).astype(int) + 700, 0, 4095).astype(np.uint16) for k in range(3)]
    saturated = fringedic.advise_settings(*bright)
    assert saturated.saturated == pytest.approx(float(np.mean(bright[0] == 4095)))
    assert any("saturated" in warning for warning in saturated.warnings)
    moved = speckle((320, 400), 501).grey(lambda x, y: (np.full_like(x, 0.3), np.full_like(y, -0.1)))
    drifted = fringedic.advise_settings(expose(grey, 31, 1), expose(moved, 31, 2), expose(moved, 31, 3))
    assert drifted.bias == pytest.approx((0.3, -0.1), abs=0.005)
    assert any("not static" in warning for warning in drifted.warnings)
    left_aligned = fringedic.advise_settings(*(16 * expose(grey, 31, k) for k in range(3)))
    assert left_aligned.quantisation == 16 and left_aligned.full_scale == 65535
    real = fringedic.advise_settings(*(expose(grey, 31, k).astype(np.float32) for k in range(3)))
    assert np.isnan(real.saturated) and real.window == left_aligned.window


def test_drift_and_flicker_do_not_count_as_image_noise(speckle, expose):
    surface = speckle((240, 240), 503)
    still, moved = surface.grey(), surface.grey(lambda x, y: (np.full_like(x, 0.05), np.full_like(y, -0.03)))
    images = expose(still, 10, 1), expose(still, 10, 2), expose(1.01 * moved - 20, 10, 3)
    noise = fringedic.advise_settings(*images).image_noise
    plain = np.std(images[2].astype(float) - images[1]) / np.sqrt(2)
    print(f"image noise {noise:.2f} (10), plain difference {plain:.2f}")
    assert noise == pytest.approx(10, rel=0.06)


def test_only_what_is_measured_counts(grey, expose):
    """Bare background under a mask, and a patch of NaN: neither changes what is said of the surface."""
    surface = np.zeros(grey.shape, bool)
    surface[40:-40, 60:-60] = True
    images = []
    for k in range(3):
        image = np.where(surface, expose(grey, 31, k), 4095.0)
        image[100:110, 100:110] = np.nan
        images.append(image)
    masked = fringedic.advise_settings(*images, mask=surface, full_scale=4095, wanted_noise=0.0095)
    inside = fringedic.advise_settings(*(expose(grey, 31, k)[40:-40, 60:-60] for k in range(3)), wanted_noise=0.0095)
    print(f"size {masked.feature_size}, {inside.feature_size}; noise {masked.noise}, {inside.noise}")
    assert masked.saturated < 0.002
    assert masked.image_noise == pytest.approx(inside.image_noise, rel=0.02)
    assert masked.feature_size == pytest.approx(inside.feature_size, rel=0.02)
    assert abs(masked.window - inside.window) <= 1
    assert masked.noise == pytest.approx(inside.noise, rel=0.15)


def test_the_report_speaks_of_lengths(advice):
    text = advice.report()
    print(text)
    for words in ("subset size", "step size", "virtual strain gauge", "feature size", "intensity gradient", "µm", "mm"):
        assert words in text


def test_bad_input_is_named(grey, expose):
    images = [expose(grey, 31, k) for k in range(3)]
    for wish in ({"wanted_noise": 0.0}, {"wanted_period": -3.0}, {"strain_window": 4}, {"pixel_size": np.nan}):
        with pytest.raises(AdviceError, match=next(iter(wish))):
            fringedic.advise_settings(*images, **wish)
    with pytest.raises(ShapeMismatchError, match="second static"):
        fringedic.advise_settings(images[0], images[1], images[2][:-1])
    with pytest.raises(NoCorrelationError):
        fringedic.advise_settings(images[0], images[1], np.random.default_rng(1).integers(0, 4096, images[0].shape))
