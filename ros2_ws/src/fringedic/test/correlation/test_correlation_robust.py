"""Light, glare, patches that changed, pixel types and symmetries."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from fringedic.correlation import measure_displacement
from fringedic.correlation.images import find_saturation
from fringedic.errors import CorrelationError, ErrorCode

SHAPE = (200, 240)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


def motion(x, y):
    return 0.3 + 0.002 * (x - 120), -0.2 + 0.001 * (y - 100)


@pytest.fixture(scope="module")
def pair(speckle, expose):
    surface = speckle(SHAPE, 301)
    return expose(surface.grey(), 10, 1).astype(float), expose(surface.grey(motion), 10, 2).astype(float)


@pytest.fixture(scope="module")
def other(speckle):
    return speckle(SHAPE, 302).image(noise=10, seed=3).astype(float)


def rms(field):
    e = np.stack([field.displacement_x, field.displacement_y]) - np.stack(motion(X, Y))
    return float(np.sqrt(np.nanmean(e**2)))


@pytest.mark.parametrize(
    ("light", "limit"),
    [
        pytest.param(lambda g: g, 0.0035, id="none"),
        pytest.param(lambda g: 0.6 * g + 300, 0.0035, id="darker"),
        pytest.param(lambda g: np.clip(1.3 * g - 300, 0, 4095), 0.0045, id="brighter, 1.5 % saturated"),
        pytest.param(lambda g: g * (0.5 + X / SHAPE[1]), 0.006, id="shading 0.5 to 1.5"),
        pytest.param(lambda g: g + 800 * Y / SHAPE[0], 0.0045, id="offset gradient"),
    ],
)
def test_change_of_light(pair, light, limit):
    field = measure_displacement(pair[0], light(pair[1]))
    assert rms(field) <= limit
    assert field.valid.mean() > 0.9


def scores(field):
    """Root mean square of the errors over their uncertainties."""
    e = np.stack([field.displacement_x, field.displacement_y]) - np.stack(motion(X, Y))
    return float(np.sqrt(np.nanmean((e / np.stack([field.sigma_x, field.sigma_y])) ** 2)))


@pytest.mark.parametrize(
    "light",
    [
        pytest.param(0.5 + X / SHAPE[1], id="0.5 to 1.5 along x"),
        pytest.param(0.3 + 1.4 * Y / SHAPE[0], id="0.3 to 1.7 along y"),
        pytest.param(np.exp(-((X - 120) ** 2 + (Y - 100) ** 2) / (2 * 120**2)), id="vignette down to 0.4"),
    ],
)
def test_shading_is_followed(pair, light):
    """Inside, shading has no effect; at the edges, where windows are one-sided, a small one."""
    field = measure_displacement(pair[0], light * pair[1])
    inner = field.isel(row=slice(30, -30), column=slice(30, -30))
    e = inner.displacement_x.to_numpy() - motion(X, Y)[0][30:-30, 30:-30]
    assert rms(field) <= 0.006
    assert scores(field) <= 1.3
    assert np.sqrt(np.mean(e**2)) <= 0.004


def test_saturation_on_one_side(pair):
    """An exposure half as long again cuts off 13 % of the pixels."""
    f, g = pair[0].astype(np.uint16), np.clip(1.5 * pair[1], 0, 4095).astype(np.uint16)
    assert np.mean(g == 4095) > 0.1
    field = measure_displacement(f, g)
    assert rms(field) <= 0.004
    assert 0.9 <= scores(field) <= 1.25
    assert field.valid.mean() > 0.7


def test_dark_spots_at_the_end_of_the_range_are_measured(speckle):
    """Half a per cent of clipped pixels loses no point, nor do spots that contain nothing else."""
    surface = speckle(SHAPE, 303)
    images = surface.grey(), surface.grey(motion)
    for share in (0.005, 0.03):
        f, g = (np.clip(image, np.quantile(image, share), None) for image in images)
        field = measure_displacement(f.astype(np.uint16), g.astype(np.uint16))
        inner = field.isel(row=slice(20, -20), column=slice(20, -20))
        assert inner.valid.all()
        assert rms(field) <= 0.002


def test_saturated_ends_of_the_grey_levels():
    grey = np.random.default_rng(7).normal(2024, 300, SHAPE).astype(np.uint16)
    assert find_saturation(grey) == (-np.inf, np.inf)
    assert find_saturation(np.clip(grey, 0, 2450)) == (-np.inf, 2450)
    assert find_saturation(np.clip(grey, 1650, 4095)) == (1650, np.inf)
    assert find_saturation(np.where(grey > 2024, 255, 0).astype(np.uint8)) == (-np.inf, np.inf), (
        "an image of two levels"
    )
    assert find_saturation((grey // 256).astype(np.uint8)) == (-np.inf, np.inf), "an image of few levels"


def test_a_still_surface_beside_the_specimen(pair, other):
    """Points near the border between two motions are right or not measured: hardly any has the other side's motion."""
    still = X < 90
    moved = np.roll(pair[1], (-3, 2), axis=(0, 1))  # whole pixels: exact
    f, g = np.where(still, other, pair[0]), np.where(still, other, moved)
    exact = np.where(still, 0, np.stack(motion(X - 2, Y + 3)) + np.array([2.0, -3.0])[:, None, None])
    field = measure_displacement(f, g)
    e = np.abs(np.stack([field.displacement_x, field.displacement_y]) - exact)[:, 8:-8, 8:-8]
    away = np.abs(X - 90)[8:-8, 8:-8] > 16
    wrong = float(np.mean(e.max(axis=0) > 0.5))
    assert np.sqrt(np.nanmean(e[:, away] ** 2)) <= 0.02
    assert wrong <= 0.01


@pytest.mark.parametrize("noise", [0, 10])
def test_a_bare_patch_that_stands_still(pair, noise):
    bare = (X - 130) ** 2 + (Y - 100) ** 2 < 40**2
    generator = np.random.default_rng(5)
    moved = np.roll(pair[1], (-3, 2), axis=(0, 1))
    f, g = (np.where(bare, 2000 + noise * generator.standard_normal(SHAPE), image) for image in (pair[0], moved))
    field = measure_displacement(f, g)
    exact = np.stack(motion(X - 2, Y + 3)) + np.array([2.0, -3.0])[:, None, None]
    e = np.where(bare, np.nan, np.stack([field.displacement_x, field.displacement_y]) - exact)[:, 8:-8, 8:-8]
    assert np.sqrt(np.nanmean(e**2)) <= 0.006
    assert np.nanmax(abs(e)) <= 0.1


def test_glare(pair):
    distance2 = (X - 150) ** 2 + (Y - 100) ** 2
    field = measure_displacement(pair[0], np.clip(pair[1] + 6000 * np.exp(-distance2 / 200), 0, 4095))
    assert not field.valid.to_numpy()[distance2 < 12**2].any()
    away = field.where(distance2 > 45**2)
    assert rms(away) <= 0.005
    assert field.valid.mean() > 0.8


@pytest.mark.parametrize("what", ["another texture", "nothing"])
def test_patch_that_changed(pair, other, what):
    changed = pair[1].copy()
    changed[70:130, 90:170] = other[70:130, 90:170] if what == "another texture" else 2000
    field = measure_displacement(pair[0], changed)
    valid = field.valid.to_numpy()
    assert not valid[80:120, 100:160].any()
    kept = field.where((X < 75) | (X > 185) | (Y < 55) | (Y > 145))
    assert rms(kept) <= 0.004
    assert valid[:, :80].mean() > 0.9


@pytest.mark.parametrize("noise", [0, 10])
def test_a_bare_patch_is_not_measured(pair, noise):
    bare = (X - 130) ** 2 + (Y - 100) ** 2 < 40**2
    f, g = (
        np.where(bare, 2000 + noise * np.random.default_rng(k).standard_normal(SHAPE), image)
        for k, image in enumerate(pair)
    )
    valid = measure_displacement(f, g).valid.to_numpy()
    assert not valid[(X - 130) ** 2 + (Y - 100) ** 2 < 25**2].any()
    assert valid[:, :80].mean() > 0.9


@pytest.mark.parametrize(
    ("dtype", "scale", "limit"),
    [
        (np.uint8, 1 / 16, 0.004),
        (np.uint16, 16, 0.0035),
        (np.int32, 1, 0.0035),
        (np.float32, 1e-3, 0.0035),
        (np.float64, 1e3, 0.0035),
    ],
)
def test_pixel_types(pair, dtype, scale, limit):
    field = measure_displacement(*((image * scale).astype(dtype) for image in pair))
    assert rms(field) <= limit


def test_missing_pixels_of_the_deformed_image(pair):
    g = pair[1].copy()
    g[np.random.default_rng(4).random(SHAPE) < 0.002] = np.nan
    g[100:120, 60:90] = np.inf
    field = measure_displacement(pair[0], g)
    assert rms(field) <= 0.004
    assert not field.valid.to_numpy()[108:112, 70:80].any()
    assert field.valid.mean() > 0.8


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_scattered_missing_pixels(pair, share):
    """Single missing pixels of the deformed image are interpolated: neither points nor accuracy are lost."""
    g = pair[1].copy()
    g[np.random.default_rng(4).random(SHAPE) < share] = np.nan
    field = measure_displacement(pair[0], g)
    assert rms(field) <= 0.004
    assert field.valid.mean() > 0.85


def test_a_narrow_strip_is_measured(pair):
    mask = np.zeros(SHAPE, bool)
    mask[90:120] = True
    field = measure_displacement(pair[0], pair[1], mask=mask, window=16)
    assert rms(field) <= 0.01
    assert field.valid.to_numpy()[100:110, 20:-20].all()


@pytest.mark.parametrize("window", [8, 12, 16, 48])
def test_another_scene_is_refused_by_every_window(pair, other, window):
    with pytest.raises(CorrelationError, check=lambda e: e.code is ErrorCode.NO_CORRELATION):
        measure_displacement(pair[0], other, window=window)


def underexposed(seed, spots, contrast, width, noise_seed, moved=lambda x, y: (x, y)):
    """Few grey levels with rare bright spots, the exponential of a normal texture; `moved` leads back to its points."""
    size = (480, 640)
    texture = gaussian_filter(np.random.default_rng(seed).normal(size=(size[0] + 40, size[1] + 40)), width)
    row, column = np.mgrid[: size[0], : size[1]] + 20.0
    x, y = moved(column, row)
    grey = spots * np.exp(contrast * map_coordinates(texture / texture.std(), [y, x], order=3))
    noisy = grey + np.random.default_rng(noise_seed).normal(0, 0.4, size)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def compressed(image, quality):
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize(
    ("look", "quality"), [((0.3, 1.6, 1.7), 30), ((0.25, 1.5, 2.5), 40), ((0.6, 1.0, 2.5), 30), ((0.6, 1.0, 2.5), 40)]
)
def test_blocks_of_dark_jpeg_images_are_no_texture(look, quality):
    """Blocks of different scenes agree with one another, and dark surroundings without the spots."""
    images = (compressed(underexposed(seed, *look, noise_seed=seed), quality) for seed in (430, 1430))
    with pytest.raises(CorrelationError, check=lambda e: e.code is ErrorCode.NO_CORRELATION):
        measure_displacement(*images, spacing=4)


def test_a_dark_jpeg_image_that_moved_is_measured():
    look = (0.3, 1.6, 1.7)
    first = compressed(underexposed(5, *look, noise_seed=1), 90)
    second = compressed(underexposed(5, *look, noise_seed=2, moved=lambda x, y: (x - 1.7, y - 0.4)), 90)
    field = measure_displacement(first, second, spacing=4)
    for name, exact in (("displacement_x", 1.7), ("displacement_y", 0.4)):
        error = field[name] - exact
        assert abs(float(error.median())) < 0.05
        assert float((abs(error) > 5 * field["sigma" + name[-2:]]).sum() / field.valid.sum()) < 0.01
    assert field.valid.mean() > 0.4


few = settings(
    max_examples=6, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
SMALL = np.s_[40:136, 40:152]


def field_of(f, g):
    found = measure_displacement(f, g, window=16)
    return found.displacement_x.to_numpy(), found.displacement_y.to_numpy()


def close(a, b, within):
    """Both measured at nearly the same points, and equal there."""
    both = np.isfinite(a) & np.isfinite(b)
    assert both.mean() > 0.8
    assert abs(np.isfinite(a).mean() - np.isfinite(b).mean()) < 0.02
    assert np.abs(a - b)[both].max() < within


@few
@given(st.integers(0, 1000))
def test_swapping_axes_swaps_components(speckle, seed):
    surface = speckle((96, 112), seed, margin=20)
    f, g = surface.image(noise=5, seed=1), surface.image(motion, noise=5, seed=2)
    x, y = field_of(f, g)
    swapped_x, swapped_y = field_of(f.T, g.T)
    close(x, swapped_y.T, 0.002)
    close(y, swapped_x.T, 0.002)


@few
@given(st.integers(0, 1000))
def test_flipping_columns_turns_the_sign_of_x(speckle, seed):
    surface = speckle((96, 112), seed, margin=20)
    f, g = surface.image(noise=5, seed=1), surface.image(motion, noise=5, seed=2)
    x, y = field_of(f, g)
    flipped_x, flipped_y = field_of(f[:, ::-1], g[:, ::-1])
    close(x, -flipped_x[:, ::-1], 0.002)
    close(y, flipped_y[:, ::-1], 0.002)


@few
@given(st.integers(0, 1000))
def test_flipping_rows_turns_the_sign_of_y(speckle, seed):
    surface = speckle((96, 112), seed, margin=20)
    f, g = surface.image(noise=5, seed=1), surface.image(motion, noise=5, seed=2)
    x, y = field_of(f, g)
    flipped_x, flipped_y = field_of(f[::-1], g[::-1])
    close(x, flipped_x[::-1], 0.002)
    close(y, -flipped_y[::-1], 0.002)


@few
@given(st.floats(0.1, 50), st.floats(-1e4, 1e4))
def test_grey_levels_may_be_scaled_and_shifted(pair, factor, offset):
    f, g = pair[0][SMALL], pair[1][SMALL]
    x, y = field_of(f, g)
    scaled_x, scaled_y = field_of(factor * f + offset, factor * g + offset)
    close(x, scaled_x, 0.001)
    close(y, scaled_y, 0.001)


@few
@given(st.integers(-12, 12), st.integers(-12, 12))
def test_whole_pixel_translation_adds_to_the_displacement(pair, dx, dy):
    """Cutting the deformed image elsewhere moves it by whole pixels and changes nothing else."""
    f, g = pair[0][SMALL], pair[1][SMALL]
    moved = pair[1][40 - dy : 136 - dy, 40 - dx : 152 - dx]
    x, y = field_of(f, g)
    moved_x, moved_y = field_of(f, moved)
    both = np.isfinite(x) & np.isfinite(moved_x)
    assert both.mean() > 0.5
    inner = np.zeros_like(both)
    inner[28:-28, 28:-28] = True
    assert np.abs(moved_x - x - dx)[both & inner].max() < 0.003
    assert np.abs(moved_y - y - dy)[both & inner].max() < 0.003
