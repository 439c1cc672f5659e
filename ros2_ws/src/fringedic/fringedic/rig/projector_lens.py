"""Brown's distortion of the projector's lens, for fringes of either direction.

A pin-hole direction (a across the fringes, b along them) leaves the projector where its image has the distorted
coordinate ``a (1 + k1 r^2 + k2 r^4 + k3 r^6) + p (r^2 + 2 a^2) + 2 q a b``, r^2 = a^2 + b^2 (Brown 1971). This is plain
arithmetic on numbers or arrays, so that the compiled reconstruction and the fits share one definition.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from fringedic.patterns.pattern import Orientation


class ProjectorLens(NamedTuple):
    """Radial coefficients, and the tangential ones across (p) and along the fringes (q)."""

    k1: float
    k2: float
    k3: float
    p: float
    q: float

    @classmethod
    def of(cls, k1: float, k2: float, p1: float, p2: float, k3: float, orientation: Orientation) -> ProjectorLens:
        """Return the lens for fringes of a direction, from OpenCV's coefficients, whose y is downwards."""
        tangential = (p2, -p1) if orientation == Orientation.VERTICAL else (-p1, p2)
        return cls(k1, k2, k3, *tangential)


def distorted(a: Any, b: Any, k1: float, k2: float, k3: float, p: float, q: float) -> tuple[Any, Any, Any]:
    """Return the distorted coordinate across the fringes, and its derivatives by a and by b; numbers or arrays."""
    square = a * a + b * b
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    growth = 2.0 * (k1 + square * (2.0 * k2 + 3.0 * k3 * square))
    across = a * radial + p * (square + 2.0 * a * a) + 2.0 * q * a * b
    by_a = radial + a * a * growth + 6.0 * p * a + 2.0 * q * b
    by_b = a * b * growth + 2.0 * p * b + 2.0 * q * a
    return across, by_a, by_b
