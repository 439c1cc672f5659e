"""Checks whether the light or the place of the surface changed while the finest fringes were exposed.

A frame k that is brighter by g, whose fringes are displaced by e [rad] and whose texture is displaced by d [px] differs
from its sinusoid by ``g I + e B sin(phi - 2 pi k/q) - I d . grad(ln A)``. The fit of the sinusoid absorbs a part of
this difference, the same part for all pixels: Q = 1 - (hat matrix) leaves the rest. g, e (with its slopes over the
image) and d of all frames follow from one linear least-squares problem. Its normal matrix is the sum of products over
the pixels, times Q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.noise import CameraNoise
from fringedic.phase.checks.sampling import Sample, wave_levels
from fringedic.phase.demodulation_kernel import CONFIDENCE

# test_flicker_is_measured, test_a_single_flash_is_found_although_four_frames_hide_where,
# test_a_surface_that_moves_during_its_stack_is_named and test_a_good_stack_passes_without_remarks fix these limits
_REPORTED = 0.2  # part of the allowed error from which a remark is made
_REPORTED_FLICKER = 0.02  # change of the light from which a remark is made
_CUT_FRINGES = 0.02  # of C/A: what the fringes leave in its mean when they do not cover all phases equally
_CHANCE = 2.0  # standard deviations of the mean C/A of pixels of random phases
_LARGEST_MEAN = 0.35  # of exp(i phi) over the pixels; above, single frames cannot be distinguished
_RANK = 1e-6  # singular values below this part of the largest are not determined by the frames


def check_flicker_and_motion(
    sample: Sample, camera: CameraNoise, largest_error: float, largest_motion: float
) -> list[str]:
    """Raise `StepError` or return remarks when the light or the surface changed between the finest fringes.

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
    list of str
        Changes below these limits that are worth a remark.

    Raises
    ------
    StepError
        With the code FLICKER or SURFACE_MOVED.
    """
    if len(sample.angles[-1]) < 4 or not _covers_all_phases(sample):
        return []
    fringes = _Fringes.of(sample)
    changes = _fit_changes(sample, fringes, camera)
    remarks = []
    for each in (
        _flicker(changes, fringes, largest_error),
        _motion_across(changes, largest_motion),
        _motion_along(changes, largest_error),
    ):
        if each.value > _REPORTED * each.limit or each.always_reported:
            if not _is_significant(*changes.part(each.parameters)):
                continue
            if each.value > each.limit:
                raise StepError(f"{each.words}; {each.limit:g} is allowed", code=each.code)
            remarks.append(each.words)
    return remarks


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


@dataclass(frozen=True)
class _Finding:
    """Size of a change with its limit, the parameters that it comes from, and the message about it."""

    value: float
    limit: float
    parameters: slice
    code: ErrorCode
    words: str
    always_reported: bool = False


def _covers_all_phases(sample: Sample) -> bool:
    phase = np.arctan2(sample.fits[-1][2], sample.fits[-1][1])
    turns = np.exp(1j * phase)
    return sample.has_many_fringes and not any(
        abs(np.mean(each)) > _LARGEST_MEAN for each in (turns, turns**2, turns**3)
    )


def _fit_changes(sample: Sample, fringes: _Fringes, camera: CameraNoise) -> _Changes:
    """Return the least-squares estimate of the changes of all frames."""
    count, pixels = fringes.levels.shape
    weight = 1 / np.sqrt(camera.variance(fringes.fit[0]))
    rest = (fringes.levels - fringes.model) * weight
    parts = _design(sample, fringes, weight)
    waves = np.stack([np.ones(count), np.cos(fringes.angles), np.sin(fringes.angles)], axis=1)
    left = np.eye(count) - waves @ np.linalg.pinv(waves)
    stacked = parts.reshape(6 * count, pixels)
    normal = np.tile(left, (6, 6)) * (stacked @ stacked.T)
    right = np.einsum("fkp,kp->fk", parts, rest).ravel()
    _add_light_condition(normal, right, sample, fringes)
    inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
    return _Changes(count, inverse @ right, inverse * float(np.sum(rest**2)) / (pixels * (count - 3)))


def _design(sample: Sample, fringes: _Fringes, weight: np.ndarray) -> np.ndarray:
    """Return the weighted derivatives of the grey levels by the six changes, shape (6, frame, pixel)."""
    where = sample.layout.slices()[-1]
    along = 0.5 * (sample.right[where].mean(axis=0) - sample.left[where].mean(axis=0))
    down = 0.5 * (sample.below[where].mean(axis=0) - sample.above[where].mean(axis=0))
    light, fringe = fringes.model * weight, fringes.quadrature * weight
    mean = fringes.fit[0]
    parts = np.empty((6, *fringes.levels.shape))
    for part, (base, factor) in zip(
        parts,
        (
            (light, None),
            (fringe, None),
            (fringe, sample.x),
            (fringe, sample.y),
            (light, -along / mean),
            (light, -down / mean),
        ),
        strict=True,
    ):
        part[...] = base if factor is None else base * factor
    return parts


def _add_light_condition(normal: np.ndarray, right: np.ndarray, sample: Sample, fringes: _Fringes) -> None:
    """Separate light that changes like cos(2 pi k/q) from displaced fringes.

    At a single pixel both look alike. But the light gives all pixels the same C/A (and S/A), whose mean over fringes of
    all phases is 0 otherwise. A taper removes the contribution of fringes that the border cuts. The mean of few pixels
    differs from 0 by chance.
    """
    count, fit = len(fringes.angles), fringes.fit
    taper = (1 - sample.x**2) ** 2 * (1 - sample.y**2) ** 2
    chance = float(np.mean(fringes.modulation / fit[0])) * math.sqrt(float(np.sum(taper**2)) / 2) / float(np.sum(taper))
    smallest = max(_CUT_FRINGES, _CHANCE * chance)
    for number, course in ((1, np.cos(fringes.angles)), (2, np.sin(fringes.angles))):
        course = np.pad(2 / count * course, (0, len(right) - count))
        offset = float(np.average(fit[number] / fit[0], weights=taper))
        normal += normal[0, 0] * np.outer(course, course)
        right += normal[0, 0] * course * (offset if abs(offset) > smallest else 0.0)


def _flicker(changes: _Changes, fringes: _Fringes, largest_error: float) -> _Finding:
    light, modulation = changes.light, fringes.modulation
    # eq. 11 of the light's change: sin(angle - phi) / B, times the model
    error = np.einsum("kp,kp,k->p", fringes.quadrature, fringes.model, -2 / changes.frames * light) / modulation**2
    rms = float(np.std(error)) / (2 * np.pi)
    return _Finding(
        rms,
        largest_error,
        slice(0, changes.frames),
        ErrorCode.FLICKER,
        f"the light changes by {100 * np.ptp(light):.1f} % between the frames (flicker), which causes a phase error of "
        f"{rms:.4f} fringe",
        always_reported=bool(np.ptp(light) > _REPORTED_FLICKER),
    )


def _motion_across(changes: _Changes, largest_motion: float) -> _Finding:
    along_x, along_y = changes.texture
    motion = float(np.hypot(np.ptp(along_x), np.ptp(along_y)))
    return _Finding(
        motion,
        largest_motion,
        slice(4 * changes.frames, None),
        ErrorCode.SURFACE_MOVED,
        f"the surface moved by {motion:.2f} px across the image while its frames were taken",
    )


def _motion_along(changes: _Changes, largest_error: float) -> _Finding:
    wander = changes.fringes - changes.fringes.mean(axis=1, keepdims=True)
    # the slopes belong to coordinates of -1 to 1, whose mean square is 1/3
    rms = float(
        np.sqrt(np.mean(wander[0] ** 2) + (np.mean(wander[1] ** 2) + np.mean(wander[2] ** 2)) / 3) / (2 * np.pi)
    )
    return _Finding(
        rms,
        largest_error,
        slice(changes.frames, 4 * changes.frames),
        ErrorCode.SURFACE_MOVED,
        f"the surface moved along the projector's light while its frames were taken: the fringes shift by {rms:.4f} "
        "fringe",
    )


def _is_significant(values: np.ndarray, covariance: np.ndarray) -> bool:
    """Return whether these values together exceed what noise alone gives (chi-square test)."""
    inverse = np.linalg.pinv(covariance, rcond=_RANK, hermitian=True)
    freedom = int(np.linalg.matrix_rank(covariance, rtol=_RANK, hermitian=True))
    return bool(values @ inverse @ values > freedom + CONFIDENCE * math.sqrt(2 * max(freedom, 1)) + CONFIDENCE**2)
