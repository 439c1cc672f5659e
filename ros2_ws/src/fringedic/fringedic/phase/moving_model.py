"""Least squares of phase stepping with a drift: tables of each cell, condition number, and the start of the drift.

A material point shows ``y_k = A + B cos(phi + omega t_k + alpha t_k^2 / 2 - delta_k)``. With
psi_k = delta_k - omega t_k - alpha t_k^2 / 2 this is ``A + C cos psi_k + S sin psi_k``, C = B cos phi, S = B sin phi.
Times are in units of the mean interval of the frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from fringedic.frames.interpolation import tabulate_noise_gain
from fringedic.phase.moving_kernel import CELL, CellTables

f4 = np.float32

LARGEST_CONDITION = 10.0
"""Of a valid point. At rest it is 1.4 to 3; the phase is then twice as noisy as the best shifts would give."""

_WIDEST = np.pi  # [rad per frame] from the predicted drift on either side: beyond, frames alias
_STEPS = 192  # of the drift over this range
_PER_WAVE = 4  # trial drifts for half a wave over the stack
_GAIN_STEPS = 64
_RIDGE = 1e-7  # of the mean eigenvalue: tables of cells that are not valid have to be finite


@dataclass(frozen=True)
class Shown:
    """Times and projected shifts of the frames of one pitch.

    Attributes
    ----------
    times
        In units of the mean interval, from the time of the phase.
    angles
        Projected shift delta_k [rad].
    """

    times: np.ndarray
    angles: np.ndarray


def condition_number(shown: Shown, drift: np.ndarray) -> np.ndarray:
    """Return the condition number of the fit of mean, cosine, sine and drift, at the worst phase.

    The columns of the design matrix have unit length; the spectral condition is bounded from above by that of the
    Frobenius norm, which is smooth in the drift.

    Parameters
    ----------
    shown
        The frames.
    drift
        Of the phase [rad per interval], any shape.

    Examples
    --------
    The shift of 1/8 turn per frame, followed by a phase that drifts by as much, and by one that drifts against it.

    >>> shown = Shown(np.arange(8) - 3.5, 2 * np.pi * np.arange(1, 9) / 8)
    >>> condition_number(shown, np.array([0.0, np.pi / 4, -np.pi / 4])) < LARGEST_CONDITION
    array([ True, False,  True])
    """
    psi = shown.angles - np.asarray(drift)[..., None] * shown.times
    worst = np.zeros(psi.shape[:-1])
    for phase in np.linspace(0, np.pi, 8, endpoint=False):
        columns = [np.ones_like(psi), np.cos(psi), np.sin(psi), shown.times * np.sin(psi - phase)]
        design = np.stack(columns, axis=-1)
        design /= np.maximum(np.linalg.norm(design, axis=-2, keepdims=True), 1e-12)
        values = np.linalg.eigvalsh(design.swapaxes(-1, -2) @ design)
        worst = np.maximum(worst, np.sqrt(values[..., -1] / np.maximum(values[..., 0], 1e-12)))
    return worst


@dataclass(frozen=True)
class DriftRange:
    """Drifts around a predicted one that can be told apart from each other, with their condition numbers.

    Attributes
    ----------
    drifts
        [rad per interval], rising.
    conditions
        Of each.
    """

    drifts: np.ndarray
    conditions: np.ndarray

    @classmethod
    def around(cls, shown: Shown, predicted: float) -> DriftRange | None:
        """Return the connected range of good condition that contains a predicted drift; None if its own is bad.

        Beyond a drift of bad condition a wave has the same frames as its mirror image on this side.
        """
        drifts = predicted + np.linspace(-_WIDEST, _WIDEST, 2 * _STEPS + 1)
        conditions = condition_number(shown, drifts)
        bad = np.flatnonzero(conditions > LARGEST_CONDITION)
        if conditions[_STEPS] > LARGEST_CONDITION:
            return None
        first = max((k + 1 for k in bad if k < _STEPS), default=0)
        last = min((k for k in bad if k > _STEPS), default=len(drifts))
        return cls(drifts[first:last], conditions[first:last])

    def condition_at(self, drift: np.ndarray) -> np.ndarray:
        """Return the condition number at drifts [rad per interval]; infinite beyond the range."""
        return np.asarray(np.interp(drift, self.drifts, self.conditions, left=np.inf, right=np.inf))


def find_drift(samples: np.ndarray, shown: Shown, within: DriftRange) -> np.ndarray:
    """Return the drift of each cell whose waves explain most of the grey levels of its pixels and of its neighbours'.

    Parameters
    ----------
    samples
        Aligned grey levels (cell row, cell column, pixel, frame); NaN where not measured.
    shown
        The frames.
    within
        Range that is searched.

    Returns
    -------
    ndarray
        [rad per interval], shape (cell row, cell column); NaN where nothing is measured or the best is at an end of the
        range.
    """
    centred = samples - samples.mean(axis=-1, keepdims=True)
    centred = np.where(np.isfinite(centred).all(axis=-1, keepdims=True), centred, 0)
    products = np.einsum("ijpk,ijpl->ijkl", centred, centred, optimize=True)
    count = max(9, math.ceil((within.drifts[-1] - within.drifts[0]) * _PER_WAVE * len(shown.times) / np.pi))
    drifts = np.linspace(within.drifts[0], within.drifts[-1], count)
    psi = shown.angles - drifts[:, None] * shown.times
    basis = np.stack([np.ones_like(psi), np.cos(psi), np.sin(psi)], axis=-1)
    projector = basis @ np.linalg.pinv(basis)
    explained = np.einsum("dkl,ijkl->ijd", projector, products, optimize=True)
    explained = uniform_filter(explained, size=(3, 3, 1), mode="nearest")
    best = np.clip(explained.argmax(axis=-1), 1, count - 2)[..., None]
    left, middle, right = (np.take_along_axis(explained, best + k, axis=-1)[..., 0] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = 0.5 * (left - right) / bend
    found = drifts[best[..., 0]] + offset * (drifts[1] - drifts[0])
    return np.where((np.abs(offset) <= 1) & (bend < 0), found, np.nan)


def tabulate_cells(
    shown: Shown, drift: np.ndarray, curvature: np.ndarray, gain: np.ndarray, *, free_drift: bool
) -> CellTables:
    """Return the filters and covariances of the fit in each cell.

    Parameters
    ----------
    shown
        The frames.
    drift, curvature
        omega and alpha of the cells, shape (cell row, cell column) [rad per interval and its square].
    gain
        Variance of a grey level after its alignment over that before, shape (cell row, cell column, frame).
    free_drift
        Whether the drift is estimated: five parameters instead of three.
    """
    t = shown.times
    psi = shown.angles - drift[..., None] * t - 0.5 * curvature[..., None] * t**2
    cosine, sine = np.cos(psi), np.sin(psi)
    columns = [np.ones_like(psi), cosine, sine]
    if free_drift:
        columns += [t * cosine, t * sine]
    design = np.stack(columns, axis=-1)
    normal = design.swapaxes(-1, -2) @ design
    size = design.shape[-1]
    normal += _RIDGE * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] / size * np.eye(size)
    filters = np.linalg.solve(normal, design.swapaxes(-1, -2))
    covariance = (filters * gain[..., None, :]) @ filters.swapaxes(-1, -2)
    omitted = np.stack([t**2 / 2 * cosine, t**2 / 2 * sine, t**3 / 6 * cosine, t**3 / 6 * sine], axis=-1)
    return CellTables(filters.astype(f4), covariance.astype(f4), (filters @ omitted).astype(f4))


def interpolation_gain(displacement: np.ndarray) -> np.ndarray:
    """Return the variance of white noise after the interpolation at displacements (2, ...) [px] over that before."""
    table = tabulate_noise_gain(_GAIN_STEPS)
    places = np.linspace(0, 1, _GAIN_STEPS + 1)
    along, down = (np.interp(each % 1, places, table) for each in displacement)
    return np.asarray(along * down)


def at_cells(values: np.ndarray) -> np.ndarray:
    """Return the values of an image (..., row, column) at the middle pixels of the cells."""
    rows, columns = values.shape[-2:]
    middle_rows, middle_columns = (
        np.minimum(np.arange(-(-size // CELL)) * CELL + CELL // 2, size - 1) for size in (rows, columns)
    )
    return values[..., middle_rows[:, None], middle_columns]


def spread(cells: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return values of the cells at all their pixels."""
    return np.repeat(np.repeat(cells, CELL, axis=-2), CELL, axis=-1)[..., : shape[0], : shape[1]]
