"""The joined surface of several sensors: differences over sigma, strain across the seam, and input that is refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import xarray as xr
from analytic_sensors import POISSON, RADIUS, STRAIN, Sensors

from fringedic.errors import DatasetError
from fringedic.sensors import Registration, join_sensors, register
from fringedic.sensors.sentences import overlap_sentence, sensor_error_sentences
from fringedic.sensors.windows import window_slopes


class Case:
    """Sensors with their registration, datasets and joined surface."""

    def __init__(self, kind: str, seed: int) -> None:
        self.sensors = Sensors(kind, seed)
        self.registration: Registration = register(self.sensors.features(), self.sensors.models)
        self.datasets = {name: self.sensors.dataset(name) for name in self.sensors.poses}
        self.joined = join_sensors(self.datasets, self.registration)
        self.step = self.joined.sel(step=1)


@pytest.fixture(scope="module")
def plate() -> Case:
    return Case("plate", 11)


@pytest.fixture(scope="module")
def cylinder() -> Case:
    return Case("cylinder", 12)


def rms(values: np.ndarray) -> float:
    return math.sqrt(float(np.nanmean(np.square(values))))


def test_a_plate_is_one_surface_whose_displacement_is_within_its_uncertainty(plate: Case) -> None:
    at = plate.sensors.in_frame_of_specimen(plate.step)
    assert np.nanmax(at.points[0]) - np.nanmin(at.points[0]) > 0.088
    assert plate.joined.attrs["sensor"] == "joined"
    assert json.loads(plate.joined.attrs["chart"])["kind"] == "plane"
    for name in ("u", "v", "w"):
        assert 0.85 < rms(plate.step[f"overlap_{name}"].values) < 1.15
    # the height differs by errors that all points of this rig have in common
    assert rms(plate.step["overlap_shape"].values) < 3.0
    assert overlap_sentence(plate.joined).startswith("Where two sensors overlap, their RMS difference in units of its")


@pytest.mark.parametrize("name", ["plate", "cylinder"])
def test_strain_has_its_uncertainty_and_no_step_where_sensors_overlap(
    name: str, request: pytest.FixtureRequest
) -> None:
    """The score of n independent windows scatters by 1/sqrt(2 n): 3 of it are allowed beside the target of 0.1."""
    case: Case = request.getfixturevalue(name)
    several = case.step["sensors"].values
    contraction = -POISSON * STRAIN
    for strain, truth in (("e_11", contraction), ("e_22", STRAIN), ("e_12", 0.0)):
        error = case.step[strain].values - (truth + truth**2 / 2)
        score = error / case.step[f"sigma_{strain}"].values
        for count in (1, 2):
            of_these = score[(several == count) & np.isfinite(score)]
            windows = of_these.size / case.joined.attrs["strain_window"] ** 2
            assert abs(rms(of_these) - 1.0) < 0.1 + 3.0 / math.sqrt(2.0 * windows)
        step = np.nanmean(error[several == 2]) - np.nanmean(error[several == 1])
        assert abs(step) < 5e-6


def test_noise_that_differs_over_a_window_gives_the_scatter_of_its_slopes() -> None:
    generator = np.random.default_rng(5)
    a, b = np.meshgrid(np.arange(40.0), np.arange(30.0))
    sigma = 0.1 + np.exp((a - 20.0) / 4.0)
    draws = sigma * generator.standard_normal((500, *a.shape))
    found = window_slopes(a, b, draws, np.ones(a.shape, bool), 4, errors=sigma[None] ** 2)
    inner = (slice(None), slice(5, -5), slice(5, -5))
    of_a, of_b, of_both = found.variances[0]
    for covariance, scatter in (
        (of_a, found.values[:, 0].var(axis=0)),
        (of_b, found.values[:, 1].var(axis=0)),
        (of_both, (found.values[:, 0] * found.values[:, 1]).mean(axis=0)),
    ):
        scale = np.sqrt(of_a * of_b)
        np.testing.assert_allclose((scatter / scale)[inner[1:]], (covariance / scale)[inner[1:]], atol=0.4)


def test_the_noise_of_two_views_is_smaller_than_that_of_one(plate: Case) -> None:
    several = plate.step["sensors"].values
    at = plate.sensors.in_frame_of_specimen(plate.step)
    error = at.motion - plate.sensors.displacement(at.points)
    assert rms(error[2][several == 2]) < 0.75 * rms(error[2][several == 1])


def test_a_cylinder_is_closed(cylinder: Case) -> None:
    chart = json.loads(cylinder.joined.attrs["chart"])
    assert (chart["kind"], chart["closed"]) == ("cylinder", True)
    at = cylinder.sensors.in_frame_of_specimen(cylinder.step)
    radius = np.hypot(at.points[0], at.points[2])
    sigma = float(np.nanmean(cylinder.step["sigma_shape"]))
    assert abs(np.nanmean(radius) - RADIUS) < 3 * sigma
    assert np.isfinite(cylinder.step["w"].values).any(axis=0).all()
    for axis in "xyz":
        values = cylinder.step[axis].values
        np.testing.assert_array_equal(values[:, 0], values[:, -1])
    strain = cylinder.step["e_11"].values  # also of the first and the last column
    assert np.isfinite(strain[len(strain) // 2]).all()


def test_a_step_that_a_sensor_did_not_measure_is_that_of_the_others(plate: Case) -> None:
    right = plate.datasets["right"]
    nothing = {name: np.nan * right[name] for name in ("u", "v", "w")}
    failed = right.assign(nothing | {"error": ("step", np.array(["the image is too dark"], object))})
    both = plate.datasets | {"right": xr.concat([right, failed.assign_coords(step=[2])], "step")}
    both["left"] = xr.concat([both["left"], both["left"].assign_coords(step=[2])], "step")
    joined = join_sensors(both, plate.registration)
    assert (joined["sensors"].sel(step=1) == 2).any()
    assert not (joined["sensors"].sel(step=2) == 2).any()
    assert sensor_error_sentences(joined) == ["Step 2 was measured without the sensor 'right': the image is too dark."]


def test_what_cannot_be_joined_is_said_in_one_sentence(plate: Case) -> None:
    left, right = plate.datasets.values()
    registration = plate.registration
    with pytest.raises(DatasetError, match="only the sensor left was measured: a joined surface needs two"):
        join_sensors({"left": left}, registration)
    with pytest.raises(DatasetError, match="the sensor 'top' has no pose in the registration, which contains left, ri"):
        join_sensors({"left": left, "top": right}, registration)
    with pytest.raises(DatasetError, match="the dataset of the sensor 'right' was given as that of 'left'"):
        join_sensors({"left": right, "right": left}, registration)
    with pytest.raises(DatasetError, match="the dataset of the sensor 'right' has no noise_z: process its recording"):
        join_sensors({"left": left, "right": right.drop_vars("noise_z")}, registration)
    other = json.loads(right.attrs["calibration"])
    again = right.assign_attrs(calibration=json.dumps(other | {"identifier": "later"}))
    with pytest.raises(DatasetError, match=r"'right' was measured with the calibration 'later', but registered"):
        join_sensors({"left": left, "right": again}, registration)
    swapped = right.assign_attrs(calibration=json.dumps(other | {"identifier": "of left"}))
    with pytest.raises(DatasetError, match="'right' was measured with the calibration of 'left': the cameras or"):
        join_sensors({"left": left, "right": swapped}, registration)
    apart = left.isel(column=slice(0, 60)), right.isel(column=slice(-60, None))
    with pytest.raises(DatasetError, match="surfaces of the sensors left, right do not overlap"):
        join_sensors(dict(zip(("left", "right"), apart, strict=True)), registration)
    with pytest.raises(DatasetError, match="count from different reference steps"):
        join_sensors({"left": left, "right": right.assign(reference_step=right.reference_step + 1)}, registration)
