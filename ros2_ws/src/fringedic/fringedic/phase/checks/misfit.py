"""Misfit of a stack with an assumption about the patterns that its frames show.

Noise is no part of it: each deviation is multiplied by that of a second pixel, two pixels away along the fringes, which
has nearly the same phase but independent noise. The expected product is the square of the deviation that both have in
common. Sums over the pixels are weighted by the modulation, so that an unlit background contributes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from fringedic.frames.noise import CameraNoise
from fringedic.phase.checks.projector_lag import LaggingWave
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.sinusoids import fit_wave, remove_harmonics, square_modulation, wave_levels, waves

# The scenes of benchmarks/stack_checks.py fix these limits
_LARGEST_RESIDUAL = 0.05  # a good fit leaves less than this part of the modulation, RMS
_LARGEST_STEP = 0.15  # the mean of three frames differs from that of other pitches by less, over the modulation
_LARGEST_MISMATCH = 0.69  # |1 - exp(i d)| of one pitch and the next, RMS: d = 0.7 rad; without relation 1.4
_LARGEST_UNEVENNESS = 0.2  # of the only pitch, see _unevenness: 0.04 in good stacks, from 0.33 on with a wrong frame
_LARGEST_WRONG_BITS = 0.05  # bits and fringes disagree at a few pixels beside shadows
_LARGEST_CODE_OFFSET = 0.35  # |1 - exp(i d)| of fringes and edges of the code: 20 degrees
_UNCLEAR_BITS = 0.5  # a bit is neither dark nor bright at this part of the pixels inside half periods
_CERTAIN = 0.3  # [rad] a pixel whose predicted phase has a larger standard deviation has little weight
_FEWEST_CERTAIN = 0.02  # a check of the orders needs this part of the pixels
_BOTH_LEVELS = 0.95  # bright and dark bits of a pixel differ by this part of the range of its fringes
_REPEATING = 3  # pitches whose ratio has at most this denominator need not be absolute
_SECOND_HARMONICS = (-0.1, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)  # are tried, over the modulation: it is 0.3 at gamma 2.4
_FAR_MORE_EVEN = 0.5
_HARMONIC_ROUNDS = 6  # a strength c leaves (2 c)^6 of the effect
_LAG_ROUNDS = 3  # each corrects the first frame of a pitch with the sinusoid of the round before

CLEAR = 0.4
"""Least distance of a bit of a Gray code from the mean of the fringes, over their modulation."""
INSIDE = 0.7
"""Least |sin(phi)| inside a half period, where no bit changes."""
UNKNOWN = -1
"""Pattern of a frame that shows another one than any of its step."""
Shown = Sequence[int]
"""Number of the pattern that each frame shows, or `UNKNOWN`."""


@dataclass(frozen=True)
class Evidence:
    """Deviations of a stack from its patterns, over the modulation and without noise.

    Attributes
    ----------
    residual, step
        Of each pitch: residual of the fit, and difference of the mean of three frames from that of the other pitches.
    mismatch
        Of each pitch but the first: ``|1 - exp(i d)|`` of its phase with that predicted from the next coarser one.
    unevenness
        Of phases and contrast of the only pitch.
    wrong_bits
        Part of the image where the parity of the Gray code is not the sign of the sine of the fringes.
    code_offset
        ``|1 - exp(i d)|`` of the displacement of the fringes against the edges of the Gray code, beyond what is due to
        the pixels of the projector.
    unclear_bits
        Of each bit: part of the image where it is neither dark nor bright.
    """

    residual: tuple[float, ...]
    step: tuple[float, ...]
    mismatch: tuple[float, ...]
    unevenness: float
    wrong_bits: float
    code_offset: float
    unclear_bits: tuple[float, ...]

    @property
    def total(self) -> float:
        """Sum of the squares of all deviations."""
        parts = (*self.residual, *self.step, *self.mismatch, self.unevenness, self.wrong_bits, self.code_offset)
        parts += self.unclear_bits
        return sum(each**2 for each in parts)

    @property
    def is_small(self) -> bool:
        """Whether the frames show their patterns."""
        return (
            max(self.residual) < _LARGEST_RESIDUAL
            and max(self.step) < _LARGEST_STEP
            and not self.unrelated_pitches()
            and not self.is_uneven
            and not self.has_wrong_bits
            and self.code_offset < _LARGEST_CODE_OFFSET
        )

    @property
    def has_wrong_bits(self) -> bool:
        """Whether a frame of the Gray code does not show its bit."""
        return self.wrong_bits > _LARGEST_WRONG_BITS or max(self.unclear_bits, default=0.0) > _UNCLEAR_BITS

    @property
    def is_uneven(self) -> bool:
        """Whether phases and contrast of the only pitch are unevenly distributed."""
        return self.unevenness > _LARGEST_UNEVENNESS

    def unrelated_pitches(self) -> list[int]:
        """Return the numbers of the pitches that do not continue the next coarser one."""
        return [number for number, each in enumerate(self.mismatch, start=1) if each > _LARGEST_MISMATCH]


@dataclass(frozen=True)
class _Wave:
    """Sinusoid of one pitch at the pairs of pixels, and what it does not explain."""

    fit: np.ndarray
    residual: float
    count: int
    different: int  # shifts


class Misfit:
    """Measures how well an assumption about the shown patterns fits a stack.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    noise
        Of the camera, to know which predicted phases are certain.
    """

    def __init__(self, sample: Sample, noise: CameraNoise) -> None:
        self._layout, self._noise = sample.layout, noise
        self._levels = np.concatenate(sample.along_fringes(), axis=1)
        self._angles = np.concatenate([np.zeros(sample.layout.code), *sample.angles])
        self._is_even = len(sample.fits) == 1 and sample.has_many_fringes
        self._waves: dict[tuple[int, ...], _Wave] = {}

    def __call__(self, shown: Shown) -> Evidence:
        """Return the deviations under the assumption that frame k shows the pattern ``shown[k]``.

        A pitch of which fewer than two different shifts are shown gives an infinite residual.
        """
        return self._evidence([self._wave(number, shown) for number in range(len(self._layout.periods))], shown)

    def least(self, shown: Shown) -> float:
        """Return a lower bound of the total deviation, which takes less time: the residuals alone."""
        return sum(each**2 for each in self.residuals(shown))

    def residuals(self, shown: Shown) -> tuple[float, ...]:
        """Return the residual of the fit of each pitch, over its modulation."""
        return tuple(self._wave(number, shown).residual for number in range(len(self._layout.periods)))

    def lagging(self, share: float) -> Evidence:
        """Return the deviations under the assumption that every frame shows this share of the pattern before."""
        found, last = [], self._last_bit() if self.bits else None
        for where in self._layout.slices():
            levels, angles = self._levels[where], self._angles[where]
            wave = LaggingWave.of(levels, angles, share, first=1 if len(levels) > 3 else 0)
            for _ in range(_LAG_ROUNDS if last is not None else 0):
                # as if the pitch's own last pattern had been shown before it
                cyclic = np.concatenate([levels[:1] + share * (wave.level(angles[-1:]) - last), levels[1:]])
                wave = LaggingWave.of(cyclic, angles, share, first=0)
            used = slice(0 if last is not None or len(levels) == 3 else 1, None)
            rest = ((levels if last is None else cyclic) - wave_levels(wave.seen, angles))[used]
            rest = remove_harmonics(rest, wave.seen, angles[used])
            last = wave.level(angles[-1:])
            residual = _common(rest, wave.fit) / math.sqrt(max(len(rest) - 3, 1))
            found.append(_Wave(wave.fit, residual, len(levels), len(levels)))
        return self._evidence(found, range(len(self._levels)), share)

    def _last_bit(self) -> np.ndarray:
        """Return the grey levels of the finest bit alone: the bright or dark ones of the code, shape (1, pixel)."""
        code = self._levels[: self.bits]
        dark, bright = code.min(axis=0), code.max(axis=0)
        return np.asarray(np.where(code[-1] > 0.5 * (dark + bright), bright, dark)[None])

    def _evidence(self, found: list[_Wave], shown: Shown, share: float = 0.0) -> Evidence:
        if any(not math.isfinite(each.residual) for each in found):
            return Evidence((math.inf,), (0.0,), (), 0.0, 0.0, 0.0, ())
        wrong, offset, unclear = self._bits(shown, found[0], share)
        result = []
        phase = np.arctan2(found[0].fit[2], found[0].fit[1])
        for coarse, fine, (wide, narrow) in zip(found, found[1:], pairwise(self._layout.pitches), strict=False):
            ratio = wide / narrow
            # fringes of 3/2 of a pitch that repeat in view predict the finer ones up to half a turn
            part = Fraction(ratio).limit_denominator(_REPEATING)
            turns = part.denominator if abs(float(part) - ratio) < 1e-6 * ratio else 1
            if self._layout.by_beats:
                if turns == 1:  # without its order no pitch predicts another
                    result.append(0.0)
                    continue
                phase = np.arctan2(coarse.fit[2], coarse.fit[1])
            expected = phase * ratio
            away = np.arctan2(fine.fit[2], fine.fit[1]) - expected
            away -= 2 * np.pi * np.round(away / (2 * np.pi))
            variance = self._noise.variance(fine.fit[0]) * 2
            spread = variance * (
                ratio**2 / (coarse.count * square_modulation(coarse.fit))
                + 1 / (fine.count * square_modulation(fine.fit))
            )
            weight = 1 / (1 + turns**2 * spread / _CERTAIN**2) ** 2
            angle = turns * away
            one, other = _halves(1 - np.exp(1j * angle))
            weights = np.multiply(*_halves(weight))
            common = 0.0
            if weights.mean() >= _FEWEST_CERTAIN:
                common = math.sqrt(max(float(np.average(np.real(one * np.conj(other)), weights=weights)), 0.0))
            result.append(common / math.sqrt(turns))
            phase = expected + away
        return Evidence(
            residual=tuple(each.residual for each in found),
            step=tuple(self._step(number, found) for number in range(len(found))),
            mismatch=tuple(result),
            unevenness=_unevenness(found[0].fit) if self._is_even and found[0].count == 3 else 0.0,
            wrong_bits=wrong,
            code_offset=offset,
            unclear_bits=unclear,
        )

    @property
    def bits(self) -> int:
        """Number of frames of the Gray code."""
        return self._layout.code

    def deviation(self, shown: Shown, frame: int) -> float:
        """Return how far a frame is from its own pattern, given all others; 1 is as far as from the pattern before."""
        number = next(n for n, where in enumerate(self._layout.slices()) if where.start <= frame < where.stop)
        fit = self._wave(number, shown).fit
        away = _common(self._levels[frame : frame + 1] - wave_levels(fit, self._angles[frame : frame + 1]), fit)
        return away / (math.sqrt(2) * math.sin(math.pi / self._layout.periods[number][0].shifts))

    def _wave(self, number: int, shown: Shown) -> _Wave:
        where = self._layout.slices()[number]
        frames = [frame for frame, pattern in enumerate(shown) if where.start <= pattern < where.stop]
        key = (number, *frames, *(shown[frame] for frame in frames))
        if key not in self._waves:
            self._waves[key] = self._fit(number, frames, self._angles[[shown[frame] for frame in frames]])
        return self._waves[key]

    def _fit(self, number: int, frames: list[int], angles: np.ndarray) -> _Wave:
        different = len(np.unique(np.round(np.exp(1j * angles), 6)))
        alone = len(self._layout.periods) == 1 and not self._layout.code
        if different < 2 or (different == 2 and alone):
            return _Wave(np.empty((3, 0)), math.inf, 0, different)
        levels = self._levels[frames]
        if different == 2:  # the mean of the other pitches takes the place of the third equation
            mean = self._mean_of_others(number)
            pair = np.linalg.pinv(waves(angles)[:, 1:]) @ (levels - mean)
            return _Wave(np.concatenate([mean[None], pair]).astype(np.float32), 0.0, len(frames), different)
        freedom = len(frames) - 3
        if freedom < 1:
            harmonic = self._is_even and len(frames) < self._layout.counts[number]
            fit = _even_wave(levels, angles) if harmonic else fit_wave(levels, angles)
            return _Wave(fit, 0.0, len(frames), different)
        fit = fit_wave(levels, angles)
        rest = remove_harmonics(levels - wave_levels(fit, angles), fit, angles)
        return _Wave(fit, _common(rest, fit) / math.sqrt(freedom), len(frames), different)

    def _mean_of_others(self, number: int) -> np.ndarray:
        """Return the mean grey level of all pitches but one, as recorded; that of a Gray code beside a single pitch."""
        if len(self._layout.periods) == 1:
            return self._mean_of_code()
        frames = np.arange(self._layout.code, len(self._levels))
        where = self._layout.slices()[number]
        return np.asarray(self._levels[frames[(frames < where.start) | (frames >= where.stop)]].mean(axis=0))

    def _mean_of_code(self) -> np.ndarray:
        """Return the middle of the bright and dark levels of the code; the mean of the fringes where it has but one."""
        code, fringes = self._levels[: self._layout.code], self._levels[self._layout.code :]
        dark, bright = code.min(axis=0), code.max(axis=0)
        both = bright - dark > _BOTH_LEVELS * np.ptp(fringes, axis=0)
        return np.asarray(np.where(both, 0.5 * (bright + dark), fringes.mean(axis=0)))

    def _step(self, number: int, found: list[_Wave]) -> float:
        """Return the difference of the mean of a pitch from that of the others.

        Three frames fit any sinusoid; only their mean can be checked, as all pitches are equally bright.
        """
        if found[number].different > 3 or (len(found) == 1 and not self._layout.code):
            return 0.0
        if len(found) == 1:  # a nonlinear response displaces the middle of bright and dark by a part of the modulation
            away, strength = self._mean_of_code() - found[0].fit[0], np.sqrt(square_modulation(found[0].fit))
            return _common(
                (away - np.vdot(away, strength) / np.vdot(strength, strength) * strength)[None], found[0].fit
            )
        others = [each for each in found if each is not found[number]]
        mean = np.average([each.fit[0] for each in others], axis=0, weights=[each.count for each in others])
        return _common((found[number].fit[0] - mean)[None], found[number].fit)

    def _bits(self, shown: Shown, wave: _Wave, share: float) -> tuple[float, float, tuple[float, ...]]:
        """Return `wrong_bits`, `code_offset` and `unclear_bits` of the evidence, with a share of the pattern before.

        Neighbouring numbers of a Gray code differ in one bit. The parity of all bits therefore changes from each half
        period to the next, as the sign of sin(phi) of the fringes does. Two frames of one bit have to be alike.
        """
        at = {pattern: frame for frame, pattern in enumerate(shown) if 0 <= pattern < self.bits}
        if not at:
            return 0.0, 0.0, ()
        power = square_modulation(wave.fit)
        inside = power * (wave.fit[2] ** 2 > INSIDE**2 * power)
        if wave.different < 3 and inside.sum() < _FEWEST_CERTAIN * power.sum():
            return 1.0, 0.0, ()  # two like frames: any bits would agree with such phases
        bits = (self._levels[: max(at.values()) + 1] - wave.fit[0]) / np.sqrt(power)
        away = bits.copy()
        if share != 0:  # each frame shows a share of the bit before
            for frame in range(1, len(bits)):
                away[frame] = (bits[frame] - share * np.sign(away[frame - 1])) / (1 - share)
        twice = [away[[frame, at[shown[frame]]]] > 0 for frame in range(len(away)) if 0 <= shown[frame] < self.bits]
        wrong = max(_average(one != other, inside) for one, other in twice)
        away = away[list(at.values())]
        clear = np.abs(away) > CLEAR
        unclear = tuple(_average(~each, inside) for each in clear)
        if len(at) < self.bits:
            return wrong, 0.0, unclear
        known = clear.all(axis=0)
        parity = np.logical_xor.reduce(away > 0)
        wrong = max(wrong, _average(parity != (wave.fit[2] > 0), inside * known))
        # displaced edges turn the mean of sign(sin(phi)) exp(i phi)
        turns = (wave.fit[1] + 1j * wave.fit[2]) * known
        seen, right = (np.sum(turns * np.where(sign, 1, -1)) for sign in (parity, wave.fit[2] > 0))
        turn = seen * np.conj(right)
        offset = float(np.abs(1 - turn / max(abs(turn), 1e-6)))
        # edges lie between two pixels of the projector; harmonics displace the fringes of three frames
        allowed = np.pi / self._layout.pitches[0] + (_LARGEST_CODE_OFFSET if wave.count == 3 else 0.0)
        return wrong, max(offset - allowed, 0.0), unclear


def _even_wave(levels: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Fit sinusoids to three frames of more shifts, with a second harmonic if they are far more even then.

    Three frames have no residual that would show the harmonic, and it displaces their phases if the angles are not
    those of three shifts.
    """
    alone = fit_wave(levels, angles)
    best = min((_with_harmonic(levels, angles, strength) for strength in _SECOND_HARMONICS), key=_unevenness)
    return best if _unevenness(best) < _FAR_MORE_EVEN * _unevenness(alone) else alone


def _with_harmonic(levels: np.ndarray, angles: np.ndarray, strength: float) -> np.ndarray:
    """Fit ``A + B cos(phi - a) + strength B cos(2 (phi - a))`` to grey levels (frame, pixel); shape (3, pixel)."""
    fit = fit_wave(levels, angles)
    for _ in range(_HARMONIC_ROUNDS):
        _, cosine, sine = fit
        twice = np.stack([cosine**2 - sine**2, 2 * cosine * sine]) / np.sqrt(square_modulation(fit))
        fit = fit_wave(levels - strength * (waves(2 * angles)[:, 1:].astype(np.float32) @ twice), angles)
    return fit


def _average(condition: np.ndarray, weights: np.ndarray) -> float:
    """Return the part of the weights where a condition holds; 0 without any weight."""
    return float(condition @ weights / max(float(weights.sum()), 1e-6))


def _halves(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values at the two pixels of each pair."""
    middle = values.shape[-1] // 2
    return values[..., :middle], values[..., middle:]


def _common(deviation: np.ndarray, fit: np.ndarray) -> float:
    """Return the deviation (frame, pixel) that the pixels of a pair have in common, over their modulation."""
    one, other = _halves(deviation)
    strength = np.multiply(*_halves(np.sqrt(square_modulation(fit)))).sum()
    return math.sqrt(max(float(np.vdot(one, other)) / float(strength), 0.0))


def _unevenness(fit: np.ndarray) -> float:
    """Return how unevenly phases and contrast of many fringes are distributed, 0 to about 1.

    They are distributed evenly where all frames show their patterns, also with gamma, whose error with three shifts
    varies with 3 phi. A frame with another pattern causes errors that vary with phi and 2 phi.
    """
    power = square_modulation(fit)
    strength = np.sqrt(power)
    turns = (fit[1] + 1j * fit[2]) / strength
    contrast = strength / np.maximum(fit[0], np.float32(1e-6))
    swing = np.clip(contrast / np.median(contrast), 0.0, 2.0)
    swing -= np.average(swing, weights=power)
    return math.hypot(
        *(abs(np.average(part * each, weights=power)) for part in (1.0, 2 * swing) for each in (turns, turns**2))
    )
