"""Checks whether exposures begin before the projector has changed: every frame then shows part of the pattern before.

With the share f of the pattern before, frame k of a pitch is ``(1 - f) P(a_k) + f P(a_k - d)``, d being the step of the
shifts. This is a sinusoid, too: its complex amplitude is that of P times ``c = 1 - f + f exp(-i d)``. Only the first
frame of a pitch reveals f: before it the projector showed the last pattern of another pitch, whose sinusoid is known
from its own frames in the same way. The estimate is the f with which the first frames fit best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from fringedic.phase.checks.sampling import Sample
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.layout import Layout
from fringedic.phase.sinusoids import fit_wave

# the tests in test_projector_lag.py fix these limits
_PIXELS = 1000  # are enough for one number, which takes many trials
_FEWEST_FRAMES = 4  # the sinusoid is fitted to all frames of a pitch but the first
_LARGEST_DIFFERENCE = 0.25  # the shares of two pitches may differ by this part of the share
_EXPLAINED = 0.6  # a share explains at least this part of the misfit of the first frames
_HARMONICS = 0.12  # harmonics of the response explain up to this part of the misfit: 0.06 at gamma 2.2
_ONE_PITCH = 0.1  # a single pitch needs at least this share to be believed
_WHOLE_FRAME = 0.95  # from this share on the frames are one frame late, which check_order reports


@dataclass(frozen=True)
class LaggingWave:
    """Sinusoid of a pattern whose frames all show a share of the pattern before.

    Attributes
    ----------
    fit
        Mean, B cos(phi) and B sin(phi) of the pattern alone [grey level], shape (3, pixel).
    seen
        The same of what the camera sees.
    """

    fit: np.ndarray
    seen: np.ndarray

    @classmethod
    def of(cls, levels: np.ndarray, angles: np.ndarray, share: float, first: int = 1) -> LaggingWave:
        """Fit the frames of a pitch, shape (frame, pixel), from `first` on: the one before shows another pitch."""
        fit = fit_wave(levels[first:], angles[first:])
        alone = (fit[1] - 1j * fit[2]) / (1 - share + share * np.exp(-1j * (angles[1] - angles[0])))
        return cls(np.stack([fit[0], alone.real, -alone.imag]), fit)

    def level(self, angles: np.ndarray) -> np.ndarray:
        """Return the grey levels of the pattern alone at these angles, shape (frame, pixel)."""
        return np.asarray(self.fit[0] + np.cos(angles)[:, None] * self.fit[1] + np.sin(angles)[:, None] * self.fit[2])


def find_lag(sample: Sample, smallest: float = 0.0) -> Finding | None:
    """Return the fault when frames were exposed while the projector still changed to their patterns.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    smallest
        Share of the pattern before from which it is a fault. A share f gives an error of the phase up to f over the
        number of shifts.

    Returns
    -------
    Finding or None
        The fault, with the position of the first frame that shows a part of another pitch or of the Gray code.
    """
    layout = sample.layout
    groups = [
        group
        for group in range(0 if layout.code else 1, len(layout.counts))
        if min(layout.counts[max(group - 1, 0)], layout.counts[group]) >= _FEWEST_FRAMES
    ]
    few = sample.thin(_PIXELS)
    found = [_share(few, group) for group in groups]
    if not found:
        return None
    shares, explained = np.array(found).T
    share = float(np.median(shares))
    smallest = max(smallest, _ONE_PITCH if len(found) == 1 else 0.0)
    # a varying delay gives different shares that still explain the misfit; flicker or motion would not
    credible = np.ptp(shares) < _LARGEST_DIFFERENCE * share or explained.min() > _EXPLAINED
    least = _EXPLAINED if len(found) == 1 else _HARMONICS
    if smallest < share < _WHOLE_FRAME and shares.min() > 0 and credible and explained.min() > least:
        return Finding(FindingKind.PARTLY_LATE, True, (first_lagging_frame(layout),), value=share)
    return None


def first_lagging_frame(layout: Layout) -> int:
    """Return the first frame that shows a part of another pitch or of the Gray code."""
    first: int = layout.slices()[0 if layout.code or len(layout.counts) == 1 else 1].start
    return first


def _share(sample: Sample, group: int) -> tuple[float, float]:
    """Return the share of the pattern before in the frames of a pitch, and the part of the misfit that it explains.

    The misfit is a quadratic form of the levels of the first frame and of both fits: their products are summed over the
    pixels once, not for every trial.
    """
    now, angles = sample.groups()[group], sample.angles[group]
    fit = fit_wave(now[1:], angles[1:])
    if group == 0:
        # A coarser bit shows how bright and dark a pixel is, which leaves the finest bit alone.
        code = sample.levels[: sample.layout.code]
        dark, bright = code.min(axis=0), code.max(axis=0)
        parts = np.concatenate(
            [now[:1], fit, np.asarray(np.where(code[-1] > 0.5 * (dark + bright), bright, dark)[None])]
        )
    else:
        before = sample.angles[group - 1]
        parts = np.concatenate([now[:1], fit, fit_wave(sample.groups()[group - 1][1:], before[1:])])
    products = np.asarray(parts, float) @ np.asarray(parts, float).T / parts.shape[1]

    def misfit(share: float) -> float:
        last = [1.0] if group == 0 else _alone(before, share, before[-1])
        weights = np.array([1.0, *(share - 1) * _alone(angles, share, angles[0]), *(-share * np.array(last))])
        return float(weights @ products @ weights)

    trials = np.linspace(-0.1, 1.0, 23)
    best = float(trials[int(np.argmin([misfit(float(trial)) for trial in trials]))])
    found = minimize_scalar(misfit, bounds=(best - 0.05, best + 0.05), method="bounded")
    return float(found.x), 1 - float(found.fun) / max(misfit(0.0), 1e-6)


def _alone(angles: np.ndarray, share: float, angle: float) -> np.ndarray:
    """Return the weights of mean, B cos(phi) and B sin(phi), as seen, in the level of the pattern alone at an angle."""
    turned = np.exp(1j * angle) / (1 - share + share * np.exp(-1j * (angles[1] - angles[0])))
    return np.array([1.0, turned.real, turned.imag])
