"""Assesses whether patterns that are pre-compensated for a response curve improve the phase."""

from __future__ import annotations

from enum import Enum

from fringedic.patterns.response import ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError

NEGLIGIBLE = 5e-4  # [fringe] RMS of three shifts; a smaller error is left uncorrected
UNEVEN = 0.02  # standard deviation of the curve over the image, of a range of 1


class Correction(Enum):
    """Effect of the correction on the phase."""

    UNNECESSARY = "unnecessary"
    HARMFUL = "harmful"
    USEFUL = "useful"


def assess_correction(before: HarmonicError, after: HarmonicError) -> Correction:
    """Compare the harmonic error of three shifts without and with the correction.

    Parameters
    ----------
    before, after
        Harmonic error of the phase of patterns without and with the correction.

    Examples
    --------
    >>> from types import SimpleNamespace as Error
    >>> assess_correction(Error(rms=lambda shifts: 0.024), Error(rms=lambda shifts: 0.0004))
    <Correction.USEFUL: 'useful'>
    """
    if before.rms(3) < NEGLIGIBLE:
        return Correction.UNNECESSARY
    return Correction.HARMFUL if after.rms(3) > before.rms(3) else Correction.USEFUL


def is_uneven(curve: ResponseCurve) -> bool:
    """Return whether the curve differs so much over the image that the light or the surface must have changed."""
    return curve.sigma > UNEVEN
