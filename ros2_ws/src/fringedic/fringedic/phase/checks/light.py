"""Estimates how much brighter each frame of a stack is than its sinusoid."""

from __future__ import annotations

import numpy as np

from fringedic.phase.checks.sampling import Sample
from fringedic.phase.sinusoids import fit_wave, wave_levels

_ROUNDS = 4  # the sinusoid takes a part of the change with it, and gives it back round by round


def light_changes(sample: Sample) -> np.ndarray:
    """Return the light of each frame over its mean, shape (frame,); 1 for the frames of a Gray code.

    The model of a frame is the sinusoid of its pitch around the mean of all pitches.
    """
    gains = np.ones(len(sample.levels))
    for _ in range(_ROUNDS):
        levels = sample.levels / gains[:, None].astype(np.float32)
        mean = levels[sample.layout.code :].mean(axis=0)
        for where, angles in zip(sample.layout.slices(), sample.angles, strict=True):
            fit = fit_wave(levels[where], angles)
            model = wave_levels(np.stack([mean, fit[1], fit[2]]), angles)
            gains[where] *= np.sum(levels[where] * model, axis=1) / np.sum(model**2, axis=1)
    return gains
