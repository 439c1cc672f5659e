"""Settings of projectors: one model for each source, and those of the projector node."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, SerializeAsAny, model_validator

from fringedic.settings.base import FilePath, VirtualDeviceNodeSettings
from fringedic.settings.devices import Devices, ImageDeviceSettings
from fringedic.virtual_rig import VirtualRigConfiguration


class ProjectorSettings(ImageDeviceSettings):
    """Settings of every projector."""

    elsewhere: ClassVar[str] = "source: display shows the patterns on a display of this computer"

    source: str = Field(
        "virtual",
        description="Destination of the patterns. virtual: the virtual rig; display: a projector on this computer; or "
        "the name of an installed driver.",
    )
    response_curve: FilePath = Field(
        "",
        description="YAML file of the response curve of projector and camera, for which fringes and Gray codes are "
        "pre-compensated; empty: no pre-compensation.",
    )

    @property
    def device(self) -> str:
        """What two sensors cannot have in common; empty when it is not known."""
        return ""

    @model_validator(mode="after")
    def _size_is_known(self) -> Self:
        if self.source != "virtual" and self.size is None:
            raise ValueError(f"source: {self.source} needs width and height, the projector's own resolution")
        return self


class VirtualProjector(ProjectorSettings):
    """The projector of the virtual rig, whose camera receives the published patterns."""

    driver: ClassVar[str] = "fringe_projector_node.screens:open_virtual_screen"

    source: Literal["virtual"] = "virtual"


class DisplayProjector(ProjectorSettings):
    """A projector that is a display of this computer."""

    driver: ClassVar[str] = "fringe_projector_node.display:DisplayScreen"

    source: Literal["display"] = "display"
    display: int = Field(0, ge=0, le=15, description="Number of the projector among this computer's displays, from 0.")

    @property
    def device(self) -> str:
        """Number of the display."""
        return f"display {self.display}"


PROJECTORS = Devices("fringedic.projectors", ProjectorSettings, (VirtualProjector, DisplayProjector), default="virtual")
Projector = Annotated[SerializeAsAny[ProjectorSettings], PROJECTORS]
"""Settings of any projector; `source` selects their model."""


class ProjectorNodeSettings(VirtualDeviceNodeSettings):
    """Settings of the projector node."""

    device: Projector = Field(VirtualProjector(), description="The projector.")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the patterns [px]."""
        virtual = VirtualRigConfiguration.from_dict(self.virtual_rig).projector
        return self.device.size or (virtual.columns, virtual.rows)
