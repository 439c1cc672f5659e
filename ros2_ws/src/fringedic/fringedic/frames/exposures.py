"""Merges several exposures of one stack, for surfaces with glare and dark parts (high dynamic range)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange

from fringedic.errors import ImageError
from fringedic.frames.exposure_groups import exposure_groups
from fringedic.frames.noise import CameraNoise, saturation_level
from fringedic.patterns.pattern import PatternKind, ProjectedPattern


@dataclass(frozen=True)
class ExposedStack:
    """Frames of a step with one exposure time.

    Attributes
    ----------
    time
        Exposure time [s].
    frames
        Grey levels, shape (frame, row, column).
    patterns
        Pattern of each frame.
    numbers
        Number of each frame within the step.
    """

    time: float
    frames: np.ndarray
    patterns: list[ProjectedPattern]
    numbers: list[int]

    def without_grey(self) -> ExposedStack:
        """Return the frames from which a phase is measured by phase stepping."""
        kept = [index for index, each in enumerate(self.patterns) if each.kind != PatternKind.GREY]
        return self if len(kept) == len(self.patterns) else self.select(kept)

    def select(self, kept: Sequence[int]) -> ExposedStack:
        """Return some of the frames by their positions in the stack."""
        return replace(
            self,
            frames=self.frames[kept],
            patterns=[self.patterns[index] for index in kept],
            numbers=[self.numbers[index] for index in kept],
        )


def split_exposures(
    frames: np.ndarray, patterns: Sequence[ProjectedPattern], exposure_times: Sequence[float] | None
) -> list[ExposedStack]:
    """Sort the frames of a step by their exposure times.

    Parameters
    ----------
    frames
        Grey levels, shape (frame, row, column).
    patterns
        Pattern of each frame.
    exposure_times
        Exposure time of each frame [s]; None for equal times.

    Returns
    -------
    list of ExposedStack
        In the order in which the exposure times occur first; all of the same patterns.

    Raises
    ------
    ImageError
        There is not one exposure time for each frame, or a pattern is missing at an exposure time.
    """
    times = [0.0] * len(patterns) if exposure_times is None else list(exposure_times)
    if len(times) != len(patterns):
        raise ImageError(f"{len(times)} exposure times for {len(patterns)} frames: give one for each")
    whole = ExposedStack(times[0] if times else 0.0, frames, list(patterns), list(range(len(patterns))))
    groups = exposure_groups(times)
    if len(groups) < 2:
        return [whole]
    found = []
    for time, kept in groups.items():
        part = replace(whole, time=time).select(kept)
        found.append(part)
        if part.patterns != found[0].patterns:
            raise ImageError(f"exposures of {1e3 * time:g} ms show other patterns than the first ones")
    return found


def merge_stacks(
    exposures: Sequence[ExposedStack], noise: CameraNoise, saturation: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Merge the exposures of a step, see `merge_exposures`."""
    stacks, times = [each.frames for each in exposures], [each.time for each in exposures]
    return merge_exposures(stacks, times, noise=noise, saturation=saturation)


def fill_saturated(texture: np.ndarray, exposures: Sequence[ExposedStack]) -> None:
    """Fill pixels where every exposure saturates, in place.

    They get the clipped grey level of the shortest exposure, scaled to the first one's exposure time.

    Parameters
    ----------
    texture
        Grey levels of the first exposure, shape (row, column), not finite where every exposure saturates.
    exposures
        All exposures of the step.
    """
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

    At every pixel the grey levels per exposure time are averaged with weights ``t^2 / sigma_I^2`` (inverse variance),
    sigma_I^2 being the noise at the mean level of that exposure. An exposure is left out at a pixel where any of its
    frames saturates: all frames of a pixel are merged with the same weights, so that the fringes stay sinusoidal.

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
        float32 (frame, row, column), grey levels at the first stack's exposure time; infinite where every exposure
        saturates, so that `absolute_phase` counts these pixels as saturated.
    sigma : ndarray
        float32 (row, column), standard deviation of the merged grey levels, for the argument ``noise`` of
        `absolute_phase`.

    Raises
    ------
    ImageError
        There are fewer than two stacks, exposure times are not positive and different, there is not one for each
        stack, or the stacks differ in shape or type.

    References
    ----------
    M. A. Robertson, S. Borman, R. L. Stevenson, "Estimation-theoretic approach to dynamic range enhancement using
    multiple exposures", Journal of Electronic Imaging 12 (2003) 219-228.

    Examples
    --------
    >>> short = np.full((3, 1, 2), 20, np.uint8)
    >>> long = np.full((3, 1, 2), 80, np.uint8)
    >>> long[1, 0, 1] = 255  # saturates: the second pixel is that of the short exposure
    >>> frames, sigma = merge_exposures([short, long], [0.01, 0.04], noise=CameraNoise(read=1.0))
    >>> frames[0].tolist(), sigma.round(3).tolist()
    ([[20.0, 20.0]], [[0.24300000071525574, 1.0]])
    """
    if len(stacks) != len(exposure_times):
        raise ImageError(f"{len(stacks)} stacks for {len(exposure_times)} exposure times: give one for each")
    if len(stacks) < 2 or len(set(exposure_times)) < len(stacks) or not min(exposure_times) > 0:
        raise ImageError(f"exposure times {list(exposure_times)}: give two or more, positive and different")
    if len({(stack.shape, stack.dtype) for stack in stacks}) > 1 or stacks[0].ndim != 3:
        raise ImageError(f"stacks of {[(stack.shape, str(stack.dtype)) for stack in stacks]} cannot be merged")
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
    """Add one exposure with the weight t^2/sigma^2 of the level I/t, which is t/sigma^2 of the level I."""
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
