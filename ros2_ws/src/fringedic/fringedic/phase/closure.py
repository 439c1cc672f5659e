"""Closure between pitches: the phase at the finest pitch beside the frames of the next coarser one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.layout import layout_of, shift_angles


def phase_closure(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    phase: np.ndarray,
    sigma: np.ndarray,
    modulation: np.ndarray,
) -> np.ndarray | None:
    """Return the phase of the next coarser pitch minus what the finest one predicts, in standard deviations.

    The frames of the coarser pitch give the order of the finest fringes and nothing else of the phase, so that the
    noise of both is independent. Here their phase is the argument of one complex sum over the frames, and the noise of
    a grey level is that from which `sigma` was computed.

    Parameters
    ----------
    frames, patterns
        Grey levels (frame, row, column) and pattern of each frame, as of `absolute_phase`.
    phase, sigma
        Absolute phase at the finest pitch and its standard deviation [rad], (row, column).
    modulation
        At the finest pitch [grey level].

    Returns
    -------
    ndarray or None
        float32 (row, column) [standard deviations], NaN where the phase is not measured; None of a single pitch.

    Raises
    ------
    PhaseError
        No phase can be measured from such a sequence.

    Examples
    --------
    >>> from fringedic.patterns import fringe_sequence
    >>> patterns = fringe_sequence(100, 1, [100, 10], shifts=4).patterns
    >>> truth = np.linspace(-20, 20, 100).reshape(1, 100)
    >>> frames = [100 + 50 * np.cos(truth * 10 / p.pitch - np.pi / 2 * p.shift) for p in patterns]
    >>> maps = np.full((1, 100), 0.02), np.full((1, 100), 50.0)
    >>> closure = phase_closure(np.array(frames), patterns, truth, *maps)
    >>> wrong = phase_closure(np.array(frames), patterns, truth + 2 * np.pi, *maps)
    >>> bool(abs(closure).max() < 0.01), bool(abs(wrong).min() > 20)
    (True, True)
    """
    layout = layout_of(patterns)
    if len(layout.periods) < 2:
        return None
    coarse, number = layout.periods[-2], layout.counts[-1]
    ratio = layout.pitches[-1] / layout.pitches[-2]
    # sum of (A + B cos(phi - a)) exp(i a) over whole cycles = N / 2 B exp(i phi)
    turns = np.exp(1j * shift_angles(coarse)).astype(np.complex64)
    total = np.tensordot(turns, frames[layout.slices()[-2]].astype(np.float32), axes=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.angle(total * np.exp(-1j * ratio * phase))
        noise = sigma * modulation * np.sqrt(number / 2)  # of a grey level
        coarse_sigma = noise * np.sqrt(len(coarse) / 2) / np.abs(total)  # sqrt(2 / N) noise / B
        return np.asarray(away / np.hypot(coarse_sigma, ratio * sigma), np.float32)
