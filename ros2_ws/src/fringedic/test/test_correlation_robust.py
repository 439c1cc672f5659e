"""Light, glare, patches that changed, pixel types and symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fringedic.correlation import measure_displacement
from fringedic.errors import NoCorrelationError

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
    ("name", "light", "limit"),
    [
        ("none", lambda g: g, 0.0035),
        ("darker", lambda g: 0.6 * g + 300, 0.0035),
        ("brighter, 1.5 % saturated", lambda g: np.clip(1.3 * g - 300, 0, 4095), 0.0045),
        ("shading 0.5 to 1.5", lambda g: g * (0.5 + X / SHAPE[1]), 0.006),
        ("offset gradient", lambda g: g + 800 * Y / SHAPE[0], 0.0045),
    ],
)
def test_change_of_light(pair, name, light, limit):
    field = measure_displacement(pair[0], light(pair[1]))
    print(f"light: {name}: RMSE {rms(field):.4f} px (at most {limit}), valid {float(field.valid.mean()):.3f}")
    assert rms(field) <= limit
    assert field.valid.mean() > 0.9


def test_glare(pair):
    distance2 = (X - 150) ** 2 + (Y - 100) ** 2
    field = measure_displacement(pair[0], np.clip(pair[1] + 6000 * np.exp(-distance2 / 200), 0, 4095))
    assert not field.valid.to_numpy()[distance2 < 12**2].any()
    away = field.where(distance2 > 45**2)
    print(f"glare: RMSE {rms(away):.4f} px away from it (at most 0.005)")
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
    print(f"patch with {what}: RMSE {rms(kept):.4f} px elsewhere (at most 0.004)")
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


@pytest.mark.parametrize("window", [8, 12, 16, 48])
def test_another_scene_is_refused_by_every_window(pair, other, window):
    with pytest.raises(NoCorrelationError):
        measure_displacement(pair[0], other, window=window)


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
