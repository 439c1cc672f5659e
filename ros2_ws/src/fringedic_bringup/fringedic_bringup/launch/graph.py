"""The graph of a rig: which nodes run with which parameters, for the command, the launch file and the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from fringedic.configuration.rig_file import RigFile, load_fitting_calibration
from fringedic.configuration.sections import ExtensometerSection
from fringedic.errors import ConfigurationError, ImageError
from fringedic.frames.region import Region
from fringedic.metadata import Metadata
from fringedic.recording.reader import BagReader
from fringedic.settings.camera import CameraNodeSettings
from fringedic.settings.parameters import default_parameters, to_parameters
from fringedic.steps.recorded_parameters import present_parameters
from fringedic.wording.yaml_text import load_yaml

PROCESSING_NODES = {"phase": "phase_node", "dic": "dic_node", "coupling": "coupling_node"}
STEP_TOPIC = "experiment/step"
_FULL_SCALES = (0.0, 255.0, 65535.0)  # unknown, or that of the pixel type
FRAMES_MISSED = 3  # in a row, after which the extensometer reports that it has no image


@dataclass(frozen=True)
class NodeEntry:
    """One node process, as of ``ros2 run package executable``, with its name and parameters.

    Attributes
    ----------
    changes_at_restart
        Parameters that differ when the node is started again after it has ended.
    defaults
        Values of the parameters that are not given.
    """

    name: str
    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    changes_at_restart: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)

    def write_parameters(self, folder: Path, **others: Any) -> Path:
        """Write all parameters and some others into ``<name>.yaml`` of a folder, and return its path."""
        file = folder / f"{self.name}.yaml"
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {**self.parameters, **others}}}))
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
            written = present_parameters(self.name, load_yaml(file.read_text())["/**"]["ros__parameters"])
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


def rig_graph(rig: RigFile, rig_path: Path, folder: Path, *, experiment: str = "") -> Graph:
    """Return the nodes of a rig that records one run into a folder.

    The calibration of the rig file is written into the folder as ``calibration.yaml``. The nodes write the recording
    ``bag`` and, on a virtual rig, the ground truth ``truth.nc``.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path, to which the paths in it are relative.
    folder
        Created when it does not exist.
    experiment
        Name of the experiment; empty: the time of its start.

    Raises
    ------
    ConfigurationError
        The calibration file cannot be read or belongs to another rig, the coarsest fringes repeat in the view, or the
        region was drawn in an image of another size.
    """
    calibration = load_fitting_calibration(rig, rig_path)
    folder.mkdir(parents=True, exist_ok=True)
    calibration_file = "" if calibration is None else str((folder / "calibration.yaml").absolute())
    region = _region(rig, rig_path)
    processing = {
        "phase": _phase(rig) | region,
        "dic": rig.nodes.dic.model_dump() | region,
        "coupling": rig.nodes.coupling.model_dump(),
    }
    nodes = [NodeEntry("recorder", "recorder_node", "recorder", _recorder(rig, folder))]
    if rig.recording.process:
        nodes += _processing_nodes(processing)
    if rig.has_load_frame_node:
        # the machine, which may be moving, is requested to hold as soon as it answers
        again = {"machine_required": False}
        nodes.append(NodeEntry("load_frame", "load_frame_node", "load_frame", _load_frame(rig, rig_path), again))
    if rig.extensometer is not None:
        nodes.append(NodeEntry("extensometer", "dic_node", "extensometer", _extensometer(rig.extensometer)))
    settings = _experiment(rig, experiment) | {
        "load_frame": rig.load_frame is not None,
        "white_between_steps": rig.extensometer is not None,
        "facts": rig.metadata(rig_path).to_text(),
        "calibration_file": calibration_file,
        "calibration_folder": str((folder / "calibrations").absolute()),
        "record_only": not rig.recording.process,
    }
    if not rig.recording.process:
        settings["later_parameters"] = yaml.safe_dump(processing)
    nodes += [
        *_hardware(rig, rig_path, **_truth(rig, folder), **_free_run(rig)),
        NodeEntry("experiment", "experiment_node", "experiment", settings),
    ]
    if calibration is not None:
        calibration.to_yaml(calibration_file)  # when nothing can fail any more: it may replace that of an earlier run
    return _graph(rig, nodes)


def calibration_graph(rig: RigFile, rig_path: Path, folder: Path) -> Graph:
    """Return the nodes that calibrate a rig: projector, camera, phase, experiment and recorder.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path, to which the paths in it are relative.
    folder
        Where the recording ``bag`` is written.
    """
    settings = _experiment(rig, "") | {
        "nodes": ["phase"],
        "calibration_folder": str(folder.absolute()),
        "facts": Metadata(specimen=rig.specimen, hardware=rig.hardware).to_text(),
    }
    phase = _phase(rig) | {"relative_phase": "refuse"}  # the positions of planes are absolute
    if rig.sequence.fringe_order == "one_image":
        settings["fringe_order"] = "pitches"
    nodes = [
        NodeEntry("recorder", "recorder_node", "recorder", _recorder(rig, folder)),
        NodeEntry("phase", PROCESSING_NODES["phase"], "phase", phase),
        *_hardware(rig, rig_path),
        NodeEntry("experiment", "experiment_node", "experiment", settings),
    ]
    return _graph(rig, nodes)


def live_graph(rig: RigFile, rig_path: Path, region: Sequence[int] = ()) -> Graph:
    """Return the nodes of the live view for the set-up; nothing is recorded.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    region
        First column, first row, width and height of the evaluated part of the image [px]; empty: the whole image.
    """
    view: dict[str, Any] = {"full_scale_grey_level": full_scale(rig)}
    if region:
        view["region_px"] = list(region)
    live_view = NodeEntry("live_view", "camera_node", "live_view", view)
    return _graph(rig, [live_view, *_hardware(rig, rig_path)])


def exposing_graph(rig: RigFile, rig_path: Path) -> Graph:
    """Return projector and camera alone; the camera does not wait after a pattern.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    """
    at_once = rig.model_copy(update={"camera": rig.camera.model_copy(update={"settle_ms": 0.0})})
    return _graph(rig, _hardware(at_once, rig_path))


def projecting_graph(rig: RigFile, rig_path: Path) -> Graph:
    """Return the projector alone.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    """
    return Graph(rig.namespace, tuple(node for node in exposing_graph(rig, rig_path).nodes if node.name == "projector"))


def replay_graph(
    bag: Path,
    output: Path,
    overrides: Mapping[str, Mapping[str, Any]],
    *,
    steps: Sequence[int] = (),
    reference: int | None = None,
    calibration: Path | None = None,
) -> Graph:
    """Return the nodes that process a recording again and record the results.

    Parameters
    ----------
    bag
        The recording to play.
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

    Raises
    ------
    RecordingError
        The recording lacks the topic ``experiment/step``.
    """
    step_topic = BagReader(bag).find(STEP_TOPIC)[STEP_TOPIC]
    player: dict[str, Any] = {"bag_path": str(bag.absolute()), "recorder": True}
    replaced = [f"{node}.{name}" for node, values in overrides.items() for name in values]
    if replaced:
        player["overrides"] = replaced
    if calibration is not None:
        player["calibration_file"] = str(calibration.absolute())
    if steps:
        player["steps"] = list(steps)
    if reference is not None:
        player["reference_step"] = reference
    return Graph(
        step_topic.removesuffix(STEP_TOPIC).strip("/"),
        (
            NodeEntry("recorder", "recorder_node", "recorder", {"bag_path": str(output.absolute()), "derived": True}),
            *_processing_nodes(overrides),
            NodeEntry("player", "player_node", "player", player),
        ),
    )


def _graph(rig: RigFile, nodes: Sequence[NodeEntry]) -> Graph:
    """Return nodes in the namespace and with the frame prefix of a rig."""
    prefix = {} if rig.frame_prefix is None else {"frame_prefix": rig.frame_prefix}
    return Graph(rig.namespace, tuple(replace(node, parameters={**node.parameters, **prefix}) for node in nodes))


def _node(name: str, package: str, settings: BaseModel, **again: Any) -> NodeEntry:
    """Return a node with all of its settings; `again` are those that differ when it is started again."""
    return NodeEntry(name, package, name, to_parameters(settings), again, default_parameters(settings))


def _processing_nodes(parameters: Mapping[str, Mapping[str, Any]]) -> list[NodeEntry]:
    return [NodeEntry(name, package, name, parameters.get(name, {})) for name, package in PROCESSING_NODES.items()]


def _recorder(rig: RigFile, folder: Path) -> dict[str, Any]:
    return {
        "bag_path": str((folder / "bag").absolute()),
        "derived": rig.recording.derived,
        "compression": rig.recording.compression,
        "split_gb": rig.recording.split_gb or 0.0,
        "split_s": 60 * (rig.recording.split_minutes or 0.0),
    }


def _hardware(rig: RigFile, rig_path: Path, **others: Any) -> list[NodeEntry]:
    """Return projector and camera, and the stage of a virtual rig; `others` are further settings of the camera node."""
    camera = CameraNodeSettings(device=rig.camera, **_virtual(rig), **others)
    nodes = []
    size = rig.projector_size()
    if rig.projector is not None and size is not None:
        parameters: dict[str, Any] = {"width_px": size[0], "height_px": size[1]}
        if rig.projector.source == "display":
            parameters |= {"screen": "display", "display": rig.projector.display}
        if rig.projector.response_curve is not None:
            parameters["response_file"] = str((rig_path.parent / rig.projector.response_curve).absolute())
        nodes.append(NodeEntry("projector", "fringe_projector_node", "projector", parameters))
    if rig.camera.source == "virtual":
        nodes.append(NodeEntry("stage", "load_frame_node", "stage"))
    return [*nodes, _node("camera", "camera_node", camera)]


def _virtual(rig: RigFile) -> dict[str, Any]:
    return {} if rig.virtual_rig is None else {"virtual_rig": rig.virtual_rig}


def _region(rig: RigFile, rig_path: Path) -> dict[str, str]:
    """Return the region of interest as a parameter, so that a replay needs no other file."""
    if rig.region_file is None:
        return {}
    path, size = rig_path.parent / rig.region_file, rig.camera_size()
    region = Region.load(path)
    if size is not None:
        try:
            region.mask_for(size[::-1])
        except ImageError as error:
            raise ConfigurationError(f"{path}: {error}") from error
    return {"region": region.to_text()}


def _phase(rig: RigFile) -> dict[str, Any]:
    """Return the parameters of the phase node, with the level of saturation when it does not follow from the images."""
    parameters = rig.nodes.phase.model_dump()
    if not parameters["saturation_grey_level"] and (level := full_scale(rig)) not in _FULL_SCALES:
        parameters["saturation_grey_level"] = level
    return parameters


def full_scale(rig: RigFile) -> float:
    """Return the grey level of a saturated pixel; 0 when it follows from the images."""
    bits = rig.virtual_configuration().sensor.bits if rig.camera.source == "virtual" else rig.camera.bits
    return 2.0**bits - 1 if bits else 0.0


def _free_run(rig: RigFile) -> dict[str, float]:
    return {} if rig.extensometer is None else {"frame_rate_hz": rig.extensometer.rate_hz}


def _extensometer(section: ExtensometerSection) -> dict[str, Any]:
    return {
        "first_column_px": section.first_px[0],
        "first_row_px": section.first_px[1],
        "second_column_px": section.second_px[0],
        "second_row_px": section.second_px[1],
        "pad_px": section.subset_px,
        "largest_sigma": 1e-6 * section.largest_sigma_ustrain,
        "frame_timeout_s": max(FRAMES_MISSED / section.rate_hz, 0.1),
    }


def _load_frame(rig: RigFile, rig_path: Path) -> dict[str, Any]:
    load_frame = rig.load_frame
    assert load_frame is not None, "checked by the caller"
    parameters: dict[str, Any] = {
        "source": load_frame.source,
        "rate_hz": load_frame.rate_hz,
        "position_tolerance_mm": load_frame.position_tolerance_mm,
    }
    if load_frame.file is not None:
        parameters["machine_file"] = str((rig_path.parent / load_frame.file).absolute())
    if load_frame.source == "simulated":
        parameters["virtual_rig"] = _virtual_rig(rig)
    if load_frame.source == "controller":
        topics = ("joint_states_topic", "joint", "wrench_topic", "force_axis", "force_sign")
        names = (*topics, "slowest_mm_per_s", "motion_span_s")
        parameters |= {name: getattr(load_frame, name) for name in names}
    return parameters


def _truth(rig: RigFile, folder: Path) -> dict[str, Any]:
    return {} if rig.virtual_rig is None else {"truth_folder": str(folder.absolute())}


def _experiment(rig: RigFile, experiment: str) -> dict[str, Any]:
    first_column, first_row = rig.camera_first()
    parameters: dict[str, Any] = {
        "experiment": experiment,
        "projector": rig.projector is not None,
        "recording_required": True,
        "camera_timeout_s": rig.camera.timeout_s,
        "camera_first_column_px": first_column,
        "camera_first_row_px": first_row,
    }
    if rig.load_frame is not None:
        names = ("hold_required", "load_drift_n", "position_drift_um")
        parameters |= {name: getattr(rig.load_frame, name) for name in names}
    size = rig.projector_size()
    if size is not None:
        pitches = rig.pitches()
        parameters |= {
            "projector_width_px": size[0],
            "projector_height_px": size[1],
            "pitches_px": pitches,
            "shifts": [rig.sequence.shifts] * len(pitches),
            "orientation": rig.sequence.orientation,
            "fringe_order": rig.sequence.fringe_order,
            "grey_frame": rig.sequence.grey_frame,
        }
        if rig.sequence.exposure_times:  # an empty list in a parameter file has no type
            parameters["exposure_times_s"] = rig.sequence.exposure_times
    return parameters


def _virtual_rig(rig: RigFile) -> str:
    return yaml.safe_dump(rig.virtual_rig, default_flow_style=True, width=10_000).strip()
