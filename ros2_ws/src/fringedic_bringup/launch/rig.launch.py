"""Starts the graph of a rig on a stock ROS 2: ros2 launch fringedic_bringup rig.launch.py rig:=RIG.yaml output:=DIR."""

from __future__ import annotations

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fringedic_bringup.graph import rig_graph


def start(context: LaunchContext) -> list[Node]:
    """Return the nodes of the rig file, from the same description that the command uses."""
    rig, output, experiment = (LaunchConfiguration(name).perform(context) for name in ("rig", "output", "experiment"))
    graph = rig_graph(Path(rig), Path(output), experiment=experiment)
    return [
        Node(
            package=entry.package,
            executable=entry.executable,
            name=entry.name,
            namespace=graph.namespace,
            parameters=[dict(entry.parameters)],
            output="screen",
        )
        for entry in graph.nodes
    ]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("rig", description="rig file (YAML)"),
            DeclareLaunchArgument("output", default_value="experiment", description="folder for the recording"),
            DeclareLaunchArgument("experiment", default_value="experiment", description="name of the experiment"),
            OpaqueFunction(function=start),
        ]
    )
