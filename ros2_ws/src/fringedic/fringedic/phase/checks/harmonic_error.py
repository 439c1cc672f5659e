"""Measures the harmonic error of the phase, which a non-linear response of projector and camera causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.errors import ErrorCode, PhaseError
from fringedic.phase.demodulation import demodulate

SERIES_SHIFTS = 24  # contains every series of 3, 4, 6, 8 and 12 shifts; harmonics below 23 cause no error with it
_CLASSES = 48  # the lowest error, that of three shifts, has 16 classes of the phase per period
_FEWEST_PIXELS = 20  # with so many in a class, its mean has a fifth of the noise of a pixel


@dataclass(frozen=True)
class HarmonicError:
    """Error of the phase over one fringe.

    Attributes
    ----------
    phase
        Phase in the middle of each class [rad], shape (class,).
    error
        Number of shifts -> mean error of the phase from so many shifts [fringe], shape (class,).
    """

    phase: np.ndarray
    error: dict[int, np.ndarray]

    def rms(self, shifts: int) -> float:
        """Return the root mean square of the error with so many shifts [fringe]."""
        return float(np.sqrt(np.mean(self.error[shifts] ** 2)))


def measure_harmonic_error(
    frames: np.ndarray, shifts: Sequence[int] = (3, 4, 6, 8), *, saturation: float | None = None
) -> HarmonicError:
    """Measure the harmonic error that few shifts would cause on any surface, from a series of many shifts.

    Every (N/q)-th frame of N is a series of q shifts. Its phase minus that of all N frames, averaged over the pixels of
    equal phase, is the error: noise averages out, and the surface is the same for both. Harmonic m of the response
    changes the phase of q shifts when m + 1 or m - 1 is a multiple of q, so that N = 24 is free of harmonics below 23.

    Parameters
    ----------
    frames
        Grey levels of one pitch, shape (N, row, column), frame k - 1 taken at the shift 2 pi k / N.
    shifts
        Numbers of shifts to evaluate; each has to divide N.
    saturation
        See `absolute_phase`.

    Raises
    ------
    PhaseError
        N is not a multiple of every number of shifts, or the fringes in view do not cover all phases.

    References
    ----------
    Y. Surrel, "Design of algorithms for phase measurements by the use of phase stepping", Applied Optics 35 (1996)
    51-60: harmonics to which a number of shifts is sensitive.

    Examples
    --------
    >>> phase = np.linspace(0, 60, 4000).reshape(50, 80)
    >>> light = np.array([0.5 + 0.45 * np.cos(phase - 2 * np.pi * k / 24) for k in range(1, 25)])
    >>> error = measure_harmonic_error((200 * light**2.2).astype(np.float32))  # gamma 2.2
    >>> [round(error.rms(shifts), 4) for shifts in (3, 4)]
    [0.0294, 0.0009]
    """
    count = len(frames)
    if any(count % each or each < 3 for each in shifts):
        raise PhaseError(
            f"{count} frames are not whole multiples of {list(shifts)} shifts", code=ErrorCode.INVALID_SEQUENCE
        )
    reference = demodulate(frames, count, saturation=saturation)
    known = reference.valid.values
    phase = reference.phase.values[known].astype(float)
    classes = np.floor((phase / (2 * np.pi) + 0.5) * _CLASSES).astype(int) % _CLASSES
    pixels = np.bincount(classes, minlength=_CLASSES)
    if pixels.min() < _FEWEST_PIXELS:
        raise PhaseError(
            f"only {int(known.sum())} pixels of the image show fringes, or less than a whole fringe is in view: light "
            "more of a bright surface",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    error = {}
    for number in shifts:
        part = demodulate(frames[count // number - 1 :: count // number], number, noise=0.0, saturation=saturation)
        turns = (part.phase.values[known] - phase) / (2 * np.pi)
        turns -= np.round(turns)
        error[number] = np.bincount(classes, np.nan_to_num(turns), _CLASSES) / pixels
    return HarmonicError((np.arange(_CLASSES) + 0.5) / _CLASSES * 2 * np.pi - np.pi, error)
