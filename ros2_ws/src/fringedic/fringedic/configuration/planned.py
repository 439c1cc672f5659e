"""The rig that a rig file plans, in the terms of a virtual rig."""

from __future__ import annotations

from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError
from fringedic.virtual_rig import VirtualRigConfiguration

_BITS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono16": 16}


def planned_configuration(rig: RigFile, name: str) -> VirtualRigConfiguration:
    """Return the rig that a rig file plans as a virtual rig: that of its section plan, or of virtual_rig without one.

    Parameters
    ----------
    rig
        The content of the rig file.
    name
        Of the file, for the error.

    Raises
    ------
    ConfigurationError
        The file has neither section, or does not state the sizes of camera and projector.
    """
    if rig.plan is None and rig.virtual_rig is None:
        raise ConfigurationError(
            f"{name}: has no section plan, so sensor, lenses and distances are not known; "
            f"`fringedic plan planned` shows an example"
        )
    if rig.projector is None:
        raise ConfigurationError(f"{name}: has no projector to plan; add the section projector with width and height")
    if rig.plan is None:
        return rig.virtual_configuration()
    sizes = rig.camera_size(), rig.projector_size()
    if sizes[0] is None or sizes[1] is None:
        raise ConfigurationError(f"{name}: a plan needs width and height of camera and projector")
    bits = _BITS[rig.camera.pixel_format]
    return VirtualRigConfiguration.from_dict(rig.plan.virtual_entries(sizes[0], sizes[1], bits))
