"""Phase maps of the reference plane: what is checked before a fit, and their reduction to a grid of block means.

A fit of a dozen parameters needs no million pixels. Each map becomes some thousand blocks; the phase of a block is that
at its centre, so that neither the curvature of the phase nor missing pixels shift it, and its standard deviation is
that of the mean of its pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev

from fringedic.errors import CalibrationAnglesError, CalibrationPhaseError, CalibrationPlanesError, ShapeMismatchError
from fringedic.rig import pixel_positions

BLOCKS = 1200  # about as many for each plane
LEAST_VALID = 0.1  # of the pixels of a block, and of the blocks of a map
FEWEST_PLANES = 3
LARGEST_ANGLE = math.radians(70)  # no camera looks at a plane turned further
SMALLEST_TURN = math.radians(0.05)  # planes closer to each other than this tell nothing
SMALLEST_MOVE = 20e-6  # the same for translated planes [m]
HARMONICS = (1, 2, 3, 4, 5, 6)  # of the fringes, looked for in the residual
_ORDER = 6  # of the polynomial that carries the phase's curvature
_OUTLIER = 6.0  # standard deviations
_SAMPLES = 15_000  # pixels for the polynomial
_RIPPLE_SAMPLES = 40_000


@dataclass(frozen=True)
class PlaneBlocks:
    """One phase map as a grid of blocks.

    Attributes
    ----------
    row, column
        Centres of the blocks [px of the image], shapes (n,) and (m,).
    phase, sigma
        Absolute phase at the centres and the standard deviation of the block's mean [rad], (n, m), NaN without data.
    noise
        Root mean square of the pixels' standard deviation as predicted [rad].
    scatter
        Mean square of the pixels around their block, in units of the predicted variance: 1 when it is noise alone.
    valid, outliers
        Share of the image that is measured, and of the measured pixels that contradict their surroundings.
    ripple
        Amplitude [rad] of the residual at 1, 2, ... 6 times the fringes' frequency.
    """

    row: np.ndarray
    column: np.ndarray
    phase: np.ndarray
    sigma: np.ndarray
    noise: float
    scatter: float
    valid: float
    outliers: float
    ripple: tuple[float, ...]


def check_planes(
    phases: Sequence[np.ndarray | xr.DataArray],
    angles: Sequence[float] | None,
    heights: Sequence[float] | None,
    sigma: Sequence[np.ndarray | xr.DataArray] | None,
    held_out: Sequence[int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angles [rad], heights [m] and which planes are fitted, after checks that need no look at the phase.

    Raises
    ------
    CalibrationPlanesError
        Too few planes, no difference between them, or an index that does not exist.
    CalibrationAnglesError
        Angles that cannot be radians.
    ShapeMismatchError
        Maps of different sizes, or lists of different lengths.
    """
    count = len(phases)
    turn = np.zeros(count) if angles is None else np.asarray(angles, float)
    lift = np.zeros(count) if heights is None else np.asarray(heights, float)
    for name, values in (("angles", turn), ("heights", lift)):
        if values.shape != (count,):
            raise ShapeMismatchError(f"{values.size} {name} for {count} phase maps: give one for each")
        if not np.isfinite(values).all():
            raise CalibrationAnglesError(f"{name} are {values}: they have to be finite numbers")
    if sigma is not None and len(sigma) != count:
        raise ShapeMismatchError(f"{len(sigma)} maps of sigma for {count} phase maps: give one for each")
    shapes = [np.shape(phase) for phase in phases]
    for index, shape in enumerate(shapes):
        if len(shape) != 2:
            raise ShapeMismatchError(f"{plane_name(index, turn, lift)}: shape {shape} is no image (row, column)")
        if shape != shapes[0]:
            raise ShapeMismatchError(f"{plane_name(index, turn, lift)}: {shape} rows and columns, image 1: {shapes[0]}")
        if sigma is not None and np.shape(sigma[index]) != shape:
            raise ShapeMismatchError(
                f"{plane_name(index, turn, lift)}: sigma of shape {np.shape(sigma[index])} for a phase of {shape}"
            )
    if count and np.abs(turn).max() > LARGEST_ANGLE:
        largest = turn[np.argmax(np.abs(turn))]
        raise CalibrationAnglesError(
            f"an angle of {largest:g} rad is {math.degrees(largest):.0f} degree; the camera does not see such a plane. "
            "Angles are expected in radian: were they given in degree?"
        )
    fitted = np.ones(count, bool)
    for index in held_out:
        if not 0 <= index < count:
            raise CalibrationPlanesError(f"held_out names plane {index}, there are planes 0 to {count - 1}")
        fitted[index] = False
    if fitted.sum() < FEWEST_PLANES:
        raise CalibrationPlanesError(
            f"{fitted.sum()} planes to fit: at least {FEWEST_PLANES} at different angles are needed, better 7"
        )
    different = max(_different(turn[fitted], SMALLEST_TURN), _different(lift[fitted], SMALLEST_MOVE))
    if different < FEWEST_PLANES:
        raise CalibrationPlanesError(
            f"the planes stand at {different} different positions only: at least {FEWEST_PLANES} angles "
            f"(more than {math.degrees(SMALLEST_TURN):g} degree apart) or as many heights are needed"
        )
    return turn, lift, fitted


def response_ripple(ripple: Sequence[float]) -> float:
    """Return the largest amplitude at three times the fringes' frequency and more [rad].

    Light and motion ripple once and twice per fringe, a response that is no straight line more often.
    """
    known = [size for size in ripple[2:] if not math.isnan(size)]
    return max(known, default=math.nan)


def plane_name(index: int, angles: np.ndarray, heights: np.ndarray) -> str:
    """Return the name of a plane for people: "image 3 (angle +5 degree)"."""
    height = f", height {1e3 * heights[index]:+g} mm" if np.any(heights) else ""
    return f"image {index + 1} (angle {math.degrees(angles[index]):+.4g} degree{height})"


def reduce_plane(phase: np.ndarray | xr.DataArray, sigma: np.ndarray | xr.DataArray | None, name: str) -> PlaneBlocks:
    """Reduce a phase map [rad] to blocks.

    Parameters
    ----------
    phase, sigma
        Absolute phase and its standard deviation [rad], shape (row, column), NaN where not measured. Without sigma the
        noise is taken from the scatter of the pixels inside the blocks.
    name
        Of this plane, for messages.

    Raises
    ------
    CalibrationPhaseError
        When too little of the image is measured.
    """
    image = np.asarray(phase, float)
    rows, columns = pixel_positions(phase, image.shape)
    measured = np.isfinite(image)
    valid = float(measured.mean())
    if valid < LEAST_VALID:
        raise CalibrationPhaseError(
            f"{name}: only {100 * valid:.0f} % of the image is measured; is the plane lit, in view and not saturated?"
        )
    coefficients = _curvature(image, measured)
    residual = image - _evaluate(coefficients, *(np.linspace(-1, 1, n) for n in image.shape))
    spread = 1.4826 * float(np.nanmedian(np.abs(residual)))
    noise = np.full(image.shape, spread) if sigma is None else np.asarray(sigma, float)
    if sigma is not None and not np.any(noise[measured] > 0):
        raise CalibrationPhaseError(f"{name}: sigma is nowhere above 0; leave it out when the noise is not known")
    kept = measured & (np.abs(residual) < _OUTLIER * np.maximum(noise, spread)) & (noise > 0)
    outliers = 1 - float(kept.sum()) / float(measured.sum())
    size = max(1, round(math.sqrt(image.size / BLOCKS)))
    weight = _blocks(np.where(kept, 1 / np.where(kept, noise, 1.0) ** 2, 0.0), size)
    values = _blocks(np.where(kept, residual, 0.0), size)
    count = (weight > 0).sum(axis=-1)
    full = count >= max(1, LEAST_VALID * size**2)
    total = np.where(full, weight.sum(axis=-1), np.nan)
    mean = (weight * values).sum(axis=-1) / total
    squares = np.where(full, (weight * (values - mean[..., None]) ** 2).sum(axis=-1), 0.0)
    freedom = float(np.where(full, count - 1, 0).sum())
    scatter = float(squares.sum()) / freedom if freedom else math.nan
    if sigma is None and freedom:
        # the noise is what the pixels of a block differ by, whatever the polynomial leaves
        noise, total, scatter = noise * math.sqrt(scatter), total / scatter, 1.0
    if full.mean() < LEAST_VALID:
        raise CalibrationPhaseError(f"{name}: what is measured is scattered over single pixels")
    centre = [(np.arange(n) + 0.5) * size - 0.5 for n in full.shape]
    normalised = [2 * c / (n - 1) - 1 for c, n in zip(centre, image.shape, strict=True)]
    return PlaneBlocks(
        row=rows[0] + centre[0] * (rows[1] - rows[0]),
        column=columns[0] + centre[1] * (columns[1] - columns[0]),
        phase=_evaluate(coefficients, *normalised) + mean,
        sigma=1 / np.sqrt(total),
        noise=float(np.sqrt(np.mean(noise[kept] ** 2))),
        scatter=scatter,
        valid=valid,
        outliers=outliers,
        ripple=_ripple(image, residual, kept),
    )


def check_different(planes: Sequence[PlaneBlocks], angles: np.ndarray, heights: np.ndarray) -> None:
    """Raise an error when two planes at different positions have the same phase: the plane was not moved.

    Raises
    ------
    CalibrationPlanesError
        Names both planes.
    """
    for first in range(len(planes)):
        for second in range(first + 1, len(planes)):
            apart = abs(angles[first] - angles[second]) > SMALLEST_TURN or abs(heights[first] - heights[second]) > (
                SMALLEST_MOVE
            )
            difference = planes[first].phase - planes[second].phase
            noise = np.hypot(planes[first].sigma, planes[second].sigma)
            both = np.isfinite(difference)
            if apart and both.any() and np.sqrt(np.mean((difference[both] / noise[both]) ** 2)) < _OUTLIER / 2:
                raise CalibrationPlanesError(
                    f"{plane_name(first, angles, heights)} and {plane_name(second, angles, heights)} show the same "
                    "plane: it was not moved between them, or one image was taken for both"
                )


def _different(values: np.ndarray, apart: float) -> int:
    """Return how many values differ from each other by more than `apart`."""
    count, last = 0, -math.inf
    for value in np.sort(values):
        if value - last > apart:
            count, last = count + 1, value
    return count


def _curvature(image: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the coefficients (7, 7) of a robust polynomial over the image, positions normalised to -1 .. 1."""
    skip = max(1, math.isqrt(image.size // _SAMPLES))
    row, column = np.nonzero(measured[::skip, ::skip])
    values = image[::skip, ::skip][row, column]
    a, b = (2 * skip * each / (n - 1) - 1 for each, n in zip((row, column), image.shape, strict=True))
    order = _ORDER if len(values) > 4 * (_ORDER + 1) ** 2 else 2
    terms = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    vander = (
        chebyshev.chebvander(a, order)[:, [i for i, _ in terms]]
        * chebyshev.chebvander(b, order)[:, [j for _, j in terms]]
    )
    kept = np.ones(len(values), bool)
    for _ in range(4):  # wrong orders pull the first fits
        solution = _least_squares(vander[kept], values[kept])
        residual = np.abs(values - vander @ solution)
        kept = residual <= max(_OUTLIER * 1.4826 * float(np.median(residual)), 1e-9)
    coefficients = np.zeros((_ORDER + 1, _ORDER + 1))
    coefficients[tuple(np.transpose(terms))] = solution
    return coefficients


def _least_squares(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Solve for nearly orthogonal columns, whose normal equations lose nothing and are many times faster."""
    result: np.ndarray = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ values, rcond=None)[0]
    return result


def _evaluate(coefficients: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result: np.ndarray = chebyshev.chebvander(a, _ORDER) @ coefficients @ chebyshev.chebvander(b, _ORDER).T
    return result


def _blocks(image: np.ndarray, size: int) -> np.ndarray:
    """Return whole blocks of `size` x `size` pixels, shape (n, m, size^2)."""
    n, m = (length // size for length in image.shape)
    blocks = image[: n * size, : m * size].reshape(n, size, m, size).swapaxes(1, 2)
    return blocks.reshape(n, m, size * size)


def _ripple(phase: np.ndarray, residual: np.ndarray, kept: np.ndarray) -> tuple[float, ...]:
    """Return the amplitudes of the residual at whole multiples of the fringes' frequency.

    A plane that turns while its frames are taken ripples with opposite signs on both sides of the axis: the amplitudes
    may change linearly over the image; their root mean square is returned.
    """
    skip = max(1, math.isqrt(phase.size // _RIPPLE_SAMPLES))
    part = (slice(None, None, skip), slice(None, None, skip))
    angle, value = phase[part][kept[part]], residual[part][kept[part]]
    row, column = np.nonzero(kept[part])
    if len(angle) < 12 * len(HARMONICS):
        return (math.nan,) * len(HARMONICS)
    places = [np.ones(len(angle))]
    for each, length in ((row, phase.shape[0]), (column, phase.shape[1])):
        places.append(math.sqrt(3) * (2 * skip * each / (length - 1) - 1))  # of unit mean square
    waves = np.stack([wave(k * angle) * at for k in HARMONICS for wave in (np.cos, np.sin) for at in places], axis=1)
    found = _least_squares(waves, value).reshape(len(HARMONICS), -1)
    return tuple(float(each) for each in np.sqrt(np.sum(found**2, axis=1)))
