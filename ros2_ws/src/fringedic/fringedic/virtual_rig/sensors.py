"""Several sensors around one specimen: virtual rigs that differ in pose, optics and lens."""

from __future__ import annotations

import math
from typing import Any

from fringedic.errors import VirtualRigError
from fringedic.virtual_rig.configuration import VirtualRigConfiguration, preset
from fringedic.virtual_rig.rig import VirtualRig

Pose = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Translation [mm] and rotation vector [degree] from a sensor's rig frame to the frame of the specimen."""


def _around(degrees: float, radius: float) -> Pose:
    """Return the pose of a sensor that looks at the axis y from an angle, with its origin at a radius [mm]."""
    angle = math.radians(degrees)
    return (radius * math.sin(angle), 0.0, radius * math.cos(angle)), (0.0, degrees, 0.0)


_RADIUS = 20.0
# each sensor by its name with its pose; the specimen of each arrangement
_ARRANGEMENTS: dict[str, tuple[dict[str, Any], dict[str, Pose]]] = {
    "plate": (
        {"kind": "plate", "half_width_mm": 48.0, "half_height_mm": 40.0, "gauge_length_mm": 80.0},
        {"left": ((-19.0, 0.0, 0.0), (0.0, -9.0, 0.0)), "right": ((19.0, 0.0, 0.0), (0.0, 9.0, 0.0))},
    ),
    "cylinder": (
        {"kind": "cylinder", "radius_mm": _RADIUS},
        {name: _around(angle, _RADIUS) for name, angle in zip(("a", "b", "c", "d"), (0, 90, 180, -90), strict=True)},
    ),
    "leather": (
        {"kind": "leather"},
        {"left": ((-8.0, 0.0, 0.0), (0.0, -16.0, 0.0)), "right": ((8.0, 0.0, 0.0), (0.0, 16.0, 0.0))},
    ),
}


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
    if name not in _ARRANGEMENTS:
        raise VirtualRigError(f"sensors {name!r} are unknown; choose from {', '.join(_ARRANGEMENTS)}")
    own, poses = _ARRANGEMENTS[name]
    rigs = {}
    for number, (sensor, (translation, rotation)) in enumerate(poses.items()):
        entries = preset(name, size=size)
        sign = 1.0 if number % 2 else -1.0
        entries["camera"] |= {
            "tilt_x_degree": 0.1 + 0.05 * number,
            "tilt_y_degree": 0.08 * sign,
            "lens": {"k1": sign * (0.02 + 0.01 * number), "p1": 2e-4 * sign},
        }
        entries["projector"] |= {"roll_degree": 0.5 * sign, "yaw_degree": 0.1 * sign, "k1": 0.02 * sign}
        entries |= {
            "specimen": specimen or own,
            "placement": {"translation_mm": translation, "rotation_degree": rotation},
            "seed": seed,
        }
        rigs[sensor] = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    return rigs
