"""The name of a sensor, a camera with its projector: its default, its form, and the files that contain it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator

SENSOR = "sensor"
"""Name of a sensor that was given none, also in recordings, calibrations and datasets of earlier versions."""
JOINED = "joined"
"""Name of the surface of several sensors together in datasets and names of files; no sensor can have it."""
_TOKEN = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*")
_LONGEST = 60


def sensor_name(value: Any) -> str:
    """Check the name of a sensor, which becomes a part of topics and of file names.

    Examples
    --------
    >>> from fringedic.errors import ConfigurationError
    >>> from fringedic.wording.arguments import check_value
    >>> check_value(ConfigurationError, "sensor", "../left", sensor_name)
    Traceback (most recent call last):
    fringedic.errors.ConfigurationError: sensor is '../left': it has to be a name of letters, digits and single \
underscores, at most 60 of them, that begins with a letter
    >>> check_value(ConfigurationError, "sensor", "joined", sensor_name)
    Traceback (most recent call last):
    fringedic.errors.ConfigurationError: sensor is 'joined': it has to be another name than 'joined', which is that of \
the surface of several sensors
    """
    if value == JOINED:
        raise ValueError(f"another name than '{JOINED}', which is that of the surface of several sensors")
    if isinstance(value, str) and len(value) <= _LONGEST and _TOKEN.fullmatch(value):
        return value
    raise ValueError(
        f"a name of letters, digits and single underscores, at most {_LONGEST} of them, that begins with a letter"
    )


def _written(value: str) -> str:
    try:
        return sensor_name(value)
    except ValueError as reason:
        raise ValueError(f"it has to be {reason}") from None


SensorName = Annotated[str, AfterValidator(_written)]
"""Type of the name of a sensor in a file or in parameters."""


def choice_of_sensors(place: object, names: Iterable[str]) -> str:
    """Return the sentence about a recording or a folder of several sensors, of which one has to be chosen.

    Examples
    --------
    >>> choice_of_sensors("plate/bag", ["right", "left"])
    'plate/bag contains the sensors left, right: choose one, for example with --sensor left'
    """
    first, *others = sorted(names)
    return f"{place} contains the sensors {', '.join([first, *others])}: choose one, for example with --sensor {first}"


def file_of(path: Path, sensor: str) -> Path:
    """Return the path of a file of one sensor: with its name if it was given one.

    The points around the name keep it apart from the names of other recordings: it contains none itself.

    Examples
    --------
    >>> file_of(Path("plate/results.nc"), SENSOR), file_of(Path("plate/results.nc"), "left")
    (PosixPath('plate/results.nc'), PosixPath('plate/results.left.nc'))
    """
    return path if sensor == SENSOR else path.with_name(f"{path.stem}.{sensor}{path.suffix}")
