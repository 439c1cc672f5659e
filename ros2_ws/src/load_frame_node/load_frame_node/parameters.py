"""Parameters of the load frame node, and the machine that they select."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator
from rclpy.node import Node

from fringedic.settings.base import HardwareNodeSettings
from fringedic.virtual_rig import SimulatedLoadFrame
from fringedic_ros.virtual import VirtualRigText, virtual_configuration
from load_frame_node.machines import Machine, SimulatedMachine, load_machine, open_machine
from load_frame_node.machines.controller import ControllerMachine, ControllerTopics


class LoadFrameParameters(HardwareNodeSettings):
    """Parameters of the load frame node."""

    source: Literal["simulated", "machine", "controller"] = Field(
        "simulated",
        description="simulated: machine of the virtual rig; machine: the machine described by machine_file; "
        "controller: machine whose state a ros2_control controller publishes.",
    )
    rate_hz: float = Field(100.0, ge=2, le=1000, description="Samples of force and position per second [Hz].")
    virtual_rig: VirtualRigText = "{preset: plate}"
    machine_file: str = Field("", description="Source `machine`: YAML file with its protocol, registers and units.")
    machine_required: bool = Field(
        True,
        description="Source `machine`: refuse to be configured while the machine does not answer. `fringedic run` sets "
        "false when it starts the node again during a test.",
    )
    position_tolerance_mm: float = Field(
        0.01, gt=0, le=10, description="A move has arrived when the crosshead stands this close to the target [mm]."
    )
    joint_states_topic: str = Field("/joint_states", description="Source `controller`: JointState of the crosshead.")
    joint: str = Field("crosshead", description="Source `controller`: name of the joint of the crosshead.")
    wrench_topic: str = Field("/wrench", description="Source `controller`: WrenchStamped of the load cell.")
    force_axis: Literal["x", "y", "z"] = Field("z", description="Source `controller`: axis of the force.")
    force_sign: int = Field(1, ge=-1, le=1, description="Source `controller`: -1 when tension is negative.")
    slowest_mm_per_s: float = Field(
        0.01, gt=0, le=100, description="Source `controller`: speed above which the crosshead counts as moving [mm/s]."
    )
    motion_span_s: float = Field(
        0.2, gt=0, le=10, description="Source `controller`: time over which this speed is determined [s]."
    )

    @model_validator(mode="after")
    def _machine_is_described(self) -> Self:
        if self.source == "machine" and not self.machine_file:
            raise ValueError("source machine needs the parameter machine_file: a YAML file that describes it")
        if self.force_sign == 0:
            raise ValueError("force_sign is 0; use 1 or -1")
        return self

    def open(self, node: Node) -> Machine:
        """Connect to the machine; `node` owns the subscriptions of the source `controller`.

        Raises
        ------
        FringedicError
            The description is wrong, or the machine does not answer.
        """
        if self.source == "machine":
            return open_machine(load_machine(self.machine_file), is_required=self.machine_required)
        if self.source == "controller":
            return ControllerMachine(
                node,
                ControllerTopics(
                    joint_states=self.joint_states_topic,
                    joint=self.joint,
                    wrench=self.wrench_topic,
                    force_axis=self.force_axis,
                    force_sign=self.force_sign,
                    slowest=1e-3 * self.slowest_mm_per_s,
                    span=self.motion_span_s,
                ),
            )
        configuration = virtual_configuration(self.virtual_rig)
        return SimulatedMachine(SimulatedLoadFrame(configuration.load_frame, configuration.seed))
