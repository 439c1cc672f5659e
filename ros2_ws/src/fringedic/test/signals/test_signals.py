"""Signals from messages, their value at the exposures of a step, and other clocks."""

from __future__ import annotations

from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from fringedic.errors import RecordingError
from fringedic.signals import FORCE, POSITION, Channel, Signal, signals_of

SECOND = 1_000_000_000
TEMPERATURE = Channel("temperature_grip", "temperature", "K", "", "thermocouple")


def time(nanoseconds: int) -> Message:
    return Message(sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)


def load(stamp: int, force: float, position: float) -> tuple[str, Message]:
    return "load_frame/state", Message(header=Message(stamp=time(stamp)), force=force, position=position)


def published(channel: Channel, stamps: list[int], values: list[float], sigmas: list[float]) -> tuple[str, Message]:
    return "signals", Message(**channel._asdict(), stamps=[*map(time, stamps)], values=values, sigmas=sigmas)


def test_a_load_state_contains_force_and_position() -> None:
    signals = signals_of([load(SECOND, 5.0, 1e-3), load(2 * SECOND, 6.0, 2e-3)])
    assert list(signals) == ["force", "position"]
    assert (signals["force"].channel, signals["position"].channel) == (FORCE, POSITION)
    assert signals["force"].stamps.tolist() == [SECOND, 2 * SECOND]
    assert signals["position"].values.tolist() == [1e-3, 2e-3]
    assert np.isnan(signals["force"].sigmas).all()
    assert not signals_of([])["force"].stamps.size


def test_another_sensor_and_a_second_load_cell_are_signals_of_their_own() -> None:
    second = FORCE._replace(source="cell_2")
    signals = signals_of(
        [
            load(SECOND, 5.0, 1e-3),
            published(TEMPERATURE, [SECOND, 2 * SECOND], [295.0, 296.0], [0.5, 0.5]),
            published(second, [SECOND], [7.0], [0.1]),
        ]
    )
    assert list(signals) == ["force", "position", "temperature_grip", "force_cell_2"]
    assert signals["temperature_grip"].channel == TEMPERATURE
    assert signals["force_cell_2"].channel.name == "force_cell_2"
    assert [signals[name].values.tolist() for name in ("force", "force_cell_2")] == [[5.0], [7.0]]


def test_a_load_frame_that_publishes_its_force_as_a_signal_is_not_counted_twice() -> None:
    messages = [load(SECOND, 5.0, 1e-3), published(FORCE, [SECOND], [5.0], [0.2])]
    assert signals_of(messages)["force"].sigmas.tolist() == [0.2]


@pytest.mark.parametrize("values", [{"values": []}, {"name": ""}])
def test_a_message_that_contradicts_itself_is_refused(values: dict[str, Any]) -> None:
    topic, message = published(TEMPERATURE, [SECOND], [295.0], [0.5])
    vars(message).update(values)
    with pytest.raises(RecordingError, match="it needs a name and as many of each"):
        signals_of([(topic, message)])


def test_the_uncertainty_of_a_value_is_that_of_the_sensor_and_of_the_scatter() -> None:
    """10 N/s under 2 N of noise, 200 samples: the mean is known to 2 / sqrt(200) N, the ramp is no noise."""
    stamps = SECOND + np.arange(200) * 5_000_000
    values = 10e-9 * stamps + np.random.default_rng(3).normal(0, 2, stamps.size)
    known = Signal(FORCE, stamps, values, np.full(200, 0.3))
    value = known.value_over(stamps[0], stamps[-1])
    assert value.mean == values.mean()
    assert value.sigma == pytest.approx(np.hypot(0.3, 2 / np.sqrt(200)), rel=0.05)
    unknown = Signal(FORCE, stamps, values, np.full(200, np.nan))
    assert unknown.value_over(stamps[0], stamps[-1]).mean == value.mean
    assert np.isnan(unknown.value_over(stamps[0], stamps[-1]).sigma)


def test_nothing_near_the_exposures_is_not_measured() -> None:
    force = Signal(FORCE, np.array([SECOND, 2 * SECOND]), np.array([np.nan, 3.0]), np.array([0.1, 0.1]))
    assert force.value_over(1.5 * SECOND, 2.5 * SECOND) == (3.0, pytest.approx(0.1))
    assert np.isnan(force.value_over(0.5 * SECOND, 1.5 * SECOND)).all()
    assert np.isnan(force.value_over(9 * SECOND, 9.5 * SECOND)).all()


def test_the_stamps_of_another_clock_are_those_of_the_rig_less_offset_and_drift() -> None:
    stamps = np.array([SECOND, 11 * SECOND])
    moved = Signal(TEMPERATURE, stamps, np.zeros(2), np.zeros(2)).on_the_clock_of_the_rig(0.25, 1e-5, since=SECOND)
    assert (stamps - moved.stamps).tolist() == [250_000_000, 250_100_000]
