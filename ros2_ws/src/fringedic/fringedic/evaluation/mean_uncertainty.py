"""Standard uncertainty of the mean of a map over a region, from the correlation of neighbouring errors.

The errors of displacements are correlated over the window of the displacement, those of strains over the virtual strain
gauge: a strain is the slope of a plane through the displacements of its window. For points i, j of the region with the
standard deviations s and the correlation rho, the mean of n points has the variance

    sum over i, j of s_i s_j rho(i - j) / n^2

The weights of a slope add up to 0, so that a mean strain depends on the displacements near the edge of the region only
and is more certain than a mean of independent gauges.

References
----------
Satterthwaite, F. E. (1946). An approximate distribution of estimates of variance components. Biometrics Bulletin 2,
110-114, doi 10.2307/3002019.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import fft
from scipy.ndimage import correlate1d
from scipy.stats import chi2

from fringedic.correlation.transfer import error_correlation
from fringedic.datasets.attributes import parameters_of, recorded_calibration
from fringedic.evaluation.correlated import correlated_points
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.rig.uncertainty import position_errors
from fringedic.surface.calibration_uncertainty import calibration_covariance
from fringedic.surface.noise_correlation import displacement_gains
from fringedic.surface.planes import spacing_of

FALSE_ALARMS = 1e-3  # share of uniform maps whose noise is taken for a deviation
_CELLS = 4  # of points along the window of the displacement, in which its errors hardly differ
_ROWS, _COLUMNS = 0, 1
_SLOPES = {  # axes of the slopes that a strain consists of
    **dict.fromkeys(("e_11", "e_xx"), (_COLUMNS,)),
    **dict.fromkeys(("e_22", "e_yy"), (_ROWS,)),
    **dict.fromkeys(("e_12", "e_xy"), (_COLUMNS, _ROWS)),
}
_IN_PLANE = ("displacement_x", "displacement_y")
_OF_THE_RIG = ("u", "v", "w")
_PLACES = ("z", "w", "displacement_x", "displacement_y")
_FEW = 400  # points from which the effect of the calibration, which is smooth, is averaged


@dataclass(frozen=True)
class ErrorCorrelation:
    """How the errors of the points of a map are correlated.

    Attributes
    ----------
    window, method
        Of the displacement, as of `measure_displacement`; the window in px.
    spacing
        Distance of the points (rows, columns) [px].
    half
        Half-width of the window of a strain (rows, columns) [points].
    slopes
        Axes of the slopes that a strain consists of, 0 along rows' numbers and 1 along columns' numbers; empty for a
        displacement.
    """

    window: int
    method: str
    spacing: tuple[int, int]
    half: tuple[int, int] = (0, 0)
    slopes: tuple[int, ...] = ()

    def uncertainty_of_mean(self, sigma: np.ndarray, measured: np.ndarray, known: np.ndarray) -> float:
        """Return the standard uncertainty of the mean over the measured points of a region.

        Parameters
        ----------
        sigma
            Standard deviations (row, column).
        measured, known
            Measured points of the region and of the whole map, bool (row, column): windows of strains at the edge of
            the map contain fewer points.
        """
        cells, spacing = self._cells
        weights = _sum_cells(np.where(measured, sigma, 0.0) / np.count_nonzero(measured), cells)
        if not self.slopes:
            return math.sqrt(self._variance(weights, spacing))
        half = self._half_in(cells)
        seen = (_sum_cells(known, cells) >= 0.5 * cells[0] * cells[1]) | (weights > 0)
        inverse = _invert_normal_matrices(seen, weights > 0, half)
        gains = displacement_gains(self.window, self.method, half, spacing)[::-1]  # by rows, by columns
        variances = [gains[axis] * inverse[..., 1 + axis, 1 + axis] for axis in self.slopes]
        scaled = np.divide(weights, np.sqrt(sum(variances)), out=np.zeros_like(weights), where=weights > 0)
        sums = (_sum_slopes(scaled[..., np.newaxis] * inverse[..., 1 + axis], seen, half) for axis in self.slopes)
        return math.sqrt(sum(self._variance(each, spacing) for each in sums))

    def _variance(self, weights: np.ndarray, spacing: tuple[int, int]) -> float:
        """Return the variance of a weighted sum of displacements of variance 1 at points at a distance [px]."""
        reach = 2 * self.window
        size = (
            fft.next_fast_len(weights.shape[0] + reach // spacing[0] + 1),
            fft.next_fast_len(weights.shape[1] + reach // spacing[1] + 1),
        )
        return float(np.mean(np.abs(fft.fft2(weights, size)) ** 2 * self._spectrum(size, spacing)))

    def _spectrum(self, size: tuple[int, int], spacing: tuple[int, int]) -> np.ndarray:
        """Return the power spectrum of displacements of variance 1 on a periodic grid of points at a distance [px]."""
        reach = 2 * self.window
        lags = np.pad(error_correlation(self.window, self.method, reach), (0, 1))  # 0 beyond the reach
        places = (
            np.minimum(np.abs(np.rint(np.fft.fftfreq(length, 1 / length))).astype(int) * step, reach + 1)
            for length, step in zip(size, spacing, strict=True)
        )
        return np.asarray(np.maximum(fft.fft2(lags[np.ix_(*places)]).real, 0.0))

    def degrees_of_freedom(self, sigma: np.ndarray, measured: np.ndarray) -> float:
        """Return those of the mean squared error over the measured points of a region (Satterthwaite 1946).

        The sum of the squares of n correlated normal errors scatters as that of (sum s_i^2)^2 / sum_ij (s_i s_j rho)^2
        independent ones. At the edge of a map the correlation is taken as that of whole windows.
        """
        cells, spacing = self._cells
        weights = _sum_cells(np.where(measured, np.square(sigma, dtype=float), 0.0), cells)
        half = self._half_in(cells)
        size = (
            fft.next_fast_len(weights.shape[0] + 4 * half[0] + 2 * self.window // spacing[0] + 1),
            fft.next_fast_len(weights.shape[1] + 4 * half[1] + 2 * self.window // spacing[1] + 1),
        )
        spectrum = self._spectrum(size, spacing) * self._gain(size, half)
        squares = (fft.ifft2(spectrum).real / np.mean(spectrum)) ** 2
        scatter = float(np.mean(np.abs(fft.fft2(weights, size)) ** 2 * fft.fft2(squares).real))
        return float(np.sum(weights)) ** 2 / scatter

    def _gain(self, size: tuple[int, int], half: tuple[int, int]) -> np.ndarray:
        """Return the squared transfer of the slopes of whole windows."""
        if not self.slopes:
            return np.ones(size)
        gain = np.zeros(size)
        for axis in self.slopes:
            transfer = (
                np.abs(fft.fft(np.arange(-length, length + 1.0) ** (along == axis), points)) ** 2
                for along, (length, points) in enumerate(zip(half, size, strict=True))
            )
            gain += np.outer(*transfer)
        return gain

    @property
    def _cells(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Size of cells of points (rows, columns), and their distance [px]."""
        cells = max(1, self.window // (_CELLS * self.spacing[0])), max(1, self.window // (_CELLS * self.spacing[1]))
        return cells, (cells[0] * self.spacing[0], cells[1] * self.spacing[1])

    def _half_in(self, cells: tuple[int, int]) -> tuple[int, int]:
        """Return the half-width of the window of a strain in cells."""
        return max(1, round(self.half[0] / cells[0])), max(1, round(self.half[1] / cells[1]))


def _sum_cells(values: np.ndarray, cells: tuple[int, int]) -> np.ndarray:
    """Return the sums over cells of several points; errors hardly differ within a cell."""
    rows, columns = (-(-length // each) for length, each in zip(values.shape, cells, strict=True))
    missing = [
        (0, count * each - length) for count, each, length in zip((rows, columns), cells, values.shape, strict=True)
    ]
    padded = np.pad(values.astype(float), missing)
    return np.asarray(padded.reshape(rows, cells[0], columns, cells[1]).sum(axis=(1, 3)))


def _correlate(values: np.ndarray, powers: tuple[int, int], half: tuple[int, int]) -> np.ndarray:
    """Return the sums over windows of values times powers of their distance (rows, columns) from the centre."""
    for axis, (power, length) in enumerate(zip(powers, half, strict=True)):
        values = correlate1d(values, np.arange(-length, length + 1.0) ** power, axis, mode="constant")
    return values


def _invert_normal_matrices(known: np.ndarray, wanted: np.ndarray, half: tuple[int, int]) -> np.ndarray:
    """Return the inverse normal matrices (row, column, 3, 3) of planes 1, row, column; 0 where they are not wanted."""
    powers = ((0, 0), (1, 0), (0, 1))
    matrices = np.empty((np.count_nonzero(wanted), 3, 3))
    for i, one in enumerate(powers):
        for j, other in enumerate(powers):
            matrices[:, i, j] = _correlate(known.astype(float), (one[0] + other[0], one[1] + other[1]), half)[wanted]
    inverse = np.zeros((*wanted.shape, 3, 3))
    inverse[wanted] = np.linalg.pinv(matrices, hermitian=True)
    return inverse


def _sum_slopes(planes: np.ndarray, known: np.ndarray, half: tuple[int, int]) -> np.ndarray:
    """Return the weights of displacements in a sum of slopes.

    Parameters
    ----------
    planes
        Weights 1, row and column of each slope, (row, column, 3).
    known
        Points with a displacement.
    half
        Half-width of the windows [points].
    """
    constant, by_row, by_column = np.moveaxis(planes, -1, 0)
    sums = _correlate(constant, (0, 0), half) - _correlate(by_row, (1, 0), half) - _correlate(by_column, (0, 1), half)
    return np.where(known, sums, 0.0)


def error_correlation_of(step: xr.Dataset, name: str) -> ErrorCorrelation | None:
    """Return the correlation of the errors of a map of one step; None where it is not known how it was measured."""
    parameters = parameters_of(step)
    dic = parameters.get("dic", {})
    window = step.attrs.get("displacement_window_px", dic.get("window"))
    method = str(step.attrs.get("displacement_method", dic.get("method", "dense")))
    spacing = round(abs(spacing_of(step["row"].values))), round(abs(spacing_of(step["column"].values)))
    if window is None or not all(spacing):
        return None
    if name not in _SLOPES:
        return ErrorCorrelation(int(window), method, spacing) if name in (*_IN_PLANE, *_OF_THE_RIG) else None
    over = parameters.get("strain", parameters.get("coupling", {})).get("strain_window_px")
    width = step.attrs.get("strain_window_px", over)
    if not width:
        return None
    half = tuple(max(1, round((width - 1) / 2 / each)) for each in spacing)
    return ErrorCorrelation(int(window), method, spacing, (half[0], half[1]), _SLOPES[name])


def maps_for_mean(name: str) -> tuple[str, ...]:
    """Return the maps that `uncertainty_of_mean` reads beside a map and its standard deviations."""
    return _PLACES if name in _OF_THE_RIG else ()


def uncertainty_of_mean(
    step: xr.Dataset, name: str, values: np.ndarray, sigma: np.ndarray, inside: np.ndarray
) -> float:
    """Return the standard uncertainty of the mean of a map over a region.

    Parameters
    ----------
    step
        One step of a dataset, which states how the map was measured. If it does not, the correlation is estimated from
        the map, as its deviation from a plane: the uncertainty is then rather too large.
    name
        Of the map. The errors of a calibration are common to all points: their mean is not reduced. Of u, v and w the
        dataset has to contain `maps_for_mean`; without them, or without the calibration, nothing is reduced.
    values, sigma
        Of the map, (row, column), and its standard deviations.
    inside
        Points of the region, bool (row, column).

    Returns
    -------
    float
        In the unit of the map; NaN where nothing is measured.
    """
    measured = inside & np.isfinite(values) & np.isfinite(sigma)
    if not measured.any():
        return math.nan
    known = sigma[measured].astype(float)
    correlation = error_correlation_of(step, name)
    everywhere = np.isfinite(values)
    is_unknown = name in _OF_THE_RIG and not step.attrs.get("calibration")
    if name == "shape_z" or is_unknown:  # an unknown part of its uncertainty is that of the calibration
        return float(known.mean())
    if name in _OF_THE_RIG and (calibration := _calibration_of(step)) is not None:
        if correlation is None or not all(each in step for each in _PLACES):
            return float(known.mean())
        variance, common = _calibration_part(step, calibration, _OF_THE_RIG.index(name), measured)
        noise = np.sqrt(np.maximum(np.square(sigma.astype(float)) - variance, 0.0))
        return math.hypot(correlation.uncertainty_of_mean(noise, measured, everywhere), common)
    if correlation is not None:
        return correlation.uncertainty_of_mean(sigma, measured, everywhere)
    return float(np.sqrt(np.mean(known**2) * _estimate_correlated(values, measured) / known.size))


def spread_beyond_noise(
    step: xr.Dataset, name: str, values: np.ndarray, sigma: np.ndarray, inside: np.ndarray, uncertainty: float
) -> float:
    """Return the standard deviation of a map over a region that its noise does not explain.

    The squared deviations from the mean over their expectation by noise have the distribution of chi-squared, with the
    degrees of freedom of the correlated noise. Noise alone exceeds the limit in about `FALSE_ALARMS` of all regions.

    Parameters
    ----------
    step, name, values, sigma, inside
        As of `uncertainty_of_mean`.
    uncertainty
        Of the mean, by `uncertainty_of_mean`.

    Returns
    -------
    float
        In the unit of the map; 0 where noise explains the deviations, NaN where nothing is measured.
    """
    measured = inside & np.isfinite(values) & np.isfinite(sigma)
    if not measured.any():
        return math.nan
    noise = float(np.mean(np.square(sigma[measured], dtype=float)))
    expected = max(noise - uncertainty**2, 0.0)
    correlation = error_correlation_of(step, name)
    if correlation is not None:
        freedom = correlation.degrees_of_freedom(sigma, measured)
    else:
        freedom = noise / uncertainty**2 if uncertainty else 1.0
    freedom = max(1.0, freedom - 1.0)
    found = float(np.var(values[measured].astype(float)))
    if found <= expected * chi2.isf(FALSE_ALARMS, freedom) / freedom:
        return 0.0
    return math.sqrt(found - expected)


def _calibration_of(step: xr.Dataset) -> RigModel | None:
    """Return the rig's model with its covariance; None if there is none, or if it is not uncertain."""
    model = recorded_calibration(step)
    return model if model is not None and model.parameter_names else None


def _calibration_part(
    step: xr.Dataset, calibration: RigModel, component: int, measured: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the variance of u, v or w by the calibration at each point, and the uncertainty of the mean by it."""
    z, w, moved_x, moved_y = (step[name].transpose("row", "column").values.astype(float) for name in _PLACES)
    column, row = np.meshgrid(step["column"].values.astype(float), step["row"].values.astype(float))
    before, after = (column, row, z), (column + moved_x, row + moved_y, z + w)
    across, along, _ = calibration.projector_position
    orientation = Orientation.VERTICAL if abs(across) >= abs(along) else Orientation.HORIZONTAL
    variance = calibration_covariance(calibration, before, after, orientation)[component]
    some = np.flatnonzero(measured & np.isfinite(after).all(axis=0))
    some = some[:: max(1, some.size // _FEW)]
    errors = (
        position_errors(calibration, x.ravel()[some], y.ravel()[some], height.ravel()[some], orientation)[:, component]
        for x, y, height in (before, after)
    )
    first, last = errors
    return variance, float(np.linalg.norm((last - first).mean(axis=-1)))


def _estimate_correlated(values: np.ndarray, measured: np.ndarray) -> float:
    """Return how many measured points share one independent error, from their deviation from a plane."""
    row, column = np.nonzero(measured)
    design = np.column_stack([np.ones(row.size), row, column]).astype(float)
    known = values[measured].astype(float)
    rest = np.full(values.shape, np.nan)
    rest[measured] = known - design @ np.linalg.lstsq(design, known, rcond=None)[0]
    return min(correlated_points(rest), float(row.size))
