"""Noise of the camera: how a grey level scatters, given or estimated from the frames themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.phase.layout import check_frames, layout_of, shift_angles
from fringedic.sequence import Projection

ROUNDING_NOISE = 1 / math.sqrt(12)  # of a grey level; no camera is better
_SAMPLES = 15_000  # pixels that the noise is estimated from
_LEVELS = 16  # brightness classes of that estimate


@dataclass(frozen=True)
class CameraNoise:
    """Noise of one grey level: ``sigma_I^2 = read^2 + shot * level``.

    Attributes
    ----------
    read
        Standard deviation without light, rounding included [grey level].
    shot
        Growth of the variance with the level [grey level].
    """

    read: float
    shot: float = 0.0

    def variance(self, level: np.ndarray) -> np.ndarray:
        """Return the variance of grey levels, same shape [grey level^2]."""
        return self.read**2 + self.shot * level


def saturation_level(frames: np.ndarray, saturation: float | None) -> float:
    """Return the grey level from which a pixel counts as saturated: the one given, or the end of the pixels' type."""
    if saturation is not None:
        return saturation
    return float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else math.inf


def estimate_noise(
    frames: np.ndarray, projections: Sequence[Projection], *, saturation: float | None = None
) -> CameraNoise | None:
    """Estimate the noise of grey levels from what the sinusoids leave unexplained.

    The variance of the residuals is sorted by brightness; medians keep edges and moving things out, a line through
    them is the noise model. Harmonics of the projector count as noise.

    Parameters
    ----------
    frames, projections, saturation
        See `absolute_phase`; pixels that saturate are left out.

    Returns
    -------
    CameraNoise or None
        None when no pitch has more than 3 frames, or all pixels saturate.

    Raises
    ------
    InvalidSequenceError, ShapeMismatchError
        See `absolute_phase`.
    """
    layout = layout_of(projections)
    check_frames(frames, projections)
    freedom = sum(count - 3 for count in layout.counts)
    if freedom == 0:
        return None
    skip = math.ceil(math.sqrt(frames[0].size / _SAMPLES))
    sample = frames[:, ::skip, ::skip].reshape(len(frames), -1)
    sample = sample[:, sample.max(axis=0) < saturation_level(frames, saturation)].astype(float)
    if sample.shape[1] == 0:
        return None
    unexplained = np.zeros(sample.shape[1])
    for period, where in zip(layout.periods, layout.slices(), strict=True):
        levels = sample[where]
        # over whole cycles mean, cosine and sine are orthogonal: what they explain can be subtracted one by one
        unexplained += np.sum(levels**2, axis=0) - len(period) * levels.mean(axis=0) ** 2
        for wave in (np.cos, np.sin):
            weights = wave(shift_angles(period))[:, None]
            unexplained -= 2 / len(period) * np.sum(weights * levels, axis=0) ** 2
    texture = sample[layout.code :].mean(axis=0)
    classes = np.array_split(np.argsort(texture, kind="stable"), min(_LEVELS, sample.shape[1]))
    level = np.array([texture[each].mean() for each in classes])
    variance = np.array([np.median(unexplained[each]) for each in classes]) / chdtri(freedom, 0.5)
    read_variance, shot = nnls(np.stack([np.ones_like(level), level], axis=1), variance)[0]
    return CameraNoise(max(math.sqrt(read_variance), ROUNDING_NOISE), float(shot))
