"""Certainty of the fringe orders that the phase of a coarse pitch gives to a finer one.

The error of the coarse phase times the ratio of the pitches must stay below half a fringe. It consists of noise, which
is known at each pixel, of the harmonics of a nonlinear response, which are the same function of the coarse phase at all
pixels, and of the rest. The fine phase has the same surface and hardly any error beside the multiplied one of the
coarse phase: the harmonics of the coarse pitch are fitted to the difference of both, whose whole turns do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.harmonic_correction import HarmonicError

TURN = 2 * np.pi
_SAMPLES = 3000  # pixels
_STEP = 0.3  # [rad at the finer pitch] of the error, between trials of its ratio
_LARGEST = 0.9  # of the ratio from which on the phase does not grow everywhere
# Of the agreement, 1 for perfect phases: in a view of a part of a coarse fringe, errors that differ by a turn of the
# finer pitch agree nearly as well.
_AS_GOOD = 0.05


@dataclass(frozen=True)
class OrderCertainty:
    """Errors of a coarse phase as the orders of a finer pitch see them.

    Attributes
    ----------
    error
        Harmonic error of the coarse phase.
    rest
        RMS of what neither noise nor this error explains [rad at the finer pitch]; infinite for phases that have
        nothing to do with each other.
    """

    error: HarmonicError
    rest: float

    def predict(self, coarse: np.ndarray, sigma: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the fine phase predicted by the coarse one without its harmonic error, and its deviation [rad].

        Parameters
        ----------
        coarse, sigma
            Phase of the coarse pattern and its standard deviation [rad].
        ratio
            Coarse pitch over fine pitch.
        """
        true = self.error.correct(coarse)
        return ratio * true, ratio * sigma / self.error.growth(true)

    def certain(
        self, coarse: tuple[np.ndarray, np.ndarray], fine: tuple[np.ndarray, np.ndarray], ratio: float
    ) -> np.ndarray:
        """Return where the order is certain.

        It is where the coarse phase deviates from that of the next order by 5 standard deviations more, as for
        `combine_beats`: a normal error gives a wrong order at fewer than 6e-7 of the pixels. The phases that are
        compared have the harmonic error, whose removal would make the noise uneven.

        Parameters
        ----------
        coarse
            Phase of the coarse pattern with its harmonic error, and its standard deviation [rad].
        fine
            Absolute phase of the finer pitch, and its standard deviation [rad].
        ratio
            Coarse pitch over fine pitch.
        """
        (seen, sigma), (absolute, noise) = coarse, fine
        best = absolute / ratio
        square, *others = (
            (seen - place - self.error.at(place)) ** 2 for place in (best, best + TURN / ratio, best - TURN / ratio)
        )
        variance = sigma**2 + (self.error.growth(best) / ratio) ** 2 * (noise**2 + self.rest**2)
        return np.asarray(np.minimum(*others) - square > CONFIDENCE**2 * variance)


def fit_order_certainty(
    coarse: tuple[np.ndarray, np.ndarray],
    fine: tuple[np.ndarray, np.ndarray],
    ratio: float,
    shifts: int,
    *,
    expected: float = 0.0,
) -> OrderCertainty:
    """Fit the harmonic error of a coarse phase to its difference from a finer one.

    Parameters
    ----------
    coarse
        Absolute phase of the pattern and its standard deviation by noise [rad], any shape; NaN where not measured.
    fine
        Those of the finer pitch, up to whole turns, zero where the phase of the coarse pattern is; same shape.
    ratio
        Coarse pitch over fine pitch.
    shifts
        q of the coarse pitch; 0 for a beat, whose error is no function of its phase.
    expected
        Ratio of the harmonic; chosen where the view does not determine it.

    Examples
    --------
    >>> truth = np.linspace(-3.0, 3.0, 4000)
    >>> response = HarmonicError(3, 0.25)
    >>> sigma = np.full(4000, 0.01)
    >>> found = fit_order_certainty((truth + response.at(truth), sigma), (32 * truth, sigma), 32.0, 3)
    >>> round(found.error.ratio, 3), found.rest < 0.1
    (0.25, True)
    """
    # the whole turns of the coarse phase are known, those of the fine one do not matter
    known = np.flatnonzero(np.logical_and.reduce([np.isfinite(each) for each in (*coarse, *fine)]))
    if not known.size:
        return OrderCertainty(HarmonicError(shifts, 0.0), math.inf)
    some = np.random.default_rng(0).permutation(known)[:_SAMPLES]
    phase, sigma, seen, noise = (each.ravel()[some].astype(float) for each in (*coarse, *fine))
    weight = np.exp(-0.5 * ((ratio * sigma) ** 2 + noise**2))  # the mean cosine of normal errors

    def agreement(harmonic: float) -> float:
        return float(np.average(np.cos(seen - ratio * HarmonicError(shifts, harmonic).correct(phase)), weights=weight))

    harmonic = 0.0
    if shifts:
        step = min(_STEP / ratio, 0.1)
        count = int(_LARGEST / (shifts - 1) / step)
        trials = step * np.arange(-count, count + 1)
        values = np.array([agreement(each) for each in trials])
        peaks = find_peaks(values)[0]
        good = peaks[values[peaks] > values.max() - _AS_GOOD]
        if good.size:
            near = trials[good[np.argmin(np.abs(trials[good] - expected))]]
            bounds = (near - step, near + step)
            harmonic = float(minimize_scalar(lambda each: -agreement(each), bounds=bounds, method="bounded").x)
    found = OrderCertainty(HarmonicError(shifts, harmonic), 0.0)
    predicted, spread = found.predict(phase, sigma, ratio)
    weight = np.exp(-0.5 * (spread**2 + noise**2))
    left = float(np.sum(weight * np.cos(seen - predicted)) / max(float(np.sum(weight**2)), 1e-12))
    return replace(found, rest=math.sqrt(max(-2 * math.log(left), 0.0)) if left > 0 else math.inf)
