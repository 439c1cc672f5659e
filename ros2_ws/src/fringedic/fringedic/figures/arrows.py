"""Arrows of a 3D displacement for viewers that draw no vector fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

_LONGEST = 1.5  # arrow over the distance of two arrows


@dataclass(frozen=True)
class Arrows:
    """Arrows from points of the reference surface along their magnified displacement.

    Attributes
    ----------
    starts, ends
        Points [m], float64 (n, 3).
    magnification
        Length of an arrow over the displacement: 1, 2 or 5 times a power of ten.
    """

    starts: np.ndarray
    ends: np.ndarray
    magnification: float


def displacement_arrows(displacement: xr.Dataset, *, most: int = 24) -> Arrows:
    """Return arrows of a displacement on a regular part of its points.

    The magnification is the largest with which the 99th percentile of the lengths is at most one and a half times the
    distance of two arrows.

    Parameters
    ----------
    displacement
        x, y, z, u, v, w [m], images (row, column), NaN where not measured.
    most
        Largest number of arrows along the longer side.

    Examples
    --------
    >>> field = {name: (("row", "column"), np.zeros((2, 2))) for name in "yzuv"}
    >>> field["x"] = (("row", "column"), np.array([[0.0, 0.01], [0.0, 0.01]]))
    >>> field["w"] = (("row", "column"), np.array([[1e-5, np.nan], [1e-5, 2e-5]]))
    >>> arrows = displacement_arrows(xr.Dataset(field))
    >>> len(arrows.starts), arrows.magnification
    (3, 500.0)
    """
    every = math.ceil(max(displacement.u.shape) / most)
    chosen = displacement.isel(row=slice(every // 2, None, every), column=slice(every // 2, None, every))
    starts, vectors = (np.stack([chosen[name].values for name in names], axis=-1) for names in ("xyz", "uvw"))
    distance = float(np.nanmax(np.abs(np.diff(starts[..., 0], axis=1)), initial=0.0))
    measured = np.isfinite(starts).all(axis=-1) & np.isfinite(vectors).all(axis=-1)
    starts, vectors = starts[measured].astype(float), vectors[measured].astype(float)
    lengths = np.linalg.norm(vectors, axis=-1)
    longest = float(np.percentile(lengths, 99)) if len(lengths) else 0.0
    magnification = _round_down(_LONGEST * distance / longest) if longest and distance else 1.0
    return Arrows(starts, starts + magnification * vectors, magnification)


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))
