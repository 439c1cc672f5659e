"""Spatial frequencies of a printed grid in its image, and whether its phase can be measured at these frequencies."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.fft import fft2, fftfreq

from fringedic.camera.findings import Finding, GridFinding
from fringedic.errors import ErrorCode, GridError

# test_grid.py contains images on both sides of the thresholds that refuse an image.
FINEST = 3.5  # [px] shorter periods leave no space in the spectrum between the grid and its own harmonics
_COARSEST = 12  # at least so many periods have to fit along the shorter side
_LOWEST = 3.0  # fewer periods per image are illumination
_CONTRAST = 20.0  # a grid exceeds the typical amplitude at its frequency so many times; noise and speckle reach 6
_HARMONIC = 0.3  # a peak is a harmonic if a half or third of its frequency has this part of its amplitude
_SECOND = 0.15  # the weaker direction has at least this part of the amplitude of the stronger one
# An alias with fewer periods across the image is not distinguishable from a distortion: aliases of the lines of one
# direction, and those of the crossings, which are weaker.
_SLOWEST, _SLOWEST_CROSSED = 12.0, 4.0
_STRONG, _WEAK = 5, 11  # aliases of printed lines up to these harmonics make an image useless, or worse
_LARGEST_TURN = 15.0  # [degree] no larger turn is advised


def find_carriers(image: np.ndarray) -> np.ndarray:
    """Return the frequencies of the two directions of a grid.

    Parameters
    ----------
    image : (row, column)
        Float, finite.

    Returns
    -------
    ndarray
        float64 (2, 2) [1/px]: first the direction whose phase grows along the columns, then the one whose phase grows
        along the rows; each (along x, along y), within about a tenth of a period per image.

    Raises
    ------
    GridError
        There is no grid, lines of one direction only, or a period too long or too short to be measured.
    """
    spectrum = _Spectrum(image)
    first = _peak(spectrum.searched, spectrum.amplitude)
    typical = spectrum.typical(first) if spectrum.searched[first] > 0 else 0.0
    if spectrum.searched[first] <= _CONTRAST * typical:
        raise GridError(
            "there is no grid in this image: put the printed grid on the reference plane, in focus and evenly lit"
        )
    second = _peak(spectrum.across(first), spectrum.amplitude)
    if spectrum.amplitude[second] < max(_SECOND * spectrum.amplitude[first], _CONTRAST * typical):
        raise GridError(
            "the lines run in one direction only: the grid needs crossed lines, and both have to be in focus"
        )
    peaks = [_refine_peak(spectrum, each) for each in (first, second)]
    peaks.sort(key=lambda peak: -abs(peak[0]))
    carriers = np.array([peaks[0] * np.sign(peaks[0][0]), peaks[1] * np.sign(peaks[1][1])])
    periods = 1 / np.hypot(*carriers.T)
    if periods.max() > min(image.shape) / _COARSEST:
        raise GridError(
            f"the grid has a period of {periods.max():.0f} px: too coarse, at least {_COARSEST} periods have to fit in "
            "the image; print a finer one"
        )
    if periods.min() < FINEST:
        raise GridError(
            f"the grid has a period of {periods.min():.1f} px: too fine, {FINEST} px are needed and 6 to 15 are good"
        )
    return carriers


class _Spectrum:
    """Amplitudes of a windowed image over its frequencies; `searched` is one half of them without the lowest."""

    def __init__(self, image: np.ndarray) -> None:
        rows, columns = image.shape
        window = np.hanning(rows)[:, None] * np.hanning(columns)
        self.amplitude = np.abs(fft2((image - np.average(image, weights=window)) * window, workers=1))
        self.f_row, self.f_column = fftfreq(rows)[:, None], fftfreq(columns)[None, :]
        self.radius = np.hypot(self.f_row, self.f_column)
        # the other half of the spectrum is its mirror image
        half = (self.f_column > 0) | ((self.f_column == 0) & (self.f_row > 0))
        self.searched = np.where(half & (self.radius > _LOWEST / min(rows, columns)), self.amplitude, 0.0)

    def typical(self, index: tuple[int, int]) -> float:
        """Return the median amplitude at frequencies about as high as that of a peak."""
        near = np.abs(self.radius / self.radius[index] - 1) < 0.3
        return float(np.median(self.amplitude[near]))

    def across(self, index: tuple[int, int]) -> np.ndarray:
        """Return the searched amplitudes at directions more than 60 degree away from that of a peak."""
        direction = np.array([self.f_column[0, index[1]], self.f_row[index[0], 0]])
        along = (self.f_column * direction[0] + self.f_row * direction[1]) / (
            np.maximum(self.radius, 1e-12) * np.hypot(*direction)
        )
        return np.where(np.abs(along) < 0.5, self.searched, 0.0)


def check_aliasing(carriers: np.ndarray, shape: tuple[int, int]) -> list[Finding]:
    """Return a finding when the pixels alias harmonics of the lines to a slow error of the phase.

    Component (m, n) of crossed lines with the frequencies k and l is sampled like (m - 1) k + n l relative to k, modulo
    integers. Where that is nearly zero along both axes, the error varies as slowly as a distortion. Turning the grid
    makes it fast; small images need a larger turn.

    Raises
    ------
    GridError
        A strong harmonic is aliased (`ErrorCode.GRID_ALIASED`).
    """
    periods, strongest = {}, _WEAK
    for direction, name in enumerate(("columns", "rows")):
        slow = _slow_components(carriers, direction, shape)
        if slow:
            periods[name] = float(1 / np.hypot(*carriers[direction]))
            strongest = min(strongest, *slow)
    if not periods:
        return []
    turn = abs(float(np.arctan2(carriers[0, 1], carriers[0, 0])))
    advised = _advised_turn(float(np.mean(list(periods.values()))), shape)
    if strongest <= _STRONG:
        raise GridError(aliasing_text(periods, turn, advised), code=ErrorCode.GRID_ALIASED)
    values = {f"period_{name}": period for name, period in periods.items()} | {"turn": turn}
    return [Finding(GridFinding.IN_STEP, values=values if advised is None else {**values, "advised_turn": advised})]


def aliasing_text(periods: Mapping[str, float], turn: float, advised: float | None) -> str:
    """Return the words about a grid whose harmonics are aliased.

    Parameters
    ----------
    periods
        Periods [px] of the directions concerned by "columns" and "rows".
    turn, advised
        The present angle between lines and pixels [rad], and a better one; None when no angle helps.
    """
    lengths = " and ".join(f"{period:.3f}" for period in periods.values())
    advice = "print another pitch"
    if advised is not None:
        advice = f"turn the grid so that it is {math.degrees(advised):g} degrees"
    return (
        f"the period along the {' and '.join(periods)} is {lengths} px and in step with the pixels, to which the lines "
        f"are turned by {math.degrees(turn):.1f} degree: {advice}"
    )


def _slow_components(carriers: np.ndarray, direction: int, shape: tuple[int, int]) -> list[int]:
    """Return the orders |m| + |n| of the components that vary slowly relative to one direction."""
    size = np.array([shape[1], shape[0]])
    own, other = carriers[direction], carriers[1 - direction]
    slow = []
    for m in range(-_WEAK, _WEAK + 1):
        for n, slowest in ((0, _SLOWEST), (-1, _SLOWEST_CROSSED), (1, _SLOWEST_CROSSED)):
            beside = (m - 1) * own + n * other
            if abs(m) > 1 and np.max(np.abs(beside - np.round(beside)) * size) < slowest:
                slow.append(abs(m) + abs(n))
    return slow


def _advised_turn(period: float, shape: tuple[int, int]) -> float | None:
    """Return the smallest turn [rad], in half degrees, that is good for a period, as are its neighbours; or None."""
    good = []
    for degrees in np.arange(0.5, _LARGEST_TURN + 1.0, 0.5):
        c, s = np.cos(np.radians(degrees)) / period, np.sin(np.radians(degrees)) / period
        straight = np.array([[c, -s], [s, c]])
        good.append(not any(_slow_components(straight, direction, shape) for direction in (0, 1)))
        if len(good) > 2 and all(good[-3:]):
            return math.radians(degrees - 0.5)
    return None


def _peak(searched: np.ndarray, amplitude: np.ndarray) -> tuple[int, int]:
    """Return the strongest entry, or its fundamental when it is a harmonic of a strong one."""
    index = np.unravel_index(np.argmax(searched), searched.shape)
    place = np.array([i if i <= n // 2 else i - n for i, n in zip(index, searched.shape, strict=True)])
    for divisor in (3, 2):
        near = np.round(place / divisor).astype(int)
        block = [np.arange(i - 2, i + 3) % n for i, n in zip(near, searched.shape, strict=True)]
        part = searched[np.ix_(*block)]
        if part.max() > _HARMONIC * amplitude[index]:
            i, j = np.unravel_index(np.argmax(part), part.shape)
            return int(block[0][i]), int(block[1][j])
    return int(index[0]), int(index[1])


def _refine_peak(spectrum: _Spectrum, index: tuple[int, int]) -> np.ndarray:
    """Return the frequency of a peak between the bins: vertex of a parabola through the logarithms, along each axis."""
    found = []
    for axis, frequencies in ((1, spectrum.f_column[0]), (0, spectrum.f_row[:, 0])):
        n = spectrum.amplitude.shape[axis]
        around = []
        for step in (-1, 0, 1):
            place = list(index)
            place[axis] = (place[axis] + step) % n
            around.append(float(np.log(max(spectrum.amplitude[tuple(place)], 1e-300))))
        bend = around[0] - 2 * around[1] + around[2]
        offset = 0.5 * (around[0] - around[2]) / bend if bend < 0 else 0.0
        found.append(frequencies[index[axis]] + float(np.clip(offset, -0.5, 0.5)) / n)
    return np.array(found)
