"""Instructions to an operator who puts planes in front of the camera."""

from __future__ import annotations

import math

from fringedic.calibration.placement import PlaneKind

_NAMES = {PlaneKind.GRID: "the grid", PlaneKind.PLANE: "the plane", PlaneKind.SPECIMEN: "the specimen"}


def position_in_words(kind: int, angle: float, height: float) -> str:
    """Return the position of an object that a stage has placed; angle [rad], height [m]."""
    if kind == PlaneKind.SPECIMEN:
        return _NAMES[PlaneKind.SPECIMEN]
    return f"{_NAMES[PlaneKind(kind)]} at {math.degrees(angle) + 0.0:+.2f} degree and {1e3 * height + 0.0:+.3f} mm"


def place_in_words(kind: int, angle: float, height: float) -> str:
    """Return the instruction to put something in front of the camera; angle [rad], height [m]."""
    if kind == PlaneKind.SPECIMEN:
        return "put the specimen back"
    degrees, lift = math.degrees(angle), 1e3 * height
    side = f" ({'right' if degrees > 0 else 'left'} side towards the camera)" if abs(degrees) > 1e-6 else ""
    if kind == PlaneKind.GRID and not side:
        return "lay the printed grid on the reference plane at 0 degree, turned in its plane by 1 to 3 degrees"
    if kind == PlaneKind.GRID:
        return f"turn the reference plane with the grid on it to {degrees:+.2f} degree{side}"
    lifted = f", {abs(lift):.3f} mm {'above' if lift > 0 else 'below'} its place" if abs(lift) > 1e-6 else ""
    return f"turn the plain reference plane to {degrees + 0.0:+.2f} degree{side}{lifted}"
