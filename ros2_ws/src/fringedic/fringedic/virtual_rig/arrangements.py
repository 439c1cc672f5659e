"""Arrangements of several sensors around one specimen: how each differs from a preset."""

from __future__ import annotations

import math
from typing import Any

from fringedic.errors import VirtualRigError

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


def places_of(name: Any) -> list[str]:
    """Return the names of the sensors of an arrangement.

    Raises
    ------
    VirtualRigError
        The name is unknown.
    """
    if name not in list(_ARRANGEMENTS):  # a list compares also what cannot be a key of a dictionary
        raise VirtualRigError(f"sensors {name!r} are unknown; choose from {', '.join(_ARRANGEMENTS)}")
    return list(_ARRANGEMENTS[name][1])


def changes_of(name: Any, place: Any) -> dict[str, Any]:
    """Return what a sensor of an arrangement changes in the preset of this name: pose, alignment, lens and specimen.

    Raises
    ------
    VirtualRigError
        The arrangement, or the sensor in it, is unknown.

    Examples
    --------
    >>> changes_of("plate", "left")["placement"]["translation_mm"]
    (-19.0, 0.0, 0.0)
    """
    places = places_of(name)
    if place not in places:
        raise VirtualRigError(
            f"virtual_rig: arrangement {name} has no sensor at place {place!r}; choose from {', '.join(places)}"
        )
    specimen, poses = _ARRANGEMENTS[name]
    number, (translation, rotation) = places.index(place), poses[place]
    sign = 1.0 if number % 2 else -1.0
    return {
        "camera": {
            "tilt_x_degree": 0.1 + 0.05 * number,
            "tilt_y_degree": 0.08 * sign,
            "lens": {"k1": sign * (0.02 + 0.01 * number), "p1": 2e-4 * sign},
        },
        "projector": {"roll_degree": 0.5 * sign, "yaw_degree": 0.1 * sign, "k1": 0.02 * sign},
        "specimen": dict(specimen),
        "placement": {"translation_mm": translation, "rotation_degree": rotation},
    }
