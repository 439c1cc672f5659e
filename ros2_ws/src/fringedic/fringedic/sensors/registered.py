"""Whether a registration is that of the sensors and calibrations that it is to be used with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fringedic.errors import CalibrationError
from fringedic.rig.model import RigModel
from fringedic.sensors.files import load_registration
from fringedic.sensors.registration import Registration


def registration_for(file: Path, models: Mapping[str, RigModel | None]) -> Registration:
    """Read the registration of sensors with these calibrations.

    Parameters
    ----------
    file
        The file with the poses.
    models
        Calibration of each sensor; None for one without.

    Raises
    ------
    CalibrationError
        The file cannot be used, or is that of other sensors, or of other calibrations, whose frames are others.
    """
    registration = load_registration(file)
    known = registration.calibrations
    if known.keys() != models.keys():
        raise CalibrationError(
            f"{file}: contains the sensors {', '.join(sorted(known))}, the rig file has {', '.join(sorted(models))}: "
            "register the sensors of this rig"
        )
    identifiers = {}
    for name, model in models.items():
        if model is None:
            raise CalibrationError(f"{file}: the sensor '{name}' has no calibration in the rig file; add it")
        identifiers[name] = model.identifier
    for name, other in registration.other_calibrations(identifiers):
        raise CalibrationError(
            f"{file}: the sensor '{name}' was registered with another calibration, which has another frame: register "
            "the sensors again"
            if other is None
            else f"{file}: the sensor '{name}' has the calibration of '{other}': the calibrations are exchanged in the "
            "rig file; exchange them back"
        )
    return registration
