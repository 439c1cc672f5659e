"""Shift of a model along the surface, from the displacement: a hole or a notch that is in another place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.evaluation.correlated import correlated_points
from fringedic.models.sensitivity import surface_gradient

SHIFT = {
    "shift_x": "translation of the model along x that fits the displacement best",
    "shift_y": "translation of the model along y that fits the displacement best",
    "sigma_shift_x": "standard uncertainty of shift_x, without that of the alignment",
    "sigma_shift_y": "standard uncertainty of shift_y, without that of the alignment",
}
_MOST_POINTS = 100_000  # of each map; neighbours share their noise
_RIDGE = 1e-10  # of unit vectors: a shift that equals a rigid motion gets a large uncertainty instead of none
_DETERMINED = 0.05  # standard uncertainty over the size of the surface, above which a shift is not determined


@dataclass(frozen=True)
class Shift:
    """Translation of a model along x and y of the rig [m], with standard uncertainties; meanings in `SHIFT`.

    NaN where the displacement does not determine it: a uniform strain is the same everywhere.
    """

    shift_x: float = math.nan
    shift_y: float = math.nan
    sigma_shift_x: float = math.nan
    sigma_shift_y: float = math.nan


def estimate_shift(
    positions: np.ndarray, axes: Sequence[int], modelled: np.ndarray, difference: np.ndarray, sigma: np.ndarray
) -> Shift:
    """Estimate where along the surface the model fits the measured displacement best.

    The difference is fitted by least squares with the change of the model's maps when the model moves along x and y,
    with a multiple of these maps (another modulus), and with a small rigid motion of the specimen. The changes are
    linear in the shift, which has to be small beside the features of the displacement. The noise of neighbouring points
    is as correlated as the residuals are.

    Parameters
    ----------
    positions : (3, row, column)
        Of the surface [m].
    axes
        Axis of each map of displacement: 0, 1, 2 for u, v, w.
    modelled, difference, sigma : (map, row, column)
        Of the model, filtered as the measurement; measured minus modelled; its standard uncertainty [m]. NaN where not
        known.

    Examples
    --------
    >>> y, x = np.mgrid[0.05:-0.05:60j, -0.05:0.05:60j]
    >>> bump = 1e-4 * np.exp(-(x**2 + y**2) / 0.02**2)
    >>> moved = 1e-4 * np.exp(-((x - 2e-4) ** 2 + y**2) / 0.02**2)
    >>> noise = np.random.default_rng(1).normal(0, 1e-9, x.shape)
    >>> maps = [each[np.newaxis] for each in (bump, moved - bump + noise, np.full(x.shape, 1e-9))]
    >>> found = estimate_shift(np.stack([x, y, 0 * x]), [0], *maps)
    >>> round(1e3 * found.shift_x, 2), round(1e3 * abs(found.shift_y), 2)  # [mm]
    (0.2, 0.0)
    """
    step = max(1, math.ceil(math.sqrt(positions[0].size / _MOST_POINTS)))
    positions, modelled, difference, sigma = (
        each[:, ::step, ::step].astype(float) for each in (positions, modelled, difference, sigma)
    )
    # a map f that moves by t becomes f(x - t): its change is minus its gradient
    changes = np.stack([-each for each in surface_gradient(positions, modelled)])
    found = fit_changes(changes, positions, axes, modelled, difference, sigma)
    if found is None:
        return Shift()
    shifts, deviations = found[0], np.sqrt(np.diag(found[1]))
    size = max(float(np.ptp(each[np.isfinite(each)])) for each in positions[:2])
    return Shift(*np.where(deviations < _DETERMINED * size, [shifts, deviations], np.nan).ravel().tolist())


def fit_changes(
    changes: np.ndarray,
    positions: np.ndarray,
    axes: Sequence[int],
    modelled: np.ndarray,
    difference: np.ndarray,
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Fit the difference by changes of the model's maps, beside a multiple of these maps and a rigid motion.

    Parameters
    ----------
    changes : (change, map, row, column)
        Per unit of each change.
    positions, axes, modelled, difference, sigma
        As of `estimate_shift`.

    Returns
    -------
    tuple or None
        The changes (change,) and their covariance, with the correlation of the residuals; None where too few points are
        known or a change is 0.
    """
    basis = np.stack([*changes, modelled, *rigid_motions(positions, axes)])
    known = np.isfinite(difference) & np.isfinite(basis).all(axis=0) & (sigma > 0)
    if np.count_nonzero(known) < 10 * len(basis):
        return None
    weighted = basis[:, known] / sigma[known]
    lengths = np.linalg.norm(weighted, axis=1)
    present = lengths > 0  # a rigid motion out of the plane changes no in-plane map
    number = len(changes)
    if not present[:number].all():
        return None
    weighted = weighted[present] / lengths[present, np.newaxis]
    measured = difference[known] / sigma[known]
    covariance = np.linalg.inv(weighted @ weighted.T + _RIDGE * np.eye(len(weighted)))
    solution = covariance @ (weighted @ measured)
    residual = np.full(known.shape, np.nan)
    residual[known] = measured - solution @ weighted
    together = max(correlated_points(each) for each in residual)
    scale = 1 / lengths[:number]
    return solution[:number] * scale, together * covariance[:number, :number] * np.outer(scale, scale)


def rigid_motions(positions: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Return the displacement maps of three translations and of three rotations about the middle of the surface."""
    offsets = positions - np.nanmean(positions, axis=(1, 2), keepdims=True)
    shape = positions.shape[1:]
    translations = [[np.full(shape, float(axis == along)) for axis in axes] for along in range(3)]
    rotations = [np.cross(unit, offsets, axisb=0, axisc=0)[list(axes)] for unit in np.eye(3)]
    return np.stack([*map(np.stack, translations), *rotations])
