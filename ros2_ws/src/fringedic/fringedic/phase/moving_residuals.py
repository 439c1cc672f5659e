"""What the model of a moving stack leaves: noise, acceleration, and faults that make the model wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.special import chdtrc, chdtri

from fringedic.phase.moving_kernel import CELL
from fringedic.phase.moving_model import Shown

FALSE_ALARM = 1e-6
"""Probability that noise alone is taken for an acceleration in a stack without one."""

_TILE = 64  # [px], side of the tiles that share an acceleration
_SAMPLES = 20_000  # pixels
_FEWEST = 20  # pixels of a tile
_PARAMETERS = 4  # mean, modulation, phase, drift


@dataclass(frozen=True)
class Curvature:
    """Acceleration of the phase, from what the model without it leaves.

    Attributes
    ----------
    tiles, sigma
        [rad per interval^2] and standard deviation, shape (tile row, tile column).
    significant
        Whether noise alone is less probable than `FALSE_ALARM`.
    """

    tiles: np.ndarray
    sigma: np.ndarray
    significant: bool

    def at_cells(self, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return acceleration and standard deviation at so many cells, linear between the tiles."""
        rows, columns = (((np.arange(size) + 0.5) * CELL / _TILE - 0.5) for size in shape)
        places = np.meshgrid(rows, columns, indexing="ij")
        value, sigma = (
            map_coordinates(each, places, order=1, mode="nearest", prefilter=False) for each in (self.tiles, self.sigma)
        )
        return value, sigma


@dataclass(frozen=True)
class Residuals:
    """Residuals of the frames of the finest pitch at pixels of a lattice.

    Attributes
    ----------
    levels : (pixel, frame)
        Grey levels minus the model.
    slope : (pixel, frame)
        Derivative of the model by the phase [grey level/rad].
    design : (pixel, frame, parameter)
        Derivatives of the model by its parameters, orthonormal.
    variance : (pixel,)
        Of the aligned grey levels; NaN where the noise is not known.
    texture : (pixel,)
        Mean grey level.
    tile : (pixel,)
        Number of the tile of each pixel.
    tiles
        Rows and columns of tiles.
    shown
        The frames.
    """

    levels: np.ndarray
    slope: np.ndarray
    design: np.ndarray
    variance: np.ndarray
    texture: np.ndarray
    tile: np.ndarray
    tiles: tuple[int, int]
    shown: Shown

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a pixel."""
        return int(self.levels.shape[1]) - _PARAMETERS

    @property
    def unexplained(self) -> np.ndarray:
        """Sum of the squared residuals of each pixel [grey level^2]."""
        return np.asarray(np.sum(self.levels**2, axis=1))

    def misfit(self) -> float:
        """Return the variance of the median pixel's residuals over that of the noise."""
        return float(np.median(self.unexplained / self.variance) / chdtri(self.freedom, 0.5))

    def relative(self) -> float:
        """Return the RMS of the median pixel's residuals over its modulation."""
        deviation = np.sqrt(self.unexplained / self.freedom)
        return float(np.median(deviation / np.maximum(np.abs(self.slope).max(axis=1), 1e-6)))

    def frame_shares(self) -> np.ndarray:
        """Return the part of all squared residuals that the model would not have without each frame."""
        leverage = np.sum(self.design**2, axis=2)
        single = self.levels**2 / np.maximum(1 - leverage, 1e-3)
        weight = 1 / np.maximum(np.median(self.unexplained), self.unexplained)[:, None]
        return np.asarray((single * weight).sum(axis=0) / (self.unexplained[:, None] * weight).sum())

    def curvature(self) -> Curvature:
        """Return the acceleration in each tile that the residuals contain."""
        course = self.slope * (0.5 * self.shown.times**2)
        course = course - np.einsum("pkm,pm->pk", self.design, np.einsum("pkm,pk->pm", self.design, course))
        variance = np.where(np.isfinite(self.variance), self.variance, np.median(self.unexplained) / self.freedom)
        weight = 1 / variance
        count = self.tiles[0] * self.tiles[1]

        def total(values: np.ndarray) -> np.ndarray:
            return np.bincount(self.tile, weights=values, minlength=count).reshape(self.tiles)

        information = total(weight * np.sum(course**2, axis=1))
        found = total(weight * np.sum(course * self.levels, axis=1))
        known = (total(np.ones(len(self.tile))) >= _FEWEST) & (information > 0)
        if not known.any():
            return Curvature(np.zeros(self.tiles), np.zeros(self.tiles), False)
        safe = np.where(known, information, 1.0)
        tiles, sigma = found / safe, 1 / np.sqrt(safe)
        score = np.sum((tiles / sigma)[known] ** 2)
        mean = float(np.sum(found[known]) / np.sum(information[known]))
        tiles, sigma = np.where(known, tiles, mean), np.where(known, sigma, sigma[known].max())
        return Curvature(tiles, sigma, bool(chdtrc(int(known.sum()), score) < FALSE_ALARM))


def residuals_of(
    frames: np.ndarray,
    shown: Shown,
    maps: np.ndarray,
    course: tuple[np.ndarray, np.ndarray],
    variance: np.ndarray,
    good: np.ndarray,
) -> Residuals | None:
    """Return the residuals of aligned frames; None where hardly a pixel is measured.

    Parameters
    ----------
    frames
        Aligned grey levels (frame, row, column).
    shown
        Their times and shifts.
    maps
        Mean, modulation and phase, (3 or more, row, column).
    course
        Drift and acceleration of each pixel, (row, column).
    variance
        Of the aligned grey levels, (row, column).
    good
        Pixels that are measured.
    """
    skip = max(1, int(np.ceil(np.sqrt(good.size / _SAMPLES))))
    rows, columns = np.nonzero(good[::skip, ::skip])
    rows, columns = rows * skip, columns * skip
    if len(rows) < _FEWEST:
        return None
    levels = frames[:, rows, columns].T.astype(float)
    mean, modulation, phase = (each[rows, columns].astype(float)[:, None] for each in maps[:3])
    drift, curvature = (each[rows, columns].astype(float)[:, None] for each in course)
    t = shown.times
    angle = phase + drift * t + 0.5 * curvature * t**2 - shown.angles
    slope = -modulation * np.sin(angle)
    design = np.stack([np.ones_like(slope), np.cos(angle), np.sin(angle), t * np.sin(angle)], axis=2)
    tiles = tuple(-(-size // _TILE) for size in good.shape)
    return Residuals(
        levels=levels - mean - modulation * np.cos(angle),
        slope=slope,
        design=_orthonormal(design),
        variance=variance[rows, columns].astype(float),
        texture=mean[:, 0],
        tile=rows // _TILE * tiles[1] + columns // _TILE,
        tiles=(tiles[0], tiles[1]),
        shown=shown,
    )


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns of each pixel (pixel, frame, column), by modified Gram-Schmidt.

    The condition is below 10, so that it is as exact as a factorisation of each matrix, and ten times as fast.
    """
    basis = columns.copy()
    for column in range(basis.shape[2]):
        own = basis[:, :, column]
        own /= np.sqrt(np.einsum("pk,pk->p", own, own))[:, None]
        for later in range(column + 1, basis.shape[2]):
            basis[:, :, later] -= np.einsum("pk,pk->p", own, basis[:, :, later])[:, None] * own
    return basis
