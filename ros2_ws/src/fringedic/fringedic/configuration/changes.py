"""Changes of a rig file by a program: settings that a measurement recommends."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from fringedic.configuration.rig_file import REPLACED_KEYS, RigFile, load_rig_file, rig_of_content
from fringedic.configuration.sections import ReferencePlaneSection
from fringedic.configuration.sensors_section import names_of_sensors
from fringedic.configuration.yaml_section import read_sections, validate
from fringedic.errors import ConfigurationError
from fringedic.wording.causes import cause_of
from fringedic.wording.yaml_text import load_yaml


def change_rig_file(path: str | os.PathLike[str], settings: str) -> Path:
    """Change settings in a rig file; the file before stays beside it.

    Parameters
    ----------
    path
        The rig file. Its comments are lost, its keys keep their order.
    settings
        YAML of the changed keys, such as ``camera: {settle_ms: 20}``; other keys keep their values.

    Returns
    -------
    Path
        The file before, with the time in its name.

    Raises
    ------
    ConfigurationError
        The settings are no YAML of keys, the file has several sensors, or the changed file would not be valid; nothing
        is changed then.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp(), "rig.yaml")
    >>> _ = file.write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    >>> before = change_rig_file(file, "camera: {settle_ms: 20}")
    >>> load_rig_file(file).camera.settle_time, load_rig_file(before).camera.settle_time
    (0.02, 0.0)
    """
    file = Path(path)
    try:
        changes = load_yaml(settings)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"settings: {error}") from error
    if not isinstance(changes, dict) or not changes:
        raise ConfigurationError("settings: are not 'key: value'; write for example camera: {settle_ms: 20}")
    _content_of_one_sensor(file)
    text = file.read_text("utf-8")
    candidate = file.with_name(f".{file.stem}.candidate{file.suffix}")  # beside it, for its relative paths
    try:
        candidate.write_text(yaml.safe_dump(_merged(load_yaml(text), changes), sort_keys=False, allow_unicode=True))
        load_rig_file(candidate)
        before = _unused(file, datetime.now().strftime("%Y-%m-%dT%H-%M-%S"))
        before.write_text(text, "utf-8")
        candidate.replace(file)
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be changed: {cause_of(error)}") from error
    finally:
        candidate.unlink(missing_ok=True)
    return before


def load_changed_rig_file(path: str | os.PathLike[str], values: Mapping[str, Any]) -> RigFile:
    """Read a rig file with some values replaced; the file stays as it is.

    Parameters
    ----------
    path
        The rig file.
    values
        By section and key, such as ``{"plan.angle_degree": 35}``.

    Raises
    ------
    ConfigurationError
        The file cannot be read, has several sensors, or would not be valid with these values.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp(), "rig.yaml")
    >>> _ = file.write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    >>> load_changed_rig_file(file, {"sequence.shifts": 8}).sequence.shifts
    [8]
    """
    content = _content_of_one_sensor(Path(path))
    for name, value in values.items():
        section, key = name.split(".")
        content = _merged(content, {section: {key: value}})
    return validate(RigFile, content, str(path), REPLACED_KEYS, folder=Path(path).parent)


def _content_of_one_sensor(file: Path) -> dict[str, Any]:
    """Return the content of a valid rig file of one sensor; of several, a change would be that of all, or of none."""
    content = read_sections(file, RigFile)
    if names := names_of_sensors(content, str(file)):
        raise ConfigurationError(
            f"{file}: has the sensors {', '.join(names)}, and this is possible for one only: write the sections of "
            f"{names[0]} and those of all at the top of a file of its own"
        )
    rig_of_content(content, file, None, str(file))
    return content


def _merged(old: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with changes; mappings in it are merged, everything else is replaced."""
    merged = dict(old)
    for key, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def _unused(file: Path, stamp: str) -> Path:
    """Return a name for the file before that no other one has."""
    candidate, number = file.with_name(f"{file.stem}.before-{stamp}{file.suffix}"), 1
    while candidate.exists():
        number += 1
        candidate = file.with_name(f"{file.stem}.before-{stamp}-{number}{file.suffix}")
    return candidate


def with_angles(rig: RigFile, angles_degree: str) -> RigFile:
    """Return a rig with other calibration angles, given as "0,-10,10", all at height 0; the last but one is held out.

    Raises
    ------
    ConfigurationError
        An angle is not a number, or not possible for a plane.
    """
    try:
        angles = [float(angle) for angle in angles_degree.split(",")]
        held_out = [len(angles) - 1] if len(angles) > 3 else []
    except ValueError as error:
        raise ConfigurationError(
            f"angles {angles_degree}: give numbers separated by commas, such as 0,-15,-10,-5,5,10,15"
        ) from error
    changes = {"angles_degree": angles, "heights_mm": None, "held_out": held_out}
    section = validate(ReferencePlaneSection, rig.reference_plane.model_dump() | changes, f"angles {angles_degree}")
    return rig.model_copy(update={"reference_plane": section})
