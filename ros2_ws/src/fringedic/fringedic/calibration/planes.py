"""Phase maps of the reference plane, reduced to a grid of block means.

A fit of a dozen parameters does not need a million pixels. Each map is reduced to about a thousand blocks. The phase of
a block is the phase at its centre, so that neither the curvature of the phase nor missing pixels shift it; its standard
deviation is that of the mean of its pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev

from fringedic.calibration.placement import Placement
from fringedic.camera.grid import TO_SIGMA
from fringedic.errors import CalibrationError, ImageError
from fringedic.rig.reconstruction import pixel_positions

BLOCKS = 1200  # a plane has about so many
LEAST_VALID = 0.1  # a block needs this part of its pixels, and a map this part of its blocks
HARMONICS = (1, 2, 3, 4, 5, 6)  # of the fringes are fitted to the residual
_ORDER = 6  # a polynomial of this order models the curvature of the phase
_OUTLIER = 6.0  # standard deviations
_SAME = 3.0  # standard deviations (RMS) below which two maps show the same plane; noise alone gives 1
_SAMPLES = 15_000  # the polynomial is fitted to so many pixels
_RIPPLE_SAMPLES = 40_000


@dataclass(frozen=True, eq=False)
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
        Mean square of the pixels about their block mean, in units of the predicted variance: 1 for noise alone.
    valid, outliers
        Share of the image that is measured, and share of the measured pixels that contradict their surroundings.
    ripple
        Amplitude [rad] of the residual at 1, 2, ... 6 times the frequency of the fringes.
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

    def as_phase_map(self) -> xr.DataArray:
        """Return the phase with the positions of the block centres, as `RigModel.reconstruct` takes it."""
        return xr.DataArray(self.phase, dims=("row", "column"), coords={"row": self.row, "column": self.column})


@dataclass(frozen=True, eq=False)
class CalibrationPlanes:
    """All planes of a calibration.

    Attributes
    ----------
    placement
        Their stated angles and heights.
    blocks
        Their phase maps, reduced.
    fitted, held_out
        Indices of the planes for the fit, and of those that test its result.
    """

    placement: Placement
    blocks: tuple[PlaneBlocks, ...]
    fitted: tuple[int, ...]
    held_out: tuple[int, ...]

    @property
    def names(self) -> list[str]:
        """Names of the images for people."""
        return [self.placement.name(index) for index in range(len(self.blocks))]

    @classmethod
    def reduce(
        cls,
        phases: Sequence[np.ndarray | xr.DataArray],
        sigma: Sequence[np.ndarray | xr.DataArray] | None,
        placement: Placement,
        held_out: Sequence[int],
    ) -> CalibrationPlanes:
        """Check and reduce the phase maps [rad] and their standard deviations, images (row, column).

        Raises
        ------
        CalibrationError
            Too few planes, planes at the same position, an index that does not exist, a map without data, or a plane
            that was not moved.
        ImageError
            Maps of different sizes, or another number of sigma maps.
        """
        if sigma is not None and len(sigma) != len(phases):
            raise ImageError(f"{len(sigma)} maps of sigma for {len(phases)} phase maps: give one for each")
        shapes = [np.shape(phase) for phase in phases]
        for index, shape in enumerate(shapes):
            if len(shape) != 2:
                raise ImageError(f"{placement.name(index)}: shape {shape} is no image (row, column)")
            if shape != shapes[0]:
                raise ImageError(f"{placement.name(index)}: {shape} rows and columns, image 1: {shapes[0]}")
            if sigma is not None and np.shape(sigma[index]) != shape:
                raise ImageError(
                    f"{placement.name(index)}: sigma of shape {np.shape(sigma[index])} for a phase of {shape}"
                )
        for index in held_out:
            if not 0 <= index < len(phases):
                raise CalibrationError(f"held_out names plane {index}, there are planes 0 to {len(phases) - 1}")
        fitted = tuple(index for index in range(len(phases)) if index not in held_out)
        placement.check_positions(fitted)
        blocks = tuple(
            reduce_plane(phase, None if sigma is None else sigma[index], placement.name(index))
            for index, phase in enumerate(phases)
        )
        check_different(blocks, placement)
        return cls(placement, blocks, fitted, tuple(sorted(set(held_out))))


def response_ripple(ripple: Sequence[float]) -> float:
    """Return the largest amplitude at three times the fringes' frequency and more [rad], NaN when unknown.

    Flicker and motion cause one and two periods per fringe, a nonlinear response curve more.
    """
    known = [size for size in ripple[2:] if not math.isnan(size)]
    return max(known, default=math.nan)


def reduce_plane(phase: np.ndarray | xr.DataArray, sigma: np.ndarray | xr.DataArray | None, name: str) -> PlaneBlocks:
    """Reduce a phase map to blocks.

    Parameters
    ----------
    phase, sigma
        Absolute phase and its standard deviation [rad], shape (row, column), NaN where not measured. Without sigma the
        noise is estimated from the scatter of the pixels inside the blocks.
    name
        Of this plane, for messages.

    Raises
    ------
    CalibrationError
        Too little of the image is measured, or sigma is not positive.
    """
    image = np.asarray(phase, float)
    rows, columns = pixel_positions(phase, image.shape)
    measured = np.isfinite(image)
    valid = float(measured.mean())
    if valid < LEAST_VALID:
        raise CalibrationError(
            f"{name}: only {100 * valid:.0f} % of the image is measured; is the plane lit, in view and not saturated?"
        )
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
    for _ in range(4):  # wrong fringe orders bias the first fits
        solution = _least_squares(vander[kept], values[kept])
        residual = np.abs(values - vander @ solution)
        kept = residual <= max(_OUTLIER * TO_SIGMA * float(np.median(residual)), 1e-9)
    coefficients = np.zeros((_ORDER + 1, _ORDER + 1))
    coefficients[tuple(np.transpose(terms))] = solution
    residual = image - _evaluate(coefficients, *(np.linspace(-1, 1, n) for n in image.shape))
    spread = TO_SIGMA * float(np.nanmedian(np.abs(residual)))
    noise = np.full(image.shape, spread) if sigma is None else np.asarray(sigma, float)
    if sigma is not None and not np.any(noise[measured] > 0):
        raise CalibrationError(f"{name}: sigma is nowhere above 0; leave it out when the noise is not known")
    kept = measured & (np.abs(residual) < _OUTLIER * np.maximum(noise, spread)) & (noise > 0)
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
    if sigma is None and not math.isnan(scatter):
        # the noise is the scatter inside the blocks, which is free of what the polynomial leaves
        noise, total, scatter = noise * math.sqrt(scatter), total / scatter, 1.0
    if (~np.isnan(total)).mean() < LEAST_VALID:
        raise CalibrationError(f"{name}: what is measured is scattered over single pixels")
    centre = [(np.arange(n) + 0.5) * size - 0.5 for n in total.shape]
    normalised = [2 * c / (n - 1) - 1 for c, n in zip(centre, image.shape, strict=True)]
    return PlaneBlocks(
        row=rows[0] + centre[0] * (rows[1] - rows[0]),
        column=columns[0] + centre[1] * (columns[1] - columns[0]),
        phase=_evaluate(coefficients, *normalised) + mean,
        sigma=1 / np.sqrt(total),
        noise=float(np.sqrt(np.mean(noise[kept] ** 2))),
        scatter=scatter,
        valid=valid,
        outliers=1 - float(kept.sum()) / float(measured.sum()),
        ripple=_ripple(image, residual, kept),
    )


def check_different(blocks: Sequence[PlaneBlocks], placement: Placement) -> None:
    """Raise an error when two planes at different positions have the same phase: the plane was not moved.

    Raises
    ------
    CalibrationError
        The message names both planes.
    """
    for first in range(len(blocks)):
        for second in range(first + 1, len(blocks)):
            if placement.apart(first, second) and _show_the_same(blocks[first], blocks[second]):
                raise CalibrationError(
                    f"{placement.name(first)} and {placement.name(second)} show the same plane: it was not moved "
                    "between them, or one image was taken for both"
                )


def _show_the_same(first: PlaneBlocks, second: PlaneBlocks) -> bool:
    difference = first.phase - second.phase
    noise = np.hypot(first.sigma, second.sigma)
    both = np.isfinite(difference)
    return bool(both.any() and np.sqrt(np.mean((difference[both] / noise[both]) ** 2)) < _SAME)


def _least_squares(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Solve by normal equations: many times faster, and accurate for the nearly orthogonal columns used here."""
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
    """Return the amplitudes of the residual at integer multiples of the fringes' frequency [rad].

    A plane that turns while its frames are taken causes ripples of opposite signs on both sides of the axis. The
    amplitudes may therefore vary linearly over the image; their root mean square is returned.
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
