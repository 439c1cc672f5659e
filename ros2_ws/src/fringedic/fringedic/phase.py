"""From phase-shifted frames to the absolute phase: demodulation (eq. 11), its noise, and temporal unwrapping.

A frame is ``I_k = A + B cos(phi - 2 pi k / q)``, k = 1..n q, so that eq. 11 returns +phi. What is valid, and how
noisy, follows from the noise of a grey level: phi has the standard deviation ``sqrt(2/N) sigma_I / B`` over N = n q
frames.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
import xarray as xr
from numba import njit, prange
from scipy.optimize import nnls
from scipy.stats import chi2

from fringedic.errors import InvalidSequenceError, ShapeMismatchError
from fringedic.sequence import Orientation, PatternKind, Projection

CONFIDENCE = 5.0  # standard deviations between a measurement and the case in which it means nothing
ROUNDING_NOISE = 1 / math.sqrt(12)  # of a grey level; no camera is better
_NOISE_SAMPLES = 30_000  # pixels that the noise is estimated from
_NOISE_LEVELS = 16  # brightness classes of that estimate


@dataclass(frozen=True)
class CameraNoise:
    """Noise of one grey level: ``sigma_I^2 = read^2 + shot * level``.

    Attributes
    ----------
    read
        Standard deviation without light, rounding included [grey level].
    shot
        Growth of the variance with the level [grey level].
    """

    read: float
    shot: float = 0.0


@dataclass(frozen=True)
class _Period:
    """The frames of one pitch."""

    projections: tuple[Projection, ...]

    @property
    def pitch(self) -> float:
        return self.projections[0].pitch

    def __len__(self) -> int:
        return len(self.projections)


def demodulate(
    frames: np.ndarray,
    shifts: int,
    *,
    noise: CameraNoise | float | None = None,
    saturation: float | None = None,
) -> xr.Dataset:
    """Measure the wrapped phase of one pitch from its n q frames (eq. 11).

    Parameters
    ----------
    frames
        Grey levels, shape (n q, row, column), frame k - 1 taken at the shift 2 pi k / q.
    shifts
        q, at least 3.
    noise, saturation
        See `absolute_phase`.

    Returns
    -------
    Dataset
        ``phase`` [rad] in (-pi, pi], ``modulation`` B and ``texture`` A [grey level], ``sigma`` of the phase [rad] and
        ``valid``. Phase and sigma are NaN where not valid; modulation and texture are given everywhere.

    Raises
    ------
    InvalidSequenceError
        When q < 3 or the frames are not n cycles of q.
    """
    if shifts < 3 or len(frames) == 0 or len(frames) % shifts:
        raise InvalidSequenceError(f"{len(frames)} frames are not whole cycles of {shifts} shifts, of at least 3")
    projections = [
        Projection(PatternKind.FRINGES, Orientation.VERTICAL, 1.0, k, shifts) for k in range(1, len(frames) + 1)
    ]
    return _measure(frames, projections, noise, saturation, 0.0)


def absolute_phase(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    noise: CameraNoise | float | None = None,
    saturation: float | None = None,
    minimum_modulation: float = 0.0,
) -> xr.Dataset:
    """Measure the absolute phase at the finest pitch from all frames of a step.

    Every pitch is demodulated (eq. 11); the phase of each tells the fringe order of the next finer one. A pixel is
    valid where no frame saturates, where every pitch is modulated by more than 5 sqrt(2/N) sigma_I, and where every
    fringe order is more than 5 standard deviations away from its neighbour.

    Parameters
    ----------
    frames
        Grey levels, uint8, uint16 or float32, shape (frame, row, column).
    projections
        What each frame showed: fringes of one orientation, pitches coarse to fine, whole cycles of q >= 3 shifts.
    noise
        Noise of the camera, or its constant standard deviation [grey level]. When None it is estimated from what the
        frames leave unexplained, which takes more than 3 frames of some pitch; with 3 frames of each there is nothing
        left to estimate from: sigma is NaN and the validity assumes the noise of rounding.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.
    minimum_modulation
        Modulation that the surface itself, and no stray light, has at least [grey level].

    Returns
    -------
    Dataset
        ``phase`` [rad at the finest pitch], zero on the projector axis; ``sigma`` [rad], its standard deviation;
        ``modulation`` [grey level] of the finest pitch; ``texture`` [grey level], the mean of the whole stack;
        ``valid``. Phase and sigma are NaN where not valid; modulation and texture are given everywhere.

    Raises
    ------
    InvalidSequenceError
        When the projections are not what is said above.
    ShapeMismatchError
        When there is not one frame for each projection.
    """
    return _measure(frames, projections, noise, saturation, minimum_modulation)


def unwrap_hierarchical(wrapped: Sequence[np.ndarray | xr.DataArray], pitches: Sequence[float]) -> xr.DataArray:
    """Unwrap phases coarse to fine: each tells the fringe order of the next.

    Parameters
    ----------
    wrapped
        Wrapped phases [rad], one image of shape (row, column) for each pitch, all zero on the projector axis. The
        first has to be unique over the field: it is taken as it is.
    pitches
        Fringe pitches, coarse to fine, in any one unit.

    Returns
    -------
    DataArray
        Absolute phase at the finest pitch [rad]; NaN where any phase is NaN.

    Raises
    ------
    InvalidSequenceError
        When the pitches do not become finer.
    ShapeMismatchError
        When there is not one image for each pitch or the images differ in size.
    """
    if len(wrapped) != len(pitches) or not wrapped:
        raise ShapeMismatchError(f"{len(wrapped)} phase images for {len(pitches)} pitches: give one for each")
    _check_finer(pitches)
    images = [np.asarray(image, float) for image in wrapped]
    if len({image.shape for image in images}) > 1:
        raise ShapeMismatchError(f"phase images differ in size: {[image.shape for image in images]}")
    phase = images[0]
    for image, coarse, fine in zip(images[1:], pitches, pitches[1:], strict=False):
        phase = image + 2 * np.pi * np.round((phase * coarse / fine - image) / (2 * np.pi))
    return xr.DataArray(
        phase, dims=("row", "column"), coords=_pixels(phase.shape), name="phase", attrs={"units": "rad"}
    )


def estimate_noise(
    frames: np.ndarray, projections: Sequence[Projection], *, saturation: float | None = None
) -> CameraNoise | None:
    """Estimate the noise of grey levels from what the sinusoids leave unexplained.

    The variance of the residuals is sorted by brightness; medians keep edges and moving things out, a line through
    them is the noise model. Harmonics of the projector count as noise.

    Parameters
    ----------
    frames, projections, saturation
        See `absolute_phase`; pixels that saturate are left out.

    Returns
    -------
    CameraNoise or None
        None when no pitch has more than 3 frames, or all pixels saturate.

    Raises
    ------
    InvalidSequenceError, ShapeMismatchError
        See `absolute_phase`.
    """
    periods = _periods(projections)
    _check_frames(frames, projections)
    freedom = sum(len(period) - 3 for period in periods)
    if freedom == 0:
        return None
    skip = math.ceil(math.sqrt(frames[0].size / _NOISE_SAMPLES))
    sample = frames[:, ::skip, ::skip].reshape(len(frames), -1)
    sample = sample[:, sample.max(axis=0) < _ceiling(frames, saturation)].astype(float)
    if sample.shape[1] == 0:
        return None
    unexplained = np.zeros(sample.shape[1])
    first = 0
    for period in periods:
        levels = sample[first : first + len(period)]
        # over whole cycles mean, cosine and sine are orthogonal: what they explain can be subtracted one by one
        unexplained += np.sum(levels**2, axis=0) - len(period) * levels.mean(axis=0) ** 2
        for wave in (np.cos, np.sin):
            weights = wave(_angles(period.projections))[:, None]
            unexplained -= 2 / len(period) * np.sum(weights * levels, axis=0) ** 2
        first += len(period)
    texture = sample.mean(axis=0)
    classes = np.array_split(np.argsort(texture, kind="stable"), min(_NOISE_LEVELS, sample.shape[1]))
    level = np.array([texture[each].mean() for each in classes])
    variance = np.array([np.median(unexplained[each]) for each in classes]) / chi2.median(freedom)
    read_variance, shot = nnls(np.stack([np.ones_like(level), level], axis=1), variance)[0]
    return CameraNoise(max(math.sqrt(read_variance), ROUNDING_NOISE), float(shot))


def _measure(
    frames: np.ndarray,
    projections: Sequence[Projection],
    noise: CameraNoise | float | None,
    saturation: float | None,
    minimum_modulation: float,
) -> xr.Dataset:
    periods = _periods(projections)
    _check_frames(frames, projections)
    known = noise if noise is not None else estimate_noise(frames, projections, saturation=saturation)
    camera = known if isinstance(known, CameraNoise) else CameraNoise(ROUNDING_NOISE if known is None else known)
    angles = _angles(projections)
    pitches = [period.pitch for period in periods]
    phase, sigma, modulation, texture = (np.empty(frames.shape[1:], np.float32) for _ in range(4))
    valid = np.empty(frames.shape[1:], np.bool_)
    _absolute_phase(
        np.ascontiguousarray(frames),
        np.repeat(np.arange(len(periods)), [len(period) for period in periods]),
        np.sin(angles).astype(np.float32),
        np.cos(angles).astype(np.float32),
        np.array([len(period) for period in periods], np.float32),
        np.array([coarse / fine for coarse, fine in zip(pitches[:1] + pitches, pitches, strict=False)], np.float32),
        np.float32(camera.read**2),
        np.float32(camera.shot),
        np.float32(minimum_modulation),
        np.float32(_ceiling(frames, saturation)),
        phase,
        sigma,
        modulation,
        texture,
        valid,
    )
    if known is None:
        sigma.fill(np.nan)
    image = ("row", "column")
    return xr.Dataset(
        {
            "phase": (image, phase, {"units": "rad", "long_name": "phase of the fringes"}),
            "sigma": (image, sigma, {"units": "rad", "long_name": "standard deviation of the phase"}),
            "modulation": (image, modulation, {"units": "grey level", "long_name": "modulation of the finest fringes"}),
            "texture": (image, texture, {"units": "grey level", "long_name": "mean of the stack"}),
            "valid": (image, valid, {"long_name": "where the phase is measured"}),
        },
        coords=_pixels(frames.shape[1:]),
    )


@njit(cache=True, nogil=True, parallel=True)
def _absolute_phase(
    frames: np.ndarray,
    period_of: np.ndarray,
    sine: np.ndarray,
    cosine: np.ndarray,
    count: np.ndarray,
    ratio: np.ndarray,
    read_variance: np.float32,
    shot: np.float32,
    minimum_modulation: np.float32,
    saturation: np.float32,
    phase: np.ndarray,
    sigma: np.ndarray,
    modulation: np.ndarray,
    texture: np.ndarray,
    valid: np.ndarray,
) -> None:
    """Demodulate and unwrap a stack row by row, so that the sums of one row stay in the processor's cache."""
    images, rows, columns = frames.shape
    periods = len(count)
    turn = np.float32(2 * np.pi)
    confidence = np.float32(CONFIDENCE)
    for row in prange(rows):
        sine_sum = np.zeros((periods, columns), np.float32)
        cosine_sum = np.zeros((periods, columns), np.float32)
        total = np.zeros(columns, np.float32)
        brightest = np.zeros(columns, np.float32)
        for k in range(images):
            period = period_of[k]
            for column in range(columns):
                level = np.float32(frames[k, row, column])
                sine_sum[period, column] += sine[k] * level
                cosine_sum[period, column] += cosine[k] * level
                total[column] += level
                brightest[column] = max(brightest[column], level)
        for column in range(columns):
            mean = total[column] / np.float32(images)
            noise = math.sqrt(read_variance + shot * mean)
            measured = brightest[column] < saturation
            angle = np.float32(0)
            deviation = np.float32(0)
            amplitude = np.float32(0)
            for period in range(periods):
                s, c = sine_sum[period, column], cosine_sum[period, column]
                amplitude = np.float32(2) / count[period] * math.sqrt(s * s + c * c)
                limit = confidence * math.sqrt(np.float32(2) / count[period]) * noise
                measured &= amplitude > max(limit, minimum_modulation)
                if not measured:
                    continue
                wrapped = np.float32(math.atan2(s, c))
                coarse = angle * ratio[period]
                coarse_deviation = deviation * ratio[period]
                deviation = np.float32(math.sqrt(np.float32(2) / count[period]) * noise / amplitude)
                if period == 0:
                    angle = wrapped
                    continue
                order = math.floor((coarse - wrapped) / turn + np.float32(0.5))
                angle = wrapped + turn * np.float32(order)
                doubt = confidence * math.sqrt(coarse_deviation * coarse_deviation + deviation * deviation)
                measured &= abs(coarse - angle) + doubt < np.float32(0.5) * turn
            phase[row, column] = angle if measured else np.float32(np.nan)
            sigma[row, column] = deviation if measured else np.float32(np.nan)
            modulation[row, column] = amplitude
            texture[row, column] = mean
            valid[row, column] = measured


def _periods(projections: Sequence[Projection]) -> list[_Period]:
    """Split a sequence into its pitches and refuse what no absolute phase follows from."""
    for projection in projections:
        if projection.kind != PatternKind.FRINGES:
            raise InvalidSequenceError(f"a frame shows '{projection}': a phase needs fringes in every frame")
    if not projections:
        raise InvalidSequenceError("no frames: a phase needs at least 3")
    if len({projection.orientation for projection in projections}) > 1:
        raise InvalidSequenceError("vertical and horizontal fringes are mixed: measure each by itself")
    periods = [_Period(tuple(group)) for _, group in groupby(projections, key=lambda each: (each.pitch, each.shifts))]
    _check_finer([period.pitch for period in periods])
    for period in periods:
        shifts = period.projections[0].shifts
        if shifts < 3:
            raise InvalidSequenceError(f"pitch {period.pitch:g} px: {shifts} shifts, at least 3 are needed")
        shown = Counter(each.shift % shifts for each in period.projections)
        if len(shown) < shifts or len(set(shown.values())) > 1:
            raise InvalidSequenceError(
                f"pitch {period.pitch:g} px: {len(period)} frames are not whole cycles of {shifts} shifts"
            )
    return periods


def _check_finer(pitches: Sequence[float]) -> None:
    if any(fine >= coarse for coarse, fine in pairwise(pitches)):
        raise InvalidSequenceError(f"pitches {list(pitches)} px have to become finer from each to the next")


def _check_frames(frames: np.ndarray, projections: Sequence[Projection]) -> None:
    if frames.ndim != 3 or len(frames) != len(projections):
        raise ShapeMismatchError(
            f"frames of shape {frames.shape} for {len(projections)} projections: "
            f"expected ({len(projections)}, rows, columns)"
        )


def _ceiling(frames: np.ndarray, saturation: float | None) -> float:
    """Return the grey level from which a pixel counts as saturated."""
    if saturation is not None:
        return saturation
    return float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else math.inf


def _angles(projections: Sequence[Projection]) -> np.ndarray:
    """Return 2 pi k / q of each frame (eq. 11)."""
    return np.array([2 * np.pi * each.shift / each.shifts for each in projections])


def _pixels(shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return the coordinates of a full image."""
    return {"row": np.arange(shape[0]), "column": np.arange(shape[1])}
