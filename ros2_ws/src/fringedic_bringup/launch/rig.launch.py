"""Starts the nodes of a rig: ros2 launch fringedic_bringup rig.launch.py rig:=plate.yaml folder:=recordings/today."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fringedic.configuration.rig_file import load_rig_file
from fringedic_bringup.launch.graph import rig_graph


def generate_launch_description() -> LaunchDescription:
    """Describe one process per node of the rig file."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("rig", description="rig file"),
            DeclareLaunchArgument("folder", description="new folder for the recording"),
            DeclareLaunchArgument(
                "experiment", default_value="", description="name of the experiment; empty: the time"
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Action]:
    rig, folder, experiment = (LaunchConfiguration(name).perform(context) for name in ("rig", "folder", "experiment"))
    graph = rig_graph(load_rig_file(rig), Path(rig), Path(folder), experiment=experiment)
    return [
        Node(
            package=node.package,
            executable=node.executable,
            name=node.name,
            namespace=graph.namespace,
            parameters=[dict(node.parameters)],
            output="screen",
        )
        for node in graph.nodes
    ]
