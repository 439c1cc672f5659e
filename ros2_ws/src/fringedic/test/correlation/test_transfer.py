"""Transfer function of both methods: against measured waves, noise gain and correlation of errors."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.correlation.measure import measure_displacement
from fringedic.correlation.transfer import (
    error_correlation,
    noise_gain,
    noise_transfer,
    shortest_period,
    transfer_function,
)
from fringedic.errors import CorrelationError

METHODS = ("dense", "zoi")


@pytest.mark.parametrize(("method", "kept"), [("dense", 0.9), ("dense", 0.7), ("dense", 0.5), ("zoi", 0.9)])
def test_waves_keep_what_the_transfer_function_states(speckle, method, kept):
    """Mean over textures and components: single ones of the dense method differ by some percent around the cut-off."""
    period = shortest_period(32, method, kept=kept)

    def wave(x, _y):
        return (0.1 * np.sin(2 * np.pi * x / period),) * 2

    amplitudes = []
    for radius in (1.0, 1.4):
        surface = speckle((128, 320), 401, radius=radius)
        field = measure_displacement(surface.image(), surface.image(wave), window=32, spacing=4, method=method)
        inner = field.isel(row=slice(10, -10), column=slice(10, -10))
        phase = 2 * np.pi * inner.column.values / period
        basis = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
        rows = np.stack([inner.displacement_x.mean("row"), inner.displacement_y.mean("row")], axis=1)
        amplitudes.append(np.linalg.lstsq(basis, rows, rcond=None)[0][0])
    assert np.mean(amplitudes) / 0.1 == pytest.approx(kept, abs=0.02)


@pytest.mark.parametrize("kept", [0.5, 0.7])
def test_unresolved_waves_are_no_outliers(speckle, kept):
    """Without noise, in a small part of the image: the displacement that the window leaves there is no outlier."""
    period = shortest_period(32, kept=kept)
    surface = speckle((96, 480), 77)

    def wave(x, y):
        return np.where(x < 160, 0.5 * np.sin(2 * np.pi * x / period), 0), 0 * y

    field = measure_displacement(surface.image(), surface.image(wave), window=32, spacing=2)
    inner = field.isel(row=slice(10, -10)).sel(column=slice(20, 130)).displacement_x
    assert inner.notnull().all()
    phase = 2 * np.pi * inner.column.values / period
    basis = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
    amplitude = np.linalg.lstsq(basis, inner.mean("row").values, rcond=None)[0][0]
    assert amplitude / 0.5 == pytest.approx(kept, abs=0.08)


@pytest.mark.parametrize("method", METHODS)
def test_transfer_decreases_and_its_square_is_the_spectrum_of_the_noise(method):
    frequency = np.linspace(0, 0.1, 500)
    kept = transfer_function(frequency, 32, method)
    assert kept[0] == pytest.approx(1)
    period = shortest_period(32, method)
    assert transfer_function(1 / period, 32, method) == pytest.approx(0.9, abs=1e-3)
    assert (transfer_function(frequency[frequency < 1 / period], 32, method) > 0.899).all()
    # waves along one axis: the correlation summed over the lags along the other one
    lags = error_correlation(32, method, 160)
    along = lags[0] + 2 * lags[1:].sum(axis=0)
    spectrum = along[0] + 2 * np.cos(2 * np.pi * np.outer(frequency, np.arange(1, 161))) @ along[1:]
    np.testing.assert_allclose(spectrum / spectrum[0], noise_transfer(frequency, 32, method) ** 2, atol=2e-3)


@pytest.mark.parametrize("window", [16, 32, 64])
def test_both_methods_have_the_same_noise_gain(window):
    assert noise_gain(window, "dense") == pytest.approx(noise_gain(window, "zoi"), rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_correlation_of_errors(method):
    lags = error_correlation(32, method)
    assert lags.shape == (65, 65)
    assert lags[0, 0] == pytest.approx(1)
    assert np.allclose(lags, lags.T, atol=1e-12)
    assert lags[0, 4] > 0.7
    assert abs(lags[0, 60]) < 0.05


@pytest.mark.parametrize("function", [error_correlation, noise_gain, shortest_period])
def test_unknown_method_is_refused(function):
    with pytest.raises(CorrelationError, match="'dense' or 'zoi'"):
        function(32, "pixels")
