"""The two directions of a printed grid in its image: where the spectrum has them, and whether they can be measured."""

from __future__ import annotations

import numpy as np
from scipy.fft import fft2, fftfreq

from fringedic.errors import GridAliasedError, GridDirectionError, GridNotFoundError, GridPitchError

FINEST = 3.5  # [px] fewer pixels per period leave no room between the grid and its own harmonics
_COARSEST = 12  # periods along the shorter side of the image
_CONTRAST = 20.0  # a grid's peak over the typical amplitude at its frequency; noise and speckle reach 6
_HARMONIC = 0.3  # amplitude at a half or third of a frequency, over that of a peak which may be its harmonic
_SECOND = 0.15  # a direction's amplitude over the stronger one's
# An alias with fewer periods across the image cannot be told from a distortion: of the lines of one direction, and of
# the crossings, which is weaker.
_SLOWEST, _SLOWEST_CROSSED = 12.0, 4.0
_STRONG, _WEAK = 5, 11  # highest harmonics of printed lines that make an image useless, or worse
_MOST_TURNED = 15.0  # [degree] more is not asked for


def find_carriers(image: np.ndarray) -> np.ndarray:
    """Return the frequencies [1/px] of a grid's two directions.

    Parameters
    ----------
    image : (row, column)
        Float, finite.

    Returns
    -------
    (2, 2)
        First the one that grows along the columns, then the one that grows along the rows; each (along columns, along
        rows), within about a tenth of a period per image.

    Raises
    ------
    GridNotFoundError, GridDirectionError, GridPitchError
        When there is no grid, lines of one direction only, or a period too long or too short to be measured.
    """
    rows, columns = image.shape
    window = np.hanning(rows)[:, None] * np.hanning(columns)
    amplitude = np.abs(fft2((image - np.average(image, weights=window)) * window, workers=1))
    f_row, f_column = fftfreq(rows)[:, None], fftfreq(columns)[None, :]
    radius = np.hypot(f_row, f_column)
    lowest = 3.0 / min(rows, columns)
    # one half of the spectrum: the other is its mirror image
    half = (f_column > 0) | ((f_column == 0) & (f_row > 0))
    searched = np.where(half & (radius > lowest), amplitude, 0.0)
    first = _peak(searched, amplitude)
    typical = _typical(amplitude, radius, first) if searched[first] > 0 else 0.0
    if searched[first] <= _CONTRAST * typical:
        raise GridNotFoundError(
            "there is no grid in this image: put the printed grid on the reference plane, in focus and evenly lit"
        )
    direction = np.array([f_column[0, first[1]], f_row[first[0], 0]])
    along = (f_column * direction[0] + f_row * direction[1]) / (np.maximum(radius, 1e-12) * np.hypot(*direction))
    across = np.where(np.abs(along) < 0.5, searched, 0.0)
    second = _peak(across, amplitude)
    if amplitude[second] < max(_SECOND * amplitude[first], _CONTRAST * typical):
        raise GridDirectionError(
            "the lines run in one direction only: the grid needs crossed lines, and both have to be in focus"
        )
    peaks = [_refined(amplitude, each, f_row[:, 0], f_column[0]) for each in (first, second)]
    peaks.sort(key=lambda peak: -abs(peak[0]))
    carriers = np.array([peaks[0] * np.sign(peaks[0][0]), peaks[1] * np.sign(peaks[1][1])])
    periods = 1 / np.hypot(*carriers.T)
    if periods.max() > min(rows, columns) / _COARSEST:
        raise GridPitchError(
            f"the grid has a period of {periods.max():.0f} px: too coarse, at least {_COARSEST} periods have to fit in "
            "the image; print a finer one"
        )
    if periods.min() < FINEST:
        raise GridPitchError(
            f"the grid has a period of {periods.min():.1f} px: too fine, {FINEST} px are needed and 6 to 15 are good"
        )
    return carriers


def check_aliasing(carriers: np.ndarray, shape: tuple[int, int]) -> list[str]:
    """Return warnings about harmonics of the lines that the pixels turn into a slow error of the phase.

    Component (m, n) of crossed lines with the frequencies k and l is sampled like (m - 1) k + n l beside k, but for
    whole numbers. Where that is nearly zero along both axes, the error varies as slowly as a distortion. Turning the
    grid makes it fast, the smaller the image the more turn it takes.

    Raises
    ------
    GridAliasedError
        When it is a strong harmonic.
    """
    names, periods, strongest = [], [], _WEAK
    for direction, name in enumerate(("columns", "rows")):
        slow = _slow_components(carriers, direction, shape)
        if slow:
            names.append(name)
            periods.append(float(1 / np.hypot(*carriers[direction])))
            strongest = min(strongest, *slow)
    if not names:
        return []
    lengths = " and ".join(f"{period:.3f}" for period in periods)
    text = (
        f"the period along the {' and '.join(names)} is {lengths} px and in step with the pixels, to which the lines "
        f"are turned by {_turn(carriers):.1f} degree: {_advice(float(np.mean(periods)), shape)}"
    )
    if strongest <= _STRONG:
        raise GridAliasedError(text)
    return [text]


def _slow_components(carriers: np.ndarray, direction: int, shape: tuple[int, int]) -> list[int]:
    """Return the orders |m| + |n| of the components that vary slowly beside one direction."""
    size = np.array([shape[1], shape[0]])
    own, other = carriers[direction], carriers[1 - direction]
    slow = []
    for m in range(-_WEAK, _WEAK + 1):
        for n, slowest in ((0, _SLOWEST), (-1, _SLOWEST_CROSSED), (1, _SLOWEST_CROSSED)):
            beside = (m - 1) * own + n * other
            if abs(m) > 1 and np.max(np.abs(beside - np.round(beside)) * size) < slowest:
                slow.append(abs(m) + abs(n))
    return slow


def _turn(carriers: np.ndarray) -> float:
    """Return the angle between the lines and the pixels [degree], below 45."""
    return abs(float(np.degrees(np.arctan2(carriers[0, 1], carriers[0, 0]))))


def _advice(period: float, shape: tuple[int, int]) -> str:
    """Return the least turn, in half degrees, that is good for a period, and half a degree beside it as well."""
    good = []
    for degrees in np.arange(0.5, _MOST_TURNED + 1.0, 0.5):
        c, s = np.cos(np.radians(degrees)) / period, np.sin(np.radians(degrees)) / period
        straight = np.array([[c, -s], [s, c]])
        good.append(not any(_slow_components(straight, direction, shape) for direction in (0, 1)))
        if len(good) > 2 and all(good[-3:]):
            return f"turn the grid so that it is {degrees - 0.5:g} degrees"
    return "print another pitch"


def _typical(amplitude: np.ndarray, radius: np.ndarray, index: tuple[int, int]) -> float:
    """Return the median amplitude at frequencies about as high as that of a peak."""
    near = np.abs(radius / radius[index] - 1) < 0.3
    return float(np.median(amplitude[near]))


def _peak(searched: np.ndarray, amplitude: np.ndarray) -> tuple[int, int]:
    """Return the strongest entry, or the one at a fraction of its frequency whose harmonic it is."""
    index = np.unravel_index(np.argmax(searched), searched.shape)
    place = np.array([_signed(int(i), n) for i, n in zip(index, searched.shape, strict=True)])
    for divisor in (3, 2):
        near = np.round(place / divisor).astype(int)
        block = [np.arange(i - 2, i + 3) % n for i, n in zip(near, searched.shape, strict=True)]
        part = searched[np.ix_(*block)]
        if part.max() > _HARMONIC * amplitude[index]:
            i, j = np.unravel_index(np.argmax(part), part.shape)
            return int(block[0][i]), int(block[1][j])
    return int(index[0]), int(index[1])


def _signed(index: int, size: int) -> int:
    """Index of the discrete spectrum with its sign."""
    return index if index <= size // 2 else index - size


def _refined(amplitude: np.ndarray, index: tuple[int, int], f_row: np.ndarray, f_column: np.ndarray) -> np.ndarray:
    """Frequency of a peak between the bins: the vertex of a parabola through the logarithms, along each axis."""
    found = []
    for axis, frequencies in ((1, f_column), (0, f_row)):
        n = amplitude.shape[axis]
        around = []
        for step in (-1, 0, 1):
            place = list(index)
            place[axis] = (place[axis] + step) % n
            around.append(float(np.log(max(amplitude[tuple(place)], 1e-300))))
        bend = around[0] - 2 * around[1] + around[2]
        offset = 0.5 * (around[0] - around[2]) / bend if bend < 0 else 0.0
        found.append(frequencies[index[axis]] + float(np.clip(offset, -0.5, 0.5)) / n)
    return np.array(found)
