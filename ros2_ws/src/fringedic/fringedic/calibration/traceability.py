"""What the lengths of a calibration are traced to, and who measured it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from fringedic.calibration.placement import PlaneKind
from fringedic.metadata import Metadata
from fringedic.recording.reader import BagReader
from fringedic.steps.recorded_parameters import RecordedParameters


@dataclass(frozen=True)
class Traceability:
    """What the lengths of a calibration are traced to, and who measured it; empty or None is not known.

    Attributes
    ----------
    grid_pitch
        Distance of the lines of the printed grid [m].
    stage
        What turned the plane.
    sigma_angle, sigma_height
        Standard uncertainty of a single angle [rad] and height [m] of the plane; 0 where none was entered.
    operator
        Name.
    target
        Maker, kind and dimensions of plane and grid.
    """

    grid_pitch: float | None = None
    stage: str = ""
    sigma_angle: float = 0.0
    sigma_height: float = 0.0
    operator: str = ""
    target: str = ""


def recorded_traceability(path: str | os.PathLike[str], sensor: str | None = None) -> Traceability:
    """Return what the recording of a calibration contains about grid, stage, target and operator.

    Parameters
    ----------
    path
        The recording.
    sensor
        Name of the sensor, if the recording contains several.

    Raises
    ------
    RecordingError
        The recording cannot be read.
    """
    reader = BagReader(path, sensor=sensor)
    topics = {full: name for name, full in reader.find("experiment/plane", "node_parameters").items()}
    parameters, known = RecordedParameters({}), Traceability()
    for message in reader.published(topics):
        content = reader.decode(message.topic, message.data)
        if topics[message.topic] == "node_parameters":
            parameters.take(content)
        elif content.kind == PlaneKind.GRID and not content.angle:
            known = replace(known, grid_pitch=content.grid_pitch)
        elif content.kind == PlaneKind.PLANE:
            known = replace(known, sigma_angle=content.sigma_angle, sigma_height=content.sigma_height)
    entered = parameters.settings(None).metadata or Metadata()
    return replace(known, operator=entered.specimen.operator, target=entered.hardware.calibration_target)
