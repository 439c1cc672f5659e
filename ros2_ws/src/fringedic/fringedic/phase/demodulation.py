"""Phase stepping: from n q frames of each pitch to the absolute phase at the finest one (eq. 11).

A frame is ``I_k = A + B cos(phi - 2 pi k / q)``, k = 1..n q, so that eq. 11 returns +phi. The noise of a grey level
decides which pixels are valid: the standard deviation of phi is ``sqrt(2/N) sigma_I / B`` over N = n q frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from fringedic.errors import ErrorCode, ImageError, PhaseError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.phase.beats import combine_beats
from fringedic.phase.demodulation_kernel import Limits, Maps, NoiseModel, Shifts, measure_stack
from fringedic.phase.layout import Layout, check_frames, layout_of, pixels, shift_angles
from fringedic.phase.noise import estimate_noise
from fringedic.wording.arguments import (
    array,
    check_arguments,
    either,
    grey_levels,
    number,
    of_type,
    optional,
    several,
    whole,
)


@check_arguments(
    PhaseError,
    frames=grey_levels(3),
    shifts=whole(),
    noise=optional(either(CameraNoise, number())),
    saturation=optional(number()),
)
def demodulate(
    frames: np.ndarray,
    shifts: int,
    *,
    noise: CameraNoise | float | None = None,
    saturation: float | None = None,
) -> xr.Dataset:
    """Measure the wrapped phase of one pitch from its n q frames (phase stepping, eq. 11).

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
    PhaseError
        q is below 3 or the frames are not n cycles of q.
    ImageError
        The frames do not have the shape (frame, row, column).

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", eq. 11.

    Y. Surrel, "Additive noise effect in digital phase detection", Applied Optics 36 (1997) 271-276: sigma of the phase.

    Examples
    --------
    >>> phase = np.linspace(-3, 3, 7).reshape(1, 7)
    >>> frames = [100 + 50 * np.cos(phase - 2 * np.pi * k / 4) for k in (1, 2, 3, 4)]
    >>> measured = demodulate(np.array(frames, np.float32), shifts=4, noise=1.0)
    >>> bool(abs(measured.phase - phase).max() < 1e-5), float(measured.modulation[0, 0].round(3))
    (True, 50.0)
    """
    if shifts < 3 or len(frames) == 0 or len(frames) % shifts:
        raise PhaseError(
            f"{len(frames)} frames are not whole cycles of {shifts} shifts, of at least 3",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    patterns = [
        ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 1.0, k, shifts) for k in range(1, len(frames) + 1)
    ]
    return _measure(frames, patterns, noise, saturation, 0.0, None)


@check_arguments(
    PhaseError,
    frames=grey_levels(3),
    patterns=several(of_type(ProjectedPattern)),
    noise=optional(either(CameraNoise, either(np.ndarray, number()))),
    saturation=optional(number()),
    minimum_modulation=number(),
    gains=optional(array(1)),
)
def absolute_phase(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    *,
    noise: CameraNoise | float | np.ndarray | None = None,
    saturation: float | None = None,
    minimum_modulation: float = 0.0,
    gains: np.ndarray | None = None,
) -> xr.Dataset:
    """Measure the absolute phase at the finest pitch from all frames of a step.

    Every pitch is demodulated (eq. 11). The fringe order comes from the phase of the next coarser pitch (hierarchical
    temporal unwrapping), from the bits of a Gray code where the frames begin with one, or, where the coarsest pitch is
    less than twice the finest, from the beats of the pitches (`fringedic.phase.beats`): the phase is then that of the
    position at which all agree, with the noise of their weighted mean. A pixel is valid where no
    frame saturates, where the modulation of every pitch exceeds 5 sqrt(2/N) sigma_I, and where every fringe order is
    more than 5 standard deviations away from the neighbouring one.

    With one pitch and no code the phase is the wrapped phase. It is absolute only when one fringe covers the whole
    view; see `unwrap_spatial` otherwise.

    Parameters
    ----------
    frames
        Grey levels, uint8, uint16 or float32, shape (frame, row, column).
    patterns
        Pattern of each frame: fringes of one orientation, pitches coarse to fine, whole cycles of q >= 3 shifts; or
        the bits of a Gray code and then fringes of its pitch.
    noise
        Noise of the camera, or its standard deviation [grey level]: one, or one for each pixel, shape (row, column).
        None estimates it from the residuals of the frames, which needs more than 3 frames of some pitch. With 3 frames
        of each pitch there are no residuals: sigma is NaN and the validity assumes the noise of rounding.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.
    minimum_modulation
        Modulation [grey level] that the surface has at least, and stray light has not.
    gains
        Of the frames after the Gray code, by which flickering light makes them brighter, see
        `fringedic.phase.checks.stack.find_gains`; sigma does not contain their uncertainty.

    Returns
    -------
    Dataset
        ``phase`` [rad at the finest pitch], zero on the projector axis; ``sigma`` [rad], its standard deviation;
        ``modulation`` [grey level] of the finest pitch; ``texture`` [grey level], the mean of all fringe frames;
        ``valid``. Phase and sigma are NaN where not valid; modulation and texture are given everywhere.

    Raises
    ------
    PhaseError
        The patterns are not a sequence as described above.
    ImageError
        There is not one frame for each pattern, or the noise of each pixel has another shape.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", eq. 11.

    J. M. Huntley, H. Saldner, "Temporal phase-unwrapping algorithm for automated interferogram analysis", Applied
    Optics 32 (1993) 3047-3052.

    G. T. Reid, "Automatic fringe pattern analysis: a review", Optics and Lasers in Engineering 7 (1986) 37-68.

    Y. Surrel, "Additive noise effect in digital phase detection", Applied Optics 36 (1997) 271-276.

    Examples
    --------
    The camera sees the projector's image itself; its columns 0 to 79 are 8 of the finest fringes.

    >>> from fringedic.patterns import fringe_sequence
    >>> sequence = fringe_sequence(80, 4, [80, 10], shifts=4)
    >>> result = absolute_phase(np.array(list(sequence)), sequence.patterns, noise=1.0)
    >>> column = result.phase.values * 10 / (2 * np.pi) + 39.5
    >>> column[0, 16::16].round(1).tolist()
    [16.0, 32.0, 48.0, 64.0]
    """
    return _measure(frames, patterns, noise, saturation, minimum_modulation, gains)


def _measure_beats(
    frames: np.ndarray,
    layout: Layout,
    shifts: Shifts,
    conditions: tuple[NoiseModel, Limits],
    maps: Maps,
    *,
    known_noise: bool,
) -> None:
    """Measure each pitch alone, then the orders from all of them; the maps have the modulation of the finest pitch."""
    phases, sigmas = (np.empty((len(layout.periods), *maps.phase.shape), np.float32) for _ in range(2))
    texture = np.zeros_like(maps.texture)
    measured = np.ones_like(maps.valid)
    for pitch, where in enumerate(layout.slices()):
        alone = Shifts(
            pitch_of=np.zeros(layout.counts[pitch], np.int64),
            sine=shifts.sine[where],
            cosine=shifts.cosine[where],
            frames=shifts.frames[pitch : pitch + 1],
            ratio=np.ones(1, np.float32),
            factor=shifts.factor[where],
        )
        measure_stack(frames[where], frames[:0], alone, *conditions, maps)
        phases[pitch], sigmas[pitch] = maps.phase, maps.sigma
        texture += maps.texture * np.float32(layout.counts[pitch] / sum(layout.counts))
        measured &= maps.valid
    phase, sigma = combine_beats(phases, sigmas, layout.pitches, known_noise=known_noise)
    maps.phase[...], maps.sigma[...], maps.texture[...] = phase, sigma, texture
    maps.valid[...] = measured & np.isfinite(phase)


def _measure(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    noise: CameraNoise | float | np.ndarray | None,
    saturation: float | None,
    minimum_modulation: float,
    gains: np.ndarray | None,
) -> xr.Dataset:
    layout = layout_of(patterns)
    check_frames(frames, patterns)
    known = noise if noise is not None else estimate_noise(frames, patterns, saturation=saturation)
    shape = frames.shape[1:]
    phase, sigma, modulation, texture = (np.empty(shape, np.float32) for _ in range(4))
    maps = Maps(phase, sigma, modulation, texture, np.empty(shape, np.bool_))
    frames = np.ascontiguousarray(frames)
    fringes = patterns[layout.code :]
    angles, pitches = shift_angles(fringes), layout.pitches
    camera, of_pixels = CameraNoise(ROUNDING_NOISE), np.empty((0, 0), np.float32)
    if isinstance(known, CameraNoise):
        camera = known
    elif isinstance(known, np.ndarray):
        if known.shape != shape:
            raise ImageError(f"noise of {known.shape} pixels for frames of {shape}")
        of_pixels = np.ascontiguousarray(known, np.float32) ** 2
    elif known is not None:
        camera = CameraNoise(known)
    shifts = Shifts(
        pitch_of=np.repeat(np.arange(len(pitches)), layout.counts),
        sine=np.sin(angles).astype(np.float32),
        cosine=np.cos(angles).astype(np.float32),
        frames=np.array(layout.counts, np.float32),
        ratio=np.array(
            [coarse / fine for coarse, fine in zip(pitches[:1] + pitches, pitches, strict=False)], np.float32
        ),
        factor=(np.ones(len(fringes)) if gains is None else 1 / gains).astype(np.float32),
    )
    model = NoiseModel(np.float32(camera.read**2), np.float32(camera.shot), of_pixels)
    limits = Limits(np.float32(minimum_modulation), np.float32(saturation_level(frames, saturation)))
    if layout.by_beats:
        _measure_beats(frames, layout, shifts, (model, limits), maps, known_noise=known is not None)
    else:
        measure_stack(frames[layout.code :], frames[: layout.code], shifts, model, limits, maps)
    if known is None:
        maps.sigma.fill(np.nan)
    image = ("row", "column")
    return xr.Dataset(
        {
            "phase": (image, maps.phase, {"units": "rad", "long_name": "phase of the fringes"}),
            "sigma": (image, maps.sigma, {"units": "rad", "long_name": "standard deviation of the phase"}),
            "modulation": (
                image,
                maps.modulation,
                {"units": "grey level", "long_name": "modulation of the finest fringes"},
            ),
            "texture": (image, maps.texture, {"units": "grey level", "long_name": "mean of the fringe frames"}),
            "valid": (image, maps.valid, {"long_name": "where the phase is measured"}),
        },
        coords=pixels(maps.phase.shape),
    )
