"""A recorded calibration, computed again without ROS by the same functions as in the running system."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from fringedic.calibration.placement import PlaneKind, apart
from fringedic.calibration.session import CalibrationSession, Plane, PlaneQuality, Setting
from fringedic.errors import RecordingError
from fringedic.frames.collector import FrameCollector, Stack
from fringedic.recording.frames import RecordedMessage, events
from fringedic.recording.reader import BagReader
from fringedic.rig.compatibility import check_calibration
from fringedic.steps.phase import phase_step
from fringedic.steps.recorded_parameters import RecordedParameters
from fringedic.steps.recorded_rig import RecordedSizes, recorded_setup

_TOPICS = ("camera/image_raw", "camera/exposure", "node_parameters")


@dataclass(frozen=True)
class RecordedPlane:
    """A plane of a recorded calibration that was just measured.

    Attributes
    ----------
    step
        Its step in the recording.
    kind
        Printed grid or plain plane.
    angle
        Of the plane [rad].
    quality
        How well it was measured; None for a grid.
    """

    step: int
    kind: PlaneKind
    angle: float
    quality: PlaneQuality | None = None


def calibrate_recording(
    path: str | os.PathLike[str],
    *,
    sensor: str | None = None,
    progress: Callable[[RecordedPlane], None] = lambda _: None,
) -> CalibrationSession:
    """Calibrate the rig once more from a recording: the latest planes in it, and the grids before them.

    With the same version of this library the numbers are those of the running system, bit by bit.

    Parameters
    ----------
    path
        The recording of a calibration.
    sensor
        Name of the sensor, if the recording contains several.
    progress
        Called with every plane that was measured.

    Returns
    -------
    CalibrationSession
        With ``grid``, ``result`` and ``drift``.

    Raises
    ------
    RecordingError
        The recording contains no calibration, one that ended before its last plane, planes whose frames are incomplete,
        or no grid before them.
    CalibrationError
        The planes do not give a calibration, or one that contradicts the recorded rig; the message gives the reason.
    PatternError
        The coarsest fringes repeat in the camera's view.
    """
    reader = BagReader(path, sensor=sensor)
    planes = _accepted({(each.experiment, each.step): each for each in _messages(reader, "experiment/plane")})
    grids: set[tuple[str, int]] = set()
    steps: dict[str, set[tuple[str, int]]] = {}
    for key, plane in planes.items():
        if plane.kind == PlaneKind.GRID:
            # grids on the tilted plane belong to the same experiment
            grids = {key, *(grids if plane.angle else ())}
        elif grids:
            steps.setdefault(key[0], set(grids)).add(key)
    name = next(reversed(steps), "")
    wanted = steps.get(name, set())
    if not wanted:
        raise RecordingError(f"{path} holds no calibration: a grid, and planes after it")
    # A complete calibration repeats its first plane at the end.
    measured = [plane for key, plane in planes.items() if key in wanted and plane.kind == PlaneKind.PLANE]
    if (
        len(measured) < 2
        or not measured[-1].held_out
        or apart(measured[-1].angle - measured[0].angle, measured[-1].height - measured[0].height)
    ):
        raise RecordingError(
            f"{path}: calibration '{name}' ended before its last plane, which repeats the first one; calibrate again"
        )
    replay = _Replay(name)
    for stack, parameters in _stacks(reader, wanted):
        wanted.discard((stack.experiment, stack.step))
        progress(replay.measure(planes.pop((stack.experiment, stack.step)), stack, parameters))
    if wanted:
        lacking = ", ".join(f"step {step} of '{experiment}'" for experiment, step in sorted(wanted))
        raise RecordingError(f"{path}: frames are missing of {lacking}")
    calibrated = replay.session.calibrate(datetime.fromtimestamp(1e-9 * stack.stamp, UTC))
    check_calibration(calibrated.model, recorded_setup(reader))
    return replay.session


def _accepted(planes: Mapping[tuple[str, int], Any]) -> dict[tuple[str, int], Any]:
    """Return the planes without those that were rejected: they are followed by another attempt at the same place."""
    kept: dict[tuple[str, int], Any] = {}
    for key, plane in planes.items():
        before = next(reversed(kept), None)
        if before is not None and before[0] == key[0] and _place(kept[before]) == _place(plane):
            del kept[before]
        kept[key] = plane
    return kept


def _place(plane: Any) -> tuple[int, float, float, bool]:
    return plane.kind, plane.angle, plane.height, plane.held_out


class _Replay:
    """Gives the recorded grids and planes of one calibration to a session."""

    def __init__(self, name: str) -> None:
        self.session = CalibrationSession()
        self._name = name
        self._sigma_grid = 0.0
        self._begun = False

    def measure(self, plane: Any, stack: Stack, parameters: RecordedParameters) -> RecordedPlane:
        """Measure one plane, described by its ``fringedic_msgs/ReferencePlane``."""
        if plane.kind == PlaneKind.GRID:
            if plane.angle:
                self.session.measure_tilted_grid(stack.frames, plane.angle)
            else:
                self.session.measure_grid(stack.frames, plane.grid_pitch)
            self._sigma_grid = plane.sigma_angle
            return RecordedPlane(stack.step, PlaneKind.GRID, plane.angle)
        measured = phase_step(stack, parameters.phase)
        if not self._begun:
            sizes = RecordedSizes.of(parameters.settings(None).rig)
            if sizes.projector_size is None:
                raise RecordingError("the size of the projector was not recorded; calibrate with the rig itself")
            finest = stack.patterns[-1]
            self.session.locate_pin_hole(self._sigma_grid, finest.orientation)
            self.session.begin(
                Setting(
                    self._name,
                    sizes.projector_size,
                    finest,
                    plane.sigma_angle,
                    plane.sigma_height,
                    sizes.camera_first,
                    stack.sensor,
                )
            )
            self._begun = True
        quality = self.session.add_plane(
            Plane(plane.angle, plane.height, plane.held_out, measured.phase, measured.sigma)
        )
        return RecordedPlane(stack.step, PlaneKind.PLANE, plane.angle, quality)


def _messages(reader: BagReader, name: str) -> Iterator[Any]:
    topic = reader.find(name)[name]
    for message in reader.published([topic]):
        yield reader.decode(topic, message.data)


def _stacks(reader: BagReader, wanted: set[tuple[str, int]]) -> Iterator[tuple[Stack, RecordedParameters]]:
    """Iterate over the stacks of every wanted step with the parameters that were in force."""
    parameters, collector = RecordedParameters({}), FrameCollector()
    for event in events(reader, reader.find(*_TOPICS)):
        if isinstance(event, RecordedMessage):
            parameters.take(event.message)
        elif (event.record.experiment, event.record.step) in wanted:
            stack = collector.add(event.record, event.image)
            if stack is not None:
                yield stack, parameters
