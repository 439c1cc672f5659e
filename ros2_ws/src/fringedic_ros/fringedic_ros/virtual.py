"""The virtual rig that stands in for hardware, as the parameter `rig_file` of a hardware node names it."""

from __future__ import annotations

from fringedic.errors import RigFileError
from fringedic.rig_file import load_rig_file
from fringedic.virtual_rig import VirtualRigConfiguration


def virtual_configuration(rig_file: str) -> VirtualRigConfiguration:
    """Configuration of the virtual rig in a rig file; of the preset `plate` when no file is named.

    Raises
    ------
    RigFileError
        The file cannot be used, or it describes no virtual rig.
    """
    if not rig_file:
        return VirtualRigConfiguration.from_dict({"preset": "plate"})
    rig = load_rig_file(rig_file)
    if rig.virtual_rig is None:
        raise RigFileError(
            f"{rig_file}: has no section virtual_rig; add one, for example virtual_rig: {{preset: plate}}"
        )
    return rig.virtual_configuration()
