"""Several sensors around one specimen: virtual rigs that differ in pose, optics and lens."""

from __future__ import annotations

from typing import Any

from fringedic.virtual_rig.arrangements import places_of
from fringedic.virtual_rig.configuration import VirtualRigConfiguration, arranged
from fringedic.virtual_rig.rig import VirtualRig


def virtual_sensors(
    name: str, *, size: str = "full", seed: int = 0, specimen: dict[str, Any] | None = None
) -> dict[str, VirtualRig]:
    """Return the sensors of an arrangement by their names; each has its own errors of alignment and its own lenses.

    Parameters
    ----------
    name
        ``plate`` (two sensors side by side), ``cylinder`` (four around the full circumference) or ``leather`` (two, on
        both sides of the fold).
    size
        As in `preset`.
    seed
        Of texture and noise, which all sensors have in common as they look at one specimen.
    specimen
        Another specimen in the same place.

    Raises
    ------
    VirtualRigError
        The name is unknown.

    Examples
    --------
    >>> list(virtual_sensors("cylinder", size="tiny"))
    ['a', 'b', 'c', 'd']
    """
    rigs = {}
    for sensor in places_of(name):
        entries = arranged(name, sensor, size=size)
        entries |= {"specimen": specimen or entries["specimen"], "seed": seed}
        rigs[sensor] = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    return rigs
