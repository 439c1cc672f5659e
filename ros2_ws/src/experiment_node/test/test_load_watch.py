"""Drift of the load during the exposures of a step: it has to be known where it has a limit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import pytest

from experiment_node.active_goal import StepFailure
from experiment_node.experiments import Experiment
from experiment_node.load_watch import check_direction, check_drift, drift_limits
from experiment_node.running_step import RunningStep
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic.signals import Channel
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import LoadState
from fringedic_ros.signals import signal_message
from fringedic_ros.stamps import to_msg

START, END = 10.0, 13.0  # [s] of the exposures
TIMES = np.arange(START - 0.5, END + 0.5, 0.1)  # [s] of the samples
FORCE = ExperimentNodeSettings(load_drift_n=5.0)
POSITION = ExperimentNodeSettings(position_drift_um=10.0)


def measured_step(times: Sequence[float] | np.ndarray, forces: Any, positions: Any = 1e-3) -> RunningStep:
    """Return a step of two frames with samples of the load frame; times in seconds."""
    step = RunningStep(
        goal=cast(Any, None),
        experiment=Experiment("test"),
        number=0,
        patterns=(ProjectedPattern(PatternKind.WHITE),) * 2,
        nodes=(),
        is_reference=False,
        on_stage=lambda *_: None,
    )
    step.exposures = {0: (round(1e9 * START), round(1e9 * START) + 1), 1: (round(1e9 * END) - 1, round(1e9 * END))}
    for time, force, position in np.broadcast(times, forces, positions):
        sample = LoadState(mode=LoadState.HOLD, force=float(force), position=float(position))
        sample.header.stamp = to_msg(round(1e9 * time))
        step.signals.add("load_frame/state", sample)
    return step


def check(step: RunningStep, parameters: ExperimentNodeSettings) -> None:
    for limit in drift_limits(parameters):
        check_drift(step, limit)


@pytest.mark.parametrize(
    "is_known",
    [
        lambda time: time < 0,
        lambda time: time < TIMES[1],
        lambda time: np.isclose(time, TIMES[10]),
        lambda time: time < END - 0.2,
        lambda time: time > START + 1.2,
        lambda time: (time < START + 1.0) | (time > START + 2.2),
    ],
    ids=["never", "first", "one", "not at the end", "not at the start", "gap"],
)
@pytest.mark.parametrize(("parameters", "name"), [(FORCE, "force"), (POSITION, "crosshead position")])
def test_a_drift_with_a_limit_has_to_be_known(
    is_known: Callable[[np.ndarray], np.ndarray], parameters: ExperimentNodeSettings, name: str
) -> None:
    values = np.where(is_known(TIMES), 1e-3, math.nan)
    step = measured_step(TIMES, values, 1e-3) if name == "force" else measured_step(TIMES, 100.0, values)
    with pytest.raises(StepFailure, match=f"the drift of the {name} is unknown") as failure:
        check(step, parameters)
    assert failure.value.code == MeasureStep.Result.LOAD_DRIFT


def test_values_that_are_missing_for_less_than_a_second_hide_no_drift() -> None:
    known = (np.arange(TIMES.size) % 5) == 0
    check(measured_step(TIMES, np.where(known, 100.0 + TIMES, math.nan)), FORCE)
    with pytest.raises(StepFailure, match=r"the force drifted by \+\d"):
        check(measured_step(TIMES, np.where(known, 100.0 + 5 * TIMES, math.nan)), FORCE)


def test_a_machine_without_force_sensor_has_no_limit_of_the_force() -> None:
    check(measured_step(TIMES, math.nan), POSITION)
    check(measured_step(TIMES, math.nan, math.nan), ExperimentNodeSettings())


def test_one_sample_during_short_exposures_is_compared_with_its_neighbours() -> None:
    step = measured_step([START - 0.3, START + 0.1, START + 0.5], [100.0, 110.0, 120.0])
    step.exposures[1] = (round(1e9 * START) + 1, round(1e9 * (START + 0.2)))
    with pytest.raises(StepFailure, match=r"the force drifted by \+20 N"):
        check(step, FORCE)


@pytest.mark.parametrize("gap", [0.5, 1.5])
def test_a_required_signal_has_to_cover_the_exposures_whatever_its_drift(gap: float) -> None:
    step, required = measured_step(TIMES, 100.0), ExperimentNodeSettings(required_signals=["grip"])
    with pytest.raises(StepFailure, match="the drift of the signal 'grip' is unknown"):
        check(step, required)
    times = TIMES[(TIMES < START + 0.5) | (START + 0.5 + gap < TIMES)]
    stamps = [round(1e9 * time) for time in times]
    values, sigmas = np.linspace(290, 390, times.size), np.full(times.size, 0.5)
    step.signals.add("signals", signal_message(Channel("grip", "temperature", "K"), stamps, values, sigmas))
    if gap < 1:
        check(step, required)
        return
    with pytest.raises(StepFailure, match=r"or write required: false to signals\.grip") as failure:
        check(step, required)
    assert failure.value.code == MeasureStep.Result.LOAD_DRIFT


def test_a_crosshead_that_reverses_is_named() -> None:
    noise = 1e-7 * np.random.default_rng(1).standard_normal(TIMES.size)
    with pytest.raises(StepFailure, match=r"reversed during the exposures and went back by 0\.0[67]"):
        check_direction(measured_step(TIMES, 0.0, 1e-3 - 5e-5 * abs(TIMES - 11.7)))
    for positions in (1e-3 + 2e-5 * TIMES + noise, 1e-3 - 2e-5 * TIMES + noise, 1e-3 + noise, 1e-3):
        check_direction(measured_step(TIMES, 0.0, positions))
