"""Measures that follow from the Green-Lagrange strain of a surface; a new one is one more entry of `MEASURES`.

`TENSORS` are the measures that the strain of a flat specimen is given in. With the deformation gradient F = R U they
are functions of U alone, so that a rotation R of any size gives zero.
"""

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
class StrainTensor:
    """A measure of strain with the principal directions of the Green-Lagrange strain.

    Attributes
    ----------
    title, definition
        Its name in sentences, and its formula with the deformation gradient F = R U.
    chord
        Returns (f(a) - f(b)) / (a - b) of principal Green-Lagrange strains a and b, with f(0) = 0 the principal value
        of this measure; its limit, the derivative of f, for a = b.
    """

    title: str
    definition: str
    chord: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def convert(self, strain: SurfaceStrain) -> SurfaceStrain:
        """Return this measure of a Green-Lagrange strain."""
        zero = np.zeros_like(strain.e_1)
        one, two = (each * self.chord(each, zero) for each in (strain.e_1, strain.e_2))
        middle, half = (one + two) / 2, (one - two) / 2
        cosine, sine = np.cos(2 * strain.direction), np.sin(2 * strain.direction)
        return SurfaceStrain(middle + half * cosine, middle - half * cosine, half * sine, one, two, strain.direction)

    def convert_sigmas(self, strain: SurfaceStrain, covariance: np.ndarray) -> np.ndarray:
        """Return the standard deviations (3, row, column) of the components 11, 22, 12 of this measure.

        Parameters
        ----------
        strain
            Green-Lagrange.
        covariance : (6, row, column)
            Of its components: 11 11, 22 22, 12 12, 11 22, 11 12, 22 12.

        Notes
        -----
        The derivative of a tensor function is the one of its principal values along the principal directions, and the
        chord between them for the shear (Daleckii, Krein 1965).
        """
        c, s = np.cos(strain.direction), np.sin(strain.direction)
        cc, ss, cs = c * c, s * s, c * s
        to_principal = np.stack([cc, ss, 2 * cs, ss, cc, -2 * cs, -cs, cs, cc - ss]).reshape(3, 3, *c.shape)
        from_principal = np.stack([cc, ss, -2 * cs, ss, cc, 2 * cs, cs, -cs, cc - ss]).reshape(3, 3, *c.shape)
        one, two = strain.e_1, strain.e_2
        slopes = np.stack([self.chord(one, one), self.chord(two, two), self.chord(one, two)])
        jacobian = np.einsum("ik...,k...,kj...->ij...", from_principal, slopes, to_principal)
        order = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
        return np.asarray(np.sqrt(np.einsum("ik...,kl...,il...->i...", jacobian, covariance[order], jacobian)))


def _logarithmic_chord(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    change = 2 * (a - b) / (1 + 2 * b)
    ratio = np.divide(np.log1p(change), change, out=np.ones_like(change), where=change != 0)
    return np.asarray(ratio / (1 + 2 * b))


STRAIN_MEASURE = "strain_measure"  # attribute of a dataset; Green-Lagrange where it is missing
GREEN_LAGRANGE = "green-lagrange"
TENSORS = {
    GREEN_LAGRANGE: StrainTensor("Green-Lagrange", "(F^T F - 1)/2", lambda a, b: np.ones_like(a - b)),
    "logarithmic": StrainTensor("logarithmic", "ln U, Hencky", _logarithmic_chord),
    "engineering": StrainTensor(
        "engineering", "U - 1, Biot", lambda a, b: 2 / (np.sqrt(1 + 2 * a) + np.sqrt(1 + 2 * b))
    ),
}


def strain_attributes(measure: str) -> dict[str, str]:
    """Return the attributes of a dataset that name measure and kind of shear of the strain of a flat specimen."""
    return {STRAIN_MEASURE: measure, "shear_strain": "tensor, half the engineering shear"}


def flat_fields(measure: str) -> dict[str, str]:
    """Return the fields of the strain of a flat specimen in one of `TENSORS`, and their descriptions.

    Examples
    --------
    >>> flat_fields("logarithmic")["e_xy"]
    'logarithmic strain (ln U, Hencky), tensor shear of x (right) and y (up)'
    """
    strain = f"{TENSORS[measure].title} strain ({TENSORS[measure].definition})"
    components = ("e_xx", "e_yy", "e_xy")
    return {
        "e_xx": f"{strain} along x (right)",
        "e_yy": f"{strain} along y (up)",
        "e_xy": f"{strain}, tensor shear of x (right) and y (up)",
        "e_1": f"{strain}, larger principal value",
        "e_2": f"{strain}, smaller principal value",
        "e_von_mises": f"equivalent strain (von Mises) of the {strain}",
        **{f"sigma_{name}": f"standard deviation of {name}" for name in components},
        **{f"resolution_{name}": f"expected error of {name} by the smoothing of its window" for name in components},
    }


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
    found = TENSORS["logarithmic"].convert(strain)
    return [found.e_11, found.e_22, found.e_12, found.e_1, found.e_2]


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
