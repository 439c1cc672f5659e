"""The simulated testing machine against closed forms."""

import math

import numpy as np
import pytest

from fringedic.errors import CrossheadRangeError
from fringedic.virtual_rig import CrossheadState, SimulatedLoadFrame
from fringedic.virtual_rig.configuration import LoadFrameConfiguration


def machine(**changes):
    values = {
        "maximum_position_mm": 10.0,
        "maximum_speed_mm_per_s": 5.0,
        "acceleration_mm_per_s2": 4.0,
        "stiffness_n_per_mm": 100.0,
        "relaxation": 0.2,
        "relaxation_time_s": 3.0,
        "play_mm": 0.0,
        "force_noise_n": 0.0,
    }
    return SimulatedLoadFrame(LoadFrameConfiguration(**(values | changes)))


def run(frame, time_s, interval):
    """Return samples at equal intervals of time."""
    samples = []
    for _ in range(round(time_s / interval)):
        frame.advance(interval)
        samples.append(frame.sample())
    return samples


def test_a_move_has_ramps_and_ends_on_its_target():
    frame = machine()
    assert frame.sample() == (CrossheadState.IDLE, 0.0, 0.0)
    frame.move_to(3e-3, 2e-3)
    # 2 mm/s at 4 mm/s2: 0.5 s and 0.5 mm per ramp, 1 s at full speed
    for time_s, position in ((0.25, 0.125e-3), (0.5, 0.5e-3), (1.0, 1.5e-3), (1.5, 2.5e-3), (1.75, 2.875e-3)):
        frame = machine()
        frame.move_to(3e-3, 2e-3)
        frame.advance(time_s)
        assert frame.sample().state is CrossheadState.MOVING
        assert math.isclose(frame.sample().position, position, rel_tol=1e-12)
    frame.advance(0.2501)
    assert frame.sample().state is CrossheadState.HOLDING
    assert frame.sample().position == 3e-3


@pytest.mark.parametrize(("start", "goal", "speed"), [(0.0, 1e-5, 5e-3), (0.0, 1e-2, 5e-3), (7e-3, 2e-3, 1e-3)])
def test_the_path_does_not_depend_on_the_intervals(start, goal, speed):
    ends = []
    for interval in (1e-3, 0.0173, 0.25):
        frame = machine()
        if start:
            frame.move_to(start, 5e-3)
            frame.advance(100.0)
        frame.move_to(goal, speed)
        samples = run(frame, 0.25, interval) if interval < 0.25 else run(frame, 0.25, 0.25)
        frame.advance(0.25 - len(samples) * interval if interval < 0.25 else 0.0)
        ends.append(frame.sample().position)
        frame.advance(100.0)
        assert frame.sample().position == goal
        assert min(start, goal) <= min(s.position for s in samples)
        assert max(s.position for s in samples) <= max(start, goal)
    np.testing.assert_allclose(ends, ends[0], rtol=1e-9)


def test_a_new_goal_behind_the_crosshead_turns_it_back():
    frame = machine()
    frame.move_to(5e-3, 4e-3)
    frame.advance(1.2)
    frame.move_to(1e-3, 4e-3)
    positions = [s.position for s in run(frame, 10.0, 0.01)]
    assert positions[-1] == 1e-3
    assert max(positions) < 5e-3
    assert max(positions) > positions[0]
    speeds = np.diff(positions) / 0.01
    assert np.abs(np.diff(speeds)).max() <= 4e-3 * 0.01 * 1.001  # never more than the machine's ramp


def test_any_sequence_of_commands_stays_in_range_and_ends_on_the_last_goal():
    rng = np.random.default_rng(0)
    for _ in range(200):
        frame = machine()
        for _ in range(12):
            if rng.uniform() < 0.7:
                goal = rng.choice([0.0, 10e-3, rng.uniform(0, 10e-3), frame.sample().position])
                frame.move_to(goal, rng.choice([5e-3, 1e-6, rng.uniform(1e-4, 5e-3)]))
            else:
                frame.hold()
            before, interval = frame.sample().position, rng.choice([0.0, 1e-6, 0.01, rng.uniform(0, 2)])
            frame.advance(interval)
            after = frame.sample().position
            assert 0.0 <= after <= 10e-3
            assert abs(after - before) <= 5e-3 * interval + 1e-12
        frame.move_to(2e-3, 5e-3)
        frame.advance(30.0)
        assert frame.sample()[::2] == (CrossheadState.HOLDING, 2e-3)


def test_the_position_stands_still_in_hold_while_the_force_relaxes():
    frame = machine(relaxation=0.3, relaxation_time_s=2.0)
    frame.move_to(2e-3, 5e-3)
    while frame.sample().state is not CrossheadState.HOLDING:
        frame.advance(0.01)
    samples = run(frame, 40.0, 0.1)
    assert {s.position for s in samples} == {2e-3}
    forces = np.array([s.force for s in samples])
    excess = forces - 100e3 * 0.7 * 2e-3
    np.testing.assert_allclose(excess[1:20] / excess[:19], math.exp(-0.1 / 2.0), rtol=1e-6)
    assert forces[-1] == pytest.approx(140.0, abs=1e-5)
    assert forces[0] > 170.0


def test_hold_stops_with_the_ramp():
    frame = machine()
    frame.move_to(8e-3, 4e-3)
    frame.advance(1.5)
    moving = frame.sample().position
    frame.hold()
    frame.advance(0.5)
    assert frame.sample().state is CrossheadState.MOVING
    frame.advance(0.51)
    assert frame.sample().state is CrossheadState.HOLDING
    assert frame.sample().position == pytest.approx(moving + 2e-3, rel=1e-9)  # v^2 / 2a


def test_play_delays_the_force_in_both_directions():
    frame = machine(play_mm=0.5, relaxation=0.0)
    for goal, force in ((0.4e-3, 0.0), (2e-3, 150.0), (1.8e-3, 150.0), (1.0e-3, 100.0)):
        frame.move_to(goal, 2e-3)
        frame.advance(100.0)
        assert frame.sample().force == pytest.approx(force, abs=1e-9)


def test_noise_is_seeded():
    configuration = LoadFrameConfiguration(force_noise_n=0.5)
    first, same, other = (SimulatedLoadFrame(configuration, seed) for seed in (1, 1, 2))
    forces = np.array([[frame.sample().force for frame in (first, same, other)] for _ in range(4000)])
    assert np.array_equal(forces[:, 0], forces[:, 1])
    assert not np.array_equal(forces[:, 0], forces[:, 2])
    assert abs(forces[:, 0].std() - 0.5) < 0.02


@pytest.mark.parametrize(
    ("position", "speed"), [(-1e-3, 1e-3), (11e-3, 1e-3), (math.nan, 1e-3), (1e-3, 0.0), (1e-3, 1.0)]
)
def test_goals_outside_the_range_change_nothing(position, speed):
    frame = machine()
    with pytest.raises(CrossheadRangeError, match="outside"):
        frame.move_to(position, speed)
    assert frame.sample() == (CrossheadState.IDLE, 0.0, 0.0)
