"""All sensors of a rig file: a rig file of one sensor for each, with everything that they have in common."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from fringedic.configuration.rig_file import RigFile, rig_of_content
from fringedic.configuration.sensors_section import REGISTRATION, names_of_sensors
from fringedic.configuration.yaml_section import read_sections
from fringedic.errors import ConfigurationError
from fringedic.settings.base import FOLDER, FilePath
from fringedic.wording.arguments import check_arguments
from fringedic.wording.arguments import path as file_path

_FILE_PATH = TypeAdapter(FilePath)


class RigSensors(NamedTuple):
    """The sensors of a rig.

    Attributes
    ----------
    rigs
        The content of the rig file for each sensor, in the order in which they are measured. All have the same
        namespace, load frame, signals, recording and programme.
    registration
        File with the poses of the sensors; None when they are not registered.
    """

    rigs: tuple[RigFile, ...]
    registration: Path | None = None

    @property
    def names(self) -> list[str]:
        """Names of the sensors."""
        return [rig.sensor for rig in self.rigs]

    @property
    def common(self) -> RigFile:
        """The rig file of the first sensor, for what all have in common."""
        return self.rigs[0]

    def changed(self, change: Callable[[RigFile], RigFile]) -> RigSensors:
        """Return the sensors with a change in each rig file."""
        return self._replace(rigs=tuple(map(change, self.rigs)))


@check_arguments(ConfigurationError, path=file_path)
def load_rig_sensors(path: str | os.PathLike[str], sensor: str | None = None) -> RigSensors:
    """Read and check a rig file with all its sensors, which may be one.

    Parameters
    ----------
    path
        A YAML file.
    sensor
        Only this sensor.

    Raises
    ------
    ConfigurationError
        As of `load_rig_file`; or two sensors have the same camera or projector, or the file of the registration is
        missing.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp(), "rig.yaml")
    >>> own = "{virtual_rig: {arrangement: plate, size: tiny, place: %s}}"
    >>> _ = file.write_text(f"{{camera: {{source: virtual}}, sensors: {{l: {own % 'left'}, r: {own % 'right'}}}}}")
    >>> load_rig_sensors(file).names
    ['l', 'r']
    """
    source = Path(path)
    content = read_sections(source, RigFile)
    names = [] if sensor is not None else names_of_sensors(content, str(source))
    if not names:
        return RigSensors((rig_of_content(content, source, sensor, str(source)),))
    rigs = [rig_of_content(content, source, name, f"{source}: sensor {name}") for name in names]
    _require_own_devices(rigs, source)
    return RigSensors(tuple(rigs), _registration(content.get(REGISTRATION), source))


def _require_own_devices(rigs: Sequence[RigFile], source: Path) -> None:
    """Check that no two sensors have the same camera or projector."""
    users: dict[tuple[str, str, str], str] = {}
    for rig in rigs:
        for part, device in (("camera", rig.camera), ("projector", rig.projector)):
            if device is None or not device.device:
                continue
            first = users.setdefault((part, device.source, device.device), rig.sensor)
            if first != rig.sensor:
                raise ConfigurationError(
                    f"{source}: the sensors '{first}' and '{rig.sensor}' have the same {part} ({device.source}: "
                    f"{device.device}); give each its own"
                )


def _registration(entry: object, source: Path) -> Path | None:
    """Return the file of a registration."""
    if entry is None:
        return None
    if not isinstance(entry, str) or not entry:
        raise ConfigurationError(f"{source}: registration: is no path; write that of the file of 'fringedic register'")
    file = Path(_FILE_PATH.validate_python(entry, context={FOLDER: source.parent}))
    if not file.is_file():
        raise ConfigurationError(f"{source}: registration: there is no file {file}; 'fringedic register' writes one")
    return file
