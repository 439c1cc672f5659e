"""Response curve of a projector, measured from images of uniform greys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from fringedic.errors import ImageError, PatternError
from fringedic.frames.noise import saturation_level
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.response import FULL_SCALE, ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError
from fringedic.wording.arguments import array, check_arguments, number, of_type, optional, several

_RAMP = 18  # greys of the procedure; 255 is 17 equal steps of 15
_LEAST_CONTRAST = 5.0  # [grey level] between dark and white, some times the noise of a pixel
_LEAST_PIXELS = 100
_LARGEST_FALL = 0.02  # of the curve between two greys, of a range of 1; noise of the mean makes less than 0.001
_PARTS = 8  # of the image along each axis, in which the curves are compared

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Contrast:
    """Images in the dark and in white light, and the pixels that take part."""

    dark: Array
    white: Array
    used: NDArray[np.bool_]

    @property
    def rise(self) -> Array:
        """White minus dark of the used pixels, shape (pixel,)."""
        return np.asarray((self.white - self.dark)[self.used])

    def rise_of(self, frame: np.ndarray) -> Array:
        """Return a frame minus dark at the used pixels, shape (pixel,)."""
        return np.asarray(frame[self.used] - self.dark[self.used])


def response_patterns(number: int = _RAMP) -> tuple[ProjectedPattern, ...]:
    """Return the uniform greys of the procedure, from black to white.

    Raises
    ------
    PatternError
        Fewer than three greys are requested.

    Examples
    --------
    >>> [pattern.shift for pattern in response_patterns(4)]
    [0, 85, 170, 255]
    """
    if number < 3:
        raise PatternError(f"{number} greys: a curve needs at least 3")
    levels = np.unique(np.round(np.linspace(0, FULL_SCALE, number)).astype(int))
    return tuple(ProjectedPattern(PatternKind.GREY, shift=int(level), shifts=FULL_SCALE) for level in levels)


@check_arguments(
    PatternError,
    frames=array(3),
    patterns=several(of_type(ProjectedPattern)),
    saturation=optional(number()),
)
def measure_response(
    frames: np.ndarray, patterns: Sequence[ProjectedPattern], *, saturation: float | None = None
) -> ResponseCurve:
    """Measure the response curve from images of uniform greys on any surface at rest.

    Every pixel has the grey level ``I = a f(level) + b`` with an albedo a and ambient light b of its own. The ratio of
    sums ``f = sum(I - I_dark) / sum(I_white - I_dark)`` removes both and gives bright pixels the largest weight. The
    curve between the measured greys is a monotone cubic interpolation.

    Parameters
    ----------
    frames
        Grey levels, shape (frame, row, column).
    patterns
        The pattern of each frame: `response_patterns`, in any order, black and full white among them.
    saturation
        Grey level from which a pixel is saturated and left out; by default the largest of an integer type.

    Returns
    -------
    ResponseCurve
        Its `sigma` is the standard deviation of the curves of 8 x 8 parts of the image about the curve of the whole.

    Raises
    ------
    ImageError
        The number of frames and patterns differs.
    PatternError
        Black, white or greys in between are missing; the image is saturated or stays dark; or brighter greys do not
        make brighter images.

    References
    ----------
    Fritsch and Butland, "A method for constructing local monotone piecewise cubic interpolants" (1984).

    Examples
    --------
    A projector whose brightness is the square of the grey level, on a surface of varying albedo:

    >>> import numpy as np
    >>> patterns = response_patterns()
    >>> albedo = np.random.default_rng(1).uniform(100, 200, (20, 30))
    >>> frames = np.stack([20 + albedo * (pattern.shift / 255) ** 2 for pattern in patterns])
    >>> round(measure_response(frames, patterns).gamma, 2)
    2.0
    """
    if frames.ndim != 3 or len(frames) != len(patterns):
        raise ImageError(f"frames of shape {frames.shape} for {len(patterns)} greys")
    if any(each.kind != PatternKind.GREY for each in patterns):
        raise PatternError("the response is measured from uniform greys, but there are other patterns")
    level = np.array([FULL_SCALE * each.shift / each.shifts for each in patterns])
    if not (level == 0).any() or not (level == FULL_SCALE).any() or len(np.unique(level)) < 3:
        raise PatternError("the response needs black, full white and greys in between")
    saturation = saturation_level(frames, saturation)
    dark = frames[level == 0].mean(axis=0, dtype=float)
    white = frames[level == FULL_SCALE].mean(axis=0, dtype=float)
    unsaturated = frames.max(axis=0) < saturation
    used = unsaturated & (white - dark > _LEAST_CONTRAST)
    if used.sum() < _LEAST_PIXELS:
        why = "saturates: shorten the exposure" if not unsaturated.any() else "hardly differs between black and white"
        raise PatternError(f"response curve: the image {why}")
    contrast = _Contrast(dark, white, used)
    rise = float(np.sum(contrast.rise))
    measured = np.array([np.sum(contrast.rise_of(frame)) for frame in frames.astype(float)]) / rise
    shown, group = np.unique(level, return_inverse=True)
    mean = np.array([measured[group == each].mean() for each in range(len(shown))])
    growing = isotonic_regression(mean).x
    if np.abs(growing - mean).max() > _LARGEST_FALL:
        raise PatternError("response curve: brighter greys do not make brighter images; are frames out of order?")
    curve = PchipInterpolator(shown, growing)(np.arange(FULL_SCALE + 1))
    curve = np.maximum.accumulate(np.clip((curve - curve[0]) / (curve[-1] - curve[0]), 0.0, 1.0))
    expected = growing[group]
    rows, columns = (np.arange(size) * _PARTS // size for size in contrast.used.shape)
    part = (_PARTS * rows[:, None] + columns)[contrast.used]
    rises = np.bincount(part, contrast.rise, _PARTS**2)
    filled = rises > 0
    values = [np.bincount(part, contrast.rise_of(frame), _PARTS**2)[filled] / rises[filled] for frame in frames]
    return ResponseCurve(tuple(curve.tolist()), float(np.sqrt(np.mean((np.array(values) - expected[:, None]) ** 2))))


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
