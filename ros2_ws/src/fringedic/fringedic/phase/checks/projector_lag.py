"""Checks whether exposures begin before the projector has changed: every frame then shows part of the pattern before.

With the share f of the pattern before, frame k of a pitch is ``(1 - f) P(a_k) + f P(a_k - d)``, d being the step of the
shifts. This is a sinusoid, too: its complex amplitude is that of P times ``c = 1 - f + f exp(-i d)``. Only the first
frame of a pitch reveals f: before it the projector showed the last pattern of another pitch, whose sinusoid is known
from its own frames in the same way. The estimate is the f with which the first frames fit best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from fringedic.errors import ErrorCode, StepError
from fringedic.phase.checks.sampling import Sample, fit_wave

# the tests in test_projector_lag.py fix these limits
_PIXELS = 1000  # enough for one number, which takes many trials
_FEWEST_FRAMES = 4  # of a pitch: the sinusoid is fitted to all but the first
_LARGEST_DIFFERENCE = 0.25  # between the shares of two pitches, relative to the share
_EXPLAINED = 0.6  # part of the first frames' misfit
_HARMONICS = 0.12  # part of the misfit that harmonics of the response may explain: 0.06 at gamma 2.2
_ONE_PITCH = 0.1  # smallest share that is accepted from a single pitch
_WHOLE_FRAME = 0.95  # from this share on the frames are one frame late, which check_patterns reports


def check_projector_lag(sample: Sample, largest_error: float, numbers: Sequence[int]) -> None:
    """Raise `StepError` when frames were exposed while the projector still changed to their patterns.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    largest_error
        Error of the phase [fringe] that is allowed; a share f causes up to f over the number of shifts.
    numbers
        Number of each frame of the stack within its step.

    Raises
    ------
    StepError
        With the code WRONG_PATTERN; ``index`` is the number of the first frame of the second pitch.
    """
    layout = sample.layout
    groups = [
        group
        for group in range(1, len(layout.counts))
        if min(layout.counts[group - 1], layout.counts[group]) >= _FEWEST_FRAMES
    ]
    pixels = sample.levels.shape[1]
    some = np.arange(pixels) % max(1, pixels // _PIXELS) == 0
    found = [_share(sample.select(some), group) for group in groups]
    if not found:
        return
    shares, explained = np.array(found).T
    share = float(np.median(shares))
    smallest = max(largest_error * layout.periods[-1][0].shifts, _ONE_PITCH if len(found) == 1 else 0.0)
    # a varying delay gives different shares that still explain the misfit; flicker or motion would not
    credible = np.ptp(shares) < _LARGEST_DIFFERENCE * share or explained.min() > _EXPLAINED
    if smallest < share < _WHOLE_FRAME and shares.min() > 0 and credible and explained.min() > _HARMONICS:
        raise StepError(
            f"every frame shows {share:.0%} of the pattern before: its exposure begins before the projector has "
            "changed; raise settle_ms above the projector's delay (fringedic timing measures it)",
            index=numbers[layout.slices()[groups[0]].start],
            code=ErrorCode.WRONG_PATTERN,
        )


def _share(sample: Sample, group: int) -> tuple[float, float]:
    """Return the share of the pattern before in the frames of a pitch, and the part of the misfit that it explains."""
    before, now = (sample.groups()[each] for each in (group - 1, group))
    angles_before, angles = sample.angles[group - 1], sample.angles[group]
    mean_before, wave_before, step_before = _wave(before, angles_before)
    mean, wave, step = _wave(now, angles)

    def misfit(share: float) -> float:
        last = mean_before + _level(wave_before, step_before, share, float(angles_before[-1]))
        first = mean + _level(wave, step, share, float(angles[0]))
        return float(np.mean((now[0] - (1 - share) * first - share * last) ** 2))

    trials = np.linspace(-0.1, 1.0, 23)
    best = float(trials[int(np.argmin([misfit(float(trial)) for trial in trials]))])
    found = minimize_scalar(misfit, bounds=(best - 0.05, best + 0.05), method="bounded")
    return float(found.x), 1 - float(found.fun) / max(misfit(0.0), 1e-6)


def _wave(levels: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean and complex amplitude of all frames but the first, and the step of the shifts [rad]."""
    fit = fit_wave(levels[1:], angles[1:])
    return fit[0], fit[1] - 1j * fit[2], float(angles[1] - angles[0])


def _level(wave: np.ndarray, step: float, share: float, angle: float) -> np.ndarray:
    """Return the difference of a pattern from the mean, given the share of the pattern before in every frame."""
    alone = wave / (1 - share + share * np.exp(-1j * step))
    return np.asarray(np.real(alone * np.exp(1j * angle)))
