"""The graph of a rig: which nodes run with which parameters, for the command, the launch file and the tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from pydantic import BaseModel

from fringedic.command.outcome import CALIBRATION_FILE
from fringedic.configuration.rig_file import RigFile, fitting_calibration
from fringedic.configuration.rig_sensors import RigSensors
from fringedic.configuration.sections import ExtensometerSection
from fringedic.errors import ConfigurationError, ImageError
from fringedic.frames.region import Region
from fringedic.frames.sensor import SENSOR, file_of
from fringedic.metadata import Metadata
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import EXPOSURE
from fringedic.settings.camera import CameraNodeSettings
from fringedic.settings.experiment import ExperimentNodeSettings, ProcessingSettings
from fringedic.settings.extensometer import ExtensometerNodeSettings, ExtensometerSettings
from fringedic.settings.load_frame import HoldSettings, LoadFrameNodeSettings, MachineSettings
from fringedic.settings.parameters import default_parameters, to_parameters
from fringedic.settings.projector import ProjectorNodeSettings
from fringedic.settings.recorder import RecorderNodeSettings, RecorderSettings
from fringedic.settings.signals import InstrumentSignal, SignalsNodeSettings
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.recorded_parameters import present_parameters
from fringedic.wording.yaml_text import load_yaml
from fringedic_ros.rig_node import FRAME_PREFIX, RIG_FRAME

if TYPE_CHECKING:  # a rig of one sensor does not load it
    from fringedic.sensors.registration import Registration

PROCESSING_NODES = {"phase": "phase_node", "dic": "dic_node", "coupling": "coupling_node"}
COMPOSED = "processing"  # the process, and the executable, of all processing nodes together
_FULL_SCALES = (0.0, 255.0, 65535.0)  # unknown, or that of the pixel type
SHARED = ("load_frame/state", "load_frame/wrench", "load_frame/joint_states", "load_frame/hold", "signals")
"""What the nodes of several sensors use of their rig."""
FRAMES_MISSED = 3  # in a row, after which the extensometer reports that it has no image


def sensor_of_node(name: str) -> str:
    """Return the name of the sensor of several to which a node belongs; empty for a node of the whole rig."""
    return name.rpartition("/")[0]


def own_name(name: str) -> str:
    """Return the name of a node without that of its sensor."""
    return name.rpartition("/")[2]


@dataclass(frozen=True)
class NodeEntry:
    """One node, started as by ``ros2 run package executable``, with its name and parameters.

    Attributes
    ----------
    name
        Relative to the namespace of the graph; that of a node of one of several sensors begins with the sensor's name.
    process
        Name of the process that it shares with other nodes; empty: it has its own.
    changes_at_restart
        Parameters that differ when the node is started again after it has ended.
    defaults
        Values of the parameters that are not given.
    remappings
        Names that the node uses, and the full names that it finds there.
    """

    name: str
    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    changes_at_restart: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    process: str = ""
    remappings: Mapping[str, str] = field(default_factory=dict)

    @property
    def own_name(self) -> str:
        """Name without that of the sensor."""
        return own_name(self.name)

    @property
    def sensor(self) -> str:
        """Name of the sensor among several; empty for a node of the whole rig."""
        return sensor_of_node(self.name)

    def write_parameters(self, folder: Path, **others: Any) -> Path:
        """Write all parameters and some others into ``<name>.yaml`` of a folder, and return its path."""
        file = folder / f"{self.name}.yaml"
        file.parent.mkdir(exist_ok=True)
        nodes = f"/**/{self.name}" if self.process else "/**"  # the process reads the files of all its nodes
        file.write_text(yaml.safe_dump({nodes: {"ros__parameters": {**self.parameters, **others}}}))
        return file

    def changed_parameters(self, folder: Path) -> set[str]:
        """Return the names of the parameters that differ from the file that `write_parameters` wrote; none without it.

        The file may be that of an earlier version.

        Raises
        ------
        ConfigurationError
            The file is damaged.
        """
        file = folder / f"{self.name}.yaml"
        if not file.exists():
            return set()
        try:
            (content,) = load_yaml(file.read_text()).values()
            written = present_parameters(self.name, content["ros__parameters"])
            before = {**self.defaults, **written}
            # with lists and texts, as in the file
            now = {**self.defaults, **load_yaml(yaml.safe_dump(dict(self.parameters)))}
            return {name for name in now.keys() | before.keys() if now.get(name) != before.get(name)}
        except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError):
            raise ConfigurationError(f"{file} is damaged, so the settings of the first steps are unknown") from None


@dataclass(frozen=True)
class Graph:
    """Nodes in the order of their start, and their common namespace without the leading slash."""

    namespace: str
    nodes: tuple[NodeEntry, ...]

    @property
    def names(self) -> list[str]:
        """Names of the nodes."""
        return [node.name for node in self.nodes]

    @property
    def sensors(self) -> list[str]:
        """Names of several sensors, in the order of their measurement; empty for a rig of one."""
        return list(dict.fromkeys(node.sensor for node in self.nodes if node.sensor))

    @property
    def processes(self) -> dict[str, tuple[NodeEntry, ...]]:
        """Nodes of each process, by the name of the process, in the order of their start."""
        names = dict.fromkeys(node.process or node.name for node in self.nodes)
        return {name: tuple(node for node in self.nodes if name in (node.process, node.name)) for name in names}


def rig_graph(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    *,
    experiment: str = "",
    others: Sequence[RigFile] = (),
    registration: Registration | None = None,
) -> Graph:
    """Return the nodes of a rig that records one run into a folder.

    The calibration of the rig file is written into the folder as ``calibration.yaml``, with the name of a sensor that
    has one (``calibration.left.yaml``). The nodes write the recording ``bag`` and, on a virtual rig, the ground truth
    ``truth.nc``, that of one of several sensors in a folder of its name.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path, to which the paths in it are relative.
    folder
        Created when it does not exist.
    experiment
        Name of the experiment; empty: the time of its start.
    others
        The rig file for the other sensors, if there are several: load frame, signals and recorder are common, and all
        other nodes are in the namespace of their sensor.
    registration
        Poses of the sensors, for the tree of frames.

    Raises
    ------
    ConfigurationError
        The calibration file cannot be read or belongs to another rig, the coarsest fringes repeat in the view, or the
        region was drawn in an image of another size.
    """
    sensors = (rig, *others)
    calibrations = [fitting_calibration(each, rig_path) for each in sensors]
    folder.mkdir(parents=True, exist_ok=True)
    files = [file_of(folder / CALIBRATION_FILE, each.sensor).absolute() for each in sensors]
    nodes = [_recorder(rig, folder, [each.sensor for each in sensors] if others else [])]
    first, *rest = (
        _sensor_nodes(
            each,
            folder / each.sensor if others else folder,
            "" if calibration is None else str(file),
            experiment=experiment,
            **_beside_others(each, sensors, registration) if others else {},
        )
        for each, calibration, file in zip(sensors, calibrations, files, strict=True)
    )
    common = _common_nodes(rig)
    if others:
        in_tree = {FRAME_PREFIX: _prefix(rig)}  # so that the frame of the force is in the tree
        nodes += [replace(node, parameters={**node.parameters, **in_tree}) for node in common]
        for each, own in zip(sensors, (first, *rest), strict=True):
            nodes += _of_sensor(each, [*own.processing, *own.measuring])
        graph = _with_common(rig.namespace, nodes, SENSOR, {})
    else:
        graph = _graph(rig, [*nodes, *first.processing, *common, *first.measuring])
    for calibration, file in zip(calibrations, files, strict=True):
        if calibration is not None:
            calibration.to_yaml(file)  # when nothing can fail any more: it may replace that of an earlier run
    return graph


def registration_of(sensors: RigSensors) -> Registration | None:
    """Return the poses of the sensors of a rig file; None when they are not registered.

    Raises
    ------
    CalibrationError
        The file of the registration cannot be used, or is that of other sensors or calibrations.
    """
    if sensors.registration is None:
        return None
    from fringedic.sensors.registered import registration_for  # a rig of one sensor does not load it

    return registration_for(sensors.registration, {rig.sensor: rig.rig_model for rig in sensors.rigs})


def _beside_others(rig: RigFile, sensors: Sequence[RigFile], registration: Registration | None) -> dict[str, Any]:
    """Return the settings of the experiment node of one of several sensors."""
    settings: dict[str, Any] = {"dark_between_steps": True}
    if registration is not None and rig.sensor in registration.placed:
        (reference,) = (each for each in sensors if each.sensor == registration.reference)
        pose = registration.poses[rig.sensor]
        settings["common_frame"] = "/".join(filter(None, (_prefix(reference), RIG_FRAME)))
        settings["pose_in_common_frame"] = [*pose.translation, *pose.rotation]
    return settings


def _prefix(rig: RigFile) -> str:
    """Return the prefix of the frames of a rig."""
    return rig.topic_namespace if rig.frame_prefix is None else rig.frame_prefix


class _SensorNodes(NamedTuple):
    """Nodes of one sensor, in the order of their start."""

    processing: list[NodeEntry]
    measuring: list[NodeEntry]


def _sensor_nodes(rig: RigFile, folder: Path, calibration_file: str, **others: Any) -> _SensorNodes:
    """Return the nodes of one sensor; `folder` is that of its truth and calibrations."""
    region = {"region": _region(rig.region_file, rig.camera_size())} if rig.region_file else {}
    processing = ProcessingSettings(
        phase=_phase(rig).model_copy(update=region),
        dic=rig.nodes.dic.model_copy(update=region),
        coupling=rig.nodes.coupling,
    )
    processing_nodes: list[NodeEntry] = []
    if rig.recording.process:
        entries = (_node(name, package, getattr(processing, name)) for name, package in PROCESSING_NODES.items())
        processing_nodes = _processing_nodes(entries, composed=rig.nodes.composed)
    experiment_node = _experiment(
        rig,
        load_frame=rig.load_frame is not None,
        white_between_steps=rig.extensometer is not None,
        metadata=rig.metadata(),
        calibration_file=calibration_file,
        calibration_folder=str((folder / "calibrations").absolute()),
        record_only=not rig.recording.process,
        required_signals=_required(rig),
        later_parameters=ProcessingSettings() if rig.recording.process else processing,
        **others,
    )
    return _SensorNodes(processing_nodes, [*_hardware(rig, **_truth(rig, folder), **_free_run(rig)), experiment_node])


def _common_nodes(rig: RigFile) -> list[NodeEntry]:
    """Return load frame, signals and extensometer of a rig."""
    nodes = []
    if isinstance(rig.load_frame, MachineSettings):
        # the machine, which may be moving, is requested to hold as soon as it answers
        machine = LoadFrameNodeSettings(device=rig.load_frame, **_virtual(rig))
        nodes.append(_node("load_frame", "load_frame_node", machine, machine_required=False))
    if rig.signals:
        nodes.append(_node("signals", "load_frame_node", SignalsNodeSettings(signals=_declared(rig))))
    if rig.extensometer is not None:
        nodes.append(_extensometer(rig.extensometer))
    return nodes


def _of_sensor(rig: RigFile, nodes: Sequence[NodeEntry]) -> list[NodeEntry]:
    """Return nodes of one of several sensors: in the namespace of its name, with load frame and signals of the rig."""
    place = f"/{rig.namespace}" if rig.namespace else ""
    remappings = {name: f"{place}/{name}" for name in SHARED}
    prefix = {} if rig.frame_prefix is None else {FRAME_PREFIX: rig.frame_prefix}
    return [
        replace(
            node,
            name=f"{rig.sensor}/{node.name}",
            process=node.process and f"{rig.sensor}/{node.process}",
            parameters={**node.parameters, "sensor": rig.sensor, **prefix},
            remappings=remappings,
        )
        for node in nodes
    ]


def calibration_graph(rig: RigFile, folder: Path) -> Graph:
    """Return the nodes that calibrate a rig: projector, camera, phase, experiment and recorder.

    Parameters
    ----------
    rig
        The content of the rig file.
    folder
        Where the recording ``bag`` is written.
    """
    phase = _phase(rig).model_copy(update={"relative_phase": "refuse"})  # the positions of planes are absolute
    others = {"fringe_order": "pitches"} if rig.sequence.fringe_order == "one_image" else {}
    experiment = _experiment(
        rig,
        nodes=["phase"],
        calibration_folder=str(folder.absolute()),
        metadata=Metadata(specimen=rig.specimen, hardware=rig.hardware),
        **others,
    )
    nodes = [
        _recorder(rig, folder),
        _node("phase", PROCESSING_NODES["phase"], phase),
        *_hardware(rig),
        experiment,
    ]
    return _graph(rig, nodes)


def live_graph(rig: RigFile, region: Sequence[int] = ()) -> Graph:
    """Return the nodes of the live view for the set-up; nothing is recorded.

    Parameters
    ----------
    rig
        The content of the rig file.
    region
        First column, first row, width and height of the evaluated part of the image [px]; empty: the whole image.
    """
    view: dict[str, Any] = {"full_scale_grey_level": full_scale(rig)}
    if region:
        view["region_px"] = list(region)
    live_view = NodeEntry("live_view", "camera_node", "live_view", view)
    return _graph(rig, [live_view, *_hardware(rig)])


def exposing_graph(rig: RigFile) -> Graph:
    """Return projector and camera alone; the camera does not wait after a pattern.

    Parameters
    ----------
    rig
        The content of the rig file.
    """
    at_once = rig.model_copy(update={"camera": rig.camera.model_copy(update={"settle_ms": 0.0})})
    return _graph(rig, _hardware(at_once))


def projecting_graph(rig: RigFile) -> Graph:
    """Return the projector alone.

    Parameters
    ----------
    rig
        The content of the rig file.
    """
    graph = exposing_graph(rig)
    return replace(graph, nodes=tuple(node for node in graph.nodes if node.name == "projector"))


def replay_graph(
    bag: BagReader,
    output: Path,
    overrides: Mapping[str, Mapping[str, Any]],
    *,
    steps: Sequence[int] = (),
    reference: int | None = None,
    calibration: Path | None = None,
    composed: bool = False,
) -> Graph:
    """Return the nodes that process a recording again and record the results.

    Parameters
    ----------
    bag
        The recording to play, with the choice of its sensor.
    output
        Folder of the new recording.
    overrides
        Parameters that replace the recorded ones, ``{"dic": {"window": 24}}``.
    steps
        Only these steps and their references; all when empty.
    reference
        A step that all others are measured against; by default as recorded.
    calibration
        File that replaces the recorded calibration of the rig.
    composed
        Whether the processing nodes share a process.

    Raises
    ------
    RecordingError
        The recording lacks exposure records, or contains several sensors and none is chosen.
    """
    exposures = bag.find(EXPOSURE)[EXPOSURE]
    player: dict[str, Any] = {"bag_path": str(bag.path.absolute()), "recorder": True}
    replaced = [f"{node}.{name}" for node, values in overrides.items() for name in values]
    if replaced:
        player["overrides"] = replaced
    if calibration is not None:
        player["calibration_file"] = str(calibration.absolute())
    if steps:
        player["steps"] = list(steps)
    if reference is not None:
        player["reference_step"] = reference
    nodes = [
        NodeEntry("recorder", "recorder_node", "recorder", {"bag_path": str(output.absolute()), "derived": True}),
        *_processing_nodes(
            (NodeEntry(name, package, name, overrides.get(name, {})) for name, package in PROCESSING_NODES.items()),
            composed=composed,
        ),
        NodeEntry("player", "player_node", "player", player),
    ]
    return _with_common(exposures.removesuffix(EXPOSURE).strip("/"), nodes, bag.sensor, {})


def _graph(rig: RigFile, nodes: Sequence[NodeEntry]) -> Graph:
    """Return nodes in the namespace of a rig, with its frame prefix and the name of its sensor."""
    common = {} if rig.frame_prefix is None else {FRAME_PREFIX: rig.frame_prefix}
    return _with_common(rig.topic_namespace, nodes, rig.sensor, common)


def _with_common(namespace: str, nodes: Sequence[NodeEntry], sensor: str, common: Mapping[str, str]) -> Graph:
    """Return nodes with the same parameters beside their own; a sensor without a name needs none."""
    if sensor != SENSOR:
        common = {"sensor": sensor, **common}
    return Graph(namespace, tuple(replace(node, parameters={**node.parameters, **common}) for node in nodes))


def _node(name: str, package: str, settings: BaseModel, **again: Any) -> NodeEntry:
    """Return a node with all of its settings; `again` are those that differ when it is started again."""
    return NodeEntry(name, package, name, to_parameters(settings), again, default_parameters(settings))


def _recorder(rig: RigFile, folder: Path, sensors: Sequence[str] = ()) -> NodeEntry:
    shared = rig.recording.model_dump(include=set(RecorderSettings.model_fields))
    settings = RecorderNodeSettings(bag_path=str((folder / "bag").absolute()), sensors=list(sensors), **shared)
    return _node("recorder", "recorder_node", settings)


def _processing_nodes(nodes: Iterable[NodeEntry], *, composed: bool) -> list[NodeEntry]:
    """Return the processing nodes, in one process when they are composed."""
    if not composed:
        return list(nodes)
    return [replace(node, package="fringedic_bringup", executable=COMPOSED, process=COMPOSED) for node in nodes]


def _hardware(rig: RigFile, **others: Any) -> list[NodeEntry]:
    """Return projector and camera, and the stage of a virtual rig; `others` are further settings of the camera node."""
    camera = CameraNodeSettings(device=rig.camera, **_virtual(rig), **others)
    nodes = []
    if rig.projector is not None:
        projector = ProjectorNodeSettings(device=rig.projector, **_virtual(rig))
        nodes.append(_node("projector", "fringe_projector_node", projector))
    if rig.camera.source == "virtual":
        nodes.append(NodeEntry("stage", "load_frame_node", "stage"))
    return [*nodes, _node("camera", "camera_node", camera)]


def _virtual(rig: RigFile) -> dict[str, Any]:
    return {} if rig.virtual_rig is None else {"virtual_rig": rig.virtual_rig}


def _region(path: str, size: tuple[int, int] | None) -> Region:
    """Return the region of interest of images of a size [px], which is a setting, so that a replay needs no file."""
    region = Region.load(path)
    if size is not None:
        try:
            region.mask_for(size[::-1])
        except ImageError as error:
            raise ConfigurationError(f"{path}: {error}") from error
    return region


def _phase(rig: RigFile) -> PhaseParameters:
    """Return the parameters of the phase node, with the level of saturation when it does not follow from the images."""
    parameters, level = rig.nodes.phase, full_scale(rig)
    if parameters.saturation_grey_level or level in _FULL_SCALES:
        return parameters
    return parameters.model_copy(update={"saturation_grey_level": level})


def full_scale(rig: RigFile) -> float:
    """Return the grey level of a saturated pixel; 0 when it follows from the images."""
    bits = rig.virtual_configuration().sensor.bits if rig.camera.source == "virtual" else rig.camera.bits
    return 2.0**bits - 1 if bits else 0.0


def _free_run(rig: RigFile) -> dict[str, float]:
    return {} if rig.extensometer is None else {"frame_rate_hz": rig.extensometer.rate_hz}


def _extensometer(section: ExtensometerSection) -> NodeEntry:
    shared = section.model_dump(include=set(ExtensometerSettings.model_fields))
    settings = ExtensometerNodeSettings(frame_timeout_s=max(FRAMES_MISSED / section.rate_hz, 0.1), **shared)
    return _node("extensometer", "dic_node", settings)


def _declared(rig: RigFile) -> dict[str, Any]:
    """Return the signals of a rig as their node takes them."""
    return {name: each.model_dump(mode="json") for name, each in rig.signals.items()}


def _required(rig: RigFile) -> list[str]:
    """Return the names of the signals without which a step fails; the file of an instrument names its signals."""
    names: list[str] = []
    for name, each in rig.signals.items():
        if each.required and isinstance(each, InstrumentSignal):
            from load_frame_node.machines.description import load_instrument

            names += load_instrument(each.file).signals
        elif each.required:
            names.append(name)
    return names


def _truth(rig: RigFile, folder: Path) -> dict[str, Any]:
    return {} if rig.virtual_rig is None else {"truth_folder": str(folder.absolute())}


def _experiment(rig: RigFile, **others: Any) -> NodeEntry:
    """Return the experiment node of a rig; `others` are its settings that are no sections of the rig file."""
    sequence, size = rig.sequence.model_dump(), rig.projector_size()
    if size is not None:
        sequence["pitches_px"] = rig.pitches()
        others |= {"projector_width_px": size[0], "projector_height_px": size[1]}
    if rig.load_frame is not None:
        others |= rig.load_frame.model_dump(include=set(HoldSettings.model_fields))
    first_column, first_row = rig.camera_first()
    settings = ExperimentNodeSettings(
        projector=rig.projector is not None,
        recording_required=True,
        camera_timeout_s=rig.camera.timeout_s,
        camera_first_column_px=first_column,
        camera_first_row_px=first_row,
        **{**sequence, **others},
    )
    return _node("experiment", "experiment_node", settings)
