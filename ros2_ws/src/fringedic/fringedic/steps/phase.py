"""The phase step: frames to absolute phase (eq. 11) and texture."""

from __future__ import annotations

import cv2
import numpy as np

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.collector import Stack
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import PatternKind
from fringedic.phase import ImageMotion
from fringedic.phase.measure import measure_phase
from fringedic.phase.settings import PhaseSettings
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.references import check_fraction
from fringedic.steps.remarks import Correction, CorrectionKind
from fringedic.steps.stack_motion import measure_moving_phase
from fringedic.steps.step_results import PhaseResult

LIT_NEIGHBOURHOOD = 9  # [px], larger than a speckle


def moving_phase_step(
    stack: Stack, parameters: PhaseParameters, *, initial: ImageMotion | None = None, drift: float = 0.0
) -> PhaseResult:
    """Measure the phase of a stack during which the surface moves, at the middle of its finest pitch.

    Trackers of displacement and shape take the result like that of a step at rest.

    Parameters
    ----------
    stack
        Fringe frames, and frames of uniform light before and after those of the finest pitch.
    parameters
        Noise, limits and the smallest valid part.
    initial, drift
        See `measure_moving_phase`.

    Returns
    -------
    PhaseResult
        At `Stack.time`; ``maps`` contains ``drift`` and ``sigma_drift`` [rad/s] beside the others.

    Raises
    ------
    StepError, PhaseError, ImageError
        See `measure_moving_phase`; less of the image has a phase than the parameters require (`TOO_FEW_VALID`).
    """
    first = stack.records[0].stamp
    times = np.array([1e-9 * (record.stamp - first) for record in stack.records])
    try:
        measured = measure_moving_phase(
            stack.frames,
            times,
            stack.patterns,
            _settings(parameters),
            initial=initial,
            drift=drift,
            exposure_time=max(stack.exposure_times),
        ).maps
    except StepError as error:
        raise StepError(
            error.reason, experiment=stack.experiment, step=stack.step, index=error.index, code=error.code
        ) from error
    fraction = float(measured.valid.mean())
    check_fraction("a phase", fraction, parameters.minimum_valid_fraction, (stack.experiment, stack.step))
    texture = measured.texture.where(_lit_region(measured.valid.values))
    finest = next(each for each in reversed(stack.patterns) if each.kind == PatternKind.FRINGES)
    return PhaseResult(
        experiment=stack.experiment,
        step=stack.step,
        stamp=stack.stamp,
        maps=measured[["phase", "sigma", "modulation", "drift", "sigma_drift"]].assign(texture=texture),
        pitch=finest.pitch,
        orientation=finest.orientation,
        valid_fraction=fraction,
        rms=float(np.nanmedian(measured.sigma.values)),
    )


def phase_step(stack: Stack, parameters: PhaseParameters) -> PhaseResult:
    """Check the frames of a step and measure its phase (eq. 11), in motion if its frames were taken for it.

    Raises
    ------
    StepError
        The stack contains no fringes (`ErrorCode.FRAME_MISMATCH`); its frames are faulty (`WRONG_PATTERN`,
        `FRAMES_OUT_OF_ORDER`, `FLICKER`, `SURFACE_MOVED`); less of the image has a phase than
        ``parameters.minimum_valid_fraction`` (`TOO_FEW_VALID`, or the cause `SATURATED` or `DARK`).
    PhaseError
        Its frames give no phase, or a relative one that the parameters do not accept.
    """
    if stack.kind != PatternKind.FRINGES:
        raise StepError(
            f"shows {stack.kind.name}, a phase needs fringes",
            experiment=stack.experiment,
            step=stack.step,
            code=ErrorCode.FRAME_MISMATCH,
        )
    if stack.is_moving:
        return moving_phase_step(stack, parameters)
    try:
        measured, remarks = measure_phase(
            stack.frames, stack.patterns, _settings(parameters), exposure_times=stack.exposure_times
        )
    except StepError as error:
        raise StepError(
            error.reason,
            experiment=stack.experiment,
            step=stack.step,
            index=error.index,
            code=error.code,
        ) from error
    fraction = float(measured.valid.mean())
    check_fraction("a phase", fraction, parameters.minimum_valid_fraction, (stack.experiment, stack.step))
    texture = measured.texture.where(_lit_region(measured.valid.values))
    return PhaseResult(
        experiment=stack.experiment,
        step=stack.step,
        stamp=stack.stamp,
        maps=measured[["phase", "sigma", "modulation"]].assign(texture=texture),
        pitch=stack.patterns[-1].pitch,
        orientation=stack.patterns[-1].orientation,
        valid_fraction=fraction,
        rms=float(np.nanmedian(measured.sigma.values)),
        relative=bool(measured.phase.attrs["relative"]),
        harmonic_error=measured.phase.attrs.get("harmonic_error", float("nan")),
        remarks=tuple(remarks),
        corrections=_corrections(parameters),
    )


def _settings(parameters: PhaseParameters) -> PhaseSettings:
    read_noise = parameters.read_noise_grey_level
    return PhaseSettings(
        method=parameters.method,
        accept_relative=parameters.relative_phase == "accept",
        noise=CameraNoise(read_noise, parameters.shot_noise_grey_level) if read_noise else None,
        saturation=parameters.saturation_grey_level or None,
        minimum_modulation=parameters.minimum_modulation_grey_level,
        correct_harmonics=parameters.correct_harmonics,
        lens_blur=parameters.lens_blur_px,
        largest_error=parameters.maximum_error_fringe,
        largest_motion=parameters.maximum_motion_px,
        region=parameters.region,
    )


def _corrections(parameters: PhaseParameters) -> tuple[Correction, ...]:
    blur = [Correction(CorrectionKind.LENS_BLUR, parameters.lens_blur_px)] if parameters.lens_blur_px else []
    harmonics = [Correction(CorrectionKind.HARMONICS)] if parameters.correct_harmonics else []
    return (*blur, *harmonics)


def _lit_region(valid: np.ndarray) -> np.ndarray:
    """Return where the surface is: pixels most of whose neighbours have a phase.

    Background and shadow do not move with the surface and would pull the displacement beside them. A dark speckle
    without phase stays part of the surface.
    """
    return cv2.blur(valid.astype(np.float32), (LIT_NEIGHBOURHOOD, LIT_NEIGHBOURHOOD)) > 0.5
