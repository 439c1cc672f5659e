"""The zone method measures nothing where the texture has no or one direction only (the aperture problem)."""

import numpy as np
import pytest

import fringedic
from fringedic.errors import CorrelationError

SHAPE = (96, 96)
WINDOW = 24


def texture(direction, seed=3):
    """Smooth grey levels that vary along one direction only, or along both."""
    generator = np.random.default_rng(seed)
    column, row = np.meshgrid(np.arange(SHAPE[1] + 8.0), np.arange(SHAPE[0] + 8.0))
    grey = np.full(column.shape, 128.0)
    for _ in range(24):
        along = generator.uniform(0.2, 1.2) * generator.choice([-1, 1])
        across = generator.uniform(0.2, 1.2) * generator.choice([-1, 1])
        angle = {
            "x": along * column,
            "y": along * row,
            "45": along * (row + column),
            "both": along * column + across * row,
        }
        grey += 8 * np.cos(angle[direction] + generator.uniform(0, 2 * np.pi))
    return grey


def seen(grey, dx, dy, noise, seed):
    view = grey[4 - dy : 4 - dy + SHAPE[0], 4 - dx : 4 - dx + SHAPE[1]]
    return np.clip(np.rint(view + np.random.default_rng(seed).normal(0, noise, SHAPE)), 0, 255).astype(np.uint8)


def measure(grey, noise):
    return fringedic.measure_displacement(
        seen(grey, 0, 0, noise, 1), seen(grey, 1, 1, noise, 2), window=WINDOW, spacing=8, method="zoi"
    )


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("direction", ["x", "y", "45"])
def test_texture_of_one_direction(direction, noise):
    with pytest.raises(CorrelationError, match="texture"):
        measure(texture(direction), noise)


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_area_of_one_grey_level_in_a_good_texture(noise):
    grey = texture("both")
    grey[20:80, 20:80] = 128.0
    field = measure(grey, noise)
    inside = np.ix_(
        (field.row > 20 + WINDOW // 2) & (field.row < 72 - WINDOW // 2), (field.column > 32) & (field.column < 60)
    )
    assert not field.valid.values[inside].any()
    for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y"):
        assert np.isnan(field[name].values[inside]).all()
    error = np.hypot(field.displacement_x - 1, field.displacement_y - 1)
    assert field.valid.sum() > 10
    assert float(error.max()) < 0.6


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_texture_of_both_directions_is_measured_everywhere(noise):
    field = measure(texture("both"), noise)
    whole = (field.row > WINDOW) & (field.row < 72) & (field.column > WINDOW) & (field.column < 72)
    assert bool(field.valid.where(whole, True).all())
    assert float(np.hypot(field.displacement_x - 1, field.displacement_y - 1).where(whole).max()) < 0.1
