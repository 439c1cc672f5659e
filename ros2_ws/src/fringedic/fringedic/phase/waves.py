"""Waves that a bent response of projector and camera puts on the phase, told apart from noise and surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.errors import InvalidSequenceError
from fringedic.phase.steps import demodulate

WAVE_SHIFTS = 24  # of the series: it holds every series of 3, 4, 6, 8 and 12, and harmonics below 23 do not bend it
_BINS = 48  # of the phase
_FEWEST = 20  # pixels in each of them


@dataclass(frozen=True)
class PhaseWaves:
    """Error of the phase over one fringe.

    Attributes
    ----------
    phase
        Phase in the middle of each class [rad].
    error
        Mean error of a phase from few shifts there [fringe], by the number of shifts.
    """

    phase: np.ndarray
    error: dict[int, np.ndarray]

    def rms(self, shifts: int) -> float:
        """Root mean square of the waves with so many shifts [fringe]."""
        return float(np.sqrt(np.mean(self.error[shifts] ** 2)))


def phase_waves(
    frames: np.ndarray, shifts: Sequence[int] = (3, 4, 6, 8), *, saturation: float | None = None
) -> PhaseWaves:
    """Measure the waves that few shifts would put on the phase of any surface, from a series of many shifts.

    Every (N/q)-th frame of N is a series of q shifts. Its phase minus that of all N, averaged over the pixels of one
    and the same phase, is the wave: noise averages out, and the surface is the same for both. Harmonic m of the
    response bends the phase of q shifts when m + 1 or m - 1 is a multiple of q, so N = 24 sees those below 23.

    Parameters
    ----------
    frames
        Grey levels of one pitch, shape (N, row, column), frame k - 1 taken at the shift 2 pi k / N.
    shifts
        Numbers of shifts to look at; each has to divide N.
    saturation
        See `absolute_phase`.

    Raises
    ------
    InvalidSequenceError
        N is not a multiple of every number of shifts, or the fringes in view do not cover all phases.
    """
    count = len(frames)
    if any(count % each or each < 3 for each in shifts):
        raise InvalidSequenceError(f"{count} frames are not whole multiples of {list(shifts)} shifts")
    reference = demodulate(frames, count, saturation=saturation)
    known = reference.valid.values
    phase = reference.phase.values[known].astype(float)
    classes = np.floor((phase / (2 * np.pi) + 0.5) * _BINS).astype(int) % _BINS
    pixels = np.bincount(classes, minlength=_BINS)
    if pixels.min() < _FEWEST:
        raise InvalidSequenceError(
            f"only {int(known.sum())} pixels of the image show fringes, or less than a whole fringe is in view: light "
            "more of a bright surface"
        )
    error = {}
    for number in shifts:
        part = demodulate(frames[count // number - 1 :: count // number], number, noise=0.0, saturation=saturation)
        turns = (part.phase.values[known] - phase) / (2 * np.pi)
        turns -= np.round(turns)
        error[number] = np.bincount(classes, np.nan_to_num(turns), _BINS) / pixels
    return PhaseWaves((np.arange(_BINS) + 0.5) / _BINS * 2 * np.pi - np.pi, error)
