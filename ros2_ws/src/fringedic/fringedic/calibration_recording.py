"""A recorded calibration, computed again without ROS by the same functions as in the running system."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from fringedic.calibration_session import CalibrationSession, Plane, PlaneKind, Setting, place_in_words
from fringedic.chain import phase_step
from fringedic.errors import RecordingError
from fringedic.recording import BagReader
from fringedic.results.messages import image_array
from fringedic.results.recorded_parameters import RecordedParameters
from fringedic.sequence import FrameCollector, FrameRecord, Stack, frame_record, stamp_of

_TOPICS = ("camera/image_raw", "camera/exposure", "node_parameters")


def calibrate_recording(
    path: str | os.PathLike[str], *, progress: Callable[[str], None] = lambda _: None
) -> CalibrationSession:
    """Calibrate the rig once more from a recording: the latest planes in it, and the grids before them.

    With the same version of this library the numbers are those of the running system, bit by bit.

    Parameters
    ----------
    path
        The recording of a calibration.
    progress
        Told in words what is being measured.

    Returns
    -------
    CalibrationSession
        With ``grid``, ``result`` and ``drift``.

    Raises
    ------
    MissingTopicError
        The recording holds no calibration.
    RecordingError
        It holds planes whose frames are incomplete, or no grid before them.
    CalibrationPlanesError, CalibrationAnglesError, CalibrationPhaseError
        The planes do not make a calibration; the message says what is wrong with them.
    """
    reader = BagReader(path)
    planes = {(each.experiment, each.step): each for each in _messages(reader, "experiment/plane")}
    wanted, name = _latest(planes)
    if not wanted:
        raise RecordingError(f"{path} holds no calibration: a grid, and planes after it")
    session = CalibrationSession()
    begun = False
    for stack, parameters in _stacks(reader, wanted):
        plane = planes.pop((stack.experiment, stack.step))
        wanted.discard((stack.experiment, stack.step))
        if plane.kind == PlaneKind.GRID:
            progress(place_in_words(plane.kind, plane.angle, plane.height))
            if plane.angle:
                session.measure_turned_grid(stack.frames, plane.angle)
            else:
                session.measure_grid(stack.frames, plane.grid_pitch)
            sigma_grid = plane.sigma_angle
            continue
        measured = phase_step(stack, parameters.phase)
        if not begun:
            others = parameters.settings(None).rig["experiment"]
            size = (others["projector_width_px"], others["projector_height_px"])
            finest = stack.projections[-1]
            session.locate_pin_hole(sigma_grid, finest.orientation)
            session.begin(Setting(name, size, finest, plane.sigma_angle, plane.sigma_height))
            begun = True
        words = session.add_plane(Plane(plane.angle, plane.height, plane.held_out, measured.phase, measured.sigma))
        progress(f"plane {stack.step + 1}: {words}")
    if wanted:
        steps = ", ".join(f"step {step} of '{experiment}'" for experiment, step in sorted(wanted))
        raise RecordingError(f"{path}: frames are missing of {steps}")
    session.calibrate(datetime.fromtimestamp(1e-9 * stack.stamp, UTC))
    return session


def _latest(planes: Mapping[tuple[str, int], Any]) -> tuple[set[tuple[str, int]], str]:
    """Return the steps of the latest calibration with those of the grids before it, and its name; none when none is."""
    grids: set[tuple[str, int]] = set()
    steps: dict[str, set[tuple[str, int]]] = {}
    for key, plane in planes.items():
        if plane.kind == PlaneKind.GRID:
            # on the turned plane in the same experiment
            grids = {key, *(grids if plane.angle else ())}
        elif grids:
            steps.setdefault(key[0], set(grids)).add(key)
    return (steps[name], name) if (name := next(reversed(steps), "")) else (set(), "")


def _messages(reader: BagReader, name: str) -> Iterator[Any]:
    topic = reader.find(name)[name]
    for message in reader.published([topic]):
        yield reader.decode(topic, message.data)


def _stacks(reader: BagReader, wanted: set[tuple[str, int]]) -> Iterator[tuple[Stack, RecordedParameters]]:
    """The frames of every wanted step, and the parameters that held then."""
    names = {full: name for name, full in reader.find(*_TOPICS).items()}
    parameters, collector = RecordedParameters({}), FrameCollector()
    images: dict[int, Any] = {}
    records: dict[int, FrameRecord] = {}
    for raw in reader.published(names):
        message = reader.decode(raw.topic, raw.data)
        match names[raw.topic]:
            case "node_parameters":
                parameters.take(message)
            case "camera/image_raw":
                images[stamp_of(message)] = message
            case "camera/exposure":
                records[stamp_of(message)] = frame_record(message)
        for stamp in images.keys() & records.keys():
            image, record = images.pop(stamp), records.pop(stamp)
            if (record.experiment, record.step) in wanted:
                stack = collector.add(record, image_array(image))
                if stack is not None:
                    yield stack, parameters
