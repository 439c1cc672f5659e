"""Full levelling: the model's displacement is rendered with the measured texture, and measured as the test was."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates, spline_filter

from fringedic.correlation import measure_displacement
from fringedic.surface.planes import spacing_of

_ITERATIONS = 8  # of the inverse of the displacement; each multiplies its error by the strain
_ORDER: Final = 5  # of the spline: its error is far below the noise of an image
_CONTINUED = 3  # points
_CUBIC: Final = 3  # of the spline between points


def measure_rendered(
    image: np.ndarray, points: tuple[np.ndarray, np.ndarray], displacement: np.ndarray, *, window: int, method: str
) -> np.ndarray:
    """Return the displacement that is measured when the surface of an image moves by a known one.

    Parameters
    ----------
    image : (row, column)
        The reference image of the test [grey level], NaN beside the surface.
    points
        Rows and columns of the measured points [px].
    displacement : (2, row, column)
        Of the points in the image, x and y [px]; NaN beside the model.
    window, method
        Of the measurement, as in `fringedic.measure_displacement`.

    Returns
    -------
    ndarray
        Shape (2, row, column) [px], NaN where not measured.
    """
    rows, columns = points
    grid = np.stack(np.meshgrid(np.arange(image.shape[0]), np.arange(image.shape[1]), indexing="ij")).astype(float)
    moved = [spline_filter(_fill(_extrapolate(each)), order=_CUBIC) for each in displacement[::-1]]  # rows first
    spacing = np.array([spacing_of(rows), spacing_of(columns)])

    def at(place: np.ndarray) -> np.ndarray:
        """Return the displacement (row, column) at places of the reference image."""
        own = np.stack([(place[0] - rows[0]) / spacing[0], (place[1] - columns[0]) / spacing[1]])
        return np.stack([map_coordinates(each, own, order=_CUBIC, mode="nearest", prefilter=False) for each in moved])

    origin = grid  # of the material that each pixel of the deformed image shows
    for _ in range(_ITERATIONS):
        origin = grid - at(origin)
    known = np.isfinite(image)
    grey = _fill(image)
    deformed = map_coordinates(grey, origin, order=_ORDER, mode="nearest").astype(np.float32)
    nearest = [
        np.clip(np.round((grid[axis] - each[0]) / step), 0, len(each) - 1).astype(int)
        for axis, (each, step) in enumerate(zip(points, spacing, strict=True))
    ]
    mask = known & np.isfinite(displacement).all(axis=0)[nearest[0], nearest[1]]
    found = measure_displacement(
        grey.astype(np.float32),
        deformed,
        window=window,
        spacing=round(float(spacing[0])),
        mask=mask,
        method=method,
    ).reindex(row=rows, column=columns)
    return np.stack([found["displacement_x"].values, found["displacement_y"].values])


def _extrapolate(values: np.ndarray) -> np.ndarray:
    """Continue a map linearly by some points: windows at an edge contain the displacement up to the edge."""
    for _ in range(_CONTINUED):
        wide = np.pad(values, 2, constant_values=np.nan)
        centre = wide[2:-2, 2:-2]
        beside = [(wide[2:-2, 3:-1], wide[2:-2, 4:]), (wide[2:-2, 1:-3], wide[2:-2, :-4])]
        beside += [(wide[3:-1, 2:-2], wide[4:, 2:-2]), (wide[1:-3, 2:-2], wide[:-4, 2:-2])]
        lines = np.stack([2 * near - far for near, far in beside])
        number = np.isfinite(lines).sum(axis=0)
        mean = np.divide(np.nansum(lines, axis=0), number, out=np.full(values.shape, np.nan), where=number > 0)
        values = np.where(np.isfinite(centre), centre, mean)
    return values


def _fill(values: np.ndarray) -> np.ndarray:
    """Return a map whose unknown points have the value of the nearest known one."""
    nearest = distance_transform_edt(~np.isfinite(values), return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], float)
