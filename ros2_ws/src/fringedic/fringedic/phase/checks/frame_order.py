"""Checks that every frame shows its pattern; otherwise finds the explanation that fits the stack best.

The explanations are compared by the misfit that they leave: two frames interchanged, one frame missing, one delivered
twice, all of them late, or one frame with another pattern. A good one leaves hardly any.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar

from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.checks.code_jumps import CodeJumps
from fringedic.phase.checks.flicker_and_motion import without_changes
from fringedic.phase.checks.misfit import UNKNOWN, Evidence, Misfit
from fringedic.phase.checks.projector_lag import first_lagging_frame
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.findings import Finding, FindingKind

# The scenes of benchmarks/stack_checks.py fix these limits
_PIXELS = 1000  # explanations are compared on so many pixels of the sample
# The right explanation leaves at most this part of the misfit. Where one frame of four is wrong, the other three give a
# wrong phase with a nonlinear response.
_EXPLAINED = 0.45
_FLOOR = 0.004  # any stack may leave this misfit: explanations below it are as good as each other
_AS_GOOD = 1.5  # explanations whose misfit is larger by no more than this factor compete by the jumps of their code
_UNKNOWN_FRAME = 0.001  # a frame without a known pattern has to remove this misfit
_LAGS = (0.08, 0.95)  # these parts of the pattern before leave a misfit and are not a whole frame
_FEWER_JUMPS = 0.5  # the right order of the bits leaves at most this part of the jumps
_NO_SINUSOID = 0.15  # no explanation fits frames whose RMS residual exceeds this part of the modulation
_ALIKE = 2.0  # a pitch that is seen so many times smaller or larger shows another pattern
_SAME_LENGTH = 0.02  # by which the lengths may differ that pitches give for two pixels
_REPEATED = 1.25  # so many of the coarsest fringes in view are more than one that covers it
_ONE_PHASE = 0.95  # |mean of exp(i phi)| exceeds this for one phase; fringes over a third of a pitch have 0.83
_SMALLEST_DEVIATION = 0.5  # a wrong frame deviates from its pattern by this part of the deviation of the pattern before


_LOSING = (FindingKind.OTHER_PATTERN, FindingKind.DOUBLED, FindingKind.MISSING)  # a pattern is not seen


@dataclass(frozen=True)
class Explanation:
    """An assumption about the patterns that the frames show, and the first frames concerned."""

    kind: FindingKind
    shown: tuple[int, ...]
    frames: tuple[int, ...]

    @property
    def unknown(self) -> int:
        """Number of frames whose pattern is not known."""
        return self.shown.count(UNKNOWN)


def check_order(
    sample: Sample, evidence: Evidence, noise: CameraNoise, jumps: CodeJumps, patterns: Sequence[ProjectedPattern]
) -> Finding | None:
    """Return the fault when frames show other patterns than recorded.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    evidence
        Their deviations from the recorded patterns.
    noise
        Of the camera.
    jumps
        Counts the jumps of the fringe orders that a Gray code gives.
    patterns
        Recorded pattern of each frame.

    Returns
    -------
    Finding or None
        The fault, with frames by their position in the stack; None for a good stack, and where a change of the light
        explains the misfit best.
    """
    recorded = tuple(range(len(patterns)))
    if evidence.is_small:
        swapped = _interchanged_bits(jumps, sample.layout.code, recorded) if jumps.are_suspicious else None
        return None if swapped is None else _finding(swapped, patterns)
    repeating = _find_repeating(sample, evidence, patterns)
    if repeating is not None:
        return repeating
    few = sample.thin(_PIXELS)
    misfit = Misfit(few, noise)
    trials = [(misfit.least(each.shown) + _UNKNOWN_FRAME * each.unknown, each) for each in explanations(len(recorded))]
    found: list[tuple[float, Explanation]] = []
    least = math.inf
    for bound, each in sorted(trials, key=lambda trial: trial[0]):
        if bound > max(_AS_GOOD * least, _FLOOR) or math.isinf(bound):
            break  # the residuals alone exclude the rest
        if _deviates(misfit, each):
            found.append((misfit(each.shown).total + _UNKNOWN_FRAME * each.unknown, each))
            least = min(least, found[-1][0])
    equal = [each for each in found if each[0] <= max(_AS_GOOD * least, _FLOOR)]
    left, explanation = min(equal, key=lambda each: (jumps(each[1].shown) if jumps.exist else 0, each[0]))
    lag = _best_lag(misfit, sample)
    best: tuple[float, Finding | None] = min(
        (left, _finding(explanation, patterns)),
        (misfit.lagging(lag.value).total + _UNKNOWN_FRAME, lag),
        # changes of the light and motions have many parameters: they explain a frame too many or too few as well
        *((_FLOOR + Misfit(each, noise)(recorded).total, None) for each in without_changes(few, noise)),
        key=lambda each: each[0],
    )
    if best[0] < _EXPLAINED * misfit(recorded).total:
        # One pitch of three shifts may fit as well without another of its frames.
        finding = best[1]
        if finding is None or finding.kind not in _LOSING or sample.layout.counts != [3]:
            return finding
        where = sample.layout.slices()[0]
        if finding.frames[0] < where.start:
            return finding
        return Finding.of_pitch(FindingKind.UNIDENTIFIED_FRAME, where, patterns)
    slices, pitches = sample.layout.slices(), sample.layout.pitches
    unrelated = evidence.unrelated_pitches()
    for number in range(1, len(slices)):
        coarse, fine = (float(np.angle(np.mean(sample.growth(each)))) for each in (number - 1, number))
        seen = sample.layout.pitches[number - 1] * coarse / fine if fine else math.inf
        if number in unrelated or not pitches[number] / _ALIKE < seen < pitches[number] * _ALIKE:
            first, coarser = slices[number].start, patterns[slices[number - 1].start]
            return Finding(FindingKind.UNRELATED_PITCH, True, (first,), (patterns[first],), value=seen, coarser=coarser)
    worst = int(np.argmax(evidence.residual))
    if evidence.is_uneven or (evidence.residual[worst] > _NO_SINUSOID and _same_phase(sample, worst)):
        return Finding.of_pitch(FindingKind.UNIDENTIFIED_FRAME, slices[worst], patterns)
    if evidence.has_wrong_bits:
        return Finding(FindingKind.CODE_DISAGREES, True, value=evidence.wrong_bits)
    return None


def _find_repeating(sample: Sample, evidence: Evidence, patterns: Sequence[ProjectedPattern]) -> Finding | None:
    """Return that no pitch covers the view, where every pitch fits alone and all are seen in their proportions."""
    layout, pitches = sample.layout, sample.layout.pitches
    if layout.code or layout.by_beats or len(pitches) == 1 or not replace(evidence, mismatch=()).is_small:
        return None
    growth = [float(np.angle(np.mean(sample.growth(number)))) for number in range(len(pitches))]
    lengths = [turn * pitch for turn, pitch in zip(growth, pitches, strict=True)]
    if np.ptp(lengths) > _SAME_LENGTH * max(map(abs, lengths)):
        return None  # a pitch is another one than described
    place, length = (sample.x, sample.size[1]) if sample.is_vertical else (sample.y, sample.size[0])
    # the growth is that over two pixels
    fringes = abs(growth[0]) / (2 * np.pi) * 0.5 * length * 0.5 * float(np.ptp(place))
    if fringes < _REPEATED:
        return None
    return Finding(FindingKind.REPEATING, True, (), (patterns[0],), value=fringes)


def find_contradiction(
    residuals: Sequence[float], slices: Sequence[slice], patterns: Sequence[ProjectedPattern]
) -> Finding | None:
    """Return the first pitch whose frames no sinusoid fits; for stacks that nothing else explains."""
    wrong = (where for residual, where in zip(residuals, slices, strict=True) if residual > _NO_SINUSOID)
    where = next(wrong, None)
    return None if where is None else Finding.of_pitch(FindingKind.UNIDENTIFIED_FRAME, where, patterns)


def _finding(found: Explanation, patterns: Sequence[ProjectedPattern]) -> Finding:
    return Finding(found.kind, True, found.frames, tuple(patterns[frame] for frame in found.frames))


def explanations(count: int) -> Iterator[Explanation]:
    """Return all explanations of a stack of so many frames.

    Examples
    --------
    >>> [each.shown for each in explanations(3) if each.kind is FindingKind.INTERCHANGED]
    [(1, 0, 2), (2, 1, 0), (0, 2, 1)]
    """
    recorded = tuple(range(count))
    for first, second in combinations(range(count), 2):
        order = list(recorded)
        order[first], order[second] = second, first
        yield Explanation(FindingKind.INTERCHANGED, tuple(order), (first, second))
    yield Explanation(FindingKind.LATE, (UNKNOWN, *recorded[:-1]), (0,))
    for frame in range(1, count - 1):
        yield Explanation(FindingKind.DOUBLED, (*recorded[:frame], *recorded[frame - 1 : -1]), (frame,))
    for frame in range(count - 2):
        yield Explanation(FindingKind.MISSING, (*recorded[:frame], *recorded[frame + 1 :], UNKNOWN), (frame,))
    for frame in recorded:
        shown = (*recorded[:frame], UNKNOWN, *recorded[frame + 1 :])
        yield Explanation(FindingKind.OTHER_PATTERN, shown, (frame,))


def _best_lag(misfit: Misfit, sample: Sample) -> Finding:
    """Return the share of the pattern before in every frame that fits best."""

    def total(share: float) -> float:
        return misfit.lagging(share).total

    low, high = _LAGS
    trials = np.linspace(low, high, 10)
    best = float(trials[int(np.argmin([total(float(share)) for share in trials]))])
    bounds = max(best - 0.1, low), min(best + 0.1, high)
    share = float(minimize_scalar(total, bounds=bounds, method="bounded").x)
    return Finding(FindingKind.PARTLY_LATE, True, (first_lagging_frame(sample.layout),), value=share)


def _deviates(misfit: Misfit, explanation: Explanation) -> bool:
    """Return whether a frame without a known pattern is as wrong as another pattern would be, not the light alone."""
    if explanation.kind not in (FindingKind.OTHER_PATTERN, FindingKind.LATE):
        return True
    frame = explanation.frames[0]
    if frame < misfit.bits:
        return misfit([frame if each == UNKNOWN else each for each in explanation.shown]).has_wrong_bits
    return misfit.deviation(explanation.shown, frame) > _SMALLEST_DEVIATION


def _interchanged_bits(jumps: CodeJumps, bits: int, recorded: tuple[int, ...]) -> Explanation | None:
    """Return the two bits of a Gray code without whose exchange its numbers jump less."""
    found = [each for each in explanations(len(recorded)) if each.kind is FindingKind.INTERCHANGED]
    best = min((each for each in found if max(each.frames) < bits), key=lambda each: jumps(each.shown))
    return best if jumps(best.shown) < _FEWER_JUMPS * jumps(recorded) else None


def _same_phase(sample: Sample, number: int) -> bool:
    """Return whether all pixels have one phase, as when one frame of a pitch is lit and the others are dark."""
    _, cosine, sine = sample.fits[number]
    return bool(np.abs(np.mean(np.exp(1j * np.arctan2(sine, cosine)))) > _ONE_PHASE)
