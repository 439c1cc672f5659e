"""Section `sensors` of a rig file: what each of several sensors has of its own, as sections of a rig file of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fringedic.errors import ConfigurationError
from fringedic.frames.sensor import SENSOR, sensor_name
from fringedic.wording.arguments import check_value

SENSORS, REGISTRATION = "sensors", "registration"
OF_A_SENSOR = (
    "camera",
    "projector",
    "sequence",
    "calibration",
    "reference_plane",
    "nodes",
    "noise_floor_file",
    "region_file",
    "virtual_rig",
    "hardware",
)
"""Sections that a sensor may have of its own, in place of those at the top of the file."""
# They concern one sensor, or all at a time in a way that is not possible
_NOT_OF_SEVERAL = {
    "sensor": "the names of the sensors are the keys of the section sensors; remove it",
    "extensometer": "it needs white light between the steps, which would fall into the images of the other sensors; "
    "remove it",
}


def names_of_sensors(content: Mapping[str, Any], source: str) -> list[str]:
    """Return the names of the sensors in the content of a rig file; nothing in that of a single sensor.

    Raises
    ------
    ConfigurationError
        The section is no mapping of two or more valid names to sections that a sensor may have of its own.
    """
    if SENSORS not in content:
        return []
    sensors = content[SENSORS]
    if not isinstance(sensors, dict) or not all(isinstance(own, dict) for own in sensors.values()):
        raise ConfigurationError(
            f"{source}: sensors: write the name of each sensor with its own sections, such as left: {{camera: ...}}"
        )
    if len(sensors) < 2:
        raise ConfigurationError(
            f"{source}: sensors: there is only {', '.join(map(str, sensors)) or 'none'}; write the sections of a "
            "single sensor at the top of the file, without the section sensors"
        )
    for name, own in sensors.items():
        check_value(ConfigurationError, f"{source}: sensors: the name of a sensor", name, sensor_name)
        if name == SENSOR:
            raise ConfigurationError(
                f"{source}: sensors.{name}: this name has another meaning in files and datasets; choose another one"
            )
        for section in own:
            if section not in OF_A_SENSOR:
                raise ConfigurationError(
                    f"{source}: sensors.{name}.{section}: is no section of one sensor, those are "
                    f"{', '.join(OF_A_SENSOR)}; write it at the top of the file, for all sensors"
                )
    for section, reason in _NOT_OF_SEVERAL.items():
        if section in content:
            raise ConfigurationError(f"{source}: {section}: is not possible for several sensors, {reason}")
    return list(sensors)


def sections_of_sensor(content: Mapping[str, Any], source: str, sensor: str | None) -> dict[str, Any]:
    """Return the content of a rig file as that of a single sensor, which has the common sections and its own ones.

    Parameters
    ----------
    content, source
        Of the file, and its name for messages.
    sensor
        Name of the sensor; None for the only one.

    Raises
    ------
    ConfigurationError
        The file has several sensors and none is chosen, or not the chosen one, or as of `names_of_sensors`.

    Examples
    --------
    >>> content = {"camera": 1, "sensors": {"left": {"projector": 2}, "right": {"projector": 3}}}
    >>> sections_of_sensor(content, "two.yaml", "left")
    {'camera': 1, 'projector': 2, 'sensor': 'left'}
    """
    names = names_of_sensors(content, source)
    if not names:
        if sensor not in (None, content.get("sensor", SENSOR)):
            raise ConfigurationError(f"{source}: has one sensor only, which is not '{sensor}': leave --sensor out")
        return dict(content)
    if sensor not in names:
        chosen = f"has no sensor '{sensor}', but" if sensor else "has"
        raise ConfigurationError(
            f"{source}: {chosen} the sensors {', '.join(names)}: choose one with --sensor {names[0]}"
        )
    common = {name: section for name, section in content.items() if name not in (SENSORS, REGISTRATION)}
    if common.get("frame_prefix") is not None:  # the frames of sensors have different names
        common["frame_prefix"] = "/".join(filter(None, (common["frame_prefix"], sensor)))
    return {**common, **content[SENSORS][sensor], "sensor": sensor}
