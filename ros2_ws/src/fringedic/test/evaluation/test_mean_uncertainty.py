"""Standard uncertainties of means over regions, and the test of uniformity, over scenes of noise."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

import fringedic
from fringedic.camera.distortion import DistortionMap
from fringedic.correlation.transfer import error_correlation
from fringedic.evaluation.mean_uncertainty import (
    error_correlation_of,
    spread_beyond_noise,
    uncertainty_of_mean,
)
from fringedic.frames.region import Region
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.surface.calibration_uncertainty import calibration_covariance

SIZE, SPACING, WINDOW, STRAIN_WINDOW = (220, 260), 4, 24, 41
REGIONS = {  # whole image with its incomplete windows, its middle, and less than a window
    "all": Region.rectangle((0, 0), (259, 219)),
    "middle": Region.rectangle((80, 60), (180, 150)),
    "small": Region.rectangle((100, 100), (116, 108)),
}
MAPS = ("e_xx", "e_yy", "e_xy", "displacement_x", "displacement_y")


def test_z_scores_of_means_over_images_with_noise() -> None:
    """A surface at rest, seen with noise of the camera: all means are errors."""
    texture = gaussian_filter(np.random.default_rng(0).normal(size=SIZE), 1.4)
    texture = 1000 + 300 * texture / texture.std()
    scores: dict[str, list[np.ndarray]] = {name: [] for name in REGIONS}
    for seed in range(1, 41):
        random = np.random.default_rng(seed)
        one, other = (np.float32(texture + random.normal(0, 6, SIZE)) for _ in range(2))
        field = fringedic.measure_displacement(one, other, window=WINDOW, spacing=SPACING)
        strain = field.fringedic.strain(window=STRAIN_WINDOW)
        maps = strain.assign({name: field[name] for name in MAPS[3:]})
        maps = maps.assign({f"displacement_sigma_{axis}": field[f"sigma_{axis}"] for axis in "xy"})
        for name, region in REGIONS.items():
            table = maps.fringedic.region(MAPS, region)[list(MAPS)].to_array()
            score = table.sel(statistic="mean") / table.sel(statistic="standard_uncertainty")
            scores[name].append(score.values)
    for name, found in scores.items():
        each = np.sqrt(np.mean(np.square(found), axis=0))
        # 40 values: the standard deviation of their root mean square is 0.11
        assert ((each > 0.67) & (each < 1.33)).all(), (name, each)
        assert 0.85 < np.sqrt(np.mean(each**2)) < 1.15, (name, each)


def strain_of_noise(random: np.random.Generator) -> xr.Dataset:
    """Strain of a displacement that is noise alone, with the correlation of its window."""
    size, spacing = 128, 6
    lags = np.pad(error_correlation(WINDOW), (0, 1))
    places = np.minimum(np.abs(np.fft.fftfreq(size, 1 / size)).astype(int) * spacing, 2 * WINDOW + 1)
    root = np.sqrt(np.maximum(np.fft.fft2(lags[np.ix_(places, places)]).real, 0))
    noise = [3e-3 * np.fft.ifft2(np.fft.fft2(random.normal(size=(size, size))) * root).real for _ in "xy"]
    fields = {f"displacement_{axis}": np.float32(each[:60, :80]) for axis, each in zip("xy", noise, strict=True)}
    fields |= {f"sigma_{axis}": np.full((60, 80), 3e-3, np.float32) for axis in "xy"}
    arrays = {name: (("row", "column"), values) for name, values in fields.items()}
    axes = {"row": spacing * np.arange(60), "column": spacing * np.arange(80)}
    return xr.Dataset(arrays, axes, {"window_px": WINDOW, "method": "dense"}).fringedic.strain(window=61)


def test_noise_alone_is_seldom_a_spread() -> None:
    """Over 200 scenes the squares scatter as chi-squared of the stated degrees of freedom; what varies is found."""
    random = np.random.default_rng(3)
    ratios, alarms = [], 0
    for _ in range(200):
        strain = strain_of_noise(random)
        values, sigma = strain.e_xx.values, strain.sigma_e_xx.values
        everywhere = np.ones(values.shape, bool)
        measured = np.isfinite(values)
        correlation = error_correlation_of(strain, "e_xx")
        assert correlation is not None
        freedom = correlation.degrees_of_freedom(sigma, measured) - 1
        ratios.append(np.var(values[measured].astype(float)) / np.mean(sigma[measured].astype(float) ** 2))
        uncertainty = uncertainty_of_mean(strain, "e_xx", values, sigma, everywhere)
        alarms += spread_beyond_noise(strain, "e_xx", values, sigma, everywhere, uncertainty) > 0
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert 0.7 < np.var(ratios) * freedom / 2 < 1.5
    assert alarms <= 3, "of 200: a rate of 0.005 gives more in 2 % of such tests"
    gradient = np.linspace(-1, 1, values.shape[1]) * 4 * float(np.nanmedian(sigma))
    found = spread_beyond_noise(strain, "e_xx", values + gradient, sigma, everywhere, uncertainty)
    assert found == pytest.approx(float(np.std(np.broadcast_to(gradient, values.shape)[measured])), rel=0.1)


def test_the_error_of_a_calibration_is_common_to_all_points() -> None:
    """A mean has its noise reduced, and the uncertainty of the calibration whole."""
    distortion = DistortionMap(160, 120, 1e-3 * np.eye(3), np.zeros((3, 3)))
    rig = RigModel(
        camera_width=160,
        camera_height=120,
        camera_distance=0.8,
        pixel_size=400e-6,
        pixel_aspect=1.0,
        principal_column=79.5,
        principal_row=59.5,
        camera_distortion=distortion,
        projector_width=800,
        projector_height=600,
        projector_position=(-0.3, 0.0, 0.9),
        projector_focal_length=1200.0,
        projector_principal_column=399.5,
        projector_principal_row=299.5,
        parameter_names=("pixel_size",),
        covariance=((1e-3 * 400e-6) ** 2,),
    )
    column, row = np.meshgrid(np.arange(0.0, 160, 4), np.arange(0.0, 120, 4))
    zero = np.zeros(column.shape)
    variance = calibration_covariance(rig, (column, row, zero), (column + 10, row, zero), Orientation.VERTICAL)
    fields = {"z": zero, "w": zero, "displacement_x": zero + 10, "displacement_y": zero, "u": zero + 4e-3}
    text = json.dumps(dataclasses.asdict(rig), default=lambda array: array.tolist())
    step = xr.Dataset(
        {name: (("row", "column"), values) for name, values in fields.items()},
        {"row": row[:, 0], "column": column[0]},
        {"calibration": text, "displacement_window_px": 16},
    )
    everywhere = np.ones(zero.shape, bool)
    scale = np.sqrt(variance[0])
    exact = uncertainty_of_mean(step, "u", step.u.values, scale, everywhere)
    assert exact == pytest.approx(scale.mean(), rel=0.01)
    assert exact == pytest.approx(4e-6, rel=0.02), "a thousandth of the displacement"
    noisy = uncertainty_of_mean(step, "u", step.u.values, np.hypot(scale, 4e-6), everywhere)
    assert 1.0005 * exact < noisy < 1.05 * exact
    exactly = dataclasses.replace(rig, parameter_names=(), covariance=())
    text = json.dumps(dataclasses.asdict(exactly), default=lambda array: array.tolist())
    bare = step.assign_attrs(calibration=text)
    assert uncertainty_of_mean(bare, "u", step.u.values, np.hypot(scale, 4e-6), everywhere) < 0.3 * exact
    unknown = step.drop_attrs()
    sigma = np.hypot(scale, 4e-6)
    assert uncertainty_of_mean(unknown, "u", step.u.values, sigma, everywhere) == pytest.approx(sigma.mean()), (
        "the part of the calibration is not known"
    )
