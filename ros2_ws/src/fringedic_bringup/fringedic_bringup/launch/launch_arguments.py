"""Arguments of `rig.launch.py`, and the node processes that they describe."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.configuration.rig_file import NAMESPACE
from fringedic.configuration.rig_sensors import load_rig_sensors
from fringedic.errors import ConfigurationError
from fringedic_bringup.launch.environment import domain_of, node_environment
from fringedic_bringup.launch.graph import Graph, NodeEntry, registration_of, rig_graph
from fringedic_bringup.launch.processes import GRACE_S, RECORDER_GRACE_S, require_no_nodes

# A new recorder needs a new folder, and a new experiment node the number of the next step: only a client knows them.
NOT_RESPAWNED = ("recorder", "experiment")

# As the command starts a node: it ends with its parent, and has a session of its own. Ctrl-C then reaches the launch
# alone, and Linux shares the processor between sessions (autogroup): nodes of one session would share one part of it.
PREFIX = "setpriv --pdeathsig TERM setsid"


class LaunchArguments(BaseModel):
    """Arguments of the launch file; all have a default."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rig: str = Field("plate", description="rig file, or the name of one that is installed with fringedic")
    folder: str = Field(
        "",
        description="new folder for recording, parameters and logs; empty: recordings/<rig>-<time> of the present one",
    )
    experiment: str = Field("", description="name of the experiment; empty: the time of its start")
    nodes: str = Field("", description="nodes that run on this computer, separated by commas; empty: all")
    namespace: str = Field("", pattern=NAMESPACE, description="namespace that replaces the one of the rig file")
    log_level: Literal["debug", "info", "warn", "error", "fatal"] = Field("info", description="least severe log lines")
    use_sim_time: bool = Field(False, description="take the time from /clock")
    composed: bool = Field(False, description="phase, dic and coupling in one process, as nodes.composed of a rig file")
    respawn: bool = Field(
        False, description=f"start nodes that die once more, except {' and '.join(NOT_RESPAWNED)}, which hold a step"
    )

    @classmethod
    def parse(cls, texts: Mapping[str, str]) -> Self:
        """Return the arguments that a launch context contains as texts.

        Raises
        ------
        ConfigurationError
            The message names the argument.
        """
        try:
            return cls.model_validate(texts)
        except ValidationError as error:
            problem = error.errors()[0]
            name = ".".join(map(str, problem["loc"]))
            raise ConfigurationError(f"launch argument {name}:={problem['input']}: {problem['msg']}") from None


@dataclass(frozen=True)
class LaunchedProcess:
    """One process: what `launch_ros.actions.Node` needs to start it as the command does.

    Attributes
    ----------
    nodes
        Its nodes, of one package and executable.
    parameter_files
        All parameters of each node.
    respawn
        Start the node again when it dies.
    grace_s
        Longest wait after each signal at the end [s].
    """

    nodes: tuple[NodeEntry, ...]
    parameter_files: tuple[Path, ...]
    respawn: bool
    grace_s: Mapping[signal.Signals, float]

    @property
    def node_name(self) -> str | None:
        """Name of its only node; None when the nodes of a shared process have their own names."""
        return None if self.nodes[0].process else self.nodes[0].own_name

    @property
    def sensor(self) -> str:
        """Name of the sensor of several whose nodes these are, which is a namespace; empty for those of the rig."""
        return self.nodes[0].sensor

    @property
    def remappings(self) -> list[tuple[str, str]]:
        """Names that its nodes use, and the full names that they find there."""
        return list(self.nodes[0].remappings.items())


@dataclass(frozen=True)
class LaunchedRig:
    """The node processes of a rig on one computer.

    Attributes
    ----------
    namespace
        Of all nodes.
    processes
        In the order of their start.
    environment
        Variables to set beside those of the present process.
    """

    namespace: str
    processes: tuple[LaunchedProcess, ...]
    environment: Mapping[str, str]


def launched_rig(arguments: LaunchArguments) -> LaunchedRig:
    """Write the parameter files of the nodes of a rig and return what has to be started.

    Parameters
    ----------
    arguments
        Paths in it are relative to the present folder.

    Raises
    ------
    ConfigurationError
        The rig file cannot be read, a node is unknown, or the folder contains a recording.
    ProcessError
        A node runs already.
    """
    path = rig_path_of(Path(arguments.rig)).absolute()
    sensors = load_rig_sensors(path)
    if arguments.namespace:
        sensors = sensors.changed(lambda rig: rig.model_copy(update={"namespace": arguments.namespace}))
    if arguments.composed:
        sensors = sensors.changed(
            lambda rig: rig.model_copy(update={"nodes": rig.nodes.model_copy(update={"composed": True})})
        )
    rig, *others = sensors.rigs
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    folder = Path(arguments.folder or Path(rig.recording.folder) / f"{path.stem}-{stamp}").absolute()
    if (folder / "bag").exists():
        raise ConfigurationError(f"{folder} contains a recording already; choose another folder:=")
    graph = rig_graph(
        rig, path, folder, experiment=arguments.experiment, others=others, registration=registration_of(sensors)
    )
    graph = _on_this_computer(graph, arguments.nodes)
    environment = node_environment()
    require_no_nodes(domain_of(environment), graph)
    logs = folder / "logs"
    logs.mkdir(exist_ok=True)
    clock = {"use_sim_time": True} if arguments.use_sim_time else {}
    processes = tuple(
        LaunchedProcess(
            nodes,
            tuple(node.write_parameters(logs, **clock) for node in nodes),
            respawn=arguments.respawn and nodes[0].own_name not in NOT_RESPAWNED,
            grace_s=RECORDER_GRACE_S if name == "recorder" else GRACE_S,
        )
        for name, nodes in graph.processes.items()
    )
    changed = {name: value for name, value in environment.items() if os.environ.get(name) != value}
    return LaunchedRig(graph.namespace, processes, changed)


def _on_this_computer(graph: Graph, names: str) -> Graph:
    """Return the part of a graph that runs here."""
    chosen = {name.strip() for name in names.split(",") if name.strip()} or set(graph.names)
    unknown = sorted(chosen - set(graph.names))
    if unknown:
        raise ConfigurationError(
            f"nodes:={names}: this rig has no {', '.join(unknown)}; it has {', '.join(graph.names)}"
        )
    for name, nodes in graph.processes.items():
        if 0 < len(chosen & {node.name for node in nodes}) < len(nodes):
            together = ", ".join(node.name for node in nodes)
            raise ConfigurationError(
                f"nodes:={names}: {together} share the process {name}; name all of them, or take separate processes "
                "(composed:=false, and nodes.composed: false in the rig file)"
            )
    return Graph(graph.namespace, tuple(node for node in graph.nodes if node.name in chosen))
