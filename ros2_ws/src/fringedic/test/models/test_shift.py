"""A feature in the wrong place is found from the displacement, with its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fringedic.models.shift import Shift, estimate_shift

X, Y = np.meshgrid(np.linspace(-20e-3, 20e-3, 120), np.linspace(15e-3, -15e-3, 90))
SURFACE = np.stack([X, Y, 2e-3 * np.cos(60 * X)])
SIGMA = 0.3e-6


def around_a_hole(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement (u, v) [m]: tension along y, and a part that decreases from a hole."""
    decrease = 40e-6 / (1 + (x**2 + y**2) / (5e-3) ** 2)
    return np.stack([-4e-4 * x + decrease * x / 5e-3, 1.2e-3 * y + 2 * decrease * y / 5e-3])


def noise(seed: int) -> np.ndarray:
    white = np.random.default_rng(seed).normal(size=(2, *X.shape))
    return SIGMA * 2 * np.sqrt(np.pi) * 1.5 * gaussian_filter(white, (0, 1.5, 1.5), mode="wrap")


def found(true: np.ndarray, modelled: np.ndarray, seed: int) -> Shift:
    difference = true - modelled + noise(seed)
    return estimate_shift(SURFACE, [0, 1], modelled, difference, np.full(modelled.shape, SIGMA))


def test_a_shifted_hole_is_found_within_its_uncertainty_beside_a_rigid_motion_and_another_modulus():
    rigid = np.stack([5e-6 - 2e-4 * Y, -3e-6 + 2e-4 * X])
    modelled, true = around_a_hole(X, Y), 1.02 * around_a_hole(X - 0.2e-3, Y + 0.1e-3) + rigid
    shifts = [found(true, modelled, seed) for seed in range(12)]
    scores = [
        np.array([(s.shift_x - 0.2e-3) / s.sigma_shift_x, (s.shift_y + 0.1e-3) / s.sigma_shift_y]) for s in shifts
    ]
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4  # 24 normal values: 1 +- 0.15
    assert max(s.sigma_shift_x for s in shifts) < 0.05e-3


def test_a_uniform_strain_determines_no_shift():
    uniform = np.stack([-4e-4 * X, 1.2e-3 * Y])
    assert np.isnan([*vars(found(uniform, uniform, 1)).values()]).all()


def test_a_displacement_that_varies_along_y_determines_a_shift_along_y():
    wave = np.stack([0 * X, 20e-6 * np.sin(300 * Y) + 1e-3 * X])
    shift = found(np.stack([0 * X, 20e-6 * np.sin(300 * (Y - 0.1e-3)) + 1e-3 * X]), wave, 1)
    assert np.isnan(shift.shift_x)
    assert shift.shift_y == pytest.approx(0.1e-3, abs=3 * shift.sigma_shift_y)
