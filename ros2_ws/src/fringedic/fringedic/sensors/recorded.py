"""Registration and joined surface of the sensors in one recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import xarray as xr

from fringedic.datasets.opening import open_experiment
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
    recording = recording_of(Path(path))
    sensors = sorted(BagReader(recording).sensors)
    if len(sensors) < 2:
        raise RecordingError(
            f"{path} contains the sensor {', '.join(sensors)} only: a registration needs a recording of two or more"
        )
    models, seen = dict[str, RigModel](), dict[int, dict[str, list[Feature]]]()
    for sensor in sensors:
        reader = BagReader(recording, sensor=sensor)
        models[sensor] = _model(reader, sensor, calibrations or {})
        for stack, parameters in _stacks(reader):
            try:
                found, orientation = _features(stack, parameters, models[sensor], balls)
            except FringedicError as error:
                progress(f"{sensor}, step {stack.step}: not used, {error}")
                continue
            seen.setdefault(stack.step, {})[sensor] = found
            progress(f"{sensor}, step {stack.step}: {len(found)} {'planes' if balls is None else 'balls'}")
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


def _stacks(reader: BagReader) -> Iterator[tuple[Stack, PhaseParameters]]:
    parameters, collector = RecordedParameters({}), FrameCollector()
    for event in events(reader, reader.find(*_FRAMES[:2]) | reader.find_optional(*_FRAMES[2:])):
        if isinstance(event, RecordedMessage):
            parameters.take(event.message)
            continue
        stack = collector.add(event.record, event.image)
        if stack is not None:
            yield stack, parameters.phase


def _features(
    stack: Stack, parameters: PhaseParameters, model: RigModel, balls: Balls | None
) -> tuple[list[Feature], Orientation]:
    """Return the balls, or the plane, of one step."""
    measured = phase_step(stack, parameters)
    shape = model.reconstruct(measured.phase, measured.pitch, measured.sigma, measured.orientation)
    name = f"step {stack.step}"
    if balls is None:
        return [measure_plane(shape, model, f"{name}, plane", measured.orientation)], measured.orientation
    found = measure_balls(shape, model, balls.diameter, balls.number, f"{name}, ", measured.orientation)
    return found, measured.orientation


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
        with noted(target, "join", details=_details(placed)):
            save_netcdf(joined.load(), target)
    return target


def _details(registration: Registration) -> dict[str, Any]:
    created: datetime = registration.created
    return {"registration": created.isoformat(), "sensors": list(registration.poses)}
