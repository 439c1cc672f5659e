"""Signals from messages, their value at the exposures of a step, and other clocks."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from fringedic.errors import RecordingError
from fringedic.signals import FORCE, POSITION, Channel, Signal, SignalCollector, read_table, signals_of

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
    assert force.value_over(1.5 * SECOND, 2.5 * SECOND)[:2] == (3.0, pytest.approx(0.1))
    assert np.isnan(force.value_over(0.5 * SECOND, 1.5 * SECOND)).all()
    assert np.isnan(force.value_over(9 * SECOND, 9.5 * SECOND)).all()


def test_drift_is_the_change_from_begin_to_end_of_the_exposures() -> None:
    """2 N/s over exposures of 3 s, with samples that cover a part of them, and with noise that the line averages."""
    stamps = np.arange(0, 4 * SECOND, SECOND // 100)
    values = 7 + 2e-9 * stamps + np.random.default_rng(1).normal(0, 0.5, stamps.size)
    noisy = Signal(FORCE, stamps, values, np.full(stamps.size, np.nan))
    assert noisy.value_over(0.5 * SECOND, 3.5 * SECOND).drift == pytest.approx(6, abs=4 * 0.5 * np.sqrt(12 / 300))
    falling = Signal(FORCE, np.array([0, SECOND]), np.array([5.0, 3.0]), np.zeros(2))
    assert falling.value_over(0.25 * SECOND, 0.75 * SECOND).drift == pytest.approx(-1.0)
    assert np.isnan(falling.value_over(-SECOND, 0).drift)
    gap = Signal(FORCE, np.array([0, SECOND]), np.array([5.0, np.nan]), np.zeros(2))
    assert np.isnan(gap.value_over(0, SECOND).drift)


def test_a_value_in_motion_is_not_interpolated_over_a_gap() -> None:
    """10 N/s, and no samples from 1 to 60 s: at 30 s nothing is known, at 1.5 s the last sample alone."""
    stamps = np.append(np.arange(0, 1.05 * SECOND, SECOND // 10), 60 * SECOND).astype(np.int64)
    force = Signal(FORCE, stamps, 10e-9 * stamps, np.full(stamps.size, 0.3))
    assert np.isnan(force.value_at(30 * SECOND, 29.9 * SECOND, 30.1 * SECOND)).all()
    last = force.value_at(1.5 * SECOND, 1.45 * SECOND, 1.55 * SECOND)
    assert last[:2] == pytest.approx((10.0, 0.3))
    assert np.isnan(last.drift), "one sample shows no change"
    assert force.value_at(0.52 * SECOND, 0.45 * SECOND, 0.6 * SECOND) == pytest.approx((5.2, 0.3, 1.5))


def test_the_stamps_of_another_clock_are_those_of_the_rig_less_offset_and_drift() -> None:
    stamps = np.array([SECOND, 11 * SECOND])
    moved = Signal(TEMPERATURE, stamps, np.zeros(2), np.zeros(2)).on_the_clock_of_the_rig(0.25, 1e-5, since=SECOND)
    assert (stamps - moved.stamps).tolist() == [250_000_000, 250_100_000]


def test_a_live_reader_keeps_the_latest_samples_and_the_topic_that_counts() -> None:
    collector = SignalCollector(longest=2)
    for second in (1, 2, 3):
        assert collector.add(*load(second * SECOND, float(second), 1e-3)) == ["force", "position"]
    assert collector.signals["force"].values.tolist() == [2.0, 3.0]
    assert collector.add(*published(FORCE, [4 * SECOND], [4.5], [0.2])) == ["force"]
    assert collector.add(*load(5 * SECOND, 5.0, 2e-3)) == ["position"]
    assert (collector.latest["force"].value, collector.latest["position"].value) == (4.5, 2e-3)


def test_a_table_has_signals_with_their_units_and_uncertainties(tmp_path: Path) -> None:
    table = tmp_path / "logger.csv"
    table.write_text(
        "time [s],force [N],temperature_grip [K],sigma temperature_grip [K]\n"
        "1795890000.000000001,5.0,295,0.5\n1795890001.5,,296.5,0.5\n\n",
        "utf-8-sig",
    )
    signals = read_table(table)
    assert signals["force"].channel == FORCE._replace(source="logger.csv")
    assert signals["temperature_grip"].channel == Channel("temperature_grip", "temperature", "K", "", "logger.csv")
    assert signals["force"].stamps.tolist() == [1795890000_000000001, 1795890001_500000000]
    np.testing.assert_array_equal(signals["force"].values, [5.0, np.nan])
    assert np.isnan(signals["force"].sigmas).all()
    assert signals["temperature_grip"].value_over(*signals["force"].stamps)[:2] == (295.75, 0.5)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the first line has to contain time"),
        ("time [s],force\n1,5\n", "the first line has to contain time"),
        ("time [ms],force [N]\n1,5\n", "the first line has to contain time"),
        ("time [s],force [N],force [N]\n1,5,5\n", "each signal once"),
        ("time [s],sigma force [N]\n1,5\n", "has no column 'force"),
        ("time [s],force [N]\n1,5,6\n", "line 2 has 3 cells, the first line 2"),
        ("time [s],force [N]\n1,5\n2,five\n", "line 3, force: 'five' is no number"),
        ("time [s],force [N]\n", "the times have to be numbers that grow"),
        ("time [s],force [N]\n2,5\n2,6\n", "the times have to be numbers that grow"),
        ("time [s],force [N]\n1,inf\n", "line 2, force: 'inf' is no number"),
        ("time [s],force [N]\n1e30,5\n", "the times have to be numbers that grow"),
        ("time [s],force [N]\n,5\n", "the times have to be numbers that grow"),
        ('time [s],force [N]\n1,"5', "cannot be read as CSV"),
    ],
)
def test_a_file_that_is_no_such_table_is_refused(text: str, sentence: str, tmp_path: Path) -> None:
    table = tmp_path / "logger.csv"
    table.write_text(text)
    with pytest.raises(RecordingError, match=r"logger\.csv: .*" + re.escape(sentence)):
        read_table(table)


def test_a_table_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        read_table(tmp_path / "none.csv")
