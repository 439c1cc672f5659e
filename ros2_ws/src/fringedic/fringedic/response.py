"""Response curve of projector and camera together: which grey level to show for a wanted grey level in the image.

Projectors do not show light in proportion to the grey level (gamma), and some cameras bend it again. Fringes that are
not sinusoidal put waves on the measured surface. The curve is measured once for a rig by a ramp of uniform greys, kept
as YAML, and undone in the patterns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from fringedic.errors import InvalidResponseError, ShapeMismatchError
from fringedic.sequence import PatternKind, Projection

FULL_SCALE = 255  # of the projector
_RAMP = 18  # greys of the procedure; 255 is 17 equal steps of 15
_LEAST_CONTRAST = 5.0  # grey levels between dark and white that a pixel needs to take part
_LEAST_PIXELS = 100


@dataclass(frozen=True)
class ResponseCurve:
    """Relative brightness in the image of every grey level of the projector.

    Attributes
    ----------
    brightness
        (I(level) - I(0)) / (I(255) - I(0)) for level = 0..255: 256 values that grow from 0 to 1.
    sigma
        Standard deviation of the curve where it was measured: scatter over the image [-].
    """

    brightness: tuple[float, ...]
    sigma: float = 0.0

    def __post_init__(self) -> None:
        values = np.array(self.brightness, float)
        if values.shape != (FULL_SCALE + 1,) or not np.isfinite(values).all():
            raise InvalidResponseError(f"a response curve has {FULL_SCALE + 1} finite values, not {values.shape}")
        if (np.diff(values) < 0).any() or values[0] != 0 or values[-1] != 1:
            raise InvalidResponseError("a response curve has to grow from 0 to 1 and never fall")

    def level_for(self, brightness: np.ndarray) -> np.ndarray:
        """Return the grey level to show, not rounded, for a wanted brightness of 0 to 1 (any shape)."""
        values = np.array(self.brightness)
        first = np.flatnonzero(np.diff(values, prepend=-1.0) > 0)  # where the curve is flat, its lower end
        return np.interp(brightness, values[first], first.astype(float))

    @property
    def gamma(self) -> float:
        """Exponent of the power law nearest to the curve, for people: 1 is a straight line."""
        level = np.arange(1, FULL_SCALE) / FULL_SCALE
        values = np.array(self.brightness[1:-1])
        known = values > 0.02  # below, digits and noise decide
        logarithm = np.log(level[known])
        return float(np.sum(logarithm * np.log(values[known])) / np.sum(logarithm**2))

    def save(self, path: str | Path) -> None:
        """Write the curve as YAML."""
        values: dict[str, Any] = {"brightness": [round(value, 6) for value in self.brightness]}
        content = {"response_curve": {**values, "sigma": round(self.sigma, 6)}}
        Path(path).write_text(yaml.safe_dump(content, sort_keys=False))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a curve.

        Raises
        ------
        InvalidResponseError
            The file holds no such curve.
        """
        try:
            content: Any = yaml.safe_load(Path(path).read_text())
            section = content["response_curve"]
            return cls(tuple(float(value) for value in section["brightness"]), float(section.get("sigma", 0.0)))
        except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            raise InvalidResponseError(f"{path}: not a response curve: {error}") from error


def response_projections(number: int = _RAMP) -> tuple[Projection, ...]:
    """Return the uniform greys of the procedure, from black to white."""
    if number < 3:
        raise InvalidResponseError(f"{number} greys: a curve needs at least 3")
    levels = np.unique(np.round(np.linspace(0, FULL_SCALE, number)).astype(int))
    return tuple(Projection(PatternKind.GREY, shift=int(level), shifts=FULL_SCALE) for level in levels)


def measure_response(
    frames: np.ndarray, projections: Sequence[Projection], *, saturation: float | None = None
) -> ResponseCurve:
    """Measure the response curve from images of uniform greys on any surface that stands still.

    Every pixel sees ``I = a f(level) + b`` with an albedo a and ambient light b of its own. The ratio of sums
    ``f = sum(I - I_dark) / sum(I_white - I_dark)`` removes both and weights bright pixels most. The greys between
    the measured ones follow a monotone cubic through them.

    Parameters
    ----------
    frames
        Grey levels, shape (frame, row, column).
    projections
        What each showed: `response_projections`, in any order, black and full white among them.
    saturation
        Grey level from which a pixel counts as saturated and is left out; by default the largest of an integer type.

    Raises
    ------
    ShapeMismatchError
        There is not one frame for each projection.
    InvalidResponseError
        Black, white or greys in between are missing; the image is saturated or stays dark; or brighter greys do not
        make brighter images.
    """
    if frames.ndim != 3 or len(frames) != len(projections):
        raise ShapeMismatchError(f"frames of shape {frames.shape} for {len(projections)} greys")
    if any(each.kind != PatternKind.GREY for each in projections):
        raise InvalidResponseError("the response is measured from uniform greys, other patterns are among them")
    level = np.array([FULL_SCALE * each.shift / each.shifts for each in projections])
    dark, white = level == 0, level == FULL_SCALE
    if not dark.any() or not white.any() or len(np.unique(level)) < 3:
        raise InvalidResponseError("the response needs black, full white and greys in between")
    limit = saturation if saturation is not None else np.iinfo(frames.dtype).max if frames.dtype.kind == "u" else np.inf
    lowest, highest = frames[dark].mean(axis=0, dtype=float), frames[white].mean(axis=0, dtype=float)
    unsaturated = frames.max(axis=0) < limit
    used = unsaturated & (highest - lowest > _LEAST_CONTRAST)
    if used.sum() < _LEAST_PIXELS:
        why = "saturates: shorten the exposure" if not unsaturated.any() else "hardly differs between black and white"
        raise InvalidResponseError(f"response curve: the image {why}")
    rise = float(np.sum((highest - lowest)[used]))
    measured = np.array([np.sum(frame[used] - lowest[used]) for frame in frames.astype(float)]) / rise
    shown, group = np.unique(level, return_inverse=True)
    mean = np.array([measured[group == each].mean() for each in range(len(shown))])
    growing = isotonic_regression(mean).x
    if np.abs(growing - mean).max() > 0.02:
        raise InvalidResponseError(
            "response curve: brighter greys do not make brighter images; are frames out of order?"
        )
    curve = PchipInterpolator(shown, growing)(np.arange(FULL_SCALE + 1))
    curve = np.maximum.accumulate(np.clip((curve - curve[0]) / (curve[-1] - curve[0]), 0.0, 1.0))
    return ResponseCurve(tuple(curve.tolist()), _scatter(frames, lowest, highest, used, growing[group]))


def _scatter(
    frames: np.ndarray, lowest: np.ndarray, highest: np.ndarray, used: np.ndarray, expected: np.ndarray
) -> float:
    """Return how much the curve differs over the image: the spread of 8 x 8 parts about the whole's curve."""
    rows, columns = (np.arange(size) * 8 // size for size in used.shape)
    part = (8 * rows[:, None] + columns)[used]
    rise = np.bincount(part, (highest - lowest)[used], 64)
    filled = rise > 0
    values = [np.bincount(part, frame[used] - lowest[used], 64)[filled] / rise[filled] for frame in frames]
    return float(np.sqrt(np.mean((np.array(values) - expected[:, None]) ** 2)))
