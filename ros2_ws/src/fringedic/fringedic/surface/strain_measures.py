"""Measures that follow from the Green-Lagrange strain of a surface; a new one is one more entry of `MEASURES`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from fringedic.errors import SurfaceError


@dataclass(frozen=True)
class SurfaceStrain:
    """Green-Lagrange strain in the tangent plane, (row, column) each; see `strain.surface_strain`."""

    e_11: np.ndarray
    e_22: np.ndarray
    e_12: np.ndarray
    e_1: np.ndarray
    e_2: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True)
class Measure:
    """One measure.

    Attributes
    ----------
    fields
        Unit and description of its fields by name.
    compute
        Returns these fields in their order.
    """

    fields: dict[str, tuple[str, str]]
    compute: Callable[[SurfaceStrain], list[np.ndarray]]


def require_measures(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of measures.

    Raises
    ------
    SurfaceError
        A measure is unknown.
    """
    names = tuple(names)
    unknown = sorted(set(names) - MEASURES.keys())
    if unknown:
        raise SurfaceError(f"measure {', '.join(unknown)} is unknown; there are {', '.join(MEASURES)}")
    return names


def _von_mises(strain: SurfaceStrain) -> list[np.ndarray]:
    """Equivalent strain of an incompressible material, whose strain across the surface is -(e_1 + e_2)."""
    return [2 / math.sqrt(3) * np.sqrt(strain.e_1**2 + strain.e_1 * strain.e_2 + strain.e_2**2)]


def _area_change(strain: SurfaceStrain) -> list[np.ndarray]:
    """Change of area over area, from the determinant of the deformation in the surface."""
    return [np.sqrt((1 + 2 * strain.e_1) * (1 + 2 * strain.e_2)) - 1]


def _hencky(strain: SurfaceStrain) -> list[np.ndarray]:
    """Logarithm of the stretches (Hencky 1928), in the principal directions and in t1, t2."""
    h_1, h_2 = 0.5 * np.log1p(2 * strain.e_1), 0.5 * np.log1p(2 * strain.e_2)
    middle, half = (h_1 + h_2) / 2, (h_1 - h_2) / 2
    cosine, sine = np.cos(2 * strain.direction), np.sin(2 * strain.direction)
    return [middle + half * cosine, middle - half * cosine, half * sine, h_1, h_2]


def _engineering(strain: SurfaceStrain) -> list[np.ndarray]:
    """Elongations of lines along t1 and t2, and the change of their angle."""
    stretch_1, stretch_2 = np.sqrt(1 + 2 * strain.e_11), np.sqrt(1 + 2 * strain.e_22)
    return [stretch_1 - 1, stretch_2 - 1, np.arcsin(2 * strain.e_12 / (stretch_1 * stretch_2))]


MEASURES = {
    "von_mises": Measure({"e_von_mises": ("1", "von Mises strain of an incompressible material")}, _von_mises),
    "area_change": Measure({"area_change": ("1", "change of area over area")}, _area_change),
    "hencky": Measure(
        {
            "h_11": ("1", "Hencky strain along t1"),
            "h_22": ("1", "Hencky strain along t2"),
            "h_12": ("1", "Hencky tensor shear strain"),
            "h_1": ("1", "larger principal Hencky strain"),
            "h_2": ("1", "smaller principal Hencky strain"),
        },
        _hencky,
    ),
    "engineering": Measure(
        {
            "elongation_1": ("1", "change of length over length of a line along t1"),
            "elongation_2": ("1", "change of length over length of a line along t2"),
            "shear_angle": ("rad", "loss of the right angle between t1 and t2"),
        },
        _engineering,
    ),
}
