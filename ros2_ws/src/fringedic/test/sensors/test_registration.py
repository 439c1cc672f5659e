"""Several sensors in one frame: poses with their covariance, contradictions, and the file of a registration."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import yaml
from analytic_sensors import Sensors
from scipy.spatial.transform import Rotation

from fringedic.errors import CalibrationError
from fringedic.rig.model import RigModel
from fringedic.sensors import Feature, Registration, distances_across, join_sensors, measure_plane, register
from fringedic.sensors.features import FeatureKind, match_balls
from fringedic.sensors.files import load_registration, save_registration
from fringedic.sensors.findings import RegistrationFinding, RegistrationVerdict
from fringedic.sensors.sentences import distances_in_words, registration_in_words, registration_remarks


def pose_error(sensors: Sensors, found: Registration, sensor: str) -> np.ndarray:
    """Return the error of the pose of a sensor: rotation [rad] and translation [m]."""
    (turn, origin), (own, place) = sensors.poses[found.reference], sensors.poses[sensor]
    pose = found.poses[sensor]
    rotation = Rotation.from_matrix(pose.matrix) * (turn.inv() * own).inv()
    return np.concatenate([rotation.as_rotvec(), np.subtract(pose.translation, turn.inv().apply(place - origin))])


def test_poses_of_twelve_rigs_and_points_of_two_sensors_are_within_their_uncertainty() -> None:
    scores, squares, apart, goes = [], [], [], 0
    point = np.array([0.005, 0.002, 0.004])
    for seed in range(12):
        sensors = Sensors("plate", seed)
        found = register(sensors.features(), sensors.models)
        error, covariance = pose_error(sensors, found, "right"), found.pose_covariance("right")
        scores.append(error @ np.linalg.solve(covariance, error) / 6)
        squares.append(found.reduced_chi_square)
        goes += found.verdict is RegistrationVerdict.GO
        # one point, as both calibrations with their errors place it in the common frame
        places, by_errors = [], []
        for sensor, (rotation, translation) in sensors.poses.items():
            own = rotation.inv().apply(point - translation)[:, None]
            places.append(found.poses[sensor].apply(own + sensors.error(sensor, own))[:, 0])
            by_errors.append(found.position_errors(sensor, sensors.models[sensor], own)[..., 0])
        difference, by_error = places[0] - places[1], by_errors[0] - by_errors[1]
        apart.append(difference @ np.linalg.solve(by_error @ found.common_covariance @ by_error.T, difference) / 3)
    # means of 72, 252 and 36 squares of normal variables
    assert abs(np.mean(scores) - 1) < 4 * math.sqrt(2 / 72)
    assert abs(np.mean(squares) - 1) < 4 * math.sqrt(2 / 252)
    assert abs(np.mean(apart) - 1) < 4 * math.sqrt(2 / 36)
    assert goes >= 11


def test_four_sensors_around_an_object_are_closed_to_a_ring() -> None:
    sensors = Sensors("cylinder", 3)
    found = register(sensors.features(), sensors.models, reference="b")
    for sensor in found.placed:
        error, covariance = pose_error(sensors, found, sensor), found.pose_covariance(sensor)
        assert error @ np.linalg.solve(covariance, error) < 22.5  # chi square of 6, 0.1 %
    assert found.placed == ["a", "c", "d"]


@pytest.fixture(scope="module")
def sensors() -> Sensors:
    return Sensors("plate", 1)


@pytest.fixture(scope="module")
def features(sensors: Sensors) -> list[Feature]:
    return sensors.features()


def test_the_verdict_has_its_figures(sensors: Sensors, features: list[Feature]) -> None:
    first, second = registration_in_words(register(features, sensors.models))
    assert first.startswith("GO. The sensors agree within their uncertainty: 9 objects deviate by up to ")
    assert first.endswith(" per degree of freedom, 21 of them).")
    assert second.startswith("right: at (37.5")
    # three balls in one place: 18 observations, 9 numbers of the balls and 6 of the pose
    few = [each for each in features if each.name.startswith("0.0")]
    assert register(few, sensors.models).freedom == 3


def test_an_object_that_moved_is_named(sensors: Sensors, features: list[Feature]) -> None:
    moved = [
        dataclasses.replace(each, position=each.position + np.array([0.0, 0.0, 3e-4]))
        if each.sensor == "right" and each.name == "0.1.2"
        else each
        for each in features
    ]
    found = register(moved, sensors.models)
    assert found.verdict is RegistrationVerdict.NO_GO
    [finding] = [each for each in found.findings if each.code is RegistrationFinding.CONTRADICTION]
    assert finding.subject.endswith("0.1.2")
    assert "calibration files exchanged?" in registration_in_words(found)[-1]


def test_the_file_gives_the_registration_back_and_notices_a_changed_digit(
    sensors: Sensors, features: list[Feature], tmp_path: Path
) -> None:
    found, file = register(features, sensors.models), tmp_path / "registration.yaml"
    save_registration(found, file)
    read = load_registration(file)
    for name, pose in found.poses.items():
        np.testing.assert_allclose(read.poses[name].matrix, pose.matrix, atol=1e-15)
        np.testing.assert_allclose(read.poses[name].translation, pose.translation, atol=1e-16)
    np.testing.assert_array_equal(read.common_covariance, found.common_covariance)
    assert (read.verdict, read.calibrations, read.freedom) == (found.verdict, dict(found.calibrations), found.freedom)
    content = yaml.safe_load(file.read_text("utf-8"))
    content["sensors"]["right"]["translation_mm"][0] += 1.0
    file.write_text(yaml.safe_dump(content), "utf-8")
    with pytest.raises(CalibrationError, match="its content has changed since it was written"):
        load_registration(file)
    file.write_text("reference: left\n", "utf-8")
    with pytest.raises(CalibrationError, match=r"is no registration of sensors; 'fringedic register' writes one"):
        load_registration(file)
    with pytest.raises(CalibrationError, match=r"none\.yaml: cannot be read"):
        load_registration(tmp_path / "none.yaml")


def test_objects_that_do_not_place_a_sensor_are_refused_in_one_sentence(
    sensors: Sensors, features: list[Feature]
) -> None:
    alone = [each for each in features if each.sensor == "left"]
    with pytest.raises(CalibrationError, match="'right' measured no object that left measured, too: the overlap is"):
        register(alone, sensors.models)
    with pytest.raises(CalibrationError, match="only the sensor 'left' is there"):
        register(alone, {"left": sensors.models["left"]})
    with pytest.raises(CalibrationError, match="there is no sensor 'top': choose one of left, right"):
        register(features, sensors.models, reference="top")
    with pytest.raises(CalibrationError, match="have 2 balls in common, three are needed"):
        match_balls(features[:2], features[:2])
    corners = [(0.0, 0.0), (0.02, 0.0), (0.01, 0.02 * math.sqrt(0.75))]
    alike = [
        dataclasses.replace(features[0], position=np.array([*corner, 0.0]), name=f"ball {number}")
        for number, corner in enumerate(corners)
    ]
    with pytest.raises(CalibrationError, match="the distances of the balls are too alike to tell them apart"):
        match_balls(alike, alike)


def test_balls_in_any_order_get_the_names_of_the_other_sensor(features: list[Feature]) -> None:
    left, right = ([each for each in features if each.sensor == name][:3] for name in ("left", "right"))
    unnamed = [each.named("") for each in (right[2], right[0], right[1])]
    found = match_balls(left, unnamed)
    assert {each.name: tuple(each.position) for each in found} == {each.name: tuple(each.position) for each in right}


def planes(models: dict[str, RigModel], normals: list[tuple[float, float]]) -> list[Feature]:
    """Return planes with these slopes that both sensors see in the same place."""
    y, x = np.meshgrid(np.linspace(0.02, -0.02, 60), np.linspace(-0.02, 0.02, 80), indexing="ij")
    generator = np.random.default_rng(1)
    found = []
    for number, (a, b) in enumerate(normals):
        for model in models.values():
            z = 1e-3 * number + a * x + b * y + 5e-6 * generator.standard_normal(x.shape)
            shape = xr.Dataset({name: (("row", "column"), each) for name, each in {"x": x, "y": y, "z": z}.items()})
            found.append(measure_plane(shape, model, f"plane {number}"))
    return found


def test_planes_place_a_sensor_if_they_are_tilted_about_two_axes(sensors: Sensors) -> None:
    tilted = planes(sensors.models, [(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (-0.2, -0.1)])
    assert all(each.kind is FeatureKind.PLANE for each in tilted)
    pose = register(tilted, sensors.models).poses["right"]
    assert np.linalg.norm(pose.translation) < 1e-4
    assert np.linalg.norm(pose.rotation) < 1e-3
    about_one_axis = planes(sensors.models, [(0.0, 0.0), (0.2, 0.0), (-0.2, 0.0)])
    with pytest.raises(CalibrationError, match="planes have to be tilted about two axes, or measure three balls"):
        register(about_one_axis, sensors.models)


def test_a_known_distance_across_sensors_is_measured_within_its_uncertainty() -> None:
    """So many independent scores have an RMS of 1 with a standard deviation of 1/sqrt(2 n)."""
    ends, count = 1e-3 * np.array([(-30.0, 5.0, 2.0), (30.0, -4.0, -3.0)]), 40
    known = float(np.linalg.norm(ends[1] - ends[0]))
    scores = []
    for seed in range(count):
        sensors = Sensors("plate", 100 + seed)
        registration = register(sensors.features(), sensors.models)
        balls = [sensors.ball("left", "a", ends[0]), sensors.ball("right", "b", ends[1])]
        [found] = distances_across(balls, sensors.models, registration, known)
        scores.append(found.score)
    assert abs(math.sqrt(np.mean(np.square(scores))) - 1.0) < 3.0 / math.sqrt(2.0 * count)
    [found] = distances_across(balls, sensors.models, registration, known + 20 * found.sigma)
    assert not found.holds
    assert distances_in_words([found])[0].startswith("The registration does not hold: in step 0 the distance between")
    [found] = distances_across(balls, sensors.models, registration, known + 20 * found.sigma, expected_sigma=1e-2)
    assert found.holds
    same = [sensors.ball("left", "a", ends[0]), sensors.ball("right", "a", ends[0])]
    assert distances_across(same, sensors.models, registration, known) == []
    other = {name: dataclasses.replace(each, identifier="later") for name, each in sensors.models.items()}
    with pytest.raises(CalibrationError, match="'left' was measured with the calibration 'later', but registered with"):
        distances_across(balls, other, registration, known)


def test_what_is_joined_with_an_edited_registration_says_so(
    sensors: Sensors, features: list[Feature], tmp_path: Path
) -> None:
    file = tmp_path / "registration.yaml"
    save_registration(register(features, sensors.models), file)
    content = yaml.safe_load(file.read_text("utf-8"))
    content["sensors"]["right"]["translation_mm"][0] += 1e-3
    file.write_text(yaml.safe_dump(content | {"edited": True}), "utf-8")
    edited = load_registration(file)
    assert edited.edited
    joined = join_sensors({name: sensors.dataset(name) for name in sensors.poses}, edited)
    [remark] = registration_remarks(joined)
    assert remark.startswith("The registration of the sensors, of 20")
    assert remark.endswith("was edited by hand.")
