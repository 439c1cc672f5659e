"""Levelling: a model's displacement is filtered as the measurement filters that of the surface.

The in-plane displacement passes through the windows of its method with the transfer `noise_transfer` of
`fringedic.correlation.transfer` (measured waves lose a little more, decision 0101), the height through the Gaussian
that smoothed it; the strain is that of `surface_strain` with the same window. The plane of each field is subtracted
before its windows, which edges cut off, and added again: a linear field is exact up to the edges, as it is measured.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import xarray as xr

from fringedic.correlation.transfer import NARROWER, ORDER, window_deviation
from fringedic.datasets.quantities import strain_measure_of
from fringedic.errors import ModelError
from fringedic.surface.planes import spacing_of
from fringedic.surface.strain import compute_strain
from fringedic.surface.strain_measures import GREEN_LAGRANGE

_ITERATIONS = 12  # reach the fixed point; test_waves_keep_the_share_of_the_fixed_point


@dataclass(frozen=True)
class Levelling:
    """What the measurement does to the displacement of a surface.

    Attributes
    ----------
    window, method
        Of the in-plane displacement, as in `measure_displacement` [px].
    z_filter
        Standard deviation of the Gaussian that smoothed the heights [px].
    strain_window
        Of the strain [px]; 0 without strain.
    spacing
        Distance of the points [px].
    strain_measure
        Of the strain that follows from the displacement, of `fringedic.surface.strain_measures.TENSORS`.
    """

    window: int
    method: str
    z_filter: float
    strain_window: int
    spacing: int
    strain_measure: str = GREEN_LAGRANGE

    def displacement(self, maps: np.ndarray) -> np.ndarray:
        """Return maps of u, v, w (3, row, column) as they would be measured; NaN stays NaN."""
        known = np.isfinite(maps).all(axis=0)
        planes = _fit_planes(maps, known)
        u, v, w = np.where(known, maps - planes, 0.0).astype(np.float32)
        if self.z_filter > 0:
            w = _normalise(known, _gaussian(self.z_filter / self.spacing))(w)
        with ThreadPoolExecutor(2) as pool:
            in_plane = list(pool.map(lambda values: self._in_plane(values, known), (u, v)))
        return np.where(known, planes + np.stack([*in_plane, w]), np.nan).astype(np.float32)

    def nodal_strain(self, maps: np.ndarray) -> np.ndarray:
        """Return maps of e_11, e_22, e_12 (3, row, column) of the surface as they would be measured.

        The slope of a least-squares plane is the mean of the derivative over its window, with weights that fall to 0 at
        both ends along the direction of the derivative (a parabola) and are equal across it; the shear is the mean of
        two such slopes. Before, the displacement passes through the window of the correlation.
        """
        known = np.isfinite(maps).all(axis=0)
        planes = _fit_planes(maps, known)
        rest = np.where(known, maps - planes, 0.0).astype(np.float32)
        e_11, e_22, e_12 = (
            np.where(known, plane + self._in_plane(each, known), 0.0).astype(np.float32)
            for plane, each in zip(planes, rest, strict=True)
        )
        reach = max(1, round((self.strain_window - 1) / 2 / self.spacing))
        place = np.arange(-reach, reach + 1)
        equal, falling = np.ones(len(place)), reach * (reach + 1) - place * (place - 1.0)
        falling = (falling + falling[::-1]) / 2
        along_x, along_y = (
            _normalise(known, *(taps / taps.sum() for taps in pair)) for pair in ((falling, equal), (equal, falling))
        )
        found = np.stack([along_x(e_11), along_y(e_22), (along_x(e_12) + along_y(e_12)) / 2])
        return np.where(known, found, np.nan)

    def _in_plane(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        if self.method == "zoi":
            reach = (self.window - 1) // (2 * self.spacing)
            taps = np.maximum(0, 1 - np.abs(np.arange(-reach, reach + 1)) * 2 * self.spacing / (self.window - 1)) ** 2
            return _normalise(known, np.asarray(taps / taps.sum()))(values)
        return _fixed_point(values, known, window_deviation(self.window) / self.spacing)

    def strain(self, positions: np.ndarray, maps: np.ndarray, grid: xr.Dataset) -> np.ndarray:
        """Return e_11, e_22, e_12 (3, row, column) of a filtered displacement at positions (3, row, column) [m]."""
        fields = dict(zip(("x", "y", "z", "u", "v", "w"), (*positions, *maps), strict=True))
        cloud = xr.Dataset(
            {name: (("row", "column"), values) for name, values in fields.items()},
            {name: grid[name] for name in ("row", "column")},
        )
        found = compute_strain(cloud, self.strain_window, (), tensor=self.strain_measure)
        return np.stack([found[name].values for name in ("e_11", "e_22", "e_12")])


def levelling_of(experiment: xr.Dataset) -> Levelling:
    """Return the filters that a dataset was measured with.

    Raises
    ------
    ModelError
        The dataset does not contain its parameters.
    """
    recorded = json.loads(experiment.attrs.get("parameters", "[]"))
    if not recorded:
        raise ModelError("the dataset has no parameters of its measurement; open a dataset of this version")
    parameters: dict[str, dict[str, Any]] = recorded[-1]["parameters"]
    coupling, strain = parameters.get("coupling", {}), parameters.get("strain", {})
    return Levelling(
        window=int(parameters["dic"]["window"]),
        method=str(parameters["dic"].get("method", "dense")),
        z_filter=float(coupling.get("z_filter_px", 0.0)),
        strain_window=int(strain.get("strain_window_px", coupling.get("strain_window_px", 0))),
        spacing=int(spacing_of(experiment["column"].values)),
        strain_measure=strain_measure_of(experiment),
    )


def _fit_planes(maps: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the least-squares planes of the known points of maps (map, row, column), of their shape."""
    row, column = (np.arange(size, dtype=float) for size in known.shape)
    here = np.nonzero(known)
    basis = np.stack([np.ones(len(here[0])), row[here[0]], column[here[1]]])
    found = np.linalg.lstsq(basis @ basis.T, basis @ maps[:, known].T, rcond=None)[0]
    return np.asarray(
        found[0, :, None, None] + found[1, :, None, None] * row[:, None] + found[2, :, None, None] * column
    )


def _fixed_point(values: np.ndarray, known: np.ndarray, deviation: float) -> np.ndarray:
    """Return the fixed point u = S u + W (values - S u) of the dense method with windows cut off at edges.

    S = 1 - (1 - V)^ORDER; W and V are Gaussians of standard deviations `deviation` and NARROWER `deviation` [points].
    Inside the surface the transfer is `noise_transfer`; at an edge normalised windows follow the displacement as
    subsets do.
    """
    wide, narrow = (_normalise(known, _gaussian(each)) for each in (deviation, NARROWER * deviation))
    result = values
    for _ in range(_ITERATIONS):
        left = result
        for _ in range(ORDER):
            left = left - narrow(left)
        predicted = result - left
        result = predicted + wide(values - predicted)
    return result


def _normalise(
    known: np.ndarray, taps: np.ndarray, across: np.ndarray | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the separable filter, by default alike along both axes, that weighs only known points; 0 elsewhere."""
    taps_y = taps if across is None else across

    def smooth(values: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.sepFilter2D(values, cv2.CV_32F, taps, taps_y, borderType=cv2.BORDER_CONSTANT))

    inverse_share = np.divide(1, smooth(known.astype(np.float32)), out=np.zeros(known.shape, np.float32), where=known)
    return lambda values: np.asarray(smooth(values) * inverse_share)


def _gaussian(deviation: float) -> np.ndarray:
    reach = int(4 * deviation) + 1
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    return np.asarray(taps / taps.sum())
