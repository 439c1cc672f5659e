"""Closure between pitches: a z-score where the phase is right, large where an order or a frame is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.patterns import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.phase.closure import phase_closure


@pytest.fixture(scope="module")
def stack():
    """Frames of three pitches with noise, their patterns, and the measured maps."""
    generator = np.random.default_rng(5)
    patterns = fringe_sequence(400, 300, [400, 80, 16], shifts=[4, 5, 8]).patterns
    column = np.linspace(20, 380, 200) - 199.5 + 8 * np.sin(np.linspace(0, 6, 150))[:, None]
    bright = 50 + 20 * generator.random(column.shape)
    frames = [110 + bright * np.cos(2 * np.pi * (column / each.pitch - each.shift / each.shifts)) for each in patterns]
    frames = (np.array(frames) + generator.normal(0, 1.5, (len(frames), *column.shape))).astype(np.float32)
    return frames, patterns, absolute_phase(frames, patterns, noise=1.5)


def closure(frames, patterns, maps, turns=0):
    return phase_closure(
        frames, patterns, maps.phase.values + 2 * np.pi * turns, maps.sigma.values, maps.modulation.values
    )


def test_the_closure_of_a_right_phase_is_a_z_score(stack):
    found = closure(*stack)
    assert found.dtype == np.float32
    assert np.array_equal(np.isfinite(found), stack[2].valid.values)
    assert 0.97 < np.nanstd(found) < 1.03
    assert abs(np.nanmean(found)) < 0.03


def test_an_order_that_is_wrong_is_found(stack):
    for turns in (-1, 1, 2):
        assert np.nanmin(np.abs(closure(*stack, turns=turns))) > 3


def test_a_coarse_frame_of_another_scene_is_found(stack):
    frames, patterns, maps = stack
    damaged = frames.copy()
    damaged[5] = damaged[5][::-1, ::-1]
    assert np.nanmean(np.abs(closure(damaged, patterns, maps)) > 3) > 0.5


def test_one_pitch_has_no_closure(stack):
    frames, patterns, maps = stack
    assert closure(frames[-8:], patterns[-8:], maps) is None
