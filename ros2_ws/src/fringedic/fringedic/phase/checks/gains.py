"""Estimates the gain of each frame, by which flickering light makes it brighter or darker, where its frames give it.

A frame is ``I_k = g_k (A + B cos(phi - 2 pi k/q))``. The gains g_k of a pitch, of mean 1, are common to all pixels. The
sinusoid of a pixel takes a part of their effect with it; what it leaves, Q = 1 - (hat matrix), gives the gains by
weighted least squares over the pixels, with the harmonics of the response (variable projection). The frames give them
where they are more than three and the pixels have phases all over the circle: with one phase in all pixels, some
gains look like another mean or another sinusoid.

Gains that change like cos(2 pi k/q) leave the same residual as displaced fringes. Where fringes are displaced too, that
part of the gains follows from the centre of the circle of `circle_centre`, with a larger uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtrc  # scipy.stats takes each node half a second to load

from fringedic.frames.noise import CameraNoise
from fringedic.phase.checks.flicker_and_motion import (
    LARGEST_FLICKER,
    LIGHT,
    Fringes,
    centre_courses,
    circle_centre,
    compare_causes,
    covers_all_phases,
    phase_changes,
    weighted_residuals,
    without_harmonics,
)
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.sinusoids import harmonic_levels, residual_maker

_FALSE_ALARMS = 1e-6  # so often a test reports gains that are only noise, or a circle displaced by noise alone
_ROUNDS = 5  # of Gauss-Newton: changes of 15 % are then exact to 1e-5
_CONVERGED = 1e-5
_TILES = 8  # along each side of the bounding box of the pixels; those of a tile count as one observation
_PROJECTOR = {FindingKind.FLICKER, FindingKind.UNEVEN_LIGHT}
_DISPLACED = {FindingKind.MOTION_ALONG, FindingKind.DISPLACED_FRAME}
_RANK = 1e-8  # eigenvalues below this part of the largest are not determined


@dataclass(frozen=True)
class Gains:
    """Gains of the frames of a stack.

    Attributes
    ----------
    values
        Gain of each frame, of mean 1 in each pitch; 1 where no flicker is found, shape (frame,).
    covariance
        Of the gains of each pitch, shape (frame, frame) of that pitch; 0 where no flicker is found.
    finding
        The flicker, with the error of the phase that would remain; None without any.
    """

    values: np.ndarray
    covariance: list[np.ndarray]
    finding: Finding | None

    @property
    def covers_flicker(self) -> bool:
        """Whether some gains differ from 1."""
        return bool(np.ptp(self.values) > 0)


def fit_gains(sample: Sample, camera: CameraNoise, largest_error: float) -> Gains:
    """Estimate the gains of the frames of a stack.

    The gains of a pitch are used where they differ from 1 by more than noise (Hotelling's test, one false alarm in a
    million), explain more of the residuals than any other cause, and displace the centre of the circle of
    `circle_centre` as far as it is displaced.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    camera
        Noise of a grey level.
    largest_error
        Error of the phase [fringe], RMS over the image, that uncertain gains may cause.

    Returns
    -------
    Gains
        The finding is a fault where the frames do not determine the gains of fringes that give the phase.

    References
    ----------
    K.-Y. Liang, S. L. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73 (1986) 13-22:
    covariance from the scores of clusters, here image tiles, which holds for residuals that neighbours share.
    """
    layout = sample.layout
    values = np.ones(len(sample.levels))
    covariance = [np.zeros((count, count)) for count in layout.counts]
    found = []
    for number, where in enumerate(layout.slices()):
        estimate = _fit_pitch(sample, number, camera)
        if estimate is None:
            continue
        fitted = estimate.error <= largest_error
        if fitted:
            values[where], covariance[number] = estimate.gains, estimate.covariance
        # coarser fringes give the orders only
        fault = not fitted and (layout.by_beats or number == len(layout.counts) - 1)
        if fitted or (fault and estimate.effect > largest_error):
            found.append(
                Finding(
                    FindingKind.GAINS,
                    fault,
                    tuple(range(where.start, where.stop)),
                    layout.periods[number],
                    value=estimate.error,
                    limit=largest_error,
                    light_change=float(np.ptp(estimate.gains)),
                )
            )
    worst = max(found, key=lambda each: (each.fault, each.light_change), default=None)
    return Gains(values, covariance, worst)


@dataclass(frozen=True)
class _Estimate:
    """Gains of a pitch.

    Attributes
    ----------
    gains, covariance
        Of each frame.
    effect
        Error of the phase [fringe RMS] that these gains cause.
    error
        The same by their uncertainty; infinite where the phases of the pixels do not determine them.
    """

    gains: np.ndarray
    covariance: np.ndarray
    effect: float
    error: float


def _fit_pitch(sample: Sample, number: int, camera: CameraNoise) -> _Estimate | None:
    """Return the gains of a pitch; None where they are 1 within noise or do not explain the residuals best."""
    fringes = Fringes.of(sample, number)
    count = len(fringes.angles)
    if count < 4:
        return None
    ranked = compare_causes(sample, fringes, camera).ranked
    covered = covers_all_phases(fringes.fit)
    # what uneven light leaves after the fit is checked then; of one phase, the light of projector and room look alike
    if not ranked or ranked[0] not in (_PROJECTOR if covered else LIGHT):
        return None
    # the gains of four frames explain what displaced fringes leave, too
    displaced = covered and (count == 4 or not _DISPLACED.isdisjoint(ranked))
    gains, corrected = np.ones(count), fringes
    for _ in range(_ROUNDS):
        step = _Step.of(sample, corrected, camera, displaced=displaced)
        gains = gains * (1 + step.change)
        gains /= gains.mean()
        corrected = fringes.with_gains(gains)
        if np.abs(step.change).max() < _CONVERGED:
            break
    if np.ptp(gains) > LARGEST_FLICKER or not step.is_significant(gains - 1):
        return None
    changes = phase_changes(corrected)
    effect = float(np.sqrt(np.mean((changes @ (gains - 1)) ** 2))) / (2 * np.pi)
    if not covered:
        return _Estimate(gains, step.covariance, effect, np.inf)
    centre, covariance = circle_centre(sample, corrected)
    if float(centre[:2] @ np.linalg.solve(covariance[:2, :2], centre[:2])) > chdtri(2, _FALSE_ALARMS):
        return None
    error = float(np.sqrt(np.mean(np.sum(changes @ step.covariance * changes, axis=1)))) / (2 * np.pi)
    return _Estimate(gains, step.covariance, effect, error)


@dataclass(frozen=True)
class _Step:
    """Step of the least-squares estimate of the gains; `change` has the mean 0."""

    change: np.ndarray
    covariance: np.ndarray
    tiles: int

    @classmethod
    def of(cls, sample: Sample, fringes: Fringes, camera: CameraNoise, *, displaced: bool) -> _Step:
        """Return a step; `displaced`: the displacement of the fringes of each frame is fitted too."""
        count = len(fringes.angles)
        weight, rest = weighted_residuals(fringes, camera)
        parts = fringes.model * weight
        if displaced:
            parts = np.concatenate([parts, fringes.quadrature * weight])
        kinds = len(parts) // count
        harmonics = harmonic_levels(fringes.fit, fringes.angles) * weight
        maker = residual_maker(fringes.angles)
        normal = np.tile(maker, (kinds, kinds)) * (parts @ parts.T)
        right = np.sum(parts.reshape(kinds, count, -1) * rest, axis=2).ravel()
        reduced = without_harmonics(normal, right, parts, rest, harmonics)
        hessian, values = reduced.normal[:count, :count], reduced.right[:count]
        known = np.zeros_like(hessian)
        if displaced:  # eliminated like the harmonics; the centre of the circle gives what both have in common
            both, own = reduced.normal[:count, count:], reduced.normal[count:, count:]
            alone = np.linalg.pinv(own, rcond=_RANK, hermitian=True)
            share = both @ alone
            centre, covariance = circle_centre(sample, fringes)
            courses = centre_courses(fringes.angles)
            weighted = courses.T @ np.linalg.inv(covariance[:2, :2])
            known = weighted @ courses
            hessian, values = hessian - share @ both.T, values - share @ reduced.right[count:] + weighted @ centre[:2]
        free = _zero_mean(count)
        solver = free @ np.linalg.pinv(free.T @ (hessian + known) @ free, rcond=_RANK, hermitian=True) @ free.T
        values = change = solver @ values
        if displaced:
            values = np.concatenate([change, alone @ (reduced.right[count:] - both.T @ change)])
        left = rest - maker @ np.sum((parts * values[:, None]).reshape(kinds, count, -1), axis=0)
        left -= np.tensordot(reduced.strength - values @ reduced.share, harmonics, axes=1)
        scores = (parts.reshape(kinds, count, -1) * left).reshape(len(parts), -1)
        scores -= reduced.share @ np.einsum("mkp,kp->mp", harmonics, left)
        if displaced:
            scores = scores[:count] - share @ scores[count:]
        sums = _sums_of_tiles(sample, scores)
        tiles = sums.shape[1]
        meat = sums @ sums.T * (tiles / max(tiles - count, 1)) + known
        return cls(change, solver @ meat @ solver, tiles)

    def is_significant(self, change: np.ndarray) -> bool:
        """Return whether a change exceeds what noise alone gives (Hotelling's test, tiles as observations)."""
        freedom = int(np.linalg.matrix_rank(self.covariance, rtol=_RANK, hermitian=True))
        rest = self.tiles - freedom
        if freedom == 0 or rest < 1:
            return False
        square = float(change @ np.linalg.pinv(self.covariance, rcond=_RANK, hermitian=True) @ change)
        return bool(fdtrc(freedom, rest, square / freedom) < _FALSE_ALARMS)


def _sums_of_tiles(sample: Sample, values: np.ndarray) -> np.ndarray:
    """Return the sums of values (any, pixel) over the pixels of each tile of their bounding box that has some."""
    row, column = (
        np.minimum((each - each.min()) * (_TILES / max(float(np.ptp(each)), 1e-9)), _TILES - 1).astype(int)
        for each in (sample.y, sample.x)
    )
    used, tile = np.unique(row * _TILES + column, return_inverse=True)
    return np.array([np.bincount(tile, each, len(used)) for each in values])


def _zero_mean(count: int) -> np.ndarray:
    """Return an orthonormal basis of the vectors of mean 0, shape (count, count - 1)."""
    basis, _ = np.linalg.qr(np.concatenate([np.ones((count, 1)), np.eye(count)[:, 1:]], axis=1))
    return np.asarray(basis[:, 1:])
