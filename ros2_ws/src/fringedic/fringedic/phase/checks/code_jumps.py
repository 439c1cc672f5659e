"""Counts the jumps of the numbers that a Gray code gives along some lines of the image.

The parity of the bits does not depend on their order. But with two bits interchanged, or one of them wrong, the numbers
jump from half period to half period, where the right ones grow by one.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fringedic.phase.checks.misfit import CLEAR, INSIDE, Shown
from fringedic.phase.checks.sampling import half_periods
from fringedic.phase.layout import Layout, shift_angles
from fringedic.phase.sinusoids import fit_wave

_LINES = 24  # jumps are counted in so many lines of the image
_LEAST_MODULATION = 0.3  # pixels with a smaller part of the modulation of the brightest ones are left out
_SUSPICIOUS = 0.5  # jumps per line are suspicious: a step of the surface gives one or two on some lines only


class CodeJumps:
    """Jumps of the numbers of a Gray code under an assumption about the shown patterns.

    Parameters
    ----------
    frames
        The stack, shape (frame, row, column).
    layout
        Its layout.
    vertical
        Whether the fringes are vertical.
    """

    def __init__(self, frames: np.ndarray, layout: Layout, *, vertical: bool) -> None:
        self._frames, self._layout, self._vertical = frames, layout, vertical

    @property
    def exist(self) -> bool:
        """Whether the stack has a Gray code."""
        return self._layout.code > 0

    @property
    def are_suspicious(self) -> bool:
        """Whether the numbers of the stack as recorded jump on most lines."""
        return self.exist and self(range(len(self._frames))) > _SUSPICIOUS * len(self._lines[0])

    def __call__(self, shown: Shown) -> int:
        """Return the number of jumps when frame k shows the pattern ``shown[k]``.

        One bit that no frame shows is replaced: with the others it gives the sign of the sine of the fringes.
        """
        bits = self._layout.code
        at = {pattern: frame for frame, pattern in enumerate(shown)}
        fringes = [frame for frame, pattern in enumerate(shown) if pattern >= bits]
        lost = [bit for bit in range(bits) if bit not in at]
        lines = self._lines
        fit = fit_wave(lines[fringes].reshape(len(fringes), -1), self._angles[[shown[frame] for frame in fringes]])
        strength = np.hypot(fit[1], fit[2])
        away = np.stack(
            [lines[at[bit]].ravel() - fit[0] if bit in at else np.zeros_like(fit[0]) for bit in range(bits)]
        )
        bright = away > 0
        known = (np.abs(fit[2]) > INSIDE * strength) & (strength > _LEAST_MODULATION * np.percentile(strength, 95))
        known &= (np.abs(np.delete(away, lost, axis=0)) > CLEAR * strength).all(axis=0)
        if lost:
            bright[lost[0]] = np.logical_xor.reduce(np.delete(bright, lost, axis=0)) ^ (fit[2] > 0)
        shape = lines.shape[1:]
        return sum(
            _count(line[measured])
            for line, measured in zip(half_periods(bright).reshape(shape), known.reshape(shape), strict=True)
        )

    @cached_property
    def _lines(self) -> np.ndarray:
        """Some lines of the stack across the fringes, shape (frame, line, pixel)."""
        stack = self._frames if self._vertical else self._frames.swapaxes(1, 2)
        return stack[:, :: max(1, stack.shape[1] // _LINES)].astype(np.float32)

    @cached_property
    def _angles(self) -> np.ndarray:
        return np.concatenate([np.zeros(self._layout.code), *map(shift_angles, self._layout.periods)])


def _count(numbers: np.ndarray) -> int:
    growth = np.diff(numbers)
    return int(np.sum((growth < 0) | (growth > 1)))
