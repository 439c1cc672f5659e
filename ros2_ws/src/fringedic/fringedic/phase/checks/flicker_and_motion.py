"""Checks whether the light or the place of the surface changed while the finest fringes were exposed.

A frame k that is brighter by g, whose fringes are displaced by e [rad] and whose texture is displaced by d [px] differs
from its sinusoid by ``g I + e B sin(phi - 2 pi k/q) - I d . grad(ln A)``. The fit of the sinusoid absorbs a part of
this difference, the same part for all pixels: Q = 1 - (hat matrix) leaves the rest. g, e (with its slopes over the
image) and d of all frames follow from one linear least-squares problem. Its normal matrix is the sum of products over
the pixels, times Q. The harmonics of a nonlinear response, of which all pixels have the same part, are fitted
with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.frames.noise import CameraNoise
from fringedic.phase.checks.light import light_changes
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.sinusoids import harmonic_levels, residual_maker, wave_levels, waves

# The scenes of benchmarks/stack_checks.py fix these limits
_FALSE_ALARMS = 1e-6  # so often a chi-square test reports pure noise
_REPORTED = 0.2  # a remark is made from this part of the allowed error on
_REPORTED_FLICKER = 0.02  # a remark is made from this change of the light on
_LARGEST_FLICKER = 0.6  # a frame whose light changes by more shows another pattern
_OFFSET = 0.004  # the surface alone may move the centre of the fringes' circle by this part of the mean
_OUTLIER = 9.0  # a pixel with so many times the median square of the residuals has half its weight
_LARGEST_MEAN = 0.35  # above this mean of exp(i phi) over the pixels, single frames cannot be distinguished
_RANK = 1e-6  # singular values below this part of the largest are not determined by the frames


def find_changes(sample: Sample, camera: CameraNoise, largest_error: float, largest_motion: float) -> list[Finding]:
    """Return the changes of light and surface between the finest fringes.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    camera
        Noise of a grey level.
    largest_error
        Error of the phase, RMS over the image [fringe], that is allowed.
    largest_motion
        Motion across the image [px] that is allowed.

    Returns
    -------
    list of Finding
        `FLICKER`, `MOTION_ACROSS` and `MOTION_ALONG`: faults above these limits, remarks below.
    """
    if len(sample.angles[-1]) < 4 or not _covers_all_phases(sample):
        return []
    fringes = _Fringes.of(sample)
    changes = _fit_changes(sample, fringes, camera)
    count = changes.frames
    found = []
    light, modulation = changes.light, fringes.modulation
    # eq. 11 of the light's change: sin(angle - phi) / B, times the model
    error = np.einsum("kp,kp,k->p", fringes.quadrature, fringes.model, -2 / changes.frames * light) / modulation**2
    rms = float(np.std(error)) / (2 * np.pi)
    flicker = Finding(
        FindingKind.FLICKER, rms > largest_error, value=rms, limit=largest_error, light_change=float(np.ptp(light))
    )
    along_x, along_y = changes.texture
    motion = float(np.hypot(np.ptp(along_x), np.ptp(along_y)))
    across = Finding(FindingKind.MOTION_ACROSS, motion > largest_motion, value=motion, limit=largest_motion)
    wander = changes.fringes - changes.fringes.mean(axis=1, keepdims=True)
    # the slopes belong to coordinates of -1 to 1, whose mean square is 1/3
    swing = float(
        np.sqrt(np.mean(wander[0] ** 2) + (np.mean(wander[1] ** 2) + np.mean(wander[2] ** 2)) / 3) / (2 * np.pi)
    )
    along = Finding(FindingKind.MOTION_ALONG, swing > largest_error, value=swing, limit=largest_error)
    for finding, parameters in (
        (flicker, slice(0, count)),
        (across, slice(4 * count, None)),
        (along, slice(count, 4 * count)),
    ):
        worth = finding.value > _REPORTED * finding.limit or finding.light_change > _REPORTED_FLICKER
        if worth and _is_significant(*changes.part(parameters)):
            found.append(finding)
    return found


def without_changes(sample: Sample, camera: CameraNoise) -> list[Sample]:
    """Return the sample without changes of the light in all pitches, and without all changes of the finest fringes.

    Changes of the light that are too large for a flicker are left out.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    camera
        Noise of a grey level.
    """
    fringes = _Fringes.of(sample)
    changes = _fit_changes(sample, fringes, camera)
    relative = changes.relative_levels(sample, fringes)
    where = sample.layout.slices()[-1]
    parts = {}
    for name in ("levels", "right", "left", "below", "above"):
        levels = getattr(sample, name).copy()
        levels[where] -= relative * levels[where].mean(axis=0)
        parts[name] = levels
    gains = light_changes(sample)
    trials = (
        (np.ptp(gains), sample.with_light(gains)),
        (np.ptp(changes.light), replace(sample, **parts, angles=[], fits=[], _growth={})),
    )
    return [each for change, each in trials if change < _LARGEST_FLICKER]


@dataclass(frozen=True)
class _Fringes:
    """The finest fringes at the sampled pixels: levels and fitted sinusoids (frame, pixel), modulation (pixel,)."""

    angles: np.ndarray
    levels: np.ndarray
    fit: np.ndarray
    model: np.ndarray
    quadrature: np.ndarray  # B sin(phi - 2 pi k/q)
    modulation: np.ndarray

    @classmethod
    def of(cls, sample: Sample) -> _Fringes:
        angles, fit = sample.angles[-1], sample.fits[-1]
        return cls(
            angles=angles,
            levels=sample.levels[sample.layout.slices()[-1]],
            fit=fit,
            model=wave_levels(fit, angles),
            quadrature=np.outer(np.cos(angles), fit[2]) - np.outer(np.sin(angles), fit[1]),
            modulation=np.hypot(fit[1], fit[2]),
        )


@dataclass(frozen=True)
class _Changes:
    """Changes of the frames with their covariance.

    The parameters are the change of the light of each frame, the displacement of its fringes [rad] with its slopes over
    the image (3 per frame), and the displacement of its texture along x and y [px].
    """

    frames: int
    values: np.ndarray
    covariance: np.ndarray

    def part(self, parameters: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return some of the parameters with their covariance."""
        return self.values[parameters], self.covariance[parameters, parameters]

    @property
    def light(self) -> np.ndarray:
        return self.values[: self.frames]

    @property
    def fringes(self) -> np.ndarray:
        return self.values[self.frames : 4 * self.frames].reshape(3, self.frames)

    @property
    def texture(self) -> np.ndarray:
        return self.values[4 * self.frames :].reshape(2, self.frames)

    def relative_levels(self, sample: Sample, fringes: _Fringes) -> np.ndarray:
        """Return the effect on the grey levels over their mean, shape (frame, pixel)."""
        parts = _design(sample, fringes, 1 / fringes.fit[0])
        return np.asarray(np.einsum("fkp,fk->kp", parts, self.values.reshape(6, self.frames)))


def _covers_all_phases(sample: Sample) -> bool:
    turns = np.exp(1j * np.arctan2(sample.fits[-1][2], sample.fits[-1][1]))
    return sample.has_many_fringes and not any(
        abs(np.mean(each)) > _LARGEST_MEAN for each in (turns, turns**2, turns**3)
    )


def _fit_changes(sample: Sample, fringes: _Fringes, camera: CameraNoise) -> _Changes:
    """Return the least-squares estimate of the changes of all frames."""
    count, pixels = fringes.levels.shape
    rest = fringes.levels - fringes.model
    # A pixel weighs the inverse of its noise, and less where the sinusoid fits badly (shadow edges).
    weight = 1 / np.sqrt(camera.variance(np.maximum(fringes.fit[0], 0)))
    square = np.sum(rest**2, axis=0) * weight**2
    weight = np.asarray(weight / np.sqrt(1 + square / max(_OUTLIER * float(np.median(square)), 1e-12)))
    rest = rest * weight
    parts = _design(sample, fringes, weight).reshape(6 * count, pixels)
    normal = np.tile(residual_maker(fringes.angles), (6, 6)) * (parts @ parts.T)
    right = np.einsum("fkp,kp->fk", parts.reshape(6, count, pixels), rest).ravel()
    harmonics = harmonic_levels(fringes.fit, fringes.angles) * weight
    normal, right, explained = _without_harmonics(normal, right, parts, rest, harmonics)
    noise = (
        float(np.sum(rest**2)) - explained - float(right @ np.linalg.pinv(normal, rcond=_RANK, hermitian=True) @ right)
    )
    _add_circle_condition(normal, right, sample, fringes)
    inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
    scatter = noise / (pixels * (count - 3)) if count > 3 else 1.0
    return _Changes(count, inverse @ right, inverse * max(scatter, 1.0))


def _without_harmonics(
    normal: np.ndarray, right: np.ndarray, parts: np.ndarray, rest: np.ndarray, harmonics: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Eliminate the strengths of the harmonics from the normal equations (Schur complement).

    Also returns the sum of the squared residuals that the harmonics explain.
    """
    both = np.einsum("fkp,mkp->fkm", parts.reshape(-1, *rest.shape), harmonics).reshape(len(parts), -1)
    flat = harmonics.reshape(len(harmonics), rest.size)
    inverse = np.linalg.pinv(flat @ flat.T, rcond=_RANK, hermitian=True)
    strength = inverse @ (flat @ rest.ravel())
    return normal - both @ inverse @ both.T, right - both @ strength, float(strength @ (flat @ rest.ravel()))


def _design(sample: Sample, fringes: _Fringes, weight: np.ndarray) -> np.ndarray:
    """Return the weighted derivatives of the grey levels by the six changes, shape (6, frame, pixel)."""
    light, fringe = fringes.model * weight, fringes.quadrature * weight
    along, down = _texture_shares(sample, fringes)
    parts = np.empty((6, *fringes.levels.shape))
    for part, (base, factor) in zip(
        parts,
        (
            (light, None),
            (fringe, None),
            (fringe, sample.x),
            (fringe, sample.y),
            (light, along),
            (light, down),
        ),
        strict=True,
    ):
        part[...] = base if factor is None else base * factor
    return parts


def _texture_shares(sample: Sample, fringes: _Fringes) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative change of the grey levels for a texture displaced by 1 px along x and y, shape (pixel,)."""
    where = sample.layout.slices()[-1]
    right, left, below, above = (
        each[where].mean(axis=0) for each in (sample.right, sample.left, sample.below, sample.above)
    )
    return 0.5 * (left - right) / fringes.fit[0], 0.5 * (above - below) / fringes.fit[0]


def _add_circle_condition(normal: np.ndarray, right: np.ndarray, sample: Sample, fringes: _Fringes) -> None:
    """Add what the mean and the sinusoid of each pixel tell of the changes.

    A jump in the middle of four shifts displaces the sinusoids and leaves no residual beside the second harmonic of a
    nonlinear response; light that changes like cos(2 pi k/q) looks like displaced fringes. But (C/A, S/A) of all pixels
    lie on a circle, whose radius is the contrast. Changing light displaces its centre, and a moving texture displaces
    it in proportion to the gradient of the texture. The centre follows from the linear fit of a circle, with parts for
    a contrast that changes over the image or with the brightness, for displaced fringes (2 phi) and for harmonics
    (q phi).

    References
    ----------
    I. Kasa, "A circle fitting procedure and its error analysis", IEEE Transactions on Instrumentation and Measurement
    25 (1976) 8-14.
    """
    count, fit = len(fringes.angles), fringes.fit
    cosine, sine = fit[1] / fit[0], fit[2] / fit[0]
    square = cosine**2 + sine**2
    phase = np.arctan2(sine, cosine)
    even = np.ones_like(square)
    turns = [turn(number * phase) for number in {2, sample.layout.periods[-1][0].shifts} for turn in (np.cos, np.sin)]
    centre = [2 * share * axis for share in (even, *_texture_shares(sample, fringes)) for axis in (cosine, sine)]
    parts = np.stack([*centre, even, sample.x, sample.y, fit[0].mean() / fit[0], *turns])
    away = np.abs(square - np.median(square))
    trust = 1 / (1 + (away / max(3 * float(np.median(away)), 1e-9)) ** 2)
    inverse = np.linalg.pinv((parts * trust) @ parts.T, rcond=_RANK, hermitian=True)
    values = inverse @ (parts * trust) @ square
    scatter = np.average((square - values @ parts) ** 2, weights=trust)
    known = len(centre)
    covariance = inverse[:known, :known] * scatter
    covariance[[0, 1], [0, 1]] += _OFFSET**2
    courses = np.zeros((known, len(right)))
    for number, first in enumerate((0, 4 * count, 5 * count)):  # light, texture along x and y
        courses[2 * number : 2 * number + 2, first : first + count] = waves(fringes.angles)[:, 1:].T * (2 / count)
    weight = np.linalg.pinv(covariance, rcond=_RANK, hermitian=True) @ courses
    normal += courses.T @ weight
    right += values[:known] @ weight


def _is_significant(values: np.ndarray, covariance: np.ndarray) -> bool:
    """Return whether these values together exceed what noise alone gives (chi-square test)."""
    inverse = np.linalg.pinv(covariance, rcond=_RANK, hermitian=True)
    freedom = int(np.linalg.matrix_rank(covariance, rtol=_RANK, hermitian=True))
    return bool(values @ inverse @ values > chdtri(max(freedom, 1), _FALSE_ALARMS))
