"""What changed while the finest fringes were exposed: the light, or the place of the surface."""

from __future__ import annotations

import math

import numpy as np

from fringedic.errors import FlickerError, MovedSurfaceError
from fringedic.phase.noise import CameraNoise
from fringedic.phase.sample import Sample, wave_levels
from fringedic.phase.steps import CONFIDENCE

_NOTICED = 0.2  # part of the error allowed from which the operator is told
_NOTICED_FLICKER = 0.02  # change of the light from which the operator is told
_CUT_FRINGES = 0.02  # what C/A keeps of the fringes when they do not cover all phases equally
_CHANCE = 2.0  # standard deviations of C/A over pixels of random phases that are no change of the light
_SPREAD = 0.35  # largest mean of exp(i phi) over the pixels for which frames can be told apart


def check_steadiness(sample: Sample, camera: CameraNoise, largest_error: float, largest_motion: float) -> list[str]:
    """Raise or tell when the light or the surface changed between the frames of the finest fringes.

    A frame k that is brighter by g, displaced by e [rad] and whose texture is displaced by d [px] differs from its
    sinusoid by ``g I + e B sin(phi - 2 pi k/q) - I d . grad(ln A)``. The sinusoid's own fit takes part of that away,
    the same part for all pixels: Q = 1 - (hat matrix). So g, e (with its slopes over the image) and d of all frames
    follow from one linear least-squares problem whose normal matrix is the pixels' sum of products, times Q.
    """
    where, angles, fit = sample.layout.slices()[-1], sample.angles[-1], sample.fits[-1]
    count = len(angles)
    if count < 4:
        return []
    levels = sample.levels[where]
    strength = np.hypot(fit[1], fit[2])
    phase = np.arctan2(fit[2], fit[1])
    turns = np.exp(1j * phase)
    if not sample.has_many_fringes or any(abs(np.mean(each)) > _SPREAD for each in (turns, turns**2, turns**3)):
        return []
    model = wave_levels(fit, angles)
    # B sin(phi - angle), from B cos(phi) and B sin(phi)
    wave = np.outer(np.cos(angles), fit[2]) - np.outer(np.sin(angles), fit[1])
    along = 0.5 * (sample.right[where].mean(axis=0) - sample.left[where].mean(axis=0))
    down = 0.5 * (sample.below[where].mean(axis=0) - sample.above[where].mean(axis=0))
    weight = 1 / np.sqrt(camera.variance(fit[0]))
    pixels = levels.shape[1]
    parts = np.empty((6, count, pixels))
    lit, wavy = model * weight, wave * weight
    factors = ((lit, None), (wavy, None), (wavy, sample.x), (wavy, sample.y), (lit, -along / fit[0]))
    for part, (base, factor) in zip(parts, (*factors, (lit, -down / fit[0])), strict=True):
        part[...] = base if factor is None else base * factor
    rest = (levels - model) * weight
    waves = np.stack([np.ones(count), np.cos(angles), np.sin(angles)], axis=1)
    left = np.eye(count) - waves @ np.linalg.pinv(waves)
    stacked = parts.reshape(6 * count, pixels)
    normal = np.tile(left, (6, 6)) * (stacked @ stacked.T)
    right = np.einsum("fkp,kp->fk", parts, rest).ravel()
    # Light that changes like cos(2 pi k/q) looks like displaced fringes to every single pixel; but it gives all pixels
    # the same C/A, whose mean over fringes of all phases is 0 otherwise. The taper keeps cut fringes out of that mean;
    # few pixels have a mean of their own.
    taper = (1 - sample.x**2) ** 2 * (1 - sample.y**2) ** 2
    chance = float(np.mean(strength / fit[0])) * math.sqrt(float(np.sum(taper**2)) / 2) / float(np.sum(taper))
    least = max(_CUT_FRINGES, _CHANCE * chance)
    for number, course in ((1, np.cos(angles)), (2, np.sin(angles))):
        course = np.pad(2 / count * course, (0, len(right) - count))
        offset = float(np.average(fit[number] / fit[0], weights=taper))
        normal += normal[0, 0] * np.outer(course, course)
        right += normal[0, 0] * course * (offset if abs(offset) > least else 0.0)
    inverse = np.linalg.pinv(normal, rcond=1e-6, hermitian=True)
    found = inverse @ right
    covariance = inverse * float(np.sum(rest**2)) / (pixels * (count - 3))
    light, lifted, across, along_rows = (
        found[:count],
        found[count : 4 * count],
        found[4 * count : 5 * count],
        found[5 * count :],
    )

    # eq. 11 of the light's change: sin(angle - phi) / B, times the model
    bent = np.einsum("kp,kp,k->p", wave, model, -2 / count * light) / strength**2
    wander = lifted.reshape(3, count) - lifted.reshape(3, count).mean(axis=1, keepdims=True)
    lift = np.sqrt(np.mean(wander[0] ** 2) + (np.mean(wander[1] ** 2) + np.mean(wander[2] ** 2)) / 3) / (2 * np.pi)
    motion = float(np.hypot(np.ptp(across), np.ptp(along_rows)))
    bend = float(np.std(bent)) / (2 * np.pi)
    remarks = []
    for value, limit, which, kind, words in (
        (
            bend,
            largest_error,
            slice(0, count),
            FlickerError,
            f"the light changes by {100 * np.ptp(light):.1f} % between the frames (flicker), which bends the phase by "
            f"{bend:.4f} fringe",
        ),
        (
            motion,
            largest_motion,
            slice(4 * count, None),
            MovedSurfaceError,
            f"the surface moved by {motion:.2f} px across the image while its frames were taken",
        ),
        (
            float(lift),
            largest_error,
            slice(count, 4 * count),
            MovedSurfaceError,
            f"the surface moved along the projector's light while its frames were taken: the fringes wander by "
            f"{lift:.4f} fringe",
        ),
    ):
        noticed = value > _NOTICED * limit or (kind is FlickerError and np.ptp(light) > _NOTICED_FLICKER)
        if not noticed or not _significant(found[which], covariance[which, which]):
            continue
        if value > limit:
            raise kind(f"{words}; {limit:g} is allowed")
        remarks.append(words)
    return remarks


def _significant(found: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether these values together are more than what noise makes of nothing."""
    inverse = np.linalg.pinv(covariance, rcond=1e-6, hermitian=True)
    freedom = int(np.linalg.matrix_rank(covariance, rtol=1e-6, hermitian=True))
    return bool(found @ inverse @ found > freedom + CONFIDENCE * math.sqrt(2 * max(freedom, 1)) + CONFIDENCE**2)
