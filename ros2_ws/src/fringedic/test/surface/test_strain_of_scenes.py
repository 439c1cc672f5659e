"""Strain of scenes with a closed form, against the exact finite strain at each point."""

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import minimum_filter

from fringedic.correlation.transfer import error_correlation
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


def correlated_noise(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance with the correlation of the displacement over its window of 32 px."""
    size = 1024
    around = np.abs(np.fft.fftfreq(size, 1 / size)).astype(int)
    spectrum = np.fft.fft2(error_correlation(32, "dense", size // 2)[np.ix_(around, around)]).real
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * np.sqrt(np.maximum(spectrum, 0))).real
    return noise[: shape[0] * SPACING : SPACING, : shape[1] * SPACING : SPACING]


def noisy(scene: xr.Dataset, noise_px: float, seed: int) -> xr.Dataset:
    """Return a flat scene with noise of the in-plane displacement, seen from far away."""
    rng, known = np.random.default_rng(seed), xr.ones_like(scene.x)
    fields = {name: scene[name] + noise_px * PIXEL * correlated_noise(scene.x.shape, rng) for name in "uv"}
    fields |= dict.fromkeys(("sigma_u", "sigma_v"), noise_px * PIXEL * known)
    fields |= dict.fromkeys(("displacement_sigma_x", "displacement_sigma_y"), noise_px * known)
    fields |= dict.fromkeys(("sigma_w", "noise_z", "noise_z_deformed"), 0 * known)
    attributes = {"displacement_window_px": 32, "z_filter_px": 2.0, "camera_distance": 600.0}
    return scene.assign(fields).assign_attrs(attributes)


def plate_with_a_hole(
    radius: float = 5e-3, far: float = 3000e-6, poisson: float = 0.3
) -> tuple[xr.Dataset, np.ndarray]:
    """Return a plate with a hole in tension along x (Kirsch 1898, plane stress), and its strain.

    At the edge of the hole the strain along the load is three times that far away.
    """

    def displacement(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r, t = np.maximum(np.hypot(x, y) / radius, 0.5), np.arctan2(y, x)
        k, size = (3 - poisson) / (1 + poisson), far * radius * (1 + poisson) / 2
        radial = r * (k - 1) / 2 + r * np.cos(2 * t) + (1 + (1 + k) * np.cos(2 * t)) / r - np.cos(2 * t) / r**3
        around = ((1 - k) / r - r - 1 / r**3) * np.sin(2 * t)
        return size * np.stack([radial * np.cos(t) - around * np.sin(t), radial * np.sin(t) + around * np.cos(t)])

    x, y = grid(15e-3)
    half = 1e-8
    by_x, by_y = (
        (displacement(x + a, y + b) - displacement(x - a, y - b)) / (2 * half) for a, b in ((half, 0), (0, half))
    )
    inside = np.hypot(x, y) < radius
    u, v = np.where(inside, np.nan, displacement(x, y))
    strain = np.array(
        [
            [by_x[0] + 0.5 * (by_x**2).sum(axis=0), 0.5 * (by_y[0] + by_x[1] + (by_x * by_y).sum(axis=0))],
            [0.5 * (by_y[0] + by_x[1] + (by_x * by_y).sum(axis=0)), by_y[1] + 0.5 * (by_y**2).sum(axis=0)],
        ]
    )
    return cloud(x, y, 0 * x, u, v, 0 * x), strain


def test_resolution_beside_a_hole() -> None:
    """With the expected smoothing error the error against the exact strain is of the size that is stated."""
    scene, exact = plate_with_a_hole()
    seen = np.isfinite(scene.u.values)
    assert exact[0, 0][seen].max() == pytest.approx(9040e-6, rel=1e-3), "three times the strain far away"
    found = surface_strain(noisy(scene, 0.005, 3), window=WINDOW)
    distance = np.hypot(scene.x.values, scene.y.values)
    inside = (np.abs(scene.x.values) < 12.5e-3) & (np.abs(scene.y.values) < 12.5e-3)
    for name, place in STRAINS.items():
        error, sigma, resolution = (
            each.values[inside]
            for each in (found[name] - exact[place], found[f"sigma_{name}"], found[f"resolution_{name}"])
        )
        assert np.sqrt(np.nanmean((error / sigma) ** 2)) > 3, "noise alone does not explain the error"
        score = (error / np.hypot(sigma, resolution))[np.isfinite(error)]
        assert 0.6 < np.sqrt(np.mean(score**2)) < 1.25, name
        assert np.mean(np.abs(score) < 2) > 0.94, name
        assert np.array_equal(np.isfinite(error), np.isfinite(resolution))
    largest = found.resolution_e_11.where(distance < 6e-3).max()
    assert 500e-6 < largest < 5000e-6


def test_resolution_of_a_uniform_strain_is_small() -> None:
    """Noise is not taken for smoothing."""
    x, y = grid(15e-3)
    found = surface_strain(noisy(cloud(x, y, 0 * x, 1e-3 * x, -3e-4 * y, 0 * x), 0.005, 4), window=WINDOW)
    for name in STRAINS:
        ratio = found[f"resolution_{name}"] / found[f"sigma_{name}"]
        assert ratio.median() == 0
        assert np.sqrt((ratio**2).mean()) < 0.5


def test_resolution_of_a_wave_is_what_the_window_takes_from_it() -> None:
    """Too large along the component by the ratio of the second moments of a mean and of a slope, 5/3."""
    x, y = grid(15e-3)
    period, amplitude = 12e-3, 1e-3
    u = -amplitude * period / (2 * np.pi) * np.cos(2 * np.pi * x / period)
    found = surface_strain(noisy(cloud(x, y, 0 * x, u, 0 * x, 0 * x), 1e-6, 5), window=WINDOW)
    error = found.e_11 - amplitude * np.sin(2 * np.pi * x / period)
    inner = {"row": slice(30, -30), "column": slice(30, -30)}
    sizes = [float(np.sqrt((each[inner] ** 2).mean())) for each in (found.resolution_e_11, error)]
    assert 1.0 < sizes[0] / sizes[1] < 2.0
