"""Strain beside a discontinuity of the surface: windows contain the points of one side only."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter, label, uniform_filter1d

from fringedic.correlation import measure_displacement
from fringedic.surface import surface_strain
from fringedic.surface.discontinuities import find_discontinuities
from fringedic.surface.planes import fit_planes

PIXEL = 50e-6
STRAIN = 0.004
SHAPE = (140, 300)
MIDDLE = 150


def flat_cloud(displacement: xr.Dataset, height: np.ndarray | None = None) -> xr.Dataset:
    """A surface seen from far above, as `couple` gives it."""
    column, row = np.meshgrid(displacement.column.values.astype(float), displacement.row.values.astype(float))
    zero = np.zeros(column.shape)
    fields = {
        "x": PIXEL * column,
        "y": -PIXEL * row,
        "z": zero if height is None else height,
        "u": PIXEL * displacement.displacement_x.values,
        "v": -PIXEL * displacement.displacement_y.values,
        "w": zero,
        "sigma_u": PIXEL * displacement.sigma_x.values,
        "sigma_v": PIXEL * displacement.sigma_y.values,
        "displacement_sigma_x": displacement.sigma_x.values,
        "displacement_sigma_y": displacement.sigma_y.values,
        **dict.fromkeys(("sigma_w", "noise_z", "noise_z_deformed"), zero + 1e-06),
    }
    return xr.Dataset(
        {name: (("row", "column"), values) for name, values in fields.items()},
        {name: displacement[name] for name in ("row", "column")},
        {"camera_distance": 0.5, "z_filter_px": 2.0, "displacement_window_px": 32, "displacement_method": "dense"},
    )


def known_displacement(along_x: np.ndarray, sigma: float) -> xr.Dataset:
    fields = {"displacement_x": along_x, "displacement_y": 0 * along_x}
    fields |= {"sigma_x": np.full(along_x.shape, sigma), "sigma_y": np.full(along_x.shape, sigma)}
    rows, columns = (4 * np.arange(length) for length in along_x.shape)
    return xr.Dataset(
        {name: (("row", "column"), each) for name, each in fields.items()}, {"row": rows, "column": columns}
    )


@pytest.mark.parametrize("opening", [1.0, 3.0])
def test_strain_beside_a_crack(speckle, expose, opening: float) -> None:
    """A plate under 0.4 % strain whose crack opens by some pixels, through images."""
    surface = speckle(SHAPE, 5)

    def half(side: int) -> np.ndarray:
        return surface.grey(lambda x, y: (STRAIN * (x - MIDDLE) + side * opening / 2, -0.3 * STRAIN * y))

    column = np.arange(float(SHAPE[1]))
    inside = np.abs(column - MIDDLE) <= opening / 2
    cracked = np.where(inside, 500.0, np.where(column < MIDDLE, half(-1), half(1)))
    measured = measure_displacement(expose(surface.grey(), 10, 1), expose(cracked, 10, 2), spacing=4)
    strain = surface_strain(flat_cloud(measured), window=61)
    error = 1e6 * (strain.e_11 - STRAIN - STRAIN**2 / 2).values[12:-12]
    distance = np.abs(measured.column.values - MIDDLE)
    crossed = error[:, distance <= 40]
    beside = error[:, (distance >= 34) & (distance <= 60)]
    words = f"{np.sqrt(np.nanmean(crossed**2)):.0f} µstrain RMS within 40 px of a crack of {opening} px, "
    words += f"{1e6 * opening / 61:.0f} if windows reached across; {np.isfinite(beside).mean():.2f} measured beside it"
    assert np.sqrt(np.nanmean(crossed**2)) < 400, words
    assert np.isfinite(beside).mean() > 0.75, words
    assert np.isnan(error[:, distance <= 6]).all(), words


def test_a_discontinuity_ends_where_the_crack_closes() -> None:
    """A crack open by 2 px at the edge of the plate and closed in its middle; each side has its own strain."""
    row, column = np.meshgrid(4.0 * np.arange(70), 4.0 * np.arange(80), indexing="ij")
    opening = 2.0 * np.clip(1 - row / 180, 0, None) ** 2
    side = np.where(column < 160, -0.5, 0.5) * (1 - np.abs(column - 160) / 160)
    cloud = flat_cloud(known_displacement(STRAIN * column + opening * side, 0.002))
    found = find_discontinuities(cloud)
    assert found[:20, 38:42].any(axis=1).all()
    assert not found[45:].any()
    slope = STRAIN - uniform_filter1d(opening, 17, axis=0) / 320  # mean over the window of 61 px: 17 points
    error = 1e6 * np.abs(surface_strain(cloud, window=61).e_11.values - slope - slope**2 / 2)[8:16]
    assert np.nanmax(error) < 20, f"{np.nanmax(error):.2f} µstrain beside the crack"
    assert np.isfinite(error[:, 8:33]).all()


def test_a_step_of_the_height_is_a_discontinuity_and_a_hole_is_none() -> None:
    row, column = np.meshgrid(4.0 * np.arange(60), 4.0 * np.arange(80), indexing="ij")
    smooth = known_displacement(STRAIN * column, 0.002)
    assert find_discontinuities(flat_cloud(smooth, np.where(column < 160, 0.0, 2e-3)))[:, 38:42].any(axis=1).all()
    hole = smooth.copy(deep=True)
    for name in ("displacement_x", "displacement_y"):
        hole[name].values[np.hypot(row - 120, column - 160) < 30] = np.nan
    assert not find_discontinuities(flat_cloud(hole)).any()


def test_windows_contain_the_points_connected_with_their_centre() -> None:
    """Beside a spiral discontinuity and missing points, against flood fill and least squares in each window."""
    rows, columns, half = 150, 170, 12
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    generator = np.random.default_rng(8)
    turn = np.hypot(row - 75, column - 85) - 3 * np.arctan2(row - 75, column - 85)
    spiral = np.abs(turn % 20 - 10) < 1.5
    known = generator.random((rows, columns)) > 0.1
    fields = {"x": PIXEL * column, "y": -PIXEL * row, "z": generator.normal(size=(rows, columns))}
    fields["z"][~known] = np.nan
    fields["noise"] = 1 + generator.random((rows, columns))
    cloud = xr.Dataset(
        {name: (("row", "column"), values) for name, values in fields.items()},
        {"row": np.arange(rows), "column": np.arange(columns)},
    )
    planes = fit_planes(cloud, ("z",), 2 * half + 1, ("noise",), spiral)
    measured, least = known & ~spiral, ((2 * half + 1) ** 2 + 1) // 2
    worst, parts, places = 0.0, 0, np.argwhere(measured)
    for i, j in places[generator.integers(0, len(places), 300)]:
        window = slice(max(i - half, 0), i + half + 1), slice(max(j - half, 0), j + half + 1)
        pieces, _ = label(measured[window])
        connected = pieces == pieces[min(i, half), min(j, half)]
        slopes, mean = planes.slopes[0, :, i, j], planes.means[0, i, j]
        if connected.sum() < least:
            assert np.isnan([*slopes, mean]).all()
            continue
        parts += connected.sum() < measured[window].sum()
        basis = np.stack(
            [fields["x"][window][connected], fields["y"][window][connected], np.ones(connected.sum())], axis=-1
        )
        plane = np.linalg.lstsq(basis / PIXEL, fields["z"][window][connected], rcond=None)[0][:2] / PIXEL
        worst = max(
            worst, *np.abs(slopes - plane) * PIXEL, abs(mean - np.mean(fields["noise"][window][connected] ** 2))
        )
    assert parts > 20, f"only {parts} windows were divided"
    assert worst < 1e-12, f"{worst:.1e}"


@pytest.mark.parametrize("spacing", [1, 4])
def test_noise_beside_dark_speckles_is_no_discontinuity(spacing: int) -> None:
    """Heights are missing on dark speckles and have 20 times the noise around them."""
    generator = np.random.default_rng(9)
    spots = gaussian_filter(generator.normal(size=(240, 320)), 3.0 / spacing)
    darkness = spots / spots.std()
    noise = 1e-6 * np.where(darkness > 1.5, 20.0, 1.0)
    height = np.where(darkness > 2.2, np.nan, noise * generator.normal(size=noise.shape))
    flat = known_displacement(np.zeros(noise.shape), 0.004)
    positions = {name: spacing * np.arange(length) for name, length in zip(("row", "column"), noise.shape, strict=True)}
    cloud = flat_cloud(flat.assign_coords(positions), height).assign(noise_z=(("row", "column"), noise))
    found = find_discontinuities(cloud)
    assert found.mean() < 1e-3, f"{found.mean():.4f} of the points count as discontinuous"


def test_a_strain_that_changes_abruptly_is_no_discontinuity() -> None:
    """Twice the strain in a band, as beside a hole, with a fold of the height at its border."""
    column = np.tile(4.0 * np.arange(100), (60, 1))
    stretched = STRAIN * column + STRAIN * np.clip(column - 140, 0, 100)
    fold = 20e-6 * np.abs(column - 140)
    found = find_discontinuities(flat_cloud(known_displacement(stretched, 0.001), fold))
    assert not found.any(), f"{found.mean():.4f} of the points count as discontinuous"


@pytest.mark.parametrize("period", [90.0, 150.0, 300.0])
def test_waves_are_no_discontinuities(period: float) -> None:
    """Strain that changes from -6 % to 6 %, and noise."""
    row, column = np.meshgrid(4.0 * np.arange(60), 4.0 * np.arange(80), indexing="ij")
    wave = 0.06 * period / (2 * np.pi) * np.sin(2 * np.pi * (column + 0.4 * row) / period)
    noise = 0.004 * np.random.default_rng(3).normal(size=wave.shape)
    found = find_discontinuities(flat_cloud(known_displacement(wave + noise, 0.004)))
    assert found.mean() < 0.001, f"{found.mean():.4f} of the points count as discontinuous"
