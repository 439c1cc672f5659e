"""Several exposures of the same stack merged into one, for surfaces with glare and with dark parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange

from fringedic.errors import InvalidExposuresError, ShapeMismatchError
from fringedic.phase.noise import CameraNoise, estimate_noise, saturation_level
from fringedic.sequence import PatternKind, Projection, exposure_groups

_NOISE_PIXELS = 60_000  # of each exposure, among which the noise is estimated


@dataclass(frozen=True)
class ExposedStack:
    """Frames of a step that were exposed equally long.

    Attributes
    ----------
    time
        Exposure time [s].
    frames
        Grey levels, shape (frame, row, column).
    projections
        What each frame showed.
    numbers
        Number of each frame within the step.
    """

    time: float
    frames: np.ndarray
    projections: list[Projection]
    numbers: list[int]

    def without_grey(self) -> ExposedStack:
        """Return the frames that a stepped phase is measured from."""
        kept = [index for index, each in enumerate(self.projections) if each.kind != PatternKind.GREY]
        return self if len(kept) == len(self.projections) else self._only(kept)

    def _only(self, kept: Sequence[int]) -> ExposedStack:
        return replace(
            self,
            frames=self.frames[kept],
            projections=[self.projections[index] for index in kept],
            numbers=[self.numbers[index] for index in kept],
        )


def split_exposures(
    frames: np.ndarray, projections: Sequence[Projection], exposure_times: Sequence[float] | None
) -> list[ExposedStack]:
    """Sort the frames of a step by their exposure times, in the order in which these occur first.

    Raises
    ------
    ShapeMismatchError
        There is not one exposure time for each frame, or not every pattern was taken at each.
    """
    times = [0.0] * len(projections) if exposure_times is None else list(exposure_times)
    if len(times) != len(projections):
        raise ShapeMismatchError(f"{len(times)} exposure times for {len(projections)} frames: give one for each")
    whole = ExposedStack(times[0] if times else 0.0, frames, list(projections), list(range(len(projections))))
    groups = exposure_groups(times)
    if len(groups) < 2:
        return [whole]
    found = []
    for time, kept in groups.items():
        part = replace(whole, time=time)._only(kept)
        found.append(part)
        if part.projections != found[0].projections:
            raise ShapeMismatchError(f"exposures of {1e3 * time:g} ms show other patterns than the first ones")
    return found


def merge_stacks(
    exposures: Sequence[ExposedStack], noise: CameraNoise, saturation: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Merge the exposures of a step, see `merge_exposures`."""
    stacks, times = [each.frames for each in exposures], [each.time for each in exposures]
    return merge_exposures(stacks, times, noise=noise, saturation=saturation)


def noise_of_exposures(exposures: Sequence[ExposedStack], saturation: float | None) -> CameraNoise | None:
    """Estimate the noise of a grey level, which does not depend on the exposure time, from all exposures together."""
    skip = max(1, math.isqrt(exposures[0].frames[0].size // _NOISE_PIXELS))
    pixels = np.concatenate([each.frames[:, ::skip, ::skip] for each in exposures], axis=2)
    return estimate_noise(pixels, exposures[0].projections, saturation=saturation)


def fill_glare(texture: np.ndarray, exposures: Sequence[ExposedStack]) -> None:
    """Put a finite grey level where every exposure saturates: the clipped one of the shortest, in the first's units."""
    lost = ~np.isfinite(texture)
    if lost.any():
        shortest = min(exposures, key=lambda each: each.time)
        scale = exposures[0].time / shortest.time
        texture[lost] = scale * shortest.frames[:, lost].mean(axis=0, dtype=np.float32)


def merge_exposures(
    stacks: Sequence[np.ndarray],
    exposure_times: Sequence[float],
    *,
    noise: CameraNoise,
    saturation: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Merge stacks that show the same frames at different exposure times.

    At every pixel the grey levels per exposure time are averaged with weights ``t^2 / sigma_I^2``, sigma_I^2 being the
    noise at the mean level of that exposure, so that the merged frames have the least noise there is. An exposure in
    which any frame of a pixel saturates takes no part there: all frames of a pixel are merged alike, and the fringes
    stay sinusoidal. Where every exposure saturates the shortest one is kept and counts as saturated.

    Parameters
    ----------
    stacks
        One per exposure time: grey levels, shape (frame, row, column), all of one shape and type.
    exposure_times
        Exposure time of each stack [s], or in any one unit.
    noise
        Noise of one grey level.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.

    Returns
    -------
    frames : ndarray
        float32 (frame, row, column), grey levels of the first stack's exposure time; infinite where every exposure
        saturates, which `absolute_phase` takes for saturated.
    sigma : ndarray
        float32 (row, column), standard deviation of the merged grey levels, for the argument ``noise`` of
        `absolute_phase`.

    Raises
    ------
    InvalidExposuresError
        Fewer than two stacks, or exposure times that are not positive and different.
    ShapeMismatchError
        Stacks of different shape, or not one exposure time for each.
    """
    if len(stacks) != len(exposure_times):
        raise ShapeMismatchError(f"{len(stacks)} stacks for {len(exposure_times)} exposure times: give one for each")
    if len(stacks) < 2 or len(set(exposure_times)) < len(stacks) or not min(exposure_times) > 0:
        raise InvalidExposuresError(f"exposure times {list(exposure_times)}: give two or more, positive and different")
    if len({(stack.shape, stack.dtype) for stack in stacks}) > 1 or stacks[0].ndim != 3:
        raise ShapeMismatchError(f"stacks of {[(stack.shape, str(stack.dtype)) for stack in stacks]} cannot be merged")
    _, rows, columns = stacks[0].shape
    ratio = np.array(exposure_times, np.float32) / np.float32(exposure_times[0])
    limit = np.float32(saturation_level(stacks[0], saturation))
    total = np.zeros(stacks[0].shape, np.float32)
    weight = np.zeros((rows, columns), np.float32)
    for stack, times in zip(stacks, ratio, strict=True):
        _add_exposure(
            np.ascontiguousarray(stack), times, limit, np.float32(noise.read**2), np.float32(noise.shot), total, weight
        )
    known = weight > 0
    sigma = np.full((rows, columns), np.nan, np.float32)
    sigma[known] = 1 / np.sqrt(weight[known])
    _divide(total, weight)
    return total, sigma


@njit(cache=True, nogil=True, parallel=True)
def _add_exposure(
    stack: np.ndarray,
    times: np.float32,
    saturation: np.float32,
    read_variance: np.float32,
    shot: np.float32,
    total: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Add one exposure's share: weight t^2/sigma^2 of the level I/t, so t/sigma^2 of the level itself."""
    images, rows, columns = stack.shape
    for row in prange(rows):
        mean = np.zeros(columns, np.float32)
        brightest = np.zeros(columns, np.float32)
        for k in range(images):
            for column in range(columns):
                level = np.float32(stack[k, row, column])
                mean[column] += level
                brightest[column] = max(brightest[column], level)
        for column in range(columns):
            variance = read_variance + shot * mean[column] / np.float32(images)
            mean[column] = times / variance if brightest[column] < saturation else np.float32(0)
            weight[row, column] += times * mean[column]
        for k in range(images):
            for column in range(columns):
                total[k, row, column] += mean[column] * np.float32(stack[k, row, column])


@njit(cache=True, nogil=True, parallel=True)
def _divide(total: np.ndarray, weight: np.ndarray) -> None:
    images, rows, columns = total.shape
    for row in prange(rows):
        for k in range(images):
            for column in range(columns):
                if weight[row, column] > 0:
                    total[k, row, column] /= weight[row, column]
                else:
                    total[k, row, column] = np.inf
