"""Elastic constants of maps whose stress, strain and noise are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

from fringedic.errors import DatasetError
from fringedic.evaluation import elastic_constants, strain_curve
from fringedic.frames.region import Region
from fringedic.surface import surface_strain
from fringedic.virtual_rig import VirtualRig

MODULUS, RATIO, SECTION = 3e9, 0.35, 20e-6
NOISE, SIGMA_FORCE = 1e-4, 2.0
AXIAL = np.linspace(0, 3e-3, 7)
SHAPE = (30, 40)
MAP = ("row", "column")


def noise(generator: np.random.Generator, correlation: float) -> np.ndarray:
    """Noise of each step and its reference, (step, row, column), with the correlation length [points]."""
    maps = gaussian_filter(generator.normal(size=(len(AXIAL), *SHAPE)), (0, correlation, correlation), mode="wrap")
    maps *= NOISE / np.sqrt(2) / maps.std()
    return maps - maps[0]


def plate(seed: int, correlation: float = 2.0) -> xr.Dataset:
    """Uniaxial stress along y with noise of strain and force; the first step is the reference."""
    generator = np.random.default_rng(seed)
    strain = AXIAL[:, None, None] + noise(generator, correlation)
    across = -RATIO * AXIAL[:, None, None] + noise(generator, correlation)
    force = MODULUS * SECTION * AXIAL + generator.normal(0, SIGMA_FORCE, AXIAL.size)
    sigma = np.full_like(strain, NOISE)
    sigma[0] = 0
    maps = {"e_22": strain, "e_11": across, "sigma_e_11": sigma, "sigma_e_22": sigma}
    return xr.Dataset(
        {name: (("step", "row", "column"), values) for name, values in maps.items()} | {"force": ("step", force)},
        {"step": range(AXIAL.size), "row": range(SHAPE[0]), "column": range(SHAPE[1])},
        {"facts": json.dumps({"specimen": {"section_mm2": 1e6 * SECTION}})},
    )


def test_errors_of_the_constants_are_those_that_are_stated() -> None:
    """Over 60 specimens the root mean square of error over uncertainty is 1 within three of its standard deviations."""
    found = [elastic_constants(plate(seed), sigma_force=SIGMA_FORCE) for seed in range(60)]
    assert {each.axial for each in found} == {"e_22"}
    modulus = np.array([(each.modulus - MODULUS) / each.sigma_modulus for each in found])
    ratio = np.array([(each.poisson_ratio - RATIO) / each.sigma_poisson_ratio for each in found])
    for errors in (modulus, ratio):
        assert 0.73 < np.sqrt(np.mean(errors**2)) < 1.27, np.sqrt(np.mean(errors**2))
        assert abs(errors.mean()) < 0.4


def test_a_mean_of_correlated_noise_is_less_certain() -> None:
    """The stated uncertainty of the means agrees with their scatter over the specimens."""
    for correlation in (0.0, 2.0):
        curves = [strain_curve(plate(seed, correlation)).isel(step=slice(1, None)) for seed in range(40)]
        scatter = np.sqrt(np.mean([(curve.e_11 + RATIO * AXIAL[1:]) ** 2 for curve in curves]))
        stated = np.sqrt(np.mean([curve.sigma_e_11**2 for curve in curves]))
        assert 0.75 < stated / scatter < 1.35, (correlation, stated, scatter)


def test_a_range_of_strain_leaves_the_other_steps_out() -> None:
    dataset = plate(1)
    dataset["force"][-1] = 0.5 * dataset["force"][-1]  # it has yielded
    wrong, right = elastic_constants(dataset), elastic_constants(dataset, strain=(-1e-4, 2.7e-3))
    assert (wrong.steps, right.steps) == (7, 6)
    assert abs(right.modulus / MODULUS - 1) < 0.05 < abs(wrong.modulus / MODULUS - 1)
    assert wrong.sigma_modulus > 5 * right.sigma_modulus  # the points scatter about the line


def test_the_uncertainty_of_the_force_is_that_of_its_signal_where_the_sensor_states_it() -> None:
    stated = plate(1).assign(force_sigma=("step", np.full(AXIAL.size, SIGMA_FORCE)))
    stated["force"].attrs["quantity"] = "force"
    assert elastic_constants(stated) == elastic_constants(plate(1), sigma_force=SIGMA_FORCE)
    unknown = stated.assign(force_sigma=("step", np.full(AXIAL.size, np.nan)))
    assert elastic_constants(unknown, sigma_force=SIGMA_FORCE) == elastic_constants(plate(1), sigma_force=SIGMA_FORCE)


def test_the_force_may_be_that_of_another_load_cell() -> None:
    dataset = plate(1)
    upper = dataset.rename(force="force_upper").assign(force=dataset["force"] * np.nan)
    assert elastic_constants(upper, load="force_upper") == elastic_constants(dataset)
    upper["force_upper"].attrs |= {"units": "N", "quantity": "force"}
    with pytest.raises(DatasetError, match=r"no force \[N\] 'lower', only force_upper; "):
        elastic_constants(upper, load="lower")


def test_constants_are_those_of_the_reference_of_most_steps() -> None:
    """From step 4 on the strain is that since step 4, and the force is still the whole one."""
    dataset = plate(1)
    for name in ("e_11", "e_22"):
        dataset[name][4:] = dataset[name][4:] - dataset[name][4]
    dataset["reference_step"] = ("step", [0, 0, 0, 0, 4, 4, 4])
    first, later = elastic_constants(dataset), elastic_constants(dataset.isel(step=slice(2, None)))
    assert [(each.steps, each.reference_step) for each in (first, later)] == [(4, 0), (3, 4)]
    for found in (first, later):
        assert abs(found.modulus / MODULUS - 1) < 0.05
        assert abs(found.poisson_ratio - RATIO) < 2 * found.sigma_poisson_ratio < 0.06
    assert np.isnan(elastic_constants(dataset.isel(step=[0, 1, 4, 5])).modulus), "two steps of each reference"


def test_a_region_and_a_step_without_result() -> None:
    dataset = plate(1)
    dataset["e_22"][:, :, 20:] *= 2
    dataset["e_22"][3] = np.nan
    found = elastic_constants(dataset, Region.rectangle((0, 0), (19, 29)))
    assert (found.steps, abs(found.poisson_ratio - RATIO) < 0.02) == (6, True)


def test_a_strain_that_is_not_uniform_gives_no_constants() -> None:
    """Folded leather that flattens is no specimen in uniaxial stress; a uniform one whose material scatters is."""
    rig = VirtualRig.from_preset("leather", size="tiny")
    strains = []
    for position in np.linspace(0.1, 0.5, 4) * rig.maximum_position:
        truth = rig.truth(position)
        strains.append(surface_strain(truth.assign_coords({n: range(truth.sizes[n]) for n in MAP}), window=25))
    leather = xr.concat(strains, "step").assign_coords(step=range(4))
    leather = leather.assign({f"sigma_{name}": 1e-5 + 0 * leather[name] for name in ("e_11", "e_22")})
    found = elastic_constants(leather)
    assert np.isnan([found.modulus, found.sigma_modulus, found.poisson_ratio, found.sigma_poisson_ratio]).all()
    assert found.nonuniformity > 1
    assert f"{found.axial} is not uniform in the region: its standard deviation is" in found.reason

    scattered = plate(1)
    local = 1 + 0.1 * np.random.default_rng(1).normal(size=SHAPE)
    for name in ("e_11", "e_22"):
        scattered[name] = scattered[name] * xr.Variable(MAP, local)
    found = elastic_constants(scattered)
    assert found.nonuniformity == pytest.approx(0.1, abs=0.02)
    assert (abs(found.poisson_ratio - RATIO) < 0.02, found.reason) == (True, "")

    transverse = plate(1)
    transverse["e_11"] = transverse["e_11"] * xr.Variable(MAP[1:], np.linspace(0, 2, SHAPE[1]))
    found = elastic_constants(transverse)
    assert (np.isnan(found.poisson_ratio), round(found.nonuniformity, 1)) == (True, 0.6)
    assert abs(found.modulus / MODULUS - 1) < 0.05, "it depends on the axial strain alone"
    assert found.reason.startswith("e_11 is not uniform in the region")


def test_constants_that_are_not_known() -> None:
    dataset = plate(1)
    without = elastic_constants(dataset.drop_vars("force"))
    assert np.isnan(without.modulus)
    assert without.reason.startswith("the stress is not known at all steps")
    assert elastic_constants(dataset.isel(step=[0, 3])).reason == "2 steps are in the range of strain, 3 are needed"
    assert elastic_constants(dataset).reference_step == -1, "the dataset does not name it"
    assert np.isnan(elastic_constants(dataset.isel(step=[0, 3])).poisson_ratio)
    with pytest.raises(DatasetError, match="no point of the result lies in the region"):
        elastic_constants(dataset, Region.rectangle((50, 50), (60, 60)))
    with pytest.raises(DatasetError, match="the dataset has no map e_11"):
        strain_curve(dataset.drop_vars("e_11"))
