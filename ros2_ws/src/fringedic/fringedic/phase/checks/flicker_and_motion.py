"""Checks whether the light or the place of the surface changed while the fringes were exposed that give the phase.

A frame k that is brighter by g, whose fringes are displaced by e [rad] and whose texture is displaced by d [px] differs
from its sinusoid by ``g I + e B sin(phi - 2 pi k/q) - I d . grad(ln A)``. The fit of the sinusoid absorbs a part of
this difference, the same part for all pixels: Q = 1 - (hat matrix) leaves the rest. g, e (with its slopes over the
image) and d of all frames follow from one linear least-squares problem. Its normal matrix is the sum of products over
the pixels, times Q. The harmonics of a nonlinear response, of which all pixels have the same part, are fitted
with them. Where only the room's light changes, its term is ``g A`` instead of ``g I``. A rolling shutter exposes row
after row, so that flickering light gives it a g that changes from row to row, here a polynomial.

The causes are compared by the sum of squares that each explains alone, less ln(n) for each of its parameters (Bayesian
information criterion, n residuals). A finding names the cause that explains the most, and after it the causes that
explain the most of what is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.frames.noise import CameraNoise
from fringedic.phase.checks.light import light_changes
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.sinusoids import fit_wave, harmonic_levels, residual_maker, wave_levels, waves

# The scenes of benchmarks/stack_checks.py fix these limits
_FALSE_ALARMS = 1e-6  # so often a chi-square test reports pure noise
_REPORTED = 0.2  # a remark is made from this part of the allowed error on
_REPORTED_FLICKER = 0.02  # a remark is made from this change of the light on
LARGEST_FLICKER = 0.6  # a frame whose light changes by more shows another pattern
_OFFSET = 0.004  # the surface alone may move the centre of the fringes' circle by this part of the mean
_OUTLIER = 9.0  # a pixel with so many times the median square of the residuals has half its weight
_LARGEST_MEAN = 0.35  # above this mean of exp(i phi) over the pixels, single frames cannot be distinguished
_RANK = 1e-6  # singular values below this part of the largest are not determined by the frames
LIGHT = {FindingKind.FLICKER, FindingKind.ROOM_LIGHT, FindingKind.UNEVEN_LIGHT}
_DEGREE = 4  # of the polynomial of light that changes from row to row: up to one and a half periods in the image
_ONE_FRAME = 0.9  # of what the displaced fringes of all frames explain, where one frame alone is displaced


def find_changes(sample: Sample, camera: CameraNoise, largest_error: float, largest_motion: float) -> list[Finding]:
    """Return the changes of light and surface between the finest fringes; between those of all pitches by beats.

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
        `FLICKER`, `ROOM_LIGHT`, `UNEVEN_LIGHT`, `MOTION_ACROSS`, `MOTION_ALONG` and `DISPLACED_FRAME`, in the order of
        what they explain: one fault above these limits, the last, remarks below.
    """
    if not sample.has_many_fringes:
        return []
    layout, found = sample.layout, []
    for number in reversed(range(len(layout.periods)) if layout.by_beats else [len(layout.periods) - 1]):
        found.append(_find_in_pitch(sample, number, camera, largest_error, largest_motion))
        if any(each.fault for each in found[-1]):
            return found[-1]
    return found[0]


def _find_in_pitch(
    sample: Sample, number: int, camera: CameraNoise, largest_error: float, largest_motion: float
) -> list[Finding]:
    """Return the changes between the frames of a pitch; at most one, the last, is a fault."""
    fringes = Fringes.of(sample, number)
    if len(fringes.angles) < 4 or not covers_all_phases(fringes.fit):
        return []
    limits = largest_error, largest_motion
    found = _significant_findings(fringes, _fit_changes(sample, fringes, camera, room=False), *limits, room=False)
    if not found:
        return []
    causes = compare_causes(sample, fringes, camera)
    if causes.ranked[:1] == (FindingKind.UNEVEN_LIGHT,):  # the fit above takes it for other changes
        return _uneven_light(fringes, causes.uneven, largest_error)
    if FindingKind.ROOM_LIGHT in causes.ranked:
        found = _significant_findings(fringes, _fit_changes(sample, fringes, camera, room=True), *limits, room=True)
    if causes.displaced is not None:
        frame, pattern = fringes.where.start + causes.displaced, sample.layout.periods[number][causes.displaced]
        found = [
            replace(each, kind=FindingKind.DISPLACED_FRAME, frames=(frame,), patterns=(pattern,))
            if each.kind is FindingKind.MOTION_ALONG
            else each
            for each in found
        ]
    if causes.ranked:  # otherwise only the centre of the circle shows the change
        found = sorted(
            (each for each in found if each.kind in causes.ranked), key=lambda each: causes.ranked.index(each.kind)
        )
    first = next((number for number, each in enumerate(found) if each.fault), len(found))
    return found[: first + 1]


def _significant_findings(
    fringes: Fringes, changes: _Changes, largest_error: float, largest_motion: float, *, room: bool
) -> list[Finding]:
    """Return the changes that are large enough for a finding and exceed their noise; `room`: see `_fit_changes`."""
    count, light = changes.frames, changes.light
    rms = float(np.std(phase_changes(fringes, room=room) @ light)) / (2 * np.pi)
    flicker = Finding(
        FindingKind.ROOM_LIGHT if room else FindingKind.FLICKER,
        rms > largest_error,
        value=rms,
        limit=largest_error,
        light_change=float(np.ptp(light)),
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
    found = []
    for finding, parameters in (
        (flicker, slice(0, count)),
        (across, slice(4 * count, None)),
        (along, slice(count, 4 * count)),
    ):
        worth = finding.value > _REPORTED * finding.limit or finding.light_change > _REPORTED_FLICKER
        if worth and _is_significant(*changes.part(parameters)):
            found.append(finding)
    return found


def _uneven_light(fringes: Fringes, light: np.ndarray, largest_error: float) -> list[Finding]:
    """Return the finding about light that changes from row to row, shape (frame, pixel), where it is large enough."""
    error = float(np.std(np.sum(phase_changes(fringes) * light.T, axis=1))) / (2 * np.pi)
    change = float(np.ptp(light, axis=0).max())
    if error < _REPORTED * largest_error and change < _REPORTED_FLICKER:
        return []
    fault = error > largest_error
    return [Finding(FindingKind.UNEVEN_LIGHT, fault, value=error, limit=largest_error, light_change=change)]


@dataclass(frozen=True)
class Causes:
    """Causes of the residuals of a pitch.

    Attributes
    ----------
    ranked
        The cause that explains the most, then the one that explains the most of what is left, and so on.
    displaced
        Position in the pitch of the one frame whose fringes are displaced; None where several are, or it is not known.
    uneven
        Change of the light that differs from row to row, if it alone is the cause, shape (frame, pixel).
    """

    ranked: tuple[FindingKind, ...]
    displaced: int | None
    uneven: np.ndarray


def compare_causes(sample: Sample, fringes: Fringes, camera: CameraNoise) -> Causes:
    """Rank the causes of what the sinusoids of a pitch do not explain, with the harmonics of the response fitted."""
    equations = _Equations.of(sample, fringes, camera, more_light=True)
    count = len(fringes.angles)
    blocks = np.arange(len(equations.right)).reshape(-1, count)
    scale = math.log(fringes.levels.size) * equations.scatter
    shifts, across, along = blocks[1], blocks[4:6].ravel(), FindingKind.MOTION_ALONG
    single = np.array([equations.explained(each) for each in shifts[:, None]])
    first, second = np.argsort(single)[[-1, -2]]
    displaced = None
    if single[second] < _ONE_FRAME * single[first] and single[first] > _ONE_FRAME * equations.explained(shifts):
        displaced, along = int(first), FindingKind.DISPLACED_FRAME
    variants: dict[FindingKind, Sequence[np.ndarray]] = {
        FindingKind.FLICKER: (blocks[0],),
        FindingKind.ROOM_LIGHT: (blocks[6],),
        FindingKind.MOTION_ACROSS: (across,),
        along: (shifts, blocks[1:4].ravel()) if displaced is None else (shifts[[first]],),
    }
    uneven = blocks[[0, *range(7, len(blocks))]]
    if count > 4:  # of four frames it explains what fringes displaced from row to row leave, too
        variants[FindingKind.UNEVEN_LIGHT] = (uneven.ravel(),)
    courses = np.concatenate([np.ones((1, len(sample.y))), _row_courses(sample)])
    values = equations.solution(uneven.ravel()).reshape(uneven.shape)
    return Causes(_rank(equations, variants, scale), displaced, values.T @ courses)


def _rank(
    equations: _Equations, variants: Mapping[FindingKind, Sequence[np.ndarray]], scale: float
) -> tuple[FindingKind, ...]:
    """Return the causes by what each explains beside those before it; kinds of light exclude each other.

    A parameter has to explain more than `scale`.
    """

    def score(columns: np.ndarray) -> float:
        return equations.explained(columns) - scale * equations.rank(columns)

    left, ranked = dict(variants), []
    chosen, reached = np.empty(0, int), 0.0
    while left:
        trials = [(score(np.append(chosen, each)), kind, each) for kind, options in left.items() for each in options]
        best, kind, columns = max(trials, key=lambda trial: trial[0])
        if best <= reached:
            break
        ranked.append(kind)
        chosen, reached = np.append(chosen, columns), best
        for each in LIGHT if kind in LIGHT else {kind}:
            left.pop(each, None)
    return tuple(ranked)


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
    fringes = Fringes.of(sample)
    changes = _fit_changes(sample, fringes, camera, room=False)
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
    return [each for change, each in trials if change < LARGEST_FLICKER]


@dataclass(frozen=True)
class Fringes:
    """The fringes of a pitch at the sampled pixels."""

    where: slice  # of the frames in the stack
    angles: np.ndarray
    levels: np.ndarray  # (frame, pixel)
    fit: np.ndarray  # mean, cosine and sine part of the sinusoid of each pixel

    @classmethod
    def of(cls, sample: Sample, number: int = -1) -> Fringes:
        """Return those of a pitch, of the finest one by default."""
        where = sample.layout.slices()[number]
        return cls(where, sample.angles[number], sample.levels[where], sample.fits[number])

    @cached_property
    def model(self) -> np.ndarray:
        """Fitted sinusoids, shape (frame, pixel)."""
        return wave_levels(self.fit, self.angles)

    @cached_property
    def quadrature(self) -> np.ndarray:
        """B sin(phi - 2 pi k/q), shape (frame, pixel)."""
        return np.outer(np.cos(self.angles), self.fit[2]) - np.outer(np.sin(self.angles), self.fit[1])

    @cached_property
    def modulation(self) -> np.ndarray:
        """B, shape (pixel,)."""
        return np.asarray(np.hypot(self.fit[1], self.fit[2]))

    def with_gains(self, gains: np.ndarray) -> Fringes:
        """Return the fringes with the grey levels of each frame divided by its gain."""
        levels = self.levels / gains[:, None].astype(np.float32)
        return replace(self, levels=levels, fit=fit_wave(levels, self.angles))


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

    def relative_levels(self, sample: Sample, fringes: Fringes) -> np.ndarray:
        """Return the effect on the grey levels over their mean, shape (frame, pixel)."""
        parts = _design(sample, fringes, 1 / fringes.fit[0])
        return np.asarray(np.einsum("fkp,fk->kp", parts, self.values.reshape(6, self.frames)))


def covers_all_phases(fit: np.ndarray) -> bool:
    """Return whether the pixels of fitted sinusoids have phases all over the circle, so that frames can be told."""
    turns = np.exp(1j * np.arctan2(fit[2], fit[1]))
    return not any(abs(np.mean(each)) > _LARGEST_MEAN for each in (turns, turns**2, turns**3))


@dataclass
class _Equations:
    """Normal equations of the changes of all frames, without the harmonics, and the scatter of a weighted residual."""

    normal: np.ndarray
    right: np.ndarray
    scatter: float

    @classmethod
    def of(cls, sample: Sample, fringes: Fringes, camera: CameraNoise, *, more_light: bool) -> _Equations:
        """Return the equations of the six changes; `more_light`: and those of the room's light and of uneven light."""
        weight, rest = weighted_residuals(fringes, camera)
        pixels = rest.shape[1]
        parts = _design(sample, fringes, weight)
        if more_light:
            room = np.broadcast_to(fringes.fit[0] * weight, (1, *rest.shape))
            parts = np.concatenate([parts, room, parts[0] * _row_courses(sample)[:, None]])
        kinds = len(parts)
        parts = parts.reshape(-1, pixels)
        normal = np.tile(residual_maker(fringes.angles), (kinds, kinds)) * (parts @ parts.T)
        right = np.einsum("fkp,kp->fk", parts.reshape(kinds, *rest.shape), rest).ravel()
        harmonics = harmonic_levels(fringes.fit, fringes.angles) * weight
        reduced = without_harmonics(normal, right, parts, rest, harmonics)
        freedom = pixels * (len(fringes.angles) - 3)
        equations = cls(reduced.normal, reduced.right, 1.0)
        noise = float(np.sum(rest**2)) - reduced.explained - equations.explained(np.arange(len(right)))
        equations.scatter = max(noise / freedom, 1.0) if freedom else 1.0
        return equations

    def solution(self, columns: np.ndarray) -> np.ndarray:
        """Return some of the parameters, the others being 0."""
        block = self.normal[np.ix_(columns, columns)]
        return np.asarray(np.linalg.pinv(block, rcond=_RANK, hermitian=True) @ self.right[columns])

    def explained(self, columns: np.ndarray) -> float:
        """Return the sum of squares that some of the parameters explain alone."""
        return float(self.right[columns] @ self.solution(columns))

    def rank(self, columns: np.ndarray) -> int:
        """Return the number of independent parameters among them."""
        return int(np.linalg.matrix_rank(self.normal[np.ix_(columns, columns)], rtol=_RANK, hermitian=True))


def phase_changes(fringes: Fringes, *, room: bool = False) -> np.ndarray:
    """Return the change of the phase [rad] by that of the light in each frame, shape (pixel, frame) (eq. 11).

    `room`: the light of the room changes, which adds to all fringes alike, not that of the projector.
    """
    lit = fringes.fit[0] if room else fringes.model
    return np.asarray((-2 / len(fringes.angles) * fringes.quadrature * lit / fringes.modulation**2).T)


def _row_courses(sample: Sample) -> np.ndarray:
    """Return the Legendre polynomials of the row without the constant one, shape (degree, pixel)."""
    return np.asarray(np.polynomial.legendre.legvander(sample.y, _DEGREE).T[1:])


def weighted_residuals(fringes: Fringes, camera: CameraNoise) -> tuple[np.ndarray, np.ndarray]:
    """Return the weight of each pixel, the inverse of its noise, and the weighted residuals (frame, pixel).

    A pixel weighs less where the sinusoid fits badly (shadow edges).
    """
    rest = fringes.levels - fringes.model
    weight = 1 / np.sqrt(camera.variance(np.maximum(fringes.fit[0], 0)))
    square = np.sum(rest**2, axis=0) * weight**2
    weight = np.asarray(weight / np.sqrt(1 + square / max(_OUTLIER * float(np.median(square)), 1e-12)))
    return weight, rest * weight


def _fit_changes(sample: Sample, fringes: Fringes, camera: CameraNoise, *, room: bool) -> _Changes:
    """Return the least-squares estimate of the changes of all frames; `room`: the light is that of the room."""
    equations = _Equations.of(sample, fringes, camera, more_light=room)
    count = len(fringes.angles)
    if room:  # takes the place of the projector's light
        which = np.concatenate([np.arange(6 * count, 7 * count), np.arange(count, 6 * count)])
        equations = replace(equations, normal=equations.normal[np.ix_(which, which)], right=equations.right[which])
    _add_circle_condition(equations.normal, equations.right, sample, fringes)
    inverse = np.linalg.pinv(equations.normal, rcond=_RANK, hermitian=True)
    return _Changes(count, inverse @ equations.right, inverse * equations.scatter)


@dataclass(frozen=True)
class Reduced:
    """Normal equations from which the strengths of the harmonics are eliminated (Schur complement).

    Attributes
    ----------
    normal, right
        Of the other parameters.
    explained
        Sum of the squared residuals that the harmonics explain.
    strength
        Of the harmonics without the other parameters.
    share
        Change of the strengths by each parameter, shape (parameter, harmonic).
    """

    normal: np.ndarray
    right: np.ndarray
    explained: float
    strength: np.ndarray
    share: np.ndarray


def without_harmonics(
    normal: np.ndarray, right: np.ndarray, parts: np.ndarray, rest: np.ndarray, harmonics: np.ndarray
) -> Reduced:
    """Eliminate the strengths of the harmonics from the normal equations."""
    cube = parts.reshape(-1, *rest.shape).transpose(1, 0, 2)
    both = np.matmul(cube, harmonics.transpose(1, 2, 0)).transpose(1, 0, 2).reshape(len(parts), -1)
    flat = harmonics.reshape(len(harmonics), rest.size)
    inverse = np.linalg.pinv(flat @ flat.T, rcond=_RANK, hermitian=True)
    strength = inverse @ (flat @ rest.ravel())
    share = both @ inverse
    explained = float(strength @ (flat @ rest.ravel()))
    return Reduced(normal - share @ both.T, right - both @ strength, explained, strength, share)


def _design(sample: Sample, fringes: Fringes, weight: np.ndarray) -> np.ndarray:
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


def _texture_shares(sample: Sample, fringes: Fringes) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative change of the grey levels for a texture displaced by 1 px along x and y, shape (pixel,)."""
    right, left, below, above = (
        each[fringes.where].mean(axis=0) for each in (sample.right, sample.left, sample.below, sample.above)
    )
    return 0.5 * (left - right) / fringes.fit[0], 0.5 * (above - below) / fringes.fit[0]


def circle_centre(sample: Sample, fringes: Fringes) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of the circle on which (C/A, S/A) of all pixels lie, with its covariance.

    A jump in the middle of four shifts displaces the sinusoids and leaves no residual beside the second harmonic of a
    nonlinear response; light that changes like cos(2 pi k/q) looks like displaced fringes. But the radius of the circle
    is the contrast. Changing light displaces its centre, and a moving texture displaces it in proportion to the
    gradient of the texture. The centre follows from the linear fit of a circle, with parts for a contrast that changes
    over the image or with the brightness, for displaced fringes (2 phi) and for harmonics (q phi).

    Returns
    -------
    values, covariance : ndarray
        Of the centre by the light, and by 1 px of the texture along x and y: C, S each, shape (6,) and (6, 6).

    References
    ----------
    I. Kasa, "A circle fitting procedure and its error analysis", IEEE Transactions on Instrumentation and Measurement
    25 (1976) 8-14.
    """
    fit = fringes.fit
    cosine, sine = fit[1] / fit[0], fit[2] / fit[0]
    square = cosine**2 + sine**2
    phase = np.arctan2(sine, cosine)
    even = np.ones_like(square)
    turns = [turn(number * phase) for number in {2, _shifts(sample, fringes)} for turn in (np.cos, np.sin)]
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
    return values[:known], covariance


def centre_courses(angles: np.ndarray) -> np.ndarray:
    """Return the displacement of the centre by the light of each frame, shape (2, frame)."""
    return waves(angles)[:, 1:].T * (2 / len(angles))


def _shifts(sample: Sample, fringes: Fringes) -> int:
    """Return q of the pitch."""
    number = next(number for number, where in enumerate(sample.layout.slices()) if where == fringes.where)
    return sample.layout.periods[number][0].shifts


def _add_circle_condition(normal: np.ndarray, right: np.ndarray, sample: Sample, fringes: Fringes) -> None:
    """Add the equations of the changes that follow from the centre of the circle, see `circle_centre`."""
    count = len(fringes.angles)
    values, covariance = circle_centre(sample, fringes)
    courses = np.zeros((len(values), len(right)))
    for number, first in enumerate((0, 4 * count, 5 * count)):  # light, texture along x and y
        courses[2 * number : 2 * number + 2, first : first + count] = centre_courses(fringes.angles)
    weight = np.linalg.pinv(covariance, rcond=_RANK, hermitian=True) @ courses
    normal += courses.T @ weight
    right += values @ weight


def _is_significant(values: np.ndarray, covariance: np.ndarray) -> bool:
    """Return whether these values together exceed what noise alone gives (chi-square test)."""
    inverse = np.linalg.pinv(covariance, rcond=_RANK, hermitian=True)
    freedom = int(np.linalg.matrix_rank(covariance, rtol=_RANK, hermitian=True))
    return bool(values @ inverse @ values > chdtri(max(freedom, 1), _FALSE_ALARMS))
