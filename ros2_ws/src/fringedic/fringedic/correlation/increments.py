"""Total displacement from increments, composed in the initial configuration (Molimard et al., section 4.2).

The increment from step k to k + 1 is known at the pixels of step k, where a material point that started at p is at
p + D_k(p). So

    D_(k+1)(p) = D_k(p) + d_(k+1)(p + D_k(p))

and sums at fixed pixels would follow the wrong points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt, map_coordinates, spline_filter, spline_filter1d
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from fringedic.correlation.transfer import error_correlation
from fringedic.errors import CorrelationError
from fringedic.wording.arguments import check_arguments, dataset, number, several

_MARGIN = 12  # points around a field: a cubic spline forgets its boundary condition as .27 per point
_NAMES = ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
_RIDGE = 1e-9  # of a node's weight, so that nodes without points do not make the fit singular


@dataclass(frozen=True)
class PixelGrid:
    """Equidistant points of an image: first row and column, distance [px] and numbers of points."""

    row: float
    column: float
    spacing: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, increment: xr.Dataset) -> PixelGrid:
        """Return the grid of a displacement.

        Raises
        ------
        CorrelationError
            The points are not equidistant, with the same distance in both directions.
        """
        rows, columns = (np.asarray(increment[name], float) for name in ("row", "column"))
        steps = np.concatenate([np.diff(rows), np.diff(columns)])
        if len(rows) < 2 or len(columns) < 2 or not np.allclose(steps, steps[0]):
            raise CorrelationError("the points of an increment have to be equidistant along rows and columns")
        return cls(float(rows[0]), float(columns[0]), float(steps[0]), (len(rows), len(columns)))

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of all points [px], each of the grid's shape."""
        rows = self.row + self.spacing * np.arange(self.shape[0])
        columns = self.column + self.spacing * np.arange(self.shape[1])
        row, column = np.meshgrid(rows, columns, indexing="ij")
        return row, column

    def index(self, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the fractional indices of pixel positions."""
        return (row - self.row) / self.spacing, (column - self.column) / self.spacing


class Interpolation(Protocol):
    """A displacement between its points."""

    def at(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return the displacement (2, ...) [px] at indices of the grid."""
        ...


class Spline:
    """Interpolating cubic spline of the field without its affine part, which continues linearly at the edges."""

    def __init__(self, field: np.ndarray) -> None:
        rows, columns = np.indices(field.shape[1:], np.float32)
        measured = np.isfinite(field).all(axis=0)
        some = np.flatnonzero(measured)[:: max(1, np.count_nonzero(measured) // 20000)]
        basis = np.stack([np.ones(len(some)), rows.ravel()[some], columns.ravel()[some]], axis=-1)
        self._affine = np.linalg.lstsq(basis, field.reshape(2, -1)[:, some].T.astype(float), rcond=None)[0].T
        rest = field - np.einsum("ck,kij->cij", self._affine, np.stack([np.ones_like(rows), rows, columns]))
        if not measured.all():
            nearest = distance_transform_edt(~measured, return_distances=False, return_indices=True)
            rest = rest[:, nearest[0], nearest[1]]
        around = ((0, 0), (_MARGIN, _MARGIN), (_MARGIN, _MARGIN))
        padded = np.pad(rest, around, mode="reflect", reflect_type="odd")
        self._coefficients = [spline_filter(each, order=3, output=np.float64, mode="mirror") for each in padded]

    def at(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return the displacement (2, ...) [px] at indices of the grid."""
        where = np.stack([row, column]) + _MARGIN
        found = np.stack(
            [map_coordinates(each, where, order=3, mode="mirror", prefilter=False) for each in self._coefficients]
        )
        a = self._affine.reshape(2, 3, *([1] * np.ndim(row)))
        return np.asarray(found + a[:, 0] + a[:, 1] * row + a[:, 2] * column)


class Mesh:
    """Bilinear finite elements fitted to all points by least squares (Avril et al. 2008).

    Parameters
    ----------
    field
        (2, row, column) [px], NaN where not measured.
    size
        Side of the square elements in points.
    """

    def __init__(self, field: np.ndarray, size: float) -> None:
        self._size = size
        self._shape = tuple(int(np.ceil((length - 1) / size)) + 1 for length in field.shape[1:])
        measured = np.isfinite(field).all(axis=0)
        rows, columns = np.nonzero(measured)
        shape = self._shape_functions(rows, columns)
        normal = (shape.T @ shape).tocsc()
        normal.setdiag(normal.diagonal() + _RIDGE)
        values = field[:, rows, columns].astype(float)
        self._nodes = splu(normal).solve(shape.T @ values.T).T
        self.misfit = float(np.sqrt(np.mean((shape @ self._nodes.T - values.T) ** 2)))

    def _shape_functions(self, rows: np.ndarray, columns: np.ndarray) -> csr_matrix:
        """Weights of the four corners at indices of the grid, shape (point, node)."""
        down, across = rows / self._size, columns / self._size
        i = np.clip(np.floor(down).astype(np.intp), 0, self._shape[0] - 2)
        j = np.clip(np.floor(across).astype(np.intp), 0, self._shape[1] - 2)
        g, f = down - i, across - j
        weights = np.stack([(1 - g) * (1 - f), (1 - g) * f, g * (1 - f), g * f], axis=-1)
        corner = i * self._shape[1] + j
        nodes = corner[:, None] + np.array([0, 1, self._shape[1], self._shape[1] + 1])
        return csr_matrix(
            (weights.ravel(), nodes.ravel(), np.arange(0, weights.size + 1, 4)),
            shape=(len(rows), self._shape[0] * self._shape[1]),
        )

    def at(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return the displacement (2, ...) [px] at indices of the grid."""
        found = self._shape_functions(np.ravel(row), np.ravel(column)) @ self._nodes.T
        return np.asarray(found.T.reshape(2, *np.shape(row)))


@dataclass
class Total:
    """Displacement since the initial configuration.

    Attributes
    ----------
    displacement, variance : (2, row, column)
        d_x and d_y at the points of the initial configuration [px], and their variances [px^2].
    misfit
        Largest root mean square distance of a mesh from its points [px].
    """

    displacement: np.ndarray
    variance: np.ndarray
    misfit: float = 0.0


def compose(
    total: Total,
    grid: PixelGrid,
    increment: np.ndarray,
    sigma: np.ndarray,
    increment_grid: PixelGrid,
    *,
    element: float | None = None,
    noise_gain: float = 1.0,
) -> Total:
    """Compose a total displacement with one more increment.

    An error of the position before is stretched with the material, 1 + grad d, and the error of the increment is added:
    Sigma' = (1 + grad d) Sigma (1 + grad d)^T + Sigma_d.

    Parameters
    ----------
    total, grid
        Displacement so far, and its points.
    increment, sigma, increment_grid
        (2, row, column) [px] in the image that the total leads to.
    element
        Side of the finite elements [px]; None for the spline.
    noise_gain
        Variance of the interpolated increment over that at its points, see `interpolation_noise`.

    Returns
    -------
    Total
        NaN where a point has left the measured part of the increment.
    """
    row, column = grid.points()
    index = increment_grid.index(row + total.displacement[1], column + total.displacement[0])
    inside = np.isfinite(index[0]) & np.isfinite(index[1])
    for where, length in zip(index, increment_grid.shape, strict=True):
        with np.errstate(invalid="ignore"):
            inside &= (where >= 0) & (where <= length - 1)
    known = np.isfinite(increment).all(axis=0)
    touched = [np.where(inside, each, 0.0) for each in index]
    # a point beside a hole has corners that are not measured
    inside &= map_coordinates((~known).astype(np.float32), touched, order=1, mode="nearest") < 1e-6
    points = [each[inside] for each in touched]
    field: Interpolation
    misfit = total.misfit
    if not inside.any():
        nothing = np.full(total.displacement.shape, np.nan)
        return Total(nothing, nothing.copy(), misfit)
    if element is None:
        field = Spline(increment)
    else:
        field = mesh = Mesh(increment, element / increment_grid.spacing)
        misfit = max(misfit, mesh.misfit)
    displacement = np.full(total.displacement.shape, np.nan)
    displacement[:, inside] = total.displacement[:, inside] + field.at(points[0], points[1])
    variance = np.full(total.variance.shape, np.nan)
    own = noise_gain * np.stack([_linear(each**2, points) for each in sigma])
    # by column and by row; 0 where neighbours are missing, as the slopes scale uncertainties only
    slopes = [np.nan_to_num(np.gradient(each.astype(float), increment_grid.spacing))[::-1] for each in increment]
    gradient = np.array([[_linear(by, points) for by in each] for each in slopes])
    along_x, along_y = 1 + gradient[0], gradient[1]
    (x_x, x_y), (y_x, y_y) = (along_x[0], gradient[0, 1]), (along_y[0], 1 + gradient[1, 1])
    before = total.variance[:, inside]
    variance[0, inside] = x_x**2 * before[0] + x_y**2 * before[1] + own[0]
    variance[1, inside] = y_x**2 * before[0] + y_y**2 * before[1] + own[1]
    return Total(displacement, variance, misfit)


@lru_cache(maxsize=16)
def interpolation_noise(spacing: float, element: float | None, window: int | None, method: str) -> float:
    """Return the variance between the points of a field over that of a point, the mean over all places.

    Parameters
    ----------
    spacing
        Distance of the points [px].
    element
        Side of the finite elements [px]; None for the spline.
    window, method
        Of the measurement, as in `measure_displacement`; a window of None stands for independent errors of the points.
    """
    size = 10.0 if element is None else element / spacing
    points = np.arange(int(np.ceil(5 * size)) + 1)
    places = 2 * size + (np.arange(32) + 0.5) / 32 * (1 if element is None else size)
    if element is None:
        weights = _basis_spline(places, len(points)) @ spline_filter1d(np.eye(len(points)), order=3, axis=0)
    else:
        nodes = np.arange(6.0) * size
        hats = np.maximum(0, 1 - np.abs(points[:, None] - nodes) / size)
        weights = np.maximum(0, 1 - np.abs(places[:, None] - nodes) / size) @ np.linalg.pinv(hats)
    lags = np.abs(np.subtract.outer(points, points))
    if window is None:
        correlation = (lags == 0).astype(float)
    else:
        along = error_correlation(window, method, round(points[-1] * spacing))[0]
        correlation = along[np.rint(lags * spacing).astype(np.intp)]
    return float(np.mean(np.einsum("pi,ij,pj->p", weights, correlation, weights))) ** 2


def _basis_spline(places: np.ndarray, length: int) -> np.ndarray:
    """Return the cubic B-splines of `length` points at places between them, shape (place, point)."""
    t = np.abs(places[:, None] - np.arange(length))
    inner, outer = 2 / 3 - t**2 + t**3 / 2, np.maximum(0, 2 - t) ** 3 / 6
    return np.where(t < 1, inner, outer)


def _linear(values: np.ndarray, points: list[np.ndarray]) -> np.ndarray:
    """Interpolate linearly at indices (row, column)."""
    return np.asarray(map_coordinates(values.astype(float), points, order=1, mode="nearest"))


@check_arguments(
    CorrelationError,
    increments=several(dataset("displacement_x", "displacement_y", "sigma_x", "sigma_y")),
    element=number(),
)
def accumulate(increments: Sequence[xr.Dataset], *, method: str = "spline", element: float = 20.0) -> xr.Dataset:
    """Compose increments of a displacement in the initial configuration.

    Parameters
    ----------
    increments
        From `measure_displacement`, each from one image to the next: the reference of each is the deformed image of
        the one before. Points need not be the same from increment to increment. Their attributes ``window_px`` and
        ``method`` give the correlation of the errors of neighbouring points; without them errors are independent.
    method
        ``spline``: interpolating cubic spline of each increment; exact at every measured point. ``mesh``: bilinear
        finite elements fitted to each increment by least squares (Avril et al. 2008); averages the independent noise of
        the points and underestimates curvature: with the second derivative c [1/px] the error of an element of the
        side h is up to c h^2/8 - c h^2/12.
    element
        Side of the elements [px].

    Returns
    -------
    Dataset
        ``displacement_x`` (to the right), ``displacement_y`` (down), ``sigma_x``, ``sigma_y`` [px], float32, and
        ``valid``, bool, at the points of the first increment; NaN where a point was lost. The attribute ``misfit_px``
        is the largest root mean square distance of a mesh from its points, noise included.

    Raises
    ------
    CorrelationError
        There is no increment, the method is unknown, the element has no size, or points are not equidistant.

    References
    ----------
    S. Avril, P. Feissel, F. Pierron, P. Villon (2008), European Journal of Computational Mechanics 17, 857-868.

    Examples
    --------
    >>> import numpy as np
    >>> def stretch(k):  # by 1 % of the present length
    ...     column = np.arange(0.0, 200, 4)
    ...     d_x = np.tile(0.01 * column, (50, 1))
    ...     fields = {"displacement_x": d_x, "displacement_y": 0 * d_x, "sigma_x": 0 * d_x + 0.01, "sigma_y": 0 * d_x}
    ...     dimensions = ("row", "column")
    ...     coordinates = {"row": np.arange(0.0, 200, 4), "column": column}
    ...     return xr.Dataset({name: (dimensions, values) for name, values in fields.items()}, coordinates)
    >>> total = accumulate([stretch(k) for k in range(3)])
    >>> round(float(total.displacement_x.sel(row=0, column=100)), 6)  # 1.01^3 - 1
    3.0301
    """
    if method not in ("spline", "mesh"):
        raise CorrelationError(f"method = {method!r} is unknown: it must be 'spline' or 'mesh'")
    if method == "mesh" and not element > 0:
        raise CorrelationError(f"element = {element}: the side of the elements has to be above 0 px")
    if not increments:
        raise CorrelationError("there is no increment to accumulate")
    grid = PixelGrid.of(increments[0])
    still = np.zeros((2, *grid.shape))
    total = Total(still, still.copy())
    size = element if method == "mesh" else None
    for increment in increments:
        here = PixelGrid.of(increment)
        window = increment.attrs.get("window_px")
        gain = interpolation_noise(here.spacing, size, window, str(increment.attrs.get("method", "dense")))
        d_x, d_y, sigma_x, sigma_y = (np.asarray(increment[name]) for name in _NAMES)
        total = compose(
            total,
            grid,
            np.stack([d_x, d_y]),
            np.stack([sigma_x, sigma_y]),
            here,
            element=size,
            noise_gain=gain,
        )
    sigma = np.sqrt(total.variance)
    attributes = {"method": method, "increments": len(increments)}
    attributes |= {name: increments[0].attrs[name] for name in ("window_px",) if name in increments[0].attrs}
    if method == "mesh":
        attributes |= {"element_px": element, "misfit_px": total.misfit}
    words = (
        "in-plane displacement x (right)",
        "in-plane displacement y (down)",
        "of displacement_x",
        "of displacement_y",
    )
    arrays = (*total.displacement.astype(np.float32), *sigma.astype(np.float32))
    fields = {
        name: (("row", "column"), values, {"units": "px", "long_name": text if "dis" in name else f"sigma {text}"})
        for name, values, text in zip(_NAMES, arrays, words, strict=True)
    }
    fields["valid"] = (("row", "column"), np.isfinite(arrays[0]) & np.isfinite(arrays[1]), {"long_name": "measured"})
    return xr.Dataset(fields, {name: increments[0][name] for name in ("row", "column")}, attributes)
