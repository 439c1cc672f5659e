"""Phase of moving stacks whose motion is measured from the stack itself."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from fringedic.errors import StepError
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import WHITE, PatternKind, ProjectedPattern
from fringedic.phase import ImageMotion, PhaseSettings, demodulate_moving
from fringedic.steps import measure_moving_phase, motion_between

SCENES = Path(__file__).resolve().parents[5] / "benchmarks" / "moving_scenes" / "scene.py"
specification = importlib.util.spec_from_file_location("moving_scene", SCENES)
assert specification is not None
scenes = importlib.util.module_from_spec(specification)
sys.modules["moving_scene"] = scenes
specification.loader.exec_module(scenes)

SCENE = scenes.Scene(rows=160, columns=224, exposure=0.4, instants=3)
SETTINGS = PhaseSettings(noise=CameraNoise(float(np.hypot(1.0, 12**-0.5)), 0.02))
FRINGES = [
    ProjectedPattern(PatternKind.FRINGES, pitch=pitch, shift=-k % count or count, shifts=count)
    for pitch, count in ((288.0, 4), (48.0, 4), (12.0, 8))
    for k in range(1, count + 1)
]


def stack_of(patterns: list[ProjectedPattern], motion: object) -> tuple[np.ndarray, np.ndarray]:
    """Return frames and times, 0 in the middle of the last 8 fringe frames."""
    last = max(k for k, each in enumerate(patterns) if each.kind == PatternKind.FRINGES)
    times = np.arange(len(patterns)) - last + 3.5
    shown = [scenes.Shown(each.pitch, each.shift, max(each.shifts, 1)) for each in patterns]
    return SCENE.expose(shown, times, motion), times


def check(maps: object) -> None:
    """Compare the phase with that of the surface at rest."""
    error = maps.phase.values - SCENE.phase_at_rest(12.0)
    assert np.nanmax(np.abs(error)) < np.pi
    assert 0.9 < float(np.sqrt(np.nanmean((error / maps.sigma.values) ** 2))) < 1.1
    assert float(maps.valid.mean()) > 0.7


def test_white_frames_give_the_motion_of_a_stack() -> None:
    motion = scenes.Motion(1.2, 0.5, 0.4, ((0.002, 0.0), (0.0, -0.001)), course=lambda t: t + 0.01 * t * t)
    patterns = [WHITE, *FRINGES[:8], WHITE, *FRINGES[8:], WHITE]
    measured = measure_moving_phase(*stack_of(patterns, motion), patterns, SETTINGS)
    check(measured.maps)
    assert np.abs(measured.motion.velocity - SCENE.velocity(motion)).mean() < 0.004
    assert np.abs(measured.motion.acceleration - SCENE.acceleration(motion)).mean() < 0.002


def test_the_textures_of_stacks_before_and_after_give_the_motion_of_a_stack_without_white_frames() -> None:
    motion = scenes.Motion(0.5, 0.3, 0.3)
    frames, times = stack_of(FRINGES, motion)
    with pytest.raises(StepError, match="take a white frame before and after"):
        measure_moving_phase(frames, times, FRINGES, SETTINGS)
    exact = ImageMotion(SCENE.velocity(motion).astype(np.float32))
    last = len(FRINGES) - 8
    textures = [
        demodulate_moving(
            SCENE.expose([scenes.Shown(12.0, -k % 8 or 8, 8) for k in range(1, 9)], times[last:] + later, motion),
            times[last:],
            FRINGES[last:],
            exact,
            SETTINGS,
        ).texture.values
        for later in (-16.0, 16.0)
    ]
    between = motion_between(*textures, 32.0)
    assert np.abs(between.velocity - exact.velocity).mean() < 0.002
    check(measure_moving_phase(frames, times, FRINGES, SETTINGS, initial=between).maps)
