"""Stand-in for ros2/launch, which PyPI does not have: the part that `rig.launch.py` uses, with the same arguments.

Its nodes are started with the command line and the environment that launch_ros gives them. `make test-stock` runs the
launch file with the real one.
"""

from __future__ import annotations

import os
import runpy
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from ament_index_python import get_package_prefix, get_package_share_directory

from fringedic_bringup.launch.processes import GRACE_S


@dataclass
class LaunchContext:
    """Values of the launch arguments."""

    launch_configurations: dict[str, str]


@dataclass
class LaunchDescription:
    """Actions of a launch file."""

    entities: list[Any]


@dataclass(kw_only=True)
class OpaqueFunction:
    """Calls a function with the context."""

    function: Callable[[LaunchContext], list[Node]]


@dataclass
class LaunchConfiguration:
    """Value of a launch argument."""

    name: str

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


class DeclareLaunchArgument:
    """An argument of a launch file."""

    def __init__(self, name: str, *, default_value: str | None = None, description: str | None = None) -> None:
        self.name, self.default_value, self.description = name, default_value, description


@dataclass(kw_only=True)
class Node:
    """A node process."""

    package: str
    executable: str
    name: str
    namespace: str
    remappings: list[tuple[str, str]]
    parameters: list[str]
    ros_arguments: list[str]
    additional_env: Mapping[str, str]
    respawn: bool
    respawn_delay: float
    sigterm_timeout: str
    sigkill_timeout: str
    prefix: str
    output: str

    def start(self, log: Path, domain: str) -> subprocess.Popen[bytes]:
        """Start the process in a ROS domain, with its output in a file."""
        executable = Path(get_package_prefix(self.package), "lib", self.package, self.executable)
        rules = ["-r", f"__node:={self.name}", "-r", f"__ns:=/{self.namespace}"]
        rules += [word for used, found in self.remappings for word in ("-r", f"{used}:={found}")]
        files = [word for file in self.parameters for word in ("--params-file", file)]
        command = [*shlex.split(self.prefix), str(executable), "--ros-args", *self.ros_arguments, *rules, *files]
        environment = {**os.environ, **self.additional_env, "ROS_DOMAIN_ID": domain}
        with log.open("wb") as output:
            return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment)


@contextmanager
def running(nodes: list[Node], logs: Path, domain: str) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Start nodes; at the end all get SIGINT at once, as Ctrl-C at `ros2 launch` sends it."""
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for node in nodes:
            processes[node.name] = node.start(logs / f"{node.name}.txt", domain)
        yield processes
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        for process in processes.values():
            process.wait(GRACE_S[signal.SIGINT])


def launched(patch: pytest.MonkeyPatch, **arguments: str) -> list[Node]:
    """Return the nodes that `ros2 launch fringedic_bringup rig.launch.py NAME:=VALUE ...` starts."""
    for name in ("launch", "launch.action", "launch.actions", "launch.substitutions", "launch_ros.actions"):
        patch.setitem(sys.modules, name, ModuleType(name))
    for name, members in {
        "launch": (LaunchContext, LaunchDescription),
        "launch.actions": (DeclareLaunchArgument, OpaqueFunction),
        "launch.substitutions": (LaunchConfiguration,),
        "launch_ros.actions": (Node,),
    }.items():
        for member in members:
            setattr(sys.modules[name], member.__name__, member)
    sys.modules["launch.action"].Action = object  # type: ignore[attr-defined]
    file = Path(get_package_share_directory("fringedic_bringup"), "launch", "rig.launch.py")
    description = runpy.run_path(str(file))["generate_launch_description"]()
    declared = [each for each in description.entities if isinstance(each, DeclareLaunchArgument)]
    assert all(each.description for each in declared)
    values = {each.name: each.default_value for each in declared}
    assert arguments.keys() <= values.keys(), "ros2 launch passes undeclared arguments on without a word"
    context = LaunchContext({**values, **arguments})
    functions = [each for each in description.entities if isinstance(each, OpaqueFunction)]
    return [node for each in functions for node in each.function(context)]
