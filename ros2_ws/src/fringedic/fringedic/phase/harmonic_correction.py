"""Estimates the error that a harmonic of a nonlinear response causes, from the phase map itself, and corrects it.

With q shifts the harmonic m = q - 1, of amplitude rho over that of the fringes, looks like fringes that run backwards:
the measured complex amplitude is ``B exp(i phi) (1 + rho exp(-i q phi))``. A response without memory shifts no harmonic
against the fringes, so that rho is real, and it is the same at all pixels. The phase errs by
``e(phi) = -atan2(rho sin(q phi), 1 + rho cos(q phi))``. Harmonic q + 1 is weaker and changes rho only, to first order.

The surface does not follow sin(q phi). Second differences across the fringes remove its height and slope; noise and the
second differences of e remain, and rho is fitted to them. The phase in e comes from the two neighbours along the
fringes, whose noise is independent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.patterns.pattern import Orientation

# test_harmonic_correction.py fixes these limits
_SAMPLES = 5000  # so many pixels leave 0.00003 of a noise of 0.002 fringe
_FEWEST = 500  # pixels
# Eighths of a period of the error between the differences, at least so many px; an error of a period of one of these
# steps has none over that step, and small parts of a period have little.
_STEPS = (1, 2, 3, 5)
_SHARED = 6  # neighbouring differences 1, -2, 1 have noise in common: as much information as a sixth of them at least
_OUTLIER = 6.0  # a step of the surface exceeds the median difference so many times
_ROUNDS = 8  # of Newton's method; rho = 0.3 takes five, a small one two
_CHANGE = 1e-5  # the rounds end when rho changes by less
_NODES = 4097  # of the inverse of the error: linear interpolation errs by less than 1e-6 rad
_LARGEST_SIGMA = 0.003  # of rho, 0.0003 fringe; an error that is less well known is not stated,
_LARGEST_PART = 0.05  # unless it is known to this part of itself


@dataclass(frozen=True)
class HarmonicError:
    """Error of the phase by the harmonic q - 1 of the response.

    Attributes
    ----------
    shifts
        q.
    ratio
        rho; NaN where it cannot be determined.
    """

    shifts: int
    ratio: float

    @property
    def rms(self) -> float:
        """Root mean square of the error [fringe]."""
        ratio = min(abs(self.ratio), 1.0) if math.isfinite(self.ratio) else math.nan
        # of sum(rho^n / n sin(n q phi))
        return math.sqrt(sum((ratio**n / n) ** 2 for n in range(1, 9)) / 2) / (2 * np.pi)

    def at(self, phase: np.ndarray) -> np.ndarray:
        """Return the error at a true phase [rad]."""
        turns = self.shifts * phase
        return np.asarray(-np.arctan2(self.ratio * np.sin(turns), 1 + self.ratio * np.cos(turns)))

    def growth(self, phase: np.ndarray) -> np.ndarray:
        """Return the derivative of the measured phase by the true one, at a true phase [rad].

        The noise of a corrected phase is that of the measured one divided by it.
        """
        cosine = np.cos(self.shifts * phase)
        part = self.ratio * (cosine + self.ratio) / (1 + 2 * self.ratio * cosine + self.ratio**2)
        return np.asarray(1 - self.shifts * part)

    def slope(self, phase: np.ndarray) -> np.ndarray:
        """Return the derivative of the error by rho at a true phase [rad]."""
        turns = self.shifts * phase
        return np.asarray(-np.sin(turns) / (1 + 2 * self.ratio * np.cos(turns) + self.ratio**2))

    def correct(self, phase: np.ndarray) -> np.ndarray:
        """Return a measured phase [rad], any shape, without the error; unchanged where rho is 0 or NaN."""
        if not self.ratio or math.isnan(self.ratio):
            return phase
        # the error has q periods per turn and is zero at their ends
        true = np.linspace(-np.pi, np.pi, _NODES) / self.shifts
        period = 2 * np.pi / self.shifts
        start = period * np.round(phase.astype(float) / period)
        return np.asarray(start + np.interp(phase - start, true + self.at(true), true), phase.dtype)


def fit_harmonic_error(phase: xr.DataArray, shifts: int, orientation: Orientation) -> HarmonicError:
    """Estimate the error of a phase map by the harmonic q - 1 of the response.

    Parameters
    ----------
    phase
        Phase [rad], wrapped or absolute, over (row, column); NaN where not measured.
    shifts
        q of its pitch.
    orientation
        Direction of the fringes.

    Returns
    -------
    HarmonicError
        Its ratio is NaN where too little is measured, where the error cannot be distinguished from the surface, or
        where it is so large that the phase does not grow everywhere.

    Examples
    --------
    >>> truth = np.tile(np.linspace(0, 400, 700), (60, 1))
    >>> measured = truth + HarmonicError(4, 0.02).at(truth)
    >>> fit = fit_harmonic_error(xr.DataArray(measured, dims=("row", "column")), 4, Orientation.VERTICAL)
    >>> round(fit.ratio, 4), round(fit.rms, 5), bool(abs(fit.correct(measured) - truth).max() < 1e-4)
    (0.02, 0.00225, True)
    """
    lines = phase.values if orientation == Orientation.VERTICAL else phase.values.T
    inner = np.arange(1, len(lines) - 1)[:: max(1, round(lines.size / _SAMPLES))]
    if not inner.size or lines.shape[1] < 2:
        return HarmonicError(shifts, math.nan)
    middle = lines[inner].astype(float)
    growth = np.abs(_wrap(np.diff(middle, axis=1)))
    growth = growth[np.isfinite(growth)]
    period = 2 * np.pi / max(shifts * float(np.median(growth)), 1e-3) if growth.size else 1.0
    steps = [round(step * max(period / 8, 1.0)) for step in _STEPS]
    if lines.shape[1] <= 2 * steps[-1]:
        return HarmonicError(shifts, math.nan)
    beside = middle + 0.5 * (_wrap(lines[inner - 1] - middle) + _wrap(lines[inner + 1] - middle))
    seen = _wrap(_differences(middle, steps))
    known = np.isfinite(seen) & np.isfinite(_differences(beside, steps))
    if known.sum() < _FEWEST * len(steps):
        return HarmonicError(shifts, math.nan)
    known &= np.abs(seen) <= _OUTLIER * np.median(np.abs(seen[known]))
    seen = seen[known]
    error = HarmonicError(shifts, 0.0)
    for _ in range(_ROUNDS):
        true = error.correct(beside)
        slope = _differences(error.slope(true), steps)[known]
        rest = seen - _differences(error.at(true), steps)[known]
        information = max(float(slope @ slope), 1e-12)
        change = float(slope @ rest) / information
        error = HarmonicError(shifts, error.ratio + change)
        if abs(error.ratio) * (shifts - 1) >= 1:
            return HarmonicError(shifts, math.nan)
        if abs(change) < _CHANGE:
            break
    sigma = math.sqrt(_SHARED * float(np.mean(rest**2)) / information)
    return error if sigma < max(_LARGEST_SIGMA, _LARGEST_PART * abs(error.ratio)) else HarmonicError(shifts, math.nan)


def _differences(lines: np.ndarray, steps: list[int]) -> np.ndarray:
    """Return the second differences along the lines over all steps, one after the other, shape (line, difference)."""
    parts = [lines[:, 2 * step :] - 2 * lines[:, step:-step] + lines[:, : -2 * step] for step in steps]
    return np.concatenate(parts, axis=1)


def _wrap(angle: np.ndarray) -> np.ndarray:
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))
