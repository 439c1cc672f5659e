"""First-order changes of a model's maps against those of a model that is moved."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from fringedic.models.sensitivity import Sensitivity
from fringedic.surface import surface_strain

X, Y = np.meshgrid(1e-3 * np.arange(-30.0, 31.0), 1e-3 * np.arange(25.0, -26.0, -1))
CENTRE = np.array([2e-3, -1e-3, 0.5e-3])


def height(x, y):
    return 5 * x**2 + 3 * x * y + 2e-3 * np.sin(40 * y)


def motion(x, y):
    """Tension and bending with a large rotation [m]."""
    return np.stack([0.02 * x + 0.1 * y + x * y, -0.1 * x + 0.01 * y + 0.5 * x**2, 0.15 * x + 2 * x * y])


def seen(step):
    """Return the displacement at the points when the model has moved by a step (6,), and its height."""
    turn = Rotation.from_rotvec(step[3:]).as_matrix()
    z = height(X, Y)
    for _ in range(30):
        own = np.einsum("ji,jrc->irc", turn, np.stack([X, Y, z]) - (CENTRE + step[:3])[:, None, None])
        own += CENTRE[:, None, None]
        z = z + height(own[0], own[1]) - own[2]
    return np.einsum("ij,jrc->irc", turn, motion(own[0], own[1]))


def strain(displacement):
    fields = dict(zip("xyzuvw", (X, Y, height(X, Y), *displacement), strict=True))
    cloud = xr.Dataset(
        {name: (("row", "column"), each) for name, each in fields.items()},
        {"row": np.arange(51), "column": np.arange(61)},
    )
    found = surface_strain(cloud, window=3)
    return np.stack([found[name].values for name in ("e_11", "e_22", "e_12")])


@pytest.mark.parametrize("axis", range(6))
def test_changes_are_those_of_a_moved_model(axis: int):
    step = np.zeros(6)
    step[axis] = 1e-4 if axis < 3 else 2e-3
    before, after = seen(np.zeros(6)), seen(step)
    sensitivity = Sensitivity(np.stack([X, Y, height(X, Y)]), before, CENTRE)
    change = sensitivity.displacement(step)
    assert np.abs(change - (after - before)).max() < 0.02 * np.abs(after - before).max() + 1e-9
    true = (strain(after) - strain(before))[:, 2:-2, 2:-2]
    assert np.abs(sensitivity.strain(change)[:, 2:-2, 2:-2] - true).max() < 0.03 * np.abs(true).max() + 1e-7
