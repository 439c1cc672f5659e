"""The model's displacement is filtered as the measurement filters that of the surface."""

from __future__ import annotations

import numpy as np
import pytest

import fringedic
from fringedic.correlation import shortest_period
from fringedic.correlation.transfer import noise_transfer
from fringedic.models.levelling import Levelling
from fringedic.models.rendering import measure_rendered

ROW, COLUMN = np.meshgrid(np.arange(0, 400, 4.0), np.arange(0, 480, 4.0), indexing="ij")


@pytest.mark.parametrize("method", ["dense", "zoi"])
def test_waves_keep_the_share_of_the_fixed_point(method):
    filters = Levelling(32, method, 3.0, 0, 4)
    period = shortest_period(32, method)
    wave = np.sin(2 * np.pi * COLUMN / period)
    found = filters.displacement(np.stack([wave, wave.copy(), wave.copy()]))[:, 30:70, 30:90]
    kept = [np.sum(each * wave[30:70, 30:90]) / np.sum(wave[30:70, 30:90] ** 2) for each in found]
    assert kept[:2] == pytest.approx(2 * [float(noise_transfer(1 / period, 32, method))], abs=0.005)
    assert kept[2] == pytest.approx(np.exp(-2 * (np.pi * 3.0 / period) ** 2), abs=0.005)


def test_a_uniform_displacement_is_not_changed_at_edges():
    hole = np.hypot(COLUMN - 240, ROW - 200) < 60
    maps = np.where(hole, np.nan, np.full((3, *ROW.shape), 0.25))
    found = Levelling(32, "dense", 2.0, 0, 4).displacement(maps)
    assert np.array_equal(np.isnan(found[0]), hole)
    assert np.nanmax(np.abs(found - maps)) < 1e-6


@pytest.mark.parametrize("method", ["dense", "zoi"])
def test_a_linear_displacement_is_not_changed_at_edges(method):
    hole = np.hypot(COLUMN - 240, ROW - 200) < 60
    true = np.stack([0.05 * COLUMN - 0.02 * ROW, 0.01 * ROW, 0.1 * COLUMN + 0.2 * ROW])
    found = Levelling(32, method, 6.0, 41, 4).displacement(np.where(hole, np.nan, true))
    assert np.array_equal(np.isnan(found[0]), hole)
    assert np.nanmax(np.abs(found - true)) < 1e-5  # the precision of float32 at 120 px


def test_levelled_displacement_is_closer_to_the_measured_one_at_a_hole(speckle):
    """An image pair whose displacement falls off from a hole: the filter predicts most of the loss."""
    surface = speckle((240, 240), seed=3)
    mask = np.hypot(*(np.mgrid[:240, :240] - 120.0)) >= 40

    def motion(x, y):
        distance = np.maximum(np.hypot(x - 120, y - 120), 38.0)
        return 2.0 * (40 / distance) ** 3 * (x - 120) / distance, 0 * x

    measured = fringedic.measure_displacement(
        surface.image(noise=8, seed=1), surface.image(motion, noise=8, seed=2), window=32, spacing=4, mask=mask
    ).displacement_x.values
    x, y = np.meshgrid(*2 * [np.arange(0, 240, 4.0)])
    true = np.where(np.isfinite(measured), motion(x, y)[0], np.nan)
    levelled = Levelling(32, "dense", 0.0, 0, 4).displacement(np.stack([true] * 3))[0]
    near = (np.hypot(x - 120, y - 120) < 60) & np.isfinite(measured)
    image, points = surface.image(noise=8, seed=1).astype(float), (np.arange(0, 240, 4), np.arange(0, 240, 4))
    rendered = measure_rendered(image, points, np.stack([true, 0 * true]), window=32, method="dense")[0]
    raw, filtered, full = (np.sqrt(np.nanmean((measured - each)[near] ** 2)) for each in (true, levelled, rendered))
    assert filtered < 0.7 * raw
    assert full < 0.75 * filtered
