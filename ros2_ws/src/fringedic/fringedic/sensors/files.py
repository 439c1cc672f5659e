"""The registration of sensors as a file for people: mm and degree, with the hash of its numbers."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fringedic.camera.findings import Finding
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.sensors.findings import RegistrationFinding
from fringedic.sensors.poses import SensorPose
from fringedic.sensors.registration import Registration, Residual
from fringedic.wording.causes import cause_of
from fringedic.wording.sealed_yaml import ChangedFileError, sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

REGISTRATION_FILE = "registration.yaml"
_VERSION = 1
_MM = 1e-3


def save_registration(registration: Registration, path: str | Path) -> None:
    """Write a registration."""
    content = {
        "version": _VERSION,
        "created": registration.created.isoformat(),
        "verdict": str(registration.verdict),
        "reference": registration.reference,
        "orientation": registration.orientation.name.lower(),
        "sensors": {
            name: {
                "calibration": registration.calibrations[name],
                "translation_mm": [each / _MM for each in pose.translation],
                "rotation_degree": [math.degrees(each) for each in pose.rotation],
                **_sigmas(registration, name),
            }
            for name, pose in registration.poses.items()
        },
        "chi_square": registration.chi_square,
        "freedom": registration.freedom,
        "residuals": [
            {
                "sensor": each.sensor,
                "object": each.name,
                "deviation_um": round(1e6 * each.deviation, 4),
                "sigmas": round(each.sigmas, 3),
            }
            for each in registration.residuals
        ],
        "findings": [
            {"code": str(each.code), "subject": each.subject, "values": dict(each.values)}
            for each in registration.findings
        ],
        "covariance_si": registration.covariance.tolist(),
        "calibration_directions_si": {name: each.tolist() for name, each in registration.directions.items()},
        "covariance_with_calibrations_si": {name: each.tolist() for name, each in registration.shared.items()},
    }
    Path(path).write_text(yaml.safe_dump(sealed(content), sort_keys=False, allow_unicode=True), encoding="utf-8")


def _sigmas(registration: Registration, sensor: str) -> dict[str, list[float]]:
    """Return the standard uncertainties of a pose for people."""
    if sensor == registration.reference:
        return {}
    sigma = np.sqrt(np.diag(registration.pose_covariance(sensor)))
    return {
        "sigma_translation_mm": [round(float(each) / _MM, 6) for each in sigma[3:]],
        "sigma_rotation_degree": [round(math.degrees(each), 7) for each in sigma[:3]],
    }


def load_registration(path: str | Path) -> Registration:
    """Read a file of `save_registration`.

    Raises
    ------
    CalibrationError
        The file cannot be read, is no registration, or its content has changed since it was written.
    """
    try:
        return registration_from_text(Path(path).read_text(encoding="utf-8", errors="replace"), str(path))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {cause_of(error)}") from None


def registration_from_text(text: str, place: str) -> Registration:
    """Return the registration in the text of a file; `place` is the name of the file, for messages.

    Raises
    ------
    CalibrationError
        As of `load_registration`.
    """
    try:
        content, edited = unsealed(load_yaml(text), place)
        return _registration(content, edited)
    except ChangedFileError as error:
        raise CalibrationError(f"{place}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
        raise CalibrationError(
            f"{place}: is no registration of sensors; 'fringedic register' writes one ({error!r})"
        ) from None


def _registration(content: dict[str, Any], edited: bool) -> Registration:
    sensors = content["sensors"]
    poses = {
        name: SensorPose(
            tuple(math.radians(each) for each in values["rotation_degree"]),  # type: ignore[arg-type]
            tuple(_MM * each for each in values["translation_mm"]),
        )
        for name, values in sensors.items()
    }
    for pose in poses.values():
        if len(pose.rotation) != 3 or len(pose.translation) != 3:
            raise ValueError("a pose has three numbers of rotation and of translation")
        if not np.isfinite([*pose.rotation, *pose.translation]).all():
            raise ValueError("a pose contains no finite number")
    count = 6 * (len(poses) - 1)
    directions = {name: _matrix(each, None) for name, each in content["calibration_directions_si"].items()}
    shared = {name: np.array(each, float) for name, each in content["covariance_with_calibrations_si"].items()}
    if {*poses} != {*directions} or {*poses} != {*shared} or content["reference"] not in poses:
        raise ValueError("the sensors of its parts differ")
    for name, each in shared.items():
        if each.size != count * len(directions[name]):
            raise ValueError("a covariance has another size")
    return Registration(
        reference=content["reference"],
        poses=poses,
        covariance=_matrix(content["covariance_si"], count),
        directions=directions,
        shared={name: each.reshape(count, len(directions[name])) for name, each in shared.items()},
        calibrations={name: values["calibration"] for name, values in sensors.items()},
        chi_square=float(content["chi_square"]),
        freedom=int(content["freedom"]),
        residuals=tuple(
            Residual(each["sensor"], each["object"], 1e-6 * each["deviation_um"], each["sigmas"])
            for each in content["residuals"]
        ),
        orientation=Orientation[content["orientation"].upper()],
        findings=tuple(
            Finding(RegistrationFinding(each["code"]), each["subject"], each["values"]) for each in content["findings"]
        ),
        created=datetime.fromisoformat(content["created"]),
        edited=edited,
    )


def _matrix(values: Any, size: int | None) -> np.ndarray:
    found = np.array(values, float)
    if not np.isfinite(found).all() or (size is not None and found.shape != (size, size)):
        raise ValueError("a covariance has another size, or contains no finite numbers")
    return found.reshape(len(values), -1) if len(values) else np.zeros((0, 0))
