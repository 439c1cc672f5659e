"""Phase on a moving surface, with frames of an independent renderer (benchmarks/moving_scenes)."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fringedic.errors import ErrorCode, ImageError, PhaseError, StepError
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.phase import ImageMotion, PhaseSettings, absolute_phase, check_shifts, demodulate_moving, plan_shifts

SCENES = Path(__file__).resolve().parents[5] / "benchmarks" / "moving_scenes" / "scene.py"
specification = importlib.util.spec_from_file_location("moving_scene", SCENES)
assert specification is not None
scenes = importlib.util.module_from_spec(specification)
sys.modules["moving_scene"] = scenes
specification.loader.exec_module(scenes)
Motion, Scene, Shown = scenes.Motion, scenes.Scene, scenes.Shown

PITCH = 12.0
SETTINGS = PhaseSettings(noise=CameraNoise(float(np.hypot(1.0, 12**-0.5)), 0.02))
SCENE = Scene(rows=160, columns=224, exposure=0.4, instants=3)
STRAINED = ((0.002, 0.0), (0.0, -0.001))


def patterns_of(direction: int) -> list[ProjectedPattern]:
    """Return three pitches, the finest with 8 shifts, all shifted along x (1) or against it (-1)."""
    return [
        ProjectedPattern(PatternKind.FRINGES, pitch=pitch, shift=direction * k % count or count, shifts=count)
        for pitch, count in ((288.0, 4), (48.0, 4), (PITCH, 8))
        for k in range(1, count + 1)
    ]


def frames_of(motion: Motion, patterns: list[ProjectedPattern], scene: Scene = SCENE) -> tuple[np.ndarray, np.ndarray]:
    """Return frames at a constant rate, and times that are 0 in the middle of the finest pitch [frame]."""
    times = np.arange(len(patterns)) - (len(patterns) - 8) - 3.5
    shown = [Shown(each.pitch, each.shift, each.shifts) for each in patterns]
    return scene.expose(shown, times, motion), times


def motion_in_image(motion: Motion, *, accelerated: bool = False) -> ImageMotion:
    """Return the true motion."""
    acceleration = SCENE.acceleration(motion).astype(np.float32) if accelerated else None
    return ImageMotion(SCENE.velocity(motion).astype(np.float32), acceleration)


def score(error: np.ndarray, sigma: xr.DataArray) -> float:
    """Root mean square of errors over their standard deviation."""
    return float(np.sqrt(np.nanmean((error / sigma.values) ** 2)))


@pytest.fixture(scope="module")
def at_rest() -> float:
    """RMS error of the same stack at rest [rad]."""
    patterns = patterns_of(1)
    frames, _ = frames_of(Motion(), patterns)
    measured = absolute_phase(frames, patterns, noise=SETTINGS.noise)
    return float(np.sqrt(np.nanmean((measured.phase.values - SCENE.phase_at_rest(PITCH)) ** 2)))


@pytest.mark.parametrize(
    ("motion", "direction", "ratio"),
    [
        (Motion(0.25, 0.0, 0.3), -1, 1.05),
        (Motion(-1.0, 0.5, 0.3), 1, 1.1),
        (Motion(3.0, 1.0, 0.3), -1, 1.2),
        (Motion(0.0, 3.0, -0.3), 1, 1.2),
        (Motion(1.0, 0.0, 0.3, STRAINED, (0.001, 0.001)), -1, 1.1),
    ],
)
def test_a_moving_surface_is_measured_as_one_at_rest(
    motion: Motion, direction: int, ratio: float, at_rest: float
) -> None:
    patterns = patterns_of(direction)
    frames, times = frames_of(motion, patterns)
    measured = demodulate_moving(frames, times, patterns, motion_in_image(motion), SETTINGS)
    error = measured.phase.values - SCENE.phase_at_rest(PITCH)
    assert np.sqrt(np.nanmean(error**2)) <= ratio * at_rest
    assert np.nanmax(np.abs(error)) < np.pi
    assert float(measured.valid.mean()) > 0.6  # 14.5 frames at 3 px leave the image
    assert 0.9 < score(error, measured.sigma) < 1.1
    assert 0.9 < score(measured.drift.values - SCENE.drift(PITCH, motion), measured.sigma_drift) < 1.1
    assert float(measured.condition.median()) < 6
    assert not measured.accelerated


def test_a_shift_that_follows_the_motion_is_refused() -> None:
    motion, patterns = Motion(1.5), patterns_of(1)
    frames, times = frames_of(motion, patterns)
    with pytest.raises(StepError, match="the shifts follow the motion") as caught:
        demodulate_moving(frames, times, patterns, motion_in_image(motion), SETTINGS)
    assert caught.value.code is ErrorCode.INVALID_SEQUENCE
    with pytest.raises(PhaseError, match="follow the predicted motion"):
        demodulate_moving(
            frames, times, patterns, motion_in_image(motion), SETTINGS, drift=2 * np.pi * motion.right / PITCH
        )


def test_a_surface_that_runs_the_other_way_is_refused() -> None:
    """Its frames are those of a wave that stands still, whose orders were wrong on half of the surface."""
    patterns = patterns_of(-1)
    frames, times = frames_of(Motion(-3.0, 0.3), patterns)
    with pytest.raises(StepError, match=r"the coarser fringes contradict the finest ones on \d\d % of the surface"):
        demodulate_moving(frames, times, patterns, motion_in_image(Motion(-3.0, 0.3)), SETTINGS)


def test_a_surface_that_outruns_the_shifts_is_measured_with_a_prediction(at_rest: float) -> None:
    motion, patterns = Motion(3.5), patterns_of(1)
    frames, times = frames_of(motion, patterns)
    drift = 2 * np.pi * motion.right / PITCH
    measured = demodulate_moving(frames, times, patterns, motion_in_image(motion), SETTINGS, drift=drift)
    error = measured.phase.values - SCENE.phase_at_rest(PITCH)
    assert np.nanmax(np.abs(error)) < np.pi
    assert np.sqrt(np.nanmean(error**2)) < 1.2 * at_rest


def test_acceleration_is_fitted() -> None:
    motion, patterns = Motion(0.6, 0.2, 0.8, course=lambda t: t + 0.04 * t * t), patterns_of(-1)
    frames, times = frames_of(motion, patterns)
    measured = demodulate_moving(frames, times, patterns, motion_in_image(motion, accelerated=True), SETTINGS)
    error = measured.phase.values - SCENE.phase_at_rest(PITCH)
    assert measured.accelerated
    assert np.nanmax(np.abs(error)) < np.pi
    assert 0.9 < score(error, measured.sigma) < 1.1


def test_the_frame_with_another_pattern_is_named() -> None:
    motion, patterns = Motion(1.0, 0.0, 0.3), patterns_of(-1)
    frames, times = frames_of(motion, patterns)
    frames[11] = frames[12]
    for settings in (SETTINGS, PhaseSettings()):
        with pytest.raises(StepError, match="frame 4 of the finest pitch") as caught:
            demodulate_moving(frames, times, patterns, motion_in_image(motion), settings)
        assert caught.value.code is ErrorCode.WRONG_PATTERN


def test_a_reversal_and_blurred_fringes_are_named() -> None:
    reversal, patterns = Motion(1.0, 0.0, 0.5, course=abs), patterns_of(-1)
    frames, times = frames_of(reversal, patterns)
    with pytest.raises(StepError, match="does not move as") as caught:
        demodulate_moving(frames, times, patterns, motion_in_image(reversal), SETTINGS)
    assert caught.value.code is ErrorCode.SURFACE_MOVED
    fast = Motion(2.0)
    frames, times = frames_of(fast, patterns)
    assert demodulate_moving(frames, times, patterns, motion_in_image(fast), SETTINGS, exposure_time=0.4).contrast > 0.9
    with pytest.raises(StepError, match="blurs the fringes"):
        demodulate_moving(frames, times, patterns, motion_in_image(fast), SETTINGS, exposure_time=3.7)


def test_a_prediction_numbers_the_fringes_of_one_pitch() -> None:
    motion, patterns = Motion(1.0, 0.0, 0.3), patterns_of(-1)
    frames, times = frames_of(motion, patterns)
    truth = SCENE.phase_at_rest(PITCH).astype(np.float32)
    guess = xr.Dataset(
        {"phase": (("row", "column"), truth + 0.8), "sigma": (("row", "column"), np.full_like(truth, 0.3))}
    )
    fine = slice(8, None)
    measured = demodulate_moving(
        frames[fine], times[fine], patterns[fine], motion_in_image(motion), SETTINGS, prediction=guess
    )
    assert np.nanmax(np.abs(measured.phase.values - truth)) < np.pi
    assert float(measured.valid.mean()) > 0.9
    wrong = guess.assign(phase=guess.phase + 2 * np.pi)
    refused = demodulate_moving(frames, times, patterns, motion_in_image(motion), SETTINGS, prediction=wrong)
    assert not bool(refused.valid.any())


def test_white_frames_are_ignored_and_wrong_arguments_are_named() -> None:
    motion, patterns = Motion(0.5), patterns_of(-1)
    frames, times = frames_of(motion, patterns)
    still = motion_in_image(motion)
    white = ProjectedPattern(PatternKind.WHITE)
    with_white = demodulate_moving(
        np.concatenate([frames, frames[:1]]), np.append(times, 5.0), [*patterns, white], still, SETTINGS
    )
    xr.testing.assert_identical(with_white, demodulate_moving(frames, times, patterns, still, SETTINGS))
    with pytest.raises(ImageError, match="one of each, rising"):
        demodulate_moving(frames, times[::-1], patterns, still, SETTINGS)
    with pytest.raises(ImageError, match="velocity of shape"):
        demodulate_moving(frames[:, :-1], times, patterns, still, SETTINGS)
    with pytest.raises(PhaseError, match="needs 5 or more"):
        demodulate_moving(frames[:8], times[:8], patterns[:8], still, SETTINGS)


@pytest.mark.parametrize("speed", [-3.0, -1.5, -0.25, 0.0, 0.5, 1.5, 2.25, 3.0])
def test_planned_shifts_are_as_good_as_at_rest(speed: float) -> None:
    drift = 2 * np.pi * speed / PITCH
    plan = plan_shifts(drift, 8, uncertainty=0.1)
    assert plan.noise < 1.15
    assert not plan.follows
    angles = 2 * np.pi * np.array(plan.order) / plan.shifts
    assert check_shifts(angles.tolist(), drift, uncertainty=0.1) == pytest.approx(plan.condition)
    if speed == 1.5:
        assert not plan_shifts(drift, 8, shifts=[8]).follows
        with pytest.raises(PhaseError, match=r"0\.125 fringes per frame"):
            check_shifts([2 * np.pi * k / 8 for k in range(8)], drift)


def test_shifts_that_do_not_fit_the_number_of_frames_are_refused() -> None:
    with pytest.raises(PhaseError, match="7 frames are not whole cycles of 4, 6 shifts"):
        plan_shifts(0.0, 7, shifts=[4, 6])
