"""The rig model as a YAML file for people: mm, degree and pixels, with the unit in every name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from fringedic.camera.camera_info import is_camera_info
from fringedic.camera.distortion import DistortionMap
from fringedic.errors import CalibrationError
from fringedic.frames.sensor import SENSOR
from fringedic.rig.geometry import ADDED, RigGeometry
from fringedic.wording.causes import cause_of
from fringedic.wording.sealed_yaml import EDITED_WORDS, ChangedFileError, sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

_MM, _DEGREE, _ONE = 1e-3, math.pi / 180, 1

# Names in the file by section, each with the field of the geometry and its unit in SI.
_SECTIONS: dict[str, dict[str, tuple[str, float]]] = {
    "camera": {
        "width_px": ("camera_width", _ONE),
        "height_px": ("camera_height", _ONE),
        "first_column_px": ("camera_first_column", _ONE),
        "first_row_px": ("camera_first_row", _ONE),
        "distance_mm": ("camera_distance", _MM),
        "pixel_size_mm": ("pixel_size", _MM),
        "pixel_aspect": ("pixel_aspect", _ONE),
        "principal_column_px": ("principal_column", _ONE),
        "principal_row_px": ("principal_row", _ONE),
        "tilt_x_degree": ("camera_tilt_x", _DEGREE),
        "tilt_y_degree": ("camera_tilt_y", _DEGREE),
    },
    "projector": {
        "width_px": ("projector_width", _ONE),
        "height_px": ("projector_height", _ONE),
        "position_mm": ("projector_position", _MM),
        "yaw_pitch_roll_degree": ("projector_rotation", _DEGREE),
        "focal_length_px": ("projector_focal_length", _ONE),
        "principal_column_px": ("projector_principal_column", _ONE),
        "principal_row_px": ("projector_principal_row", _ONE),
        **{name: (f"projector_{name}", _ONE) for name in ("k1", "k2", "p1", "p2", "k3")},
    },
}


def write_rig(geometry: RigGeometry, path: str | Path) -> None:
    """Write a rig as YAML."""
    distortion = geometry.camera_distortion
    content = {
        "sensor": geometry.sensor,
        "identifier": geometry.identifier,
        "model": geometry.model,
        "source": geometry.source,
        **{
            section: {key: _to_people(getattr(geometry, name), unit) for key, (name, unit) in entries.items()}
            for section, entries in _SECTIONS.items()
        },
        **({} if distortion is None else {"camera_distortion": distortion.to_dict()}),
        "covariance_si": {"parameters": list(geometry.parameter_names), "values": list(geometry.covariance)},
    }
    Path(path).write_text(yaml.safe_dump(sealed(content), sort_keys=False), encoding="utf-8")


def read_rig(path: str | Path) -> dict[str, Any]:
    """Return the fields of the `RigGeometry` (SI) that `write_rig` wrote.

    Raises
    ------
    CalibrationError
        The file cannot be read, is not the calibration of a rig, or an entry is missing.
    GridError
        The lens distortion in the file is invalid.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"cannot be read: {cause_of(error)}") from None
    except UnicodeDecodeError as error:
        raise CalibrationError(f"this is not the calibration of a rig: {error}") from None
    return parse_rig(text, str(path))


def parse_rig(text: str, place: str = "calibration") -> dict[str, Any]:
    """Return the fields of the `RigGeometry` (SI) from the text of a file that `write_rig` wrote.

    The identifier of a file that was edited by hand says so, and with it everything that is made with the rig.

    Parameters
    ----------
    text
        Of the file.
    place
        The file, for the log.

    Raises
    ------
    CalibrationError
        The text is not the calibration of a rig, or an entry is missing.
    GridError
        The lens distortion is invalid.
    """
    try:
        content = load_yaml(text)
        if is_camera_info(content):
            raise CalibrationError(
                "this is the calibration of a camera alone, as ost.yaml or camera_info of ROS, without a projector. It "
                "can replace the lens only: fringedic.camera.DistortionMap.load reads it; 'fringedic calibrate' "
                "calibrates a rig"
            )
        content, edited = unsealed(content, place)
        values: dict[str, Any] = {
            name: _from_people(content[section][key], unit)
            for section, entries in _SECTIONS.items()
            for key, (name, unit) in entries.items()
            if key in content[section] or name not in ADDED
        }
        covariance = content.get("covariance_si", {"parameters": [], "values": []})
        distortion = content.get("camera_distortion")
        return values | {
            "camera_distortion": None if distortion is None else DistortionMap.from_dict(distortion),
            "sensor": content.get("sensor", SENSOR),
            "identifier": edited_identifier(content["identifier"]) if edited else content["identifier"],
            "model": content["model"],
            "source": content["source"],
            "parameter_names": tuple(covariance["parameters"]),
            "covariance": tuple(covariance["values"]),
        }
    except KeyError as error:
        raise CalibrationError(f"{error.args[0]} is missing") from None
    except ChangedFileError as error:
        raise CalibrationError(str(error)) from None
    except (yaml.YAMLError, TypeError, AttributeError) as error:
        raise CalibrationError(f"this is not the calibration of a rig: {error}") from None


def edited_identifier(text: str) -> str:
    """Return the identifier of a calibration whose file a person has edited, which everything made with it contains."""
    return text if EDITED_WORDS in text else f"{text} ({EDITED_WORDS})".strip()


def _to_people(value: float | tuple[float, ...], unit: float) -> float | list[float]:
    if isinstance(value, tuple):
        return [each / unit for each in value]
    return value if unit == _ONE else value / unit


def _from_people(value: float | list[float], unit: float) -> float | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(each * unit for each in value)
    return value if unit == _ONE else value * unit
