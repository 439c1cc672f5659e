"""Registration and joined surface of the sensors in one recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from fringedic.datasets.opening import open_experiment
from fringedic.datasets.processing import DATASETS
from fringedic.datasets.stores import dataset_path, save_netcdf
from fringedic.errors import CalibrationError, DatasetError, FringedicError, RecordingError
from fringedic.evidence.changes import noted
from fringedic.frames.collector import FrameCollector, Stack
from fringedic.frames.sensor import JOINED
from fringedic.patterns.pattern import Orientation
from fringedic.recording.bag_files import recording_of
from fringedic.recording.frames import RecordedMessage, events
from fringedic.recording.reader import BagReader
from fringedic.rig.model import RigModel
from fringedic.sensors.distance import DistanceAcross, distances_across
from fringedic.sensors.features import Feature, match_balls, measure_balls, measure_plane
from fringedic.sensors.files import REGISTRATION_FILE, load_registration
from fringedic.sensors.join import join_sensors
from fringedic.sensors.registration import Registration, register
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.recorded_parameters import RecordedParameters

_FRAMES = ("camera/image_raw", "camera/exposure", "node_parameters")


@dataclass(frozen=True)
class Balls:
    """A common object of balls: their diameter [m], and how many every sensor sees."""

    diameter: float
    number: int = 3


def register_recording(
    path: str | os.PathLike[str],
    *,
    balls: Balls | None = None,
    calibrations: Mapping[str, RigModel] | None = None,
    reference: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Registration:
    """Place the sensors of a recording in one frame by the object that they see in its steps.

    Parameters
    ----------
    path
        The recording of two or more sensors. In each step the object is in another place.
    balls
        Its balls; None for a plane, which everything measured is then taken for.
    calibrations
        Of sensors, instead of the recorded ones.
    reference
        The sensor whose rig frame becomes the common one; by default the first by name.
    progress
        Called with a sentence about each step that a sensor measured, or could not.

    Raises
    ------
    RecordingError
        The recording contains one sensor only.
    CalibrationError
        A sensor has no calibration, no object in common with the others, or the objects do not determine its pose.
    """
    sensors = _several(Path(path))
    orientation = Orientation.VERTICAL
    models, seen = dict[str, RigModel](), dict[int, dict[str, list[Feature]]]()
    for shape in _shapes(Path(path), sensors, calibrations or {}, models, progress):
        name, model = f"step {shape.step}", models[shape.sensor]
        orientation = shape.orientation
        try:
            if balls is None:
                found = [measure_plane(shape.surface, model, f"{name}, plane", orientation)]
            else:
                found = measure_balls(
                    shape.surface, model, balls.diameter, balls.number, f"{name}, ", shape.orientation
                )
        except CalibrationError as error:
            progress(f"{shape.sensor}, {name}: not used, {error}")
            continue
        seen.setdefault(shape.step, {})[shape.sensor] = found
        progress(f"{shape.sensor}, {name}: {len(found)} {'planes' if balls is None else 'balls'}")
    features = []
    for by_sensor in seen.values():
        first, *others = by_sensor.values()
        features += first
        for other in others:
            features += other if balls is None else match_balls(first, other)
    if not features:
        raise CalibrationError(f"{path}: no sensor measured the object in any step, the reasons are above")
    return register(features, models, reference=reference, orientation=orientation)


def _model(reader: BagReader, sensor: str, calibrations: Mapping[str, RigModel]) -> RigModel:
    if sensor in calibrations:
        return calibrations[sensor]
    topics = reader.find_optional("calibration")
    messages = [message for _, message, _ in reader.messages(topics.values())]
    if not messages:
        raise CalibrationError(
            f"no calibration of the sensor '{sensor}' is recorded: give its file with --calibration {sensor}=FILE"
        )
    model = RigModel.from_message(messages[-1])
    if model.sensor != sensor:
        raise CalibrationError(
            f"the sensor '{sensor}' was recorded with the calibration of the sensor '{model.sensor}': the cameras or "
            "the calibration files are exchanged; exchange them back in the rig file"
        )
    return model


class _Shape(NamedTuple):
    """The surface that a sensor measured in a step."""

    step: int
    sensor: str
    surface: xr.Dataset
    orientation: Orientation


def _several(path: Path) -> list[str]:
    """Return the sensors of a recording of two or more."""
    sensors = sorted(BagReader(recording_of(path)).sensors)
    if len(sensors) < 2:
        raise RecordingError(
            f"{path} contains the sensor {', '.join(sensors)} only: a recording of two or more sensors is needed"
        )
    return sensors


def _shapes(
    path: Path,
    sensors: Sequence[str],
    calibrations: Mapping[str, RigModel],
    models: dict[str, RigModel],
    progress: Callable[[str], None],
) -> Iterator[_Shape]:
    """Yield the surfaces of all sensors and steps, and enter the calibrations of the sensors into `models`."""
    for sensor in sensors:
        reader = BagReader(recording_of(path), sensor=sensor)
        model = models[sensor] = _model(reader, sensor, calibrations)
        for stack, parameters in _stacks(reader):
            try:
                measured = phase_step(stack, parameters)
            except FringedicError as error:
                progress(f"{sensor}, step {stack.step}: not used, {error}")
                continue
            orientation = measured.orientation
            surface = model.reconstruct(measured.phase, measured.pitch, measured.sigma, orientation)
            yield _Shape(stack.step, sensor, surface, orientation)


def _stacks(reader: BagReader) -> Iterator[tuple[Stack, PhaseParameters]]:
    parameters, collector = RecordedParameters({}), FrameCollector()
    for event in events(reader, reader.find(*_FRAMES[:2]) | reader.find_optional(*_FRAMES[2:])):
        if isinstance(event, RecordedMessage):
            parameters.take(event.message)
            continue
        stack = collector.add(event.record, event.image)
        if stack is not None:
            yield stack, parameters.phase


def measure_distances(
    path: str | os.PathLike[str],
    registration: Registration,
    distance: float,
    *,
    diameter: float,
    sigma: float = 0.0,
    calibrations: Mapping[str, RigModel] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[DistanceAcross]:
    """Measure the known distance of two balls, of which one sensor sees one and another sensor the other.

    Parameters
    ----------
    path
        The recording of two or more sensors; in each step the bar with the balls is in another place.
    registration
        Poses of the sensors.
    distance, sigma
        Distance of the centres and its standard uncertainty, of the certificate [m].
    diameter
        Of the balls [m].
    calibrations, progress
        As of `register_recording`.

    Returns
    -------
    list of DistanceAcross
        Of every step and every pair of sensors.

    Raises
    ------
    RecordingError
        The recording contains one sensor only.
    CalibrationError
        A sensor has no calibration, or another one than the registered; or no distance was measured across sensors.
    """
    models, seen = dict[str, RigModel](), dict[int, list[Feature]]()
    for shape in _shapes(Path(path), _several(Path(path)), calibrations or {}, models, progress):
        found = _up_to_two_balls(shape, models[shape.sensor], diameter)
        seen.setdefault(shape.step, []).extend(found)
        progress(f"{shape.sensor}, step {shape.step}: {len(found)} balls")
    distances = [
        each
        for step, balls in seen.items()
        for each in distances_across(balls, models, registration, distance, expected_sigma=sigma, step=step)
    ]
    if not distances:
        raise CalibrationError(
            f"{path}: in no step two sensors measured one of the balls each: place the bar across both views"
        )
    return distances


def _up_to_two_balls(shape: _Shape, model: RigModel, diameter: float) -> list[Feature]:
    """Return the balls of a bar that a sensor sees: two, one or none."""
    for number in (2, 1):
        with suppress(CalibrationError):
            return measure_balls(shape.surface, model, diameter, number, f"step {shape.step}, ", shape.orientation)
    return []


def registration_of(path: str | os.PathLike[str]) -> Path | None:
    """Return the file with the registration of a recording: in its folder, or in that of its run; None without one."""
    recording = recording_of(Path(path))
    places = (recording.with_name(REGISTRATION_FILE), recording.parent.with_name(REGISTRATION_FILE))
    return next((each for each in places if each.is_file()), None)


def join_recording(
    path: str | os.PathLike[str],
    registration: Registration | str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    strain_window: int | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the joined surface of the sensors of a recording as a dataset.

    Parameters
    ----------
    path
        The recording, with the datasets of its sensors from `fringedic.process_bag` beside it.
    registration
        Poses of the sensors, or their file.
    output
        The dataset; by default beside the recording, with the name ``joined`` in the place of that of a sensor.
    strain_window
        As of `join_sensors`.
    overwrite
        Replace an existing output.

    Raises
    ------
    DatasetError
        A dataset of a sensor is missing, or as of `join_sensors`.
    CalibrationError
        The file of the registration cannot be used.
    """
    recording = recording_of(Path(path))
    placed = registration if isinstance(registration, Registration) else load_registration(Path(registration))
    target = dataset_path(recording, output, overwrite, JOINED)
    if target.suffix != ".nc":
        raise DatasetError(f"{target}: a joined dataset is written as NetCDF: name it .nc")
    with ExitStack() as stack:
        datasets: dict[str, xr.Dataset] = {}
        for sensor in sorted(BagReader(recording).sensors):
            datasets[sensor] = stack.enter_context(open_experiment(recording, sensor=sensor))
        joined = join_sensors(datasets, placed, strain_window=strain_window)
        with noted(target, "join", details={DATASETS: {target.name: _details(placed)}}):
            save_netcdf(joined.load(), target)
    return target


def _details(registration: Registration) -> dict[str, Any]:
    created: datetime = registration.created
    return {"registration": created.isoformat(), "sensors": list(registration.poses)}
