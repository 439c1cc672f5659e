"""Load samples of a step: what the machine did, told from noise."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.signals import samples_over, summarise
from fringedic.virtual_rig import CrossheadState, SimulatedLoadFrame, VirtualRigConfiguration


def test_drift_is_that_of_the_line_and_not_the_noise() -> None:
    """10 N/s over 0.5 s under 2 N of noise: the line's end points are known to 2 sqrt(12 / n) N."""
    time = np.arange(500) * 1e-3
    values = 100 + 10 * time + np.random.default_rng(4).normal(0, 2, time.size)
    summary = summarise([int(1e9 * each) for each in 5 + time], values)
    assert summary.samples == 500
    assert summary.drift == pytest.approx(4.99, abs=4 * 2 * np.sqrt(12 / 500))
    assert summary.mean == pytest.approx(102.5, abs=4 * 2 / np.sqrt(500))
    assert summary.spread > 10


def test_order_of_the_samples_does_not_matter_and_nan_is_not_measured() -> None:
    stamps, values = [0, 10, 20, 30], [1.0, 2.0, np.nan, 4.0]
    assert summarise(stamps, values) == pytest.approx((3, 7 / 3, 3.0, 3.0))
    assert summarise(stamps[::-1], values[::-1]) == pytest.approx((3, 7 / 3, 3.0, 3.0))
    assert summarise([0, 1], [3.0, 5.0]) == (2, 4.0, 2.0, 2.0)
    nothing = summarise([], [])
    assert nothing.samples == 0
    assert np.isnan([nothing.mean, nothing.spread, nothing.drift]).all()


def test_relaxation_of_the_simulated_specimen_against_its_truth() -> None:
    """At rest after a ramp the force decays as k r x exp(-t / T): the mean over a window is known exactly."""
    configuration = VirtualRigConfiguration.from_dict({"preset": "plate"}).load_frame
    configuration = configuration.model_copy(
        update={"play_mm": 0.0, "force_noise_n": 0.2, "relaxation": 0.2, "relaxation_time_s": 2.0}
    )
    machine = SimulatedLoadFrame(configuration, seed=7)
    machine.move_to(0.4e-3, machine.maximum_speed)
    while machine.sample().state is CrossheadState.MOVING:
        machine.advance(1e-3)
    start = machine.sample().force
    time = np.arange(400) * 2.5e-3
    forces = []
    for _ in time:
        forces.append(machine.sample().force)
        machine.advance(2.5e-3)
    summary = summarise([int(1e9 * each) for each in time], forces)
    stiffness, ratio = 1e3 * configuration.stiffness_n_per_mm, configuration.relaxation
    settled = stiffness * (1 - ratio) * 0.4e-3
    true = settled + (start - settled) * np.exp(-time / 2.0)
    assert summary.mean == pytest.approx(true.mean(), abs=0.6)  # the first sample has noise as well
    assert -np.ptp(true) * 1.1 < summary.drift < -np.ptp(true) * 0.8
    assert np.ptp(true) - 1 < summary.spread < np.ptp(true) + 4 * 0.2 * 2


def test_an_exposure_between_two_samples_has_both() -> None:
    second = 1_000_000_000
    stamps = [0, second, 2 * second, 3 * second]
    assert samples_over(stamps, 0.9 * second, 2.1 * second).tolist() == [False, True, True, False]
    assert samples_over(stamps, 1.2 * second, 1.3 * second).tolist() == [False, True, True, False]
    assert samples_over(stamps, 3.2 * second, 3.3 * second).tolist() == [False, False, False, True]
    assert not samples_over(stamps, 9 * second, 9.1 * second).any()
    assert samples_over([], 0, 1).size == 0
