"""Checks that every frame of a Gray code shows its bit.

Neighbouring numbers of a Gray code differ in one bit. The parity of all bits therefore changes from each half period to
the next, as the sign of sin(phi) of the fringes does. Where one frame shows another pattern, the two disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fringedic.errors import ErrorCode, StepError
from fringedic.patterns.pattern import Orientation, ProjectedPattern
from fringedic.phase.checks.pattern_check import wrong_frame_error
from fringedic.phase.checks.sampling import Sample, fit_wave, half_periods
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.layout import layout_of, shift_angles

# test_every_frame_is_checked_for_its_pattern and test_a_good_stack_passes_without_remarks fix these limits
_FEWER_JUMPS = 0.5  # of the jumps remain at most when the fault of the code is corrected
_LINES = 60  # of the image, in which jumps are counted
_CLEAR = 0.4  # of the modulation, between the grey level of a bit and the mean of the fringes
_INSIDE = 0.7  # |sin(phi)| inside a half period, where no bit changes
_WRONG = 0.05  # part of the pixels where bits and fringes disagree; a few do at shadows
_UNCLEAR = 0.5  # part of the pixels inside half periods where a bit is neither dark nor bright


def check_code(
    sample: Sample, frames: np.ndarray, patterns: Sequence[ProjectedPattern], numbers: Sequence[int]
) -> None:
    """Raise `StepError` when a frame of the Gray code does not show its bit.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    frames, patterns
        The whole stack, for a search of the faulty frame.
    numbers
        Number of each frame within its step.

    Raises
    ------
    StepError
        With the code WRONG_PATTERN; ``index`` is the number of the frame where it can be identified.
    """
    bits = sample.layout.code
    if not bits:
        return
    bright, clear, inside = _read(sample.levels[:bits], sample.fits[0])
    unclear = [float(np.mean(~each[inside])) if inside.any() else 0.0 for each in clear]
    worst = int(np.argmax(unclear))
    if unclear[worst] > _UNCLEAR:
        raise wrong_frame_error(numbers[worst], patterns[worst])
    known = inside & clear.all(axis=0)
    wrong = np.logical_xor.reduce(bright)[known] != (sample.fits[0][2][known] > 0)
    if not known.any() or wrong.mean() < _WRONG:
        return
    number = _wrong_bit(sample, frames, patterns)
    if number is None:
        raise StepError(
            f"Gray code and fringes disagree at {wrong.mean():.0%} of the image: the projector showed other patterns "
            "than recorded, or frames were taken while they changed",
            code=ErrorCode.WRONG_PATTERN,
        )
    raise wrong_frame_error(numbers[number], patterns[number])


def check_code_order(frames: np.ndarray, patterns: Sequence[ProjectedPattern], numbers: Sequence[int]) -> None:
    """Raise `StepError` when the fringe orders jump less with two frames of the Gray code interchanged.

    Parameters
    ----------
    frames, patterns
        The whole stack.
    numbers
        Number of each frame within its step.

    Raises
    ------
    StepError
        With the code FRAMES_OUT_OF_ORDER; ``index`` is the number of the first of the two frames.
    """
    part, along = _lines(frames, patterns)
    bits = layout_of(patterns).code

    def jumps(order: Sequence[int]) -> int:
        phase = absolute_phase(part[order], patterns).phase.values
        return int(np.sum(np.abs(np.diff(phase, axis=along)) > np.pi))

    recorded = list(range(len(patterns)))
    found = []
    for first, second in combinations(range(bits), 2):
        order = list(recorded)
        order[first], order[second] = second, first
        found.append((jumps(order), first, second))
    fewest, first, second = min(found)
    if fewest < _FEWER_JUMPS * jumps(recorded):
        raise StepError(
            f"the fringe orders of the Gray code jump less with frames {numbers[first]} and {numbers[second]} "
            "interchanged: frames are out of order",
            index=numbers[first],
            code=ErrorCode.FRAMES_OUT_OF_ORDER,
        )


def _read(levels: np.ndarray, fit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where each bit is bright, where it is clearly bright or dark, and what is inside a half period."""
    strength = np.maximum(np.hypot(fit[1], fit[2]), np.float32(1e-6))
    away = (levels - fit[0]) / strength
    return away > 0, np.abs(away) > _CLEAR, np.abs(fit[2]) > _INSIDE * strength


def _lines(frames: np.ndarray, patterns: Sequence[ProjectedPattern]) -> tuple[np.ndarray, int]:
    """Return some whole lines of a stack across the fringes, and the axis along which the phase grows."""
    along = 1 if patterns[0].orientation == Orientation.VERTICAL else 0
    skip = max(1, frames.shape[2 - along] // _LINES)
    return np.ascontiguousarray(frames[:, ::skip] if along == 1 else frames[:, :, ::skip]), along


def _wrong_bit(sample: Sample, frames: np.ndarray, patterns: Sequence[ProjectedPattern]) -> int | None:
    """Return the bit whose correction by the fringes and the other bits makes the half periods consecutive."""
    part, along = _lines(frames, patterns)
    bits = sample.layout.code
    fit = fit_wave(part[bits:].reshape(len(part) - bits, -1).astype(np.float32), shift_angles(patterns[bits:]))
    bright, clear, inside = _read(part[:bits].reshape(bits, -1).astype(np.float32), fit)
    least = _CLEAR * float(np.median(np.hypot(*sample.fits[0][1:])))
    known = (inside & (np.hypot(fit[1], fit[2]) > least)).reshape(part.shape[1:])
    wrong = np.logical_xor.reduce(bright) != (fit[2] > 0)

    def jumps(number: int) -> int:
        taken = bright.copy()
        taken[number] ^= wrong
        usable = known & np.delete(clear, number, axis=0).all(axis=0).reshape(known.shape)
        lines = half_periods(taken).reshape(known.shape), usable
        total = 0
        for numbers, measured in zip(*(each if along == 1 else each.T for each in lines), strict=True):
            growth = np.diff(numbers[measured])
            total += int(np.sum((growth < 0) | (growth > 1)))
        return total

    found = sorted((jumps(number), number) for number in range(bits))
    return found[0][1] if len(found) > 1 and found[0][0] < _FEWER_JUMPS * found[1][0] else None
