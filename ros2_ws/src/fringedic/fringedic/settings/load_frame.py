"""Settings of testing machines: one model for each source, those of the load frame node, and the proof of a hold."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, SerializeAsAny, model_validator

from fringedic.settings.base import FilePath, Settings, VirtualDeviceNodeSettings
from fringedic.settings.devices import Devices, DeviceSettings


class HoldSettings(Settings):
    """Proof of a hold during the exposures of a step."""

    hold_required: bool = Field(
        True, description="Refuse a step unless samples of the load frame show a hold before, during and after it."
    )
    load_drift_n: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the force during the exposures of a step [N]; 0: no limit."
    )
    position_drift_um: float = Field(
        0.0,
        ge=0,
        le=1e6,
        description="Largest change of the crosshead position during the exposures [µm]; 0: no limit.",
    )


class LoadFrameSettings(HoldSettings, DeviceSettings):
    """Settings of every source of force and position."""

    of_another_node: ClassVar[frozenset[str]] = frozenset(HoldSettings.model_fields)  # of the experiment node

    source: str = Field(
        "simulated",
        description="Source of force and position. simulated: the machine of the virtual rig; machine: one that a file "
        "describes; controller: joint states and wrench of ros2_control; external: a node that publishes "
        "`load_frame/state`; or the name of an installed driver.",
    )
    rate_hz: float = Field(100.0, ge=2, le=1000, description="Samples of force and position per second [Hz].")


class MachineSettings(LoadFrameSettings):
    """Settings of every machine of the load frame node.

    Attributes
    ----------
    held_at_end
        The node requests a hold when it ends.
    """

    held_at_end: ClassVar[bool] = True

    position_tolerance_mm: float = Field(
        0.01, gt=0, le=10, description="A move has arrived when the crosshead stands this close to its target [mm]."
    )


class VirtualLoadFrame(MachineSettings):
    """The machine of the virtual rig."""

    driver: ClassVar[str] = "load_frame_node.machines.simulated:open_simulated_machine"
    elsewhere: ClassVar[str] = "the section virtual_rig describes this machine"

    source: Literal["simulated"] = "simulated"


class DescribedLoadFrame(MachineSettings):
    """A machine that a file describes."""

    driver: ClassVar[str] = "load_frame_node.machines:open_described_machine"
    elsewhere: ClassVar[str] = (
        "a negative scale in the machine file or specimen.force_sign reverses the force, and motion in the machine "
        "file defines a motion"
    )

    source: Literal["machine"] = "machine"
    file: FilePath = Field("", description="Machine file: protocol, registers and units.")

    @model_validator(mode="after")
    def _file_is_named(self) -> Self:
        if not self.file:
            raise ValueError("source: machine needs the key file, a machine file that describes it")
        return self


class ControllerLoadFrame(MachineSettings):
    """A machine whose state a ros2_control controller publishes."""

    driver: ClassVar[str] = "load_frame_node.machines.controller:ControllerMachine"
    held_at_end: ClassVar[bool] = False  # it is held by its own controller

    source: Literal["controller"] = "controller"
    joint_states_topic: str = Field("/joint_states", description="JointState of the crosshead.")
    joint: str = Field("crosshead", description="Name of the joint of the crosshead.")
    wrench_topic: str = Field("/wrench", description="WrenchStamped of the load cell.")
    force_axis: Literal["x", "y", "z"] = Field("z", description="Axis of the force.")
    force_sign: Literal[-1, 1] = Field(1, description="-1 when tension is negative.")
    slowest_mm_per_s: float = Field(
        0.01, gt=0, le=100, description="Speed above which the crosshead counts as moving [mm/s]."
    )
    motion_span_s: float = Field(0.2, gt=0, le=10, description="Time over which this speed is determined [s].")


class ExternalLoadFrame(LoadFrameSettings):
    """Another node that publishes `load_frame/state`."""

    elsewhere: ClassVar[str] = (
        "the node that publishes load_frame/state has its own settings, and specimen.force_sign reverses the force"
    )

    source: Literal["external"] = "external"


_MACHINES = (VirtualLoadFrame, DescribedLoadFrame, ControllerLoadFrame)
MACHINES = Devices("fringedic.machines", MachineSettings, _MACHINES, default="simulated")
LOAD_FRAMES = Devices(MACHINES.group, LoadFrameSettings, (*_MACHINES, ExternalLoadFrame), default="simulated")
LoadFrame = Annotated[SerializeAsAny[LoadFrameSettings], LOAD_FRAMES]
"""Settings of any source of force and position; `source` selects their model."""


class LoadFrameNodeSettings(VirtualDeviceNodeSettings):
    """Settings of the load frame node."""

    device: Annotated[SerializeAsAny[MachineSettings], MACHINES] = Field(VirtualLoadFrame(), description="The machine.")
    machine_required: bool = Field(
        True,
        description="Source `machine`: refuse to be configured while the machine does not answer. `fringedic run` sets "
        "false when it starts the node again during a test.",
    )
