"""Whether the exposures begin before the projector has changed: every frame then shows some of the pattern before.

With the share f of the pattern before, frame k of a pitch is ``(1 - f) P(a_k) + f P(a_k - d)``, d being the step of the
shifts: a wave again, whose complex amplitude is that of P times ``c = 1 - f + f exp(-i d)``. No frame of a pitch tells
that by itself but the first: before it the projector showed the last pattern of another pitch, whose wave is known from
its own frames in the same way. f is where the first frames fit best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from fringedic.errors import WrongPatternError
from fringedic.phase.sample import Sample, fit_wave

_PIXELS = 1000  # are enough for one number, which takes many trials
_FEWEST = 4  # frames of a pitch: the wave is that of all but the first
_ALIKE = 0.25  # by which the shares of two pitches may differ, over the share
_EXPLAINED = 0.6  # part of the first frames' misfit
_BENT = 0.12  # part of it that the harmonics of a bent response seem to explain: 0.06 at gamma 2.2
_ALONE = 0.1  # least share that a single pitch is believed
_WHOLE = 0.95  # from here on the frames are simply one late


def check_change(sample: Sample, largest_error: float, numbers: Sequence[int]) -> None:
    """Raise when frames were exposed while the projector still changed to their patterns.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    largest_error
        Error of the phase [fringe] that is allowed; a share f makes one of up to f over the number of shifts.
    numbers
        Number of each frame of the stack within its step, for the words.

    Raises
    ------
    WrongPatternError
        ``index`` is the number of the first frame that tells.
    """
    layout = sample.layout
    groups = [
        group
        for group in range(1, len(layout.counts))
        if min(layout.counts[group - 1], layout.counts[group]) >= _FEWEST
    ]
    pixels = sample.levels.shape[1]
    some = np.arange(pixels) % max(1, pixels // _PIXELS) == 0
    found = [_share(sample.only(some), group) for group in groups]
    if not found:
        return
    shares, explained = np.array(found).T
    share = float(np.median(shares))
    least = max(largest_error * layout.periods[-1][0].shifts, _ALONE if len(found) == 1 else 0.0)
    # with a delay that varies the shares differ, but a flicker or a motion would not be explained by them
    credible = np.ptp(shares) < _ALIKE * share or explained.min() > _EXPLAINED
    if least < share < _WHOLE and shares.min() > 0 and credible and explained.min() > _BENT:
        raise WrongPatternError(
            f"every frame shows {share:.0%} of the pattern before: its exposure begins before the projector has "
            "changed; raise settle_ms above the projector's delay (fringedic timing measures it)",
            index=numbers[layout.slices()[groups[0]].start],
        )


def _share(sample: Sample, group: int) -> tuple[float, float]:
    """Part of the pattern before in the frames of a pitch, and how much of the first frame's misfit it explains."""
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
    """Mean and complex amplitude of all frames but the first, and the step of the shifts."""
    fit = fit_wave(levels[1:], angles[1:])
    return fit[0], fit[1] - 1j * fit[2], float(angles[1] - angles[0])


def _level(wave: np.ndarray, step: float, share: float, angle: float) -> np.ndarray:
    """What the pattern of an angle adds to the mean, when this share of the one before was seen in each frame."""
    alone = wave / (1 - share + share * np.exp(-1j * step))
    return np.asarray(np.real(alone * np.exp(1j * angle)))
