"""Strain of scenes with a closed form, against the exact finite strain at each point."""

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import minimum_filter

from fringedic.surface import surface_strain

WINDOW, SPACING, PIXEL = 85, 4, 50e-6
STRAINS = {"e_11": (0, 0), "e_22": (1, 1), "e_12": (0, 1)}


def cloud(x: np.ndarray, y: np.ndarray, z: np.ndarray, *moved: np.ndarray) -> xr.Dataset:
    fields = dict(zip("xyzuvw", (x, y, z, *moved), strict=True))
    axes = {name: SPACING * np.arange(size, dtype=float) for name, size in zip(("row", "column"), x.shape, strict=True)}
    return xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()}, axes)


def grid(half_width: float) -> tuple[np.ndarray, np.ndarray]:
    positions = (
        SPACING * PIXEL * np.arange(-round(half_width / SPACING / PIXEL), round(half_width / SPACING / PIXEL) + 1)
    )
    x, y = np.meshgrid(positions, -positions)
    return x, y


def cylinder(radius: float, tilt: float, load: str) -> tuple[xr.Dataset, np.ndarray]:
    """Return a cylinder up to a slope of 45 degree, its axis at an angle from y, and its strain in t1, t2."""
    axis, across = np.array([np.sin(tilt), np.cos(tilt), 0]), np.array([np.cos(tilt), -np.sin(tilt), 0])
    x, y = grid(min(radius, 15e-3))
    s, along = x * across[0] + y * across[1], x * axis[0] + y * axis[1]
    seen = np.abs(s) < radius * np.sin(np.pi / 4)
    angle = np.arcsin(np.where(seen, s, np.nan) / radius)
    if load == "torsion":
        twist = 0.01 / radius
        gradient = np.array([[1, twist * radius], [0, 1]])
        angle_after, along_after, radius_after = angle + twist * along, along, radius
    else:
        gradient = np.diag([1 - 0.3 * 0.005, 1.005])
        angle_after, along_after, radius_after = angle, 1.005 * along, (1 - 0.3 * 0.005) * radius
    z = radius * (np.cos(angle) - 1)
    after = radius_after * np.sin(angle_after)[..., None] * across + along_after[..., None] * axis
    moved = (after[..., 0] - x, after[..., 1] - y, radius_after * np.cos(angle_after) - radius - z)
    # the frame t1, t2 of each point, in the directions of circumference and axis
    circumference = np.stack([*(np.cos(angle) * each for each in across[:2]), -np.sin(angle)], axis=-1)
    normal = np.cross(circumference, axis)
    t1 = np.stack([normal[..., 2], 0 * x, -normal[..., 0]], axis=-1)
    t1 /= np.linalg.norm(t1, axis=-1, keepdims=True)
    basis = np.stack(
        [[(each * circumference).sum(axis=-1), each @ axis] for each in (t1, np.cross(normal, t1))]
    )  # t, direction, row, column
    strain = (gradient.T @ gradient - np.eye(2)) / 2
    return cloud(x, y, z, *moved), np.einsum("ikrc,kl,jlrc->ijrc", basis, strain, basis)


@pytest.mark.parametrize("load", ["torsion", "tension"])
@pytest.mark.parametrize("tilt", [0, 30, 45])
@pytest.mark.parametrize(("radius", "at_the_edge"), [(15e-3, 0.04), (30e-3, 0.002), (100e-3, 0.0001)])
def test_bias_of_the_strain_of_a_cylinder(radius: float, at_the_edge: float, tilt: int, load: str) -> None:
    """At most 0.1 % of the largest component where windows and second derivatives have points on all sides."""
    scene, exact = cylinder(radius, np.deg2rad(tilt), load)
    found = surface_strain(scene, window=WINDOW)
    half = round((WINDOW - 1) / 2 / SPACING)
    whole, inner = (
        minimum_filter(np.isfinite(scene.z.values), size=2 * reach + 1, mode="constant") for reach in (half, 2 * half)
    )
    largest = np.nanmax(np.abs(exact))
    for name, place in STRAINS.items():
        error = np.abs(found[name].values - exact[place]) / largest
        assert np.nanmax(error[inner]) < 0.001, name
        assert np.nanmax(error[whole]) < 0.0013, name
        assert np.nanmax(error) < at_the_edge, name


def test_bending_without_strain() -> None:
    """A cylinder that opens from a radius of 30 mm to 40 mm keeps all lengths."""
    x, y = grid(12e-3)
    angle = np.arcsin(x / 30e-3)
    u, w = 40e-3 * np.sin(angle * 0.75) - x, 40e-3 * (np.cos(angle * 0.75) - 1) - 30e-3 * (np.cos(angle) - 1)
    found = surface_strain(cloud(x, y, 30e-3 * (np.cos(angle) - 1), u, 0 * x, w), window=WINDOW)
    assert np.nanmax(np.abs(found.e_11)) < 20e-6, "the bending of the window alone is 200 µstrain"
