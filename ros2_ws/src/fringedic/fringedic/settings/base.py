"""What all settings have in common: strict models, paths beside a file, hardware nodes."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo

from fringedic.virtual_rig import VirtualRigConfiguration

MILLI = 1e-3
FILE, FOLDER = "file", "folder"  # keys of the context of a validation: name and folder of the file that is read


class Settings(BaseModel):
    """Base of all settings: unknown names, other types, NaN and infinity are refused.

    A model of settings is the section of a rig file, and the parameters of a node: both have the names, units, defaults
    and ranges of its fields.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


OR_EMPTY = BeforeValidator(lambda value: value or {})
"""A section that is a parameter of a node, whose text may be empty."""


class HardwareNodeSettings(Settings):
    """Settings of every hardware node."""

    autostart: bool = Field(
        True, description="Configure and activate at the start; otherwise wait for a lifecycle manager."
    )


def _beside_the_file(path: str, info: ValidationInfo) -> str:
    folder = (info.context or {}).get(FOLDER)
    return str((folder / path).absolute()) if folder is not None and path else path


FilePath = Annotated[str, AfterValidator(_beside_the_file)]
"""A path; one that is written in a file is relative to the folder of that file."""


def _checked_virtual_rig(entries: dict[str, Any]) -> dict[str, Any]:
    VirtualRigConfiguration.from_dict(entries)
    return entries


class VirtualDeviceNodeSettings(HardwareNodeSettings):
    """Settings of the node of a device that may be part of the virtual rig."""

    virtual_rig: Annotated[dict[str, Any], AfterValidator(_checked_virtual_rig)] = Field(
        {"preset": "plate"}, description="The virtual rig, as the section `virtual_rig` of a rig file."
    )
