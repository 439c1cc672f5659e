"""Whether every frame of a Gray code shows its bit.

Neighbouring numbers of a Gray code differ in one bit, so the sum of all bits changes from each half period to the next,
as the sign of sin(phi) of the fringes does. Where one frame shows something else the two disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fringedic.errors import FramesOutOfOrderError, WrongPatternError
from fringedic.phase.content import does_not_show
from fringedic.phase.layout import layout_of, shift_angles
from fringedic.phase.sample import Sample, fit_wave, half_periods
from fringedic.phase.steps import absolute_phase
from fringedic.sequence import Orientation, Projection

_FEWER_JUMPS = 0.5  # of the jumps remain when what is wrong with the code is put right
_LINES = 60  # that are looked at for the code's frames
_CLEAR = 0.4  # of the modulation, between a bit's grey level and the mean of the fringes
_INSIDE = 0.7  # |sin(phi)| inside of a half period, where no bit changes
_WRONG = 0.05  # part of the pixels where bits and fringes disagree; at shadows a few do
_UNCLEAR = 0.5  # part of the pixels inside half periods where a bit is neither dark nor bright


def check_code(sample: Sample, frames: np.ndarray, projections: Sequence[Projection], numbers: Sequence[int]) -> None:
    """Raise when a frame of the Gray code does not show its bit.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated, with the fringes.
    frames, projections
        The stack; looked at again where something is wrong.
    numbers
        Number of each frame within its step.

    Raises
    ------
    WrongPatternError
        ``index`` is the number of the frame, where it can be told.
    """
    bits = sample.layout.code
    if not bits:
        return
    bright, clear, inside = _read(sample.levels[:bits], sample.fits[0])
    unclear = [float(np.mean(~each[inside])) if inside.any() else 0.0 for each in clear]
    worst = int(np.argmax(unclear))
    if unclear[worst] > _UNCLEAR:
        raise WrongPatternError(does_not_show(numbers[worst], projections[worst]), index=numbers[worst])
    known = inside & clear.all(axis=0)
    wrong = np.logical_xor.reduce(bright)[known] != (sample.fits[0][2][known] > 0)
    if not known.any() or wrong.mean() < _WRONG:
        return
    number = _wrong_bit(sample, frames, projections)
    if number is None:
        raise WrongPatternError(
            f"Gray code and fringes disagree at {wrong.mean():.0%} of the image: the projector showed other patterns "
            "than recorded, or frames were taken while they changed"
        )
    raise WrongPatternError(does_not_show(numbers[number], projections[number]), index=numbers[number])


def check_code_order(frames: np.ndarray, projections: Sequence[Projection], numbers: Sequence[int]) -> None:
    """Raise when the orders jump less with two frames of the Gray code interchanged."""
    part, along = _lines(frames, projections)
    bits = layout_of(projections).code

    def jumps(order: Sequence[int]) -> int:
        phase = absolute_phase(part[order], projections).phase.values
        return int(np.sum(np.abs(np.diff(phase, axis=along)) > np.pi))

    recorded = list(range(len(projections)))
    found = []
    for first, second in combinations(range(bits), 2):
        order = list(recorded)
        order[first], order[second] = second, first
        found.append((jumps(order), first, second))
    fewest, first, second = min(found)
    if fewest < _FEWER_JUMPS * jumps(recorded):
        raise FramesOutOfOrderError(
            f"the orders that the Gray code tells jump, less so with frames {numbers[first]} and {numbers[second]} "
            "interchanged: frames are out of order",
            index=numbers[first],
        )


def _read(levels: np.ndarray, fit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where each bit is bright, where it is clearly so or dark, and which pixels lie inside a half period."""
    strength = np.maximum(np.hypot(fit[1], fit[2]), np.float32(1e-6))
    away = (levels - fit[0]) / strength
    return away > 0, np.abs(away) > _CLEAR, np.abs(fit[2]) > _INSIDE * strength


def _lines(frames: np.ndarray, projections: Sequence[Projection]) -> tuple[np.ndarray, int]:
    """Return some whole lines of a stack across the fringes, and the axis along which the phase grows."""
    along = 1 if projections[0].orientation == Orientation.VERTICAL else 0
    skip = max(1, frames.shape[2 - along] // _LINES)
    return np.ascontiguousarray(frames[:, ::skip] if along == 1 else frames[:, :, ::skip]), along


def _wrong_bit(sample: Sample, frames: np.ndarray, projections: Sequence[Projection]) -> int | None:
    """Return the bit that, taken as fringes and other bits want it, makes the half periods follow each other."""
    part, along = _lines(frames, projections)
    bits = sample.layout.code
    fit = fit_wave(part[bits:].reshape(len(part) - bits, -1).astype(np.float32), shift_angles(projections[bits:]))
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
