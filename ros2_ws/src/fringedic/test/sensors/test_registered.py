"""A registration is used with the sensors and calibrations that it was made for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fringedic.errors import CalibrationError
from fringedic.rig.model import RigModel
from fringedic.sensors.files import save_registration
from fringedic.sensors.poses import SensorPose
from fringedic.sensors.registered import registration_for
from fringedic.sensors.registration import Registration
from fringedic.virtual_rig import VirtualRig

LEFT = replace(RigModel(**VirtualRig.from_preset("plate", size="tiny").optics()), sensor="left", identifier="l")
RIGHT = replace(LEFT, sensor="right", identifier="r")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    registration = Registration(
        reference="left",
        poses={"left": SensorPose(), "right": SensorPose((0.0, 0.1, 0.0), (0.03, 0.0, 0.0))},
        covariance=np.eye(6),
        directions={"left": np.zeros((0, 0)), "right": np.zeros((0, 0))},
        shared={"left": np.zeros((6, 0)), "right": np.zeros((6, 0))},
        calibrations={"left": "l", "right": "r"},
        chi_square=0.0,
        freedom=0,
        residuals=(),
    )
    save_registration(registration, tmp_path / "registration.yaml")
    return tmp_path / "registration.yaml"


def test_registration_of_these_calibrations_is_read(file: Path) -> None:
    assert registration_for(file, {"left": LEFT, "right": RIGHT}).reference == "left"


@pytest.mark.parametrize(
    ("models", "words"),
    [
        ({"left": LEFT, "top": RIGHT}, "contains the sensors left, right, the rig file has left, top"),
        ({"left": LEFT, "right": None}, "the sensor 'right' has no calibration in the rig file"),
        ({"left": LEFT, "right": replace(RIGHT, identifier="new")}, "'right' was registered with another calibration"),
        ({"left": RIGHT, "right": LEFT}, "the sensor 'left' has the calibration of 'right'"),
    ],
)
def test_other_sensors_and_calibrations_are_refused(file: Path, models: dict[str, RigModel | None], words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        registration_for(file, models)
