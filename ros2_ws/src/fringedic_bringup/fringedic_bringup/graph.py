"""The one description of the graph: which nodes a rig or a replay consists of, with which parameters.

The command starts these processes itself; `launch/rig.launch.py` hands the same description to a stock ROS 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from fringedic.rig_file import RigFile, load_calibration, load_rig_file

PROCESSING = {"phase": "phase_node", "dic": "dic_node", "coupling": "coupling_node"}
RECORDER = "recorder"
PLAYER = "player"


@dataclass(frozen=True)
class NodeEntry:
    """One node process.

    Attributes
    ----------
    name
        Name of the node, first part of its topics.
    package, executable
        What ``ros2 run`` would start.
    parameters
        Values of its parameters.
    """

    name: str
    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Graph:
    """Nodes that belong together, in the order in which they are started; the recorder comes first.

    Attributes
    ----------
    namespace
        ROS namespace of all nodes, without leading slash; empty for none.
    nodes
        The node processes.
    """

    namespace: str
    nodes: tuple[NodeEntry, ...]


def rig_graph(rig_file: Path, output: Path, *, experiment: str) -> Graph:
    """Return the graph of a rig that records one experiment.

    Parameters
    ----------
    rig_file
        Description of the rig; the calibration in it is written to ``output`` for the experiment node.
    output
        Folder of the experiment; the recording becomes its ``bag``.
    experiment
        Name of the first experiment.

    Raises
    ------
    RigFileError
        The rig file cannot be used.
    """
    rig = load_rig_file(rig_file)
    output.mkdir(parents=True, exist_ok=True)
    recording = {
        "bag_path": str(output / "bag"),
        "derived": rig.recording.derived,
        "compression": rig.recording.compression,
    }
    nodes = [NodeEntry(RECORDER, "experiment_node", "recorder", recording)]
    if rig.load_frame is not None and rig.load_frame.source == "simulated":
        parameters = {"rate_hz": rig.load_frame.rate_hz, "virtual_rig": yaml.safe_dump(rig.virtual_rig)}
        nodes.append(NodeEntry("load_frame", "load_frame_node", "load_frame", parameters))
    if rig.projector is not None:
        width, height = rig.projector_size() or (0, 0)
        nodes.append(
            NodeEntry("projector", "fringe_projector_node", "projector", {"width_px": width, "height_px": height})
        )
    nodes.append(NodeEntry("camera", "camera_node", "camera", _camera(rig, rig_file, output)))
    nodes += _processing({name: getattr(rig.nodes, name).model_dump() for name in PROCESSING})
    nodes.append(
        NodeEntry("experiment", "experiment_node", "experiment", _experiment(rig, rig_file, output, experiment))
    )
    return Graph(rig.namespace, tuple(nodes))


def replay_graph(bag: Path, output: Path, *, overrides: Mapping[str, Any], derived: bool = True) -> Graph:
    """Return the graph that replays a recording through fresh processing nodes into a new recording.

    Parameters
    ----------
    bag
        The recording to play.
    output
        Folder of the new recording; must not exist.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    derived
        Also record what the processing nodes compute.
    """
    values: dict[str, dict[str, Any]] = {name: {} for name in PROCESSING}
    for name, value in overrides.items():
        node, parameter = name.split(".", 1)
        values[node][parameter] = value
    return Graph(
        "replay",
        (
            NodeEntry(RECORDER, "experiment_node", "recorder", {"bag_path": str(output), "derived": derived}),
            *_processing(values),
            NodeEntry(
                PLAYER,
                "experiment_node",
                "player",
                {"bag_path": str(bag), "recorder": True, "overrides": ",".join(overrides)},
            ),
        ),
    )


def _processing(parameters: Mapping[str, Mapping[str, Any]]) -> list[NodeEntry]:
    return [NodeEntry(name, package, name, parameters[name]) for name, package in PROCESSING.items()]


def _camera(rig: RigFile, rig_file: Path, output: Path) -> dict[str, Any]:
    camera = rig.camera
    parameters: dict[str, Any] = {
        "source": camera.source,
        "exposure_time_s": camera.exposure_time,
        "settle_time_s": camera.settle_time,
    }
    if camera.source == "virtual":
        parameters |= {"virtual_rig": yaml.safe_dump(rig.virtual_rig), "truth_folder": str(output)}
    if camera.files is not None:
        parameters["files"] = str((rig_file.parent / camera.files).resolve())
    return parameters


def _experiment(rig: RigFile, rig_file: Path, output: Path, experiment: str) -> dict[str, Any]:
    parameters: dict[str, Any] = {
        "experiment": experiment,
        "projector": rig.projector is not None,
        "recording_required": True,
    }
    size = rig.projector_size()
    if size is not None:
        pitches = rig.pitches()
        parameters |= {
            "projector_width_px": size[0],
            "projector_height_px": size[1],
            "pitches_px": [float(pitch) for pitch in pitches],
            "shifts": [rig.sequence.shifts] * len(pitches),
            "orientation": rig.sequence.orientation,
        }
    calibration = load_calibration(rig, rig_file)
    if calibration is not None:
        file = output / "calibration.yaml"
        calibration.to_yaml(file)
        parameters["calibration_file"] = str(file)
    return parameters
