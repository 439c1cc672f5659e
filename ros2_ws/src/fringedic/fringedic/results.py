"""From a recording to one labelled dataset, without ROS, and from datasets to figures of merit.

A dataset is a NetCDF file beside the recording, written step by step. Its dimensions are ``step``, ``row`` and
``column``; the coordinates ``row`` and ``column`` are pixel positions in the reference image. All maps share the grid
of the displacement: where its spacing is above one pixel, maps of the camera's pixels are taken at those points.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import h5netcdf
import h5py  # type: ignore[import-untyped]
import numpy as np
import xarray as xr
from pydantic import ValidationError

from fringedic import __version__
from fringedic.chain import (
    CouplingParameters,
    CouplingResult,
    DicParameters,
    DicResult,
    DisplacementTracker,
    Parameters,
    PhaseParameters,
    PhaseResult,
    ShapeTracker,
    phase_step,
    white_texture,
)
from fringedic.errors import (
    DatasetError,
    FrameMismatchError,
    FringedicError,
    MissingTopicError,
    ParameterError,
)
from fringedic.recording import BagReader
from fringedic.rig import RigModel
from fringedic.sequence import FrameCollector, FrameRecord, PatternKind, Stack, frame_record, stamp_of

Model = TypeVar("Model", bound=Parameters)
MICRO = 1e-6
_UNPAIRED = 64  # images or exposure records that may wait for each other
_ERROR_STAGE = 4  # of fringedic_msgs/StepStatus
_PIXELS = {"mono8": ("u1", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "32FC2": ("f4", 2)}


class Quantity(NamedTuple):
    """Unit and meaning of one map."""

    units: str
    long_name: str


MAPS: dict[str, Quantity] = {
    "phase": Quantity("rad", "absolute phase at the finest pitch"),
    "phase_sigma": Quantity("rad", "standard deviation of the phase"),
    "modulation": Quantity("grey level", "fringe amplitude"),
    "texture": Quantity("grey level", "surface without fringes"),
    "displacement_x": Quantity("px", "in-plane displacement along columns"),
    "displacement_y": Quantity("px", "in-plane displacement along rows, downwards"),
    "displacement_sigma_x": Quantity("px", "standard deviation of displacement_x"),
    "displacement_sigma_y": Quantity("px", "standard deviation of displacement_y"),
    "shape_x": Quantity("m", "x of this step's surface, seen by this pixel"),
    "shape_y": Quantity("m", "y of this step's surface, seen by this pixel"),
    "shape_z": Quantity("m", "height of this step's surface, seen by this pixel"),
    "shape_sigma_z": Quantity("m", "standard deviation of shape_z"),
    "x": Quantity("m", "x of the reference surface, to the right"),
    "y": Quantity("m", "y of the reference surface, upwards"),
    "z": Quantity("m", "height of the reference surface, towards the camera"),
    "u": Quantity("m", "displacement along x"),
    "v": Quantity("m", "displacement along y"),
    "w": Quantity("m", "displacement along z"),
    "sigma_u": Quantity("m", "standard deviation of u"),
    "sigma_v": Quantity("m", "standard deviation of v"),
    "sigma_w": Quantity("m", "standard deviation of w"),
    "u_t": Quantity("m", "displacement along the surface, first tangent"),
    "v_t": Quantity("m", "displacement along the surface, second tangent"),
    "w_n": Quantity("m", "displacement along the surface's normal"),
    "e_11": Quantity("1", "surface strain along the first tangent"),
    "e_22": Quantity("1", "surface strain along the second tangent"),
    "e_12": Quantity("1", "surface shear strain (tensor)"),
}
SCALARS: dict[str, Quantity] = {
    "force": Quantity("N", "mean force over the exposures"),
    "position": Quantity("m", "mean crosshead position over the exposures"),
    "valid_fraction": Quantity("1", "part of the points with a result of the last processing step"),
    "rms_displacement": Quantity("m", "root mean square length of (u, v, w)"),
}
PHASE_TOPICS = {"map": "phase", "sigma": "phase_sigma", "modulation": "modulation", "texture": "texture"}


# ---------------------------------------------------------------------------------------------------------- processing


def process_bag(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    steps: Iterable[int] | None = None,
    experiment: str | None = None,
    overwrite: bool = False,
    progress: Callable[[int, str], None] | None = None,
) -> Path:
    """Measure a recorded experiment again from its raw topics, by the same step functions that the nodes call.

    With the recorded parameters the maps equal those of the nodes bit by bit. A step that fails keeps its row, without
    maps, and says why in the variable ``error``. Of a recording that is cut off all whole steps are measured; the
    attribute ``damage`` says what is lost.

    Parameters
    ----------
    path
        The recording.
    output
        The NetCDF file to write; by default beside the recording with its name.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    steps
        Numbers of the steps to measure; all by default. The reference steps are measured anyway. The displacement of
        a step starts from that of its predecessors, so that results without them agree within the noise, not exactly.
    experiment
        Which experiment, where the recording holds several.
    overwrite
        Replace an existing output.
    progress
        Called after each step with its number and its error message, empty when it succeeded.

    Returns
    -------
    Path
        The NetCDF file.

    Raises
    ------
    MissingTopicError
        The recording lacks images or exposure records.
    RecordingError
        It is damaged somewhere in between; `fringedic.recording.recover` saves the rest.
    ParameterError
        An override is unknown or not allowed.
    DatasetError
        The output exists, or the recording holds no frame of the experiment, or several experiments.
    """
    reader = BagReader(path)
    names = reader.find("camera/image_raw", "camera/exposure")
    names |= reader.find_optional(
        "experiment/step", "experiment/reference", "calibration", "node_parameters", "load_frame/state"
    )
    chain = _Chain(overrides or {})
    timeline = _Timeline(reader, names, experiment)
    wanted = None if steps is None else set(steps) | timeline.references
    target = _output(path, output, overwrite)
    topics = {full: name for name, full in names.items() if name != "load_frame/state"}

    def rows() -> Iterator[_Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from chain.take(name, message, wanted)
        yield from chain.finish()

    _write(target, timeline, rows(), chain.settings, progress)
    return target


def dataset_from_derived(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    experiment: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the dataset of an experiment from what the nodes published, without measuring anything again.

    Parameters
    ----------
    path, output, experiment, overwrite
        As for `process_bag`, and the maps can be compared with those of `process_bag` one by one.

    Returns
    -------
    Path
        The NetCDF file.

    Raises
    ------
    MissingTopicError
        The recording holds no derived topics.
    RecordingError
        It is damaged.
    DatasetError
        The output exists, or the recording holds no step of the experiment, or several experiments.
    """
    reader = BagReader(path)
    names = reader.find("phase/status", "dic/status", "camera/exposure")
    derived = reader.find_optional(
        *(f"phase/{topic}" for topic in PHASE_TOPICS),
        *("dic/displacement", "dic/sigma", "coupling/shape", "coupling/displacement", "coupling/status"),
    )
    names |= derived
    names |= reader.find_optional("experiment/reference", "calibration", "node_parameters", "load_frame/state")
    timeline = _Timeline(reader, names, experiment)
    target = _output(path, output, overwrite)
    collected = _Collected(set(derived) | {"phase/status", "dic/status"})
    topics = {full: name for name, full in names.items() if name not in ("load_frame/state", "camera/exposure")}

    def rows() -> Iterator[_Row]:
        for name, message in _messages(reader, topics, timeline.experiment):
            yield from collected.take(name, message)
        yield from collected.finish()

    _write(target, timeline, rows(), collected.settings, None)
    return target


def open_experiment(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open a recorded experiment as one labelled dataset; maps are read from the disk when they are used.

    Parameters
    ----------
    path
        A NetCDF file, or a recording: then its dataset beside it, which is made from the derived topics when there is
        none yet.

    Returns
    -------
    Dataset
        Maps over (step, row, column) in SI units, with force, position, time and error of each step.

    Raises
    ------
    MissingTopicError
        The recording has neither a dataset nor derived topics; `process_bag` measures it.
    DatasetError
        The file is no dataset of this library.
    RecordingError
        There is no such recording.
    """
    path = Path(path)
    file = path
    if path.suffix != ".nc":
        file = _output(path, None, overwrite=True)
        if not file.exists():
            try:
                dataset_from_derived(path)
            except MissingTopicError as error:
                raise MissingTopicError(f"{error}; 'fringedic process {path}' measures it") from error
    try:
        dataset = xr.open_dataset(file, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: cannot be read as NetCDF: {error}") from error
    if not {"step", "row", "column"} <= set(dataset.sizes):
        dataset.close()
        raise DatasetError(f"{file}: is no experiment; it lacks the dimensions step, row and column")
    return dataset


def _messages(reader: BagReader, topics: Mapping[str, str], experiment: str) -> Iterator[tuple[str, Any]]:
    """Iterate over (relative topic, message) of one experiment in the order of publishing."""
    for raw in reader.published(topics):
        message = reader.decode(raw.topic, raw.data)
        if getattr(message, "experiment", experiment) == experiment:
            yield topics[raw.topic], message


def _write(
    target: Path,
    timeline: _Timeline,
    rows: Iterator[_Row],
    settings: Callable[[], _Settings],
    progress: Callable[[int, str], None] | None,
) -> None:
    attributes = {"experiment": timeline.experiment, "source": timeline.source}
    if timeline.damage:
        attributes["damage"] = timeline.damage
    with _DatasetWriter(target, attributes) as writer:
        for row in rows:
            timeline.complete(row)
            writer.add(row, settings())
            if progress is not None:
                progress(row.step, row.error)


def _output(path: str | os.PathLike[str], output: str | os.PathLike[str] | None, overwrite: bool) -> Path:
    source = Path(path)
    beside = source.with_suffix(".nc") if source.is_file() else source.with_name(f"{source.name}.nc")
    target = beside if output is None else Path(output)
    if target.exists() and not overwrite:
        raise DatasetError(f"{target} exists already; choose another output or ask to overwrite it")
    return target


@dataclass
class _Row:
    """One step on its way into the dataset; the stamp is None when its last frame never came."""

    step: int
    stamp: int | None = None
    error: str = ""
    reference_step: int | None = None
    force: float = float("nan")
    position: float = float("nan")
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    maps: dict[str, np.ndarray] = field(default_factory=dict)


class _Settings(NamedTuple):
    """What a row was measured with."""

    parameters: dict[str, Parameters]
    calibration: RigModel | None

    @property
    def spacing(self) -> int:
        dic = self.parameters["dic"]
        assert isinstance(dic, DicParameters)
        return dic.spacing


class _Chain:
    """The phase, dic and coupling nodes in one, fed with the recorded messages."""

    def __init__(self, overrides: Mapping[str, Any]) -> None:
        self._parameters = _RecordedParameters(overrides)
        self._collector = FrameCollector()
        self._displacement = DisplacementTracker(self._parameters.dic)
        self._shape = ShapeTracker(self._parameters.coupling)
        self._calibration: RigModel | None = None
        self._images: OrderedDict[int, Any] = OrderedDict()
        self._records: OrderedDict[int, FrameRecord] = OrderedDict()
        self._answered: set[int] = set()

    def settings(self) -> _Settings:
        return _Settings(self._parameters.current(), self._calibration)

    def take(self, topic: str, message: Any, wanted: set[int] | None) -> list[_Row]:
        """Take one recorded message and return the steps that it completes."""
        if topic == "node_parameters":
            self._parameters.take(message)
        elif topic == "calibration":
            self._calibration = rig_model(message)
            self._shape.set_calibration(self._calibration)
        elif topic == "experiment/reference":
            self._displacement.set_reference(message.experiment, message.step)
            self._shape.set_reference(message.experiment, message.step)
        elif topic == "experiment/step":
            return self._end(message)
        elif topic == "camera/image_raw":
            return self._join(stamp_of(message), image=message, wanted=wanted)
        else:
            return self._join(stamp_of(message), record=frame_record(message), wanted=wanted)
        return []

    def finish(self) -> list[_Row]:
        """Return the steps that the recording leaves incomplete."""
        return [self._abandoned(*key) for key in self._collector.open_steps]

    def _end(self, message: Any) -> list[_Row]:
        key = (message.experiment, message.step)
        if message.stage == _ERROR_STAGE and key in self._collector.open_steps:
            return [self._abandoned(*key)]
        return []

    def _abandoned(self, experiment: str, step: int) -> _Row:
        self._answered.add(step)
        return _Row(step, error=str(self._collector.abandon(experiment, step)))

    def _join(
        self, stamp: int, *, image: Any = None, record: FrameRecord | None = None, wanted: set[int] | None
    ) -> list[_Row]:
        if image is not None:
            self._images[stamp] = image
        if record is not None:
            self._records[stamp] = record
        for waiting in (self._images, self._records):
            while len(waiting) > _UNPAIRED:
                waiting.popitem(last=False)
        if stamp not in self._images or stamp not in self._records:
            return []
        image, record = self._images.pop(stamp), self._records.pop(stamp)
        unwanted = wanted is not None and record.step not in wanted
        if record.projection.kind == PatternKind.OTHER or unwanted or record.step in self._answered:
            return []
        return self._collect(record, image)

    def _collect(self, record: FrameRecord, image: Any) -> list[_Row]:
        try:
            stack = self._collector.add(record, image_array(image))
        except FringedicError as error:
            self._collector.abandon(record.experiment, record.step)
            self._answered.add(record.step)
            return [_Row(record.step, record.stamp, error=str(error))]
        if stack is None:
            return []
        self._answered.add(record.step)
        return [self._measure(stack)]

    def _measure(self, stack: Stack) -> _Row:
        row = _Row(stack.step, stack.stamp)
        try:
            if stack.kind == PatternKind.WHITE:
                _add_displacement(row, self._displace(stack, white_texture(stack.frames[-1])))
            else:
                phase = phase_step(stack, self._parameters.phase)
                _add_phase(row, phase)
                displacement = self._displace(stack, phase.texture)
                _add_displacement(row, displacement)
                _add_coupling(row, self._couple(phase, displacement))
        except FringedicError as error:
            row.error = str(error)
        return row

    def _displace(self, stack: Stack, texture: np.ndarray) -> DicResult:
        self._displacement.parameters = self._parameters.dic
        return self._displacement.step(stack.experiment, stack.step, stack.stamp, texture)

    def _couple(self, phase: PhaseResult, displacement: DicResult) -> CouplingResult:
        self._shape.parameters = self._parameters.coupling
        return self._shape.step(
            phase.experiment,
            phase.step,
            phase.stamp,
            phase.phase,
            phase.sigma,
            displacement.displacement,
            displacement.sigma,
            pitch=phase.pitch,
            orientation=phase.orientation,
            spacing=displacement.spacing,
            origin=displacement.origin,
        )


def _add_phase(row: _Row, result: PhaseResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.maps |= {
        "phase": result.phase,
        "phase_sigma": result.sigma,
        "modulation": result.modulation,
        "texture": result.texture,
    }


def _add_displacement(row: _Row, result: DicResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.reference_step = result.reference_step
    row.maps |= _displacement_maps(result.displacement, result.sigma)


def _add_coupling(row: _Row, result: CouplingResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.rms_displacement = result.rms
    row.maps |= {f"shape_{name}": values for name, values in result.shape.items()}
    row.maps |= result.displacement


def _displacement_maps(displacement: np.ndarray, sigma: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "displacement_x": displacement[..., 0],
        "displacement_y": displacement[..., 1],
        "displacement_sigma_x": sigma[..., 0],
        "displacement_sigma_y": sigma[..., 1],
    }


class _RecordedParameters:
    """Parameters of the processing nodes as recorded, with overrides on top."""

    def __init__(self, overrides: Mapping[str, Any]) -> None:
        self.phase = PhaseParameters()
        self.dic = DicParameters()
        self.coupling = CouplingParameters()
        self._overrides: dict[str, dict[str, Any]] = {"phase": {}, "dic": {}, "coupling": {}}
        for name, value in overrides.items():
            node, _, parameter = name.partition(".")
            if node not in self._overrides or parameter not in type(getattr(self, node)).model_fields:
                known = ", ".join(f"{each}.{key}" for each in self._overrides for key in self._model(each).model_fields)
                raise ParameterError(f"there is no parameter '{name}'; known are {known}")
            self._overrides[node][parameter] = value
        for node in self._overrides:
            self._set(node, {})

    def current(self) -> dict[str, Parameters]:
        return {"phase": self.phase, "dic": self.dic, "coupling": self.coupling}

    def take(self, message: Any) -> None:
        """Take what one node published about its parameters; those that this version does not know are left out."""
        if message.node in self._overrides:
            known = self._model(message.node).model_fields
            self._set(
                message.node, {each.name: _value(each.value) for each in message.parameters if each.name in known}
            )

    def _model(self, node: str) -> type[Parameters]:
        return type(getattr(self, node))

    def _set(self, node: str, recorded: Mapping[str, Any]) -> None:
        try:
            setattr(self, node, self._model(node)(**{**recorded, **self._overrides[node]}))
        except ValidationError as error:
            problems = "; ".join(
                f"{node}.{each['loc'][0]} = {each['input']!r}: {each['msg']}" for each in error.errors()
            )
            raise ParameterError(problems) from error


def _value(value: Any) -> Any:
    """Value of an ``rcl_interfaces/ParameterValue``."""
    kinds = ("", "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array")
    content = getattr(value, f"{(*kinds, 'string_array')[value.type]}_value")
    return list(content) if isinstance(content, np.ndarray | list) else content


class _Timeline:
    """When each step was exposed, and what the load frame said at that time."""

    def __init__(self, reader: BagReader, names: Mapping[str, str], experiment: str | None) -> None:
        exposures = [frame_record(message) for _, message, _ in reader.messages([names["camera/exposure"]])]
        exposures = [each for each in exposures if each.projection.kind != PatternKind.OTHER]
        present = list(dict.fromkeys(each.experiment for each in exposures))
        if experiment is None and len(present) > 1:
            raise DatasetError(f"{reader.path} holds the experiments {', '.join(present)}: say which one")
        if not present or (experiment is not None and experiment not in present):
            wanted = "any experiment" if experiment is None else f"experiment '{experiment}'"
            raise DatasetError(f"{reader.path} holds no frame of {wanted}; it has {', '.join(present) or 'none'}")
        self.experiment = present[0] if experiment is None else experiment
        self.source = reader.path.name
        self.damage = reader.lost
        self._exposed: dict[int, tuple[float, float]] = {}
        self.references: set[int] = set()
        for record in exposures:
            if record.experiment != self.experiment:
                continue
            begin, end = self._exposed.get(record.step, (np.inf, -np.inf))
            half = 0.5e9 * record.exposure_time
            self._exposed[record.step] = min(begin, record.stamp - half), max(end, record.stamp + half)
        if "experiment/reference" in names:
            messages = [message for _, message, _ in reader.messages([names["experiment/reference"]])]
            self.references = {message.step for message in messages if message.experiment == self.experiment}
        self.references |= {min(self._exposed)}
        states = []
        if "load_frame/state" in names:
            messages = [message for _, message, _ in reader.messages([names["load_frame/state"]])]
            states = [(stamp_of(message), message.force, message.position) for message in messages]
        self._stamps = np.array([state[0] for state in states], dtype=np.int64)
        self._states = np.array([state[1:] for state in states], dtype=float).reshape(-1, 2)

    def complete(self, row: _Row) -> None:
        """Average force and position over the exposures of a step; one that failed before its first has none."""
        if row.step not in self._exposed:
            return
        begin, end = self._exposed[row.step]
        within = (self._stamps >= begin) & (self._stamps <= end)
        if within.any():
            row.force, row.position = (float(value) for value in self._states[within].mean(axis=0))
        if row.stamp is None:
            row.stamp = int(end)


class _Collected:
    """Joins what the nodes published of each step."""

    def __init__(self, topics: set[str]) -> None:
        self._topics = topics
        self._parameters = _RecordedParameters({})
        self._calibration: RigModel | None = None
        self._steps: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._reference: int | None = None

    def settings(self) -> _Settings:
        return _Settings(self._parameters.current(), self._calibration)

    def take(self, topic: str, message: Any) -> list[_Row]:
        if topic == "node_parameters":
            self._parameters.take(message)
            return []
        if topic == "calibration":
            self._calibration = rig_model(message)
            return []
        if topic == "experiment/reference":
            self._reference = message.step
            return []
        stamp = stamp_of(message)
        parts = self._steps.setdefault(stamp, {})
        parts[topic] = message
        if self._expected(parts) <= parts.keys():
            return [self._row(self._steps.pop(stamp), stamp)]
        return []

    def finish(self) -> list[_Row]:
        """Return the steps of which messages are missing; they cannot be told from each other without a status."""
        return [
            self._row(parts, stamp)
            for stamp, parts in self._steps.items()
            if any(topic.endswith("/status") for topic in parts)
        ]

    def _expected(self, parts: Mapping[str, Any]) -> set[str]:
        """Topics that a step has, so far as the statuses tell: a node that failed or skipped publishes no maps."""
        expected = set()
        for topic in self._topics:
            node, name = topic.split("/")
            status = parts.get(f"{node}/status")
            white = node != "dic" and status is not None and not _has_maps(status)
            failed = status is not None and status.error_code != 0
            if name == "status" or not (white or failed):
                expected.add(topic)
        return expected

    def _row(self, parts: Mapping[str, Any], stamp: int) -> _Row:
        statuses = [parts[f"{node}/status"] for node in ("phase", "dic", "coupling") if f"{node}/status" in parts]
        row = _Row(statuses[0].step, stamp)
        for status in statuses:
            if status.error_code:
                row.error = row.error or status.error_message
            elif not np.isnan(status.valid_fraction):
                row.valid_fraction = status.valid_fraction
        for topic, name in PHASE_TOPICS.items():
            if f"phase/{topic}" in parts:
                row.maps[name] = image_array(parts[f"phase/{topic}"])
        if "dic/displacement" in parts and "dic/sigma" in parts:
            row.maps |= _displacement_maps(image_array(parts["dic/displacement"]), image_array(parts["dic/sigma"]))
            self._reference = row.step if self._reference is None else self._reference
            row.reference_step = self._reference
        if "coupling/shape" in parts:
            row.maps |= {f"shape_{name}": values for name, values in cloud_arrays(parts["coupling/shape"]).items()}
        if "coupling/displacement" in parts:
            row.maps |= cloud_arrays(parts["coupling/displacement"])
            row.rms_displacement = parts["coupling/status"].rms if "coupling/status" in parts else float("nan")
        return row


def _has_maps(status: Any) -> bool:
    """Whether a processing node had anything to do for a step: not for a white one."""
    return not (np.isnan(status.valid_fraction) and status.error_code == 0)


# ------------------------------------------------------------------------------------------------------------- writing


class _DatasetWriter:
    """Appends steps to a NetCDF file, which gets its name when it is whole."""

    def __init__(self, target: Path, attributes: Mapping[str, str]) -> None:
        self._target = target
        self._temporary = target.with_name(f".{target.name}.writing")
        self._file: Any = None
        self._settings: list[dict[str, Any]] = []
        self._attributes = {
            **attributes,
            "software": f"fringedic {__version__}",
            "conventions": "SI units; z towards the camera, x right and y up in the image; NaN is not measured",
        }
        self._grid: tuple[int, int, int] | None = None
        self._count = 0
        self._last_error = ""

    def __enter__(self) -> _DatasetWriter:
        try:
            self._file = h5netcdf.File(self._temporary, "w")
        except OSError as error:
            raise DatasetError(f"{self._target}: cannot be written: {error}") from error
        self._file.dimensions = {"step": None}
        self._variable("step", ("step",), "i8", "1", "load step")
        self._variable("time", ("step",), "i8", "nanoseconds since 1970-01-01", "stamp of the last exposure")
        self._variable("reference_step", ("step",), "i8", "1", "step that the displacement is measured against")
        self._variable("error", ("step",), h5py.string_dtype(), "", "why the step failed, empty when it did not")
        for name, quantity in SCALARS.items():
            self._variable(name, ("step",), "f8", *quantity)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        whole = kind is None and self._grid is not None
        if whole:
            for name, value in self._attributes.items():
                self._file.attrs[name] = value
        self._file.close()
        if whole:
            self._temporary.replace(self._target)
            return
        self._temporary.unlink()
        if kind is None:
            raise DatasetError(f"{self._target}: no step could be measured: {self._last_error or 'no frames'}")

    def add(self, row: _Row, settings: _Settings) -> None:
        """Append one step."""
        self._describe(row.step, settings)
        self._last_error = row.error or self._last_error
        index = self._count
        self._count += 1
        self._file.resize_dimension("step", self._count)
        values: dict[str, Any] = {
            "step": row.step,
            "time": row.stamp,
            "reference_step": -1 if row.reference_step is None else row.reference_step,
            "error": row.error,
        }
        values |= {name: getattr(row, name) for name in SCALARS}
        for name, value in values.items():
            self._file[name][index] = value
        if row.maps:
            self._write_maps(index, row, settings.spacing)
        self._file.flush()

    def _write_maps(self, index: int, row: _Row, spacing: int) -> None:
        points = row.maps["displacement_x"] if "displacement_x" in row.maps else _sampled(row.maps["phase"], spacing)
        grid = (*points.shape, spacing)
        if self._grid is None:
            self._create_grid(grid)
        elif grid != self._grid:
            raise DatasetError(
                f"{self._target}: step {row.step} has {grid[1]}x{grid[0]} points at a spacing of {grid[2]} px, the "
                f"steps before have {self._grid[1]}x{self._grid[0]} at {self._grid[2]} px; process them separately"
            )
        for name, values in row.maps.items():
            if name in self._file.variables:
                sampled = values if values.shape == grid[:2] else _sampled(values, spacing)
                self._file[name][index] = sampled

    def _create_grid(self, grid: tuple[int, int, int]) -> None:
        rows, columns, spacing = self._grid = grid
        self._file.dimensions["row"] = rows
        self._file.dimensions["column"] = columns
        for name, number in (("row", rows), ("column", columns)):
            variable = self._variable(name, (name,), "i8", "px", f"{name} in the reference image")
            variable[:] = spacing * np.arange(number)
        for name, quantity in MAPS.items():
            self._variable(
                name,
                ("step", "row", "column"),
                "f4",
                *quantity,
                chunks=(1, rows, columns),
                fillvalue=np.float32(np.nan),
            )

    def _variable(
        self, name: str, dimensions: tuple[str, ...], dtype: Any, units: str, long_name: str, **options: Any
    ) -> Any:
        variable = self._file.create_variable(name, dimensions, dtype, **options)
        if units:
            variable.attrs["units"] = units
        variable.attrs["long_name"] = long_name
        return variable

    def _describe(self, step: int, settings: _Settings) -> None:
        """Note parameters and calibration in the attributes, with the step from which on they hold."""
        now = {node: parameters.model_dump() for node, parameters in settings.parameters.items()}
        if not self._settings or self._settings[-1]["parameters"] != now:
            self._settings.append({"from_step": step, "parameters": now})
            self._attributes["parameters"] = json.dumps(self._settings)
        if settings.calibration is not None:
            self._attributes["calibration"] = json.dumps(dataclasses.asdict(settings.calibration))


def _sampled(image: np.ndarray, spacing: int) -> np.ndarray:
    return image[::spacing, ::spacing]


# ------------------------------------------------------------------------------------------------------------ messages


def image_array(message: Any) -> np.ndarray:
    """Return the pixels of a decoded ``sensor_msgs/Image``, shape (row, column) or (row, column, channel).

    Raises
    ------
    FrameMismatchError
        The encoding is not known, or the data have another size than the header says.
    """
    if message.encoding not in _PIXELS:
        raise FrameMismatchError(f"an image has the encoding '{message.encoding}'; known are {', '.join(_PIXELS)}")
    kind, channels = _PIXELS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize
    if message.step < row_bytes or message.data.size != message.step * message.height:
        raise FrameMismatchError(
            f"an image of {message.width}x{message.height} px ({message.encoding}) holds {message.data.size} bytes in "
            f"rows of {message.step}"
        )
    rows = message.data.reshape(message.height, message.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return pixels if channels == 1 else pixels.reshape(message.height, message.width, channels)


def cloud_arrays(message: Any) -> dict[str, np.ndarray]:
    """Return the float32 fields of a decoded organised ``sensor_msgs/PointCloud2`` by name, shape (row, column)."""
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [each.name for each in message.fields],
            "formats": [f"{order}f4"] * len(message.fields),
            "offsets": [each.offset for each in message.fields],
            "itemsize": message.point_step,
        }
    )
    points = message.data.view(layout).reshape(message.height, message.width)
    return {name: points[name] for name in layout.names or ()}


def rig_model(message: Any) -> RigModel:
    """Return the calibration of a decoded ``fringedic_msgs/RigCalibration``."""
    values: dict[str, Any] = {each.name: getattr(message, each.name) for each in dataclasses.fields(RigModel)}
    for name, value in values.items():
        if isinstance(value, np.ndarray | list):
            values[name] = tuple(np.asarray(value).tolist())
    return RigModel(**values)


# ---------------------------------------------------------------------------------------------------------- comparison


def open_truth(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open the ground truth that a virtual rig wrote: a NetCDF file, or a folder with ``truth.nc``.

    Raises
    ------
    DatasetError
        There is no such truth.
    """
    file = Path(path) / "truth.nc" if Path(path).is_dir() else Path(path)
    try:
        return xr.open_dataset(file, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: is no ground truth: {error}") from error


def truth_errors(dataset: xr.Dataset, truth: xr.Dataset, step: int) -> xr.Dataset:
    """Return measured minus true values of one step, NaN where not measured or not seen in both images.

    Parameters
    ----------
    dataset
        From `open_experiment`.
    truth
        From `open_truth`; its step n belongs to step n of the dataset.
    step
        Number of the step.

    Returns
    -------
    Dataset
        ``u``, ``v``, ``w`` of the material points of the reference image and ``shape_z``, the height of this step's
        surface at each of its own pixels [m]; ``visible``, where there was something to measure.

    Raises
    ------
    DatasetError
        The truth lacks the step or the pixels.
    """
    if not 0 <= step < truth.sizes["step"]:
        raise DatasetError(f"the truth has {truth.sizes['step']} steps, step {step} is not among them")
    try:
        exact = truth.isel(step=step).sel(row=dataset.row.values, column=dataset.column.values)
    except KeyError as error:
        raise DatasetError(f"the truth lacks pixels of the dataset: {error}") from error
    measured = dataset.sel(step=step)
    visible = exact["valid"].astype(bool).values & np.isfinite(exact["u"].values)
    errors = {name: np.where(visible, measured[name].values - exact[name].values, np.nan) for name in "uvw"}
    errors["shape_z"] = measured["shape_z"].values - exact["z_deformed"].values
    coordinates = {"row": dataset.row, "column": dataset.column}
    maps = {
        name: (("row", "column"), values, {"units": "m", "long_name": f"error of {name}"})
        for name, values in errors.items()
    }
    return xr.Dataset(maps | {"visible": (("row", "column"), visible, {"units": "1"})}, coordinates)


def compare_with_truth(dataset: xr.Dataset, truth_path: str | os.PathLike[str]) -> xr.Dataset:
    """Compare each step with the ground truth of the virtual rig.

    Compared are the displacement (u, v, w) of the material points seen by each reference pixel, and the height of the
    deformed surface at each of its pixels, wherever both the measurement and the truth have a value.

    Parameters
    ----------
    dataset
        From `open_experiment`.
    truth_path
        See `open_truth`.

    Returns
    -------
    Dataset
        Over ``step``: ``error_u``, ``error_v``, ``error_w``, ``error_z`` RMS [µm], and ``measured_fraction``, the part
        of the points visible in both images that was measured.

    Raises
    ------
    DatasetError
        The truth lacks steps or pixels of the dataset.
    """
    table: dict[str, list[float]] = {name: [] for name in (*(f"error_{each}" for each in "uvwz"), "measured_fraction")}
    with open_truth(truth_path) as truth:
        for step in dataset.step.values:
            errors = truth_errors(dataset, truth, int(step))
            for name in "uvwz":
                values = errors["shape_z" if name == "z" else name].values
                table[f"error_{name}"].append(_rms(values) / MICRO)
            visible = errors["visible"].values
            measured = np.isfinite(errors["w"].values) & visible
            table["measured_fraction"].append(measured.sum() / visible.sum() if visible.any() else np.nan)
    units = {name: "1" if name == "measured_fraction" else "µm" for name in table}
    return xr.Dataset(
        {name: ("step", values, {"units": units[name]}) for name, values in table.items()},
        coords={"step": dataset.step},
    )


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)].astype(np.float64)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
