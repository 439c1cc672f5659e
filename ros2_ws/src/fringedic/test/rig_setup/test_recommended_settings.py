"""The settings advisor on exact images: what it says of them and of the noise to come, against what is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import fringedic
from fringedic.correlation.transfer import shortest_period
from fringedic.errors import CorrelationError, ErrorCode, ImageError, RigSetupError
from fringedic.rig_setup.advice import SettingsProblem

FULL_WIDTH = 4 * np.sqrt(np.log(2))  # of the autocorrelation of Gaussian spots, over their standard deviation


@pytest.fixture(scope="module")
def grey(speckle):
    return speckle((320, 400), 501).grey()


@pytest.fixture(scope="module")
def advice(grey, expose):
    images = [expose(grey, 31, 10 + k) for k in range(3)]
    return fringedic.advise_settings(*images, wanted_noise=0.0095, pixel_size=50e-6)


def test_the_images_are_described(advice):
    assert advice.full_scale == 4095
    assert advice.quantisation == 1
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
    assert narrower[64] == pytest.approx(wide, rel=0.25)


def test_the_period_is_the_one_with_ten_per_cent_loss(speckle, expose):
    surface = speckle((320, 320), 502)
    f = expose(surface.grey())
    window = 32
    for factor in (1.0, 0.8):
        period = shortest_period(window) * factor

        def wave(x, _, k=2 * np.pi / period):
            return 0.1 * np.sin(k * x), 0.1 * np.sin(k * x)

        field = fringedic.measure_displacement(f, expose(surface.grey(wave)), window=window)
        inner = field.isel(row=slice(45, -45), column=slice(45, -45))
        shape = np.sin(2 * np.pi / period * inner.column.to_numpy())
        gain = float((inner.displacement_x.mean("row").to_numpy() @ shape) / (shape @ shape) / 0.1)
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
    assert advice.strain_noise == pytest.approx(found, rel=0.25)
    assert advice.gauge_length == 4 * advice.spacing + advice.window


def test_a_pattern_that_differs_along_the_axes(expose):
    """Features three times as wide as high: size and noise by axis are told apart."""
    rng = np.random.default_rng(7)
    texture = gaussian_filter(rng.normal(size=(360, 420)), (1.3, 3.9))
    grey = 2048 + 600 * texture / texture.std()
    advice = fringedic.advise_settings(*(expose(grey, 20, k) for k in range(3)))
    assert advice.feature_size == pytest.approx((FULL_WIDTH * 3.9, FULL_WIDTH * 1.3), rel=0.08)
    ratio = advice.noise[0] / advice.noise[1]
    assert ratio == pytest.approx(3, rel=0.2)
    assert SettingsProblem.LARGE_FEATURES in problems(advice)


def problems(advice):
    return {warning.problem: warning for warning in advice.warnings}


def test_requests_that_cannot_be_fulfilled_are_reported(grey, expose):
    images = [expose(grey, 31, k) for k in range(3)]
    both = problems(fringedic.advise_settings(*images, wanted_noise=0.005, wanted_period=30))
    noisy = both[SettingsProblem.PERIOD_TOO_NOISY]
    assert noisy.value == 30
    assert noisy.limit > 0.005
    period = fringedic.advise_settings(*images, wanted_period=50)
    assert period.period <= 50 < period.period + 2
    short = problems(fringedic.advise_settings(*images, wanted_period=4))
    assert short[SettingsProblem.PERIOD_TOO_FEW_FEATURES].value == 4
    beyond = fringedic.advise_settings(*images, wanted_noise=0.0005)
    assert beyond.window == 160
    unreachable = problems(beyond)[SettingsProblem.NOISE_OUT_OF_REACH]
    assert unreachable.limit > 160
    assert 0.0005 < unreachable.value < 0.01


def test_quantised_images_are_reported(grey):
    eight = [np.rint(grey / 16).clip(0, 255).astype(np.uint8)] * 3
    assert SettingsProblem.QUANTISED in problems(fringedic.advise_settings(*eight))


def test_saturated_images_are_reported(grey, expose):
    bright = [np.clip(expose(1.2 * grey, 31, k).astype(int) + 700, 0, 4095).astype(np.uint16) for k in range(3)]
    saturated = fringedic.advise_settings(*bright)
    assert saturated.saturated == pytest.approx(float(np.mean(bright[0] == 4095)))
    assert problems(saturated)[SettingsProblem.SATURATED].value == saturated.saturated


def test_motion_is_reported(speckle, grey, expose):
    moved = speckle((320, 400), 501).grey(lambda x, y: (np.full_like(x, 0.3), np.full_like(y, -0.1)))
    drifted = fringedic.advise_settings(expose(grey, 31, 1), expose(moved, 31, 2), expose(moved, 31, 3))
    assert drifted.bias == pytest.approx((0.3, -0.1), abs=0.005)
    assert problems(drifted)[SettingsProblem.MOVED].value == pytest.approx(np.hypot(0.3, 0.1), abs=0.005)


def test_a_periodic_texture_is_reported(expose):
    y, x = np.mgrid[:240, :320]
    weave = 2048 + 500 * (np.cos(2 * np.pi * x / 12) + np.cos(2 * np.pi * y / 12))
    advice = fringedic.advise_settings(*(expose(weave, 12, k) for k in range(3)))
    periodic = problems(advice)[SettingsProblem.PERIODIC]
    assert periodic.value == pytest.approx(12, abs=0.01)
    assert periodic.limit == periodic.value / 2
    assert SettingsProblem.FAINT not in problems(advice)


@pytest.mark.parametrize(("noise", "binning"), [(0.6, 4), (0.35, 4), (0.15, 2)])
def test_a_coarse_and_faint_texture_is_reported(speckle, expose, noise, binning):
    """Noise in units of the contrast. The settings give the stated noise in other images."""
    grey = 2048 + 0.5 * (speckle((240, 320), 21, radius=6.0).grey() - 2048)
    images = [expose(grey, noise * 307, k) for k in range(5)]
    advice = fringedic.advise_settings(*images[:3], wanted_period=70)
    faint = problems(advice)[SettingsProblem.FAINT]
    assert 1 <= faint.value < faint.limit
    assert advice.binning == binning
    assert advice.period <= 70
    field = fringedic.measure_displacement(*images[3:], window=advice.window, spacing=advice.spacing)
    assert field.attrs["window_px"] == advice.subset
    found = float(field.displacement_x.std()), float(field.displacement_y.std())
    assert np.hypot(*advice.noise) == pytest.approx(np.hypot(*found), rel=0.25)
    assert advice.noise_predicted == pytest.approx(advice.noise, rel=0.25)


def test_a_window_that_needs_no_averaging_is_as_wide_as_requested(speckle, expose):
    """The first window averages pixels, the recommended one measures enough points without."""
    grey = 2048 + 0.5 * (speckle((360, 480), 21, radius=6.0).grey() - 2048)
    images = [expose(grey, 0.09 * 307, k) for k in range(3)]
    advice = fringedic.advise_settings(*images)
    field = fringedic.measure_displacement(*images[:2], window=advice.window, spacing=advice.spacing)
    assert field.attrs["window_px"] == advice.subset == advice.window
    assert advice.subset > 4.9 * max(advice.feature_size)
    assert SettingsProblem.FAINT in problems(advice)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("background", [0, 110])
def test_a_normal_texture_is_neither_periodic_nor_faint(speckle, expose, seed, background):
    """Also where most of the image is a plain background: its width [px] at either side."""
    grey = speckle((240, 320), seed, radius=(1.0, 1.4, 2.0)[seed % 3]).grey()
    grey[:, :background] = grey[:, 320 - background :] = 300
    found = problems(fringedic.advise_settings(*(expose(grey, 31, k) for k in range(3))))
    assert not {SettingsProblem.PERIODIC, SettingsProblem.FAINT} & set(found)


def test_the_scale_of_the_grey_levels_does_not_matter(grey, expose):
    left_aligned = fringedic.advise_settings(*(16 * expose(grey, 31, k) for k in range(3)))
    assert left_aligned.quantisation == 16
    assert left_aligned.full_scale == 65535
    real = fringedic.advise_settings(*(expose(grey, 31, k).astype(np.float32) for k in range(3)))
    assert np.isnan(real.saturated)
    assert real.window == left_aligned.window


def test_drift_and_flicker_do_not_count_as_image_noise(speckle, expose):
    surface = speckle((240, 240), 503)
    still, moved = surface.grey(), surface.grey(lambda x, y: (np.full_like(x, 0.05), np.full_like(y, -0.03)))
    images = expose(still, 10, 1), expose(still, 10, 2), expose(1.01 * moved - 20, 10, 3)
    noise = fringedic.advise_settings(*images).image_noise
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
    assert masked.saturated < 0.002
    assert masked.image_noise == pytest.approx(inside.image_noise, rel=0.02)
    assert masked.feature_size == pytest.approx(inside.feature_size, rel=0.02)
    assert abs(masked.window - inside.window) <= 1
    assert masked.noise == pytest.approx(inside.noise, rel=0.15)


def test_bad_input_is_named(grey, expose):
    images = [expose(grey, 31, k) for k in range(3)]
    for request in ({"wanted_noise": 0.0}, {"wanted_period": -3.0}, {"strain_window": 4}, {"pixel_size": np.nan}):
        with pytest.raises(RigSetupError, match=next(iter(request))):
            fringedic.advise_settings(*images, **request)
    with pytest.raises(ImageError, match="second static"):
        fringedic.advise_settings(images[0], images[1], images[2][:-1])
    with pytest.raises(CorrelationError, check=lambda e: e.code is ErrorCode.NO_CORRELATION):
        fringedic.advise_settings(images[0], images[1], np.random.default_rng(1).integers(0, 4096, images[0].shape))
