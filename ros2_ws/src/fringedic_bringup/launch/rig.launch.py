"""Starts the nodes of a rig: ros2 launch fringedic_bringup rig.launch.py rig:=plate folder:=recordings/today."""

import signal

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fringedic_bringup.launch.launch_arguments import PREFIX, LaunchArguments, launched_rig


def generate_launch_description() -> LaunchDescription:
    """Describe the processes of the nodes of the rig file."""
    arguments = [
        DeclareLaunchArgument(name, default_value=str(field.default), description=field.description)
        for name, field in LaunchArguments.model_fields.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Action]:
    texts = {name: LaunchConfiguration(name).perform(context) for name in LaunchArguments.model_fields}
    arguments = LaunchArguments.parse(texts)
    rig = launched_rig(arguments)
    return [
        Node(
            package=process.nodes[0].package,
            executable=process.nodes[0].executable,
            name=process.node_name,
            namespace="/".join(filter(None, (rig.namespace, process.sensor))),
            remappings=process.remappings,
            parameters=[str(file) for file in process.parameter_files],
            ros_arguments=["--log-level", arguments.log_level],
            additional_env=rig.environment,
            respawn=process.respawn,
            respawn_delay=1.0,
            sigterm_timeout=str(process.grace_s[signal.SIGINT]),
            sigkill_timeout=str(process.grace_s[signal.SIGTERM]),
            prefix=PREFIX,
            output="both",
        )
        for process in rig.processes
    ]
