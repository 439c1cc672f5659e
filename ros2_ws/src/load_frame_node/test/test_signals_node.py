"""The signals node in a process of its own: a topic, a serial line on a pseudo-terminal, and an instrument."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from sensor_msgs.msg import Temperature

from fringedic.errors import ConfigurationError, MachineError
from fringedic.settings.signals import SerialSignal, TopicSignal
from fringedic_msgs.msg import Signal
from fringedic_ros.qos import SAMPLES, STATE
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer
from load_frame_node.machines import load_machine
from load_frame_node.machines.description import load_instrument
from load_frame_node.signal_sources.serial_line import SerialSource
from load_frame_node.signal_sources.topic import TopicSource
from load_frame_node.signals_node import SignalsNode

HERE = Path(__file__).parent


class Line:
    """A device that prints lines, at the other end of a pseudo-terminal."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.device, self._slave = os.ttyname(slave), slave

    def print(self, text: str) -> None:
        os.write(self._master, text.encode())

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


@contextmanager
def modbus_instrument() -> Iterator[int]:
    command = [sys.executable, str(HERE / "modbus_machine.py"), "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield int(process.stdout.readline())
        finally:
            process.kill()


class Rig(Peer):
    """Publishes a temperature, prints voltages, and collects the signals."""

    def __init__(self, line: Line) -> None:
        super().__init__()
        self.line = line
        self.signals: list[Signal] = self.listen(Signal, "signals", STATE)
        self.publisher = self.create_publisher(Temperature, "/thermo/temperature", SAMPLES)
        self.celsius, self.volts = 20.0, 2.0
        self.is_printing = True
        self.create_timer(0.05, self._tick)

    def _tick(self) -> None:
        message = Temperature(temperature=self.celsius)
        message.header.stamp = to_msg(time.time_ns())
        self.publisher.publish(message)
        if self.is_printing:
            self.line.print(f"17;{self.volts:.3f} V\r\n")

    def values(self, name: str) -> list[float]:
        return [value for each in self.signals if each.name == name for value in each.values]

    def last(self, name: str) -> Signal:
        self.signals.clear()
        self.wait(lambda: self.values(name), f"a sample of {name}")
        return next(each for each in reversed(self.signals) if each.name == name)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Rig, NodeProcess]]:
    folder, line = tmp_path_factory.mktemp("signals"), Line()
    rclpy.init()
    rig = Rig(line)
    with modbus_instrument() as port:
        instrument = {
            "protocol": "modbus",
            "name": "torque meter",
            "host": "127.0.0.1",
            "port": port,
            "timeout_s": 5.0,
            "signals": {"torque": {"register": 2, "unit": "Nmm", "offset": 5.0, "sigma": 0.5}},
        }
        (folder / "meter.yaml").write_text(yaml.safe_dump(instrument))
        declared = {
            "temperature_grip": {
                "source": "topic",
                "topic": "/thermo/temperature",
                "field": "temperature",
                "unit": "degC",
                "sigma": 0.25,
            },
            "load_2": {
                "source": "serial",
                "device": line.device,
                "column": 1,
                "unit": "V",
                "scale": "12.5 +- 0.02 N/V",
                "offset": "1 +- 0.03 N",
                "sigma": 0.004,
                "positive": "tension",
            },
            "wrong": {"source": "topic", "topic": "/thermo/temperature", "field": "humidity", "unit": "1"},
            "meter": {"source": "instrument", "file": str(folder / "meter.yaml"), "rate_hz": 20.0},
        }
        parameters = {"signals": json.dumps(json.dumps(declared))}
        with NodeProcess("load_frame_node.signals_node", folder, parameters) as process:
            rig.wait(lambda: rig.signals, "the first sample")
            yield rig, process
    rig.destroy_node()
    rclpy.shutdown()
    line.close()


def test_a_topic_gives_its_field_with_its_stamps_in_si_units(started: tuple[Rig, NodeProcess]) -> None:
    rig, _ = started
    rig.celsius = 21.5
    rig.wait(lambda: 294.65 in rig.values("temperature_grip"), "the new temperature")
    last = rig.last("temperature_grip")
    assert (last.quantity, last.unit, last.source) == ("temperature", "K", "topic")
    assert last.sigmas[-1] == 0.25
    assert abs(time.time_ns() - to_nanoseconds(last.stamps[-1])) < 5e9


def test_a_serial_line_is_scaled_with_its_uncertainty(started: tuple[Rig, NodeProcess]) -> None:
    rig, _ = started
    last = rig.last("load_2")
    assert (last.quantity, last.unit, last.positive) == ("force", "N", "tension")
    assert last.values[-1] == pytest.approx(26.0)
    assert last.sigmas[-1] == pytest.approx(math.sqrt(0.05**2 + 0.04**2 + 0.03**2))


def test_an_instrument_gives_its_signals(started: tuple[Rig, NodeProcess]) -> None:
    rig, _ = started
    last = rig.last("torque")
    assert (last.quantity, last.unit, last.source) == ("torque", "Nm", "meter")
    assert last.values[-1] == pytest.approx(5e-3, abs=1e-6)  # the machine stands at 0 mm
    assert last.sigmas[-1] == pytest.approx(5e-4)


def test_a_field_that_no_message_has_is_told(started: tuple[Rig, NodeProcess]) -> None:
    rig, process = started
    words = "has no number 'humidity'"
    rig.wait(lambda: words in process.log, "the report")
    assert "correct field" in process.log


def test_readings_that_nobody_takes_are_limited(started: tuple[Rig, NodeProcess]) -> None:
    """A node that is not active, or messages without the number, would fill the memory."""
    rig, _ = started
    source = TopicSource(TopicSignal(topic="/nobody", field="temperature", unit="K"), rig)
    message = Temperature(temperature=1.0)
    message.header.stamp = to_msg(time.time_ns())
    for _ in range(3000):
        source._take(message)  # noqa: SLF001 (as the executor calls it, without the time of 3000 messages)
    assert len(source.read()) == 1000
    assert source.read() == []


def test_a_refused_source_leaves_no_other_one_open(started: tuple[Rig, NodeProcess], tmp_path: Path) -> None:
    rig, _ = started
    good = {"source": "serial", "device": rig.line.device, "unit": "V"}
    bad = {"source": "instrument", "file": str(tmp_path / "none.yaml")}
    node = SignalsNode()
    node.set_parameters([Parameter("signals", value=json.dumps({"good": good, "bad": bad}))])
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    assert not node._sources  # noqa: SLF001 (a source that stays open is not seen from outside)
    node.destroy_node()


def test_a_silent_source_is_told_within_two_seconds_and_its_gap_is_nan(started: tuple[Rig, NodeProcess]) -> None:
    rig, process = started
    rig.last("load_2")
    rig.is_printing = False
    rig.serve(0.3)
    rig.signals.clear()
    begin = time.monotonic()
    rig.wait(lambda: any(map(math.isnan, rig.values("load_2"))), "NaN")
    took = time.monotonic() - begin
    assert took < 2.0 or os.getloadavg()[0] > (os.cpu_count() or 1)  # a busy computer may be late
    told = r"signal load_2: no reading for [12]\.\d s; check its connection"
    rig.wait(lambda: re.search(told, process.log), "the report")
    assert not any(map(math.isnan, rig.values("temperature_grip")))
    rig.is_printing = True
    rig.signals.clear()
    rig.wait(lambda: any(value == pytest.approx(26.0) for value in rig.values("load_2")), "readings again")
    rig.wait(lambda: "signal load_2: readings come again" in process.log, "the report")


def test_a_serial_line_at_1_khz_loses_nothing() -> None:
    line = Line()
    source = SerialSource(SerialSignal(device=line.device, unit="1", rate_hz=1000.0))
    source.read()  # opens the line
    count = 2000

    def send() -> None:
        line.print("half a li")
        for number in range(-1, count):
            line.print(f"{number}\n")
            time.sleep(0.001)

    thread = threading.Thread(target=send)
    begin = time.time_ns()
    thread.start()
    readings = []
    while len(readings) < count:
        readings += source.read()
        assert time.time_ns() - begin < 60e9
    thread.join()
    source.close()
    line.close()
    assert [each.value for each in readings] == list(range(count))
    stamps = [each.stamp_ns for each in readings]
    assert stamps == sorted(stamps)
    assert begin < stamps[0] + 10**9
    assert stamps[-1] <= time.time_ns()


def test_lines_that_come_at_once_have_stamps_in_their_order() -> None:
    """At 50 baud each line takes a second: as many within moments come from a device that is not bound to the rate."""
    line = Line()
    source = SerialSource(SerialSignal(device=line.device, unit="1", baud_rate=50))
    assert source.read() == []
    line.print("x\n")
    readings = []
    for first in range(0, 30, 10):
        line.print("".join(f"{number}\n" for number in range(first, first + 10)))
        while len(readings) < first + 10:
            readings += source.read()
    assert [each.value for each in readings] == list(range(30))
    assert all(after.stamp_ns > before.stamp_ns for before, after in itertools.pairwise(readings))
    source.close()
    line.close()


def read_often(source: SerialSource) -> None:
    for _ in range(100):
        source.read()


@pytest.mark.parametrize(
    ("settings", "text", "reason"),
    [
        ({"column": 3}, "1;2\n", "has 2 parts, and no column 3 counted from 0"),
        ({}, "hello\n", "'hello' of the line 'hello' is no number; correct column"),
        ({"baud_rate": 9600}, "x" * 5000, "prints no ends of lines; check baud_rate 9600"),
    ],
)
def test_lines_that_do_not_fit_are_told(settings: dict[str, Any], text: str, reason: str) -> None:
    line = Line()
    source = SerialSource(SerialSignal(device=line.device, unit="1", **settings))
    assert source.read() == []
    line.print(f"first\n{text}" if text.endswith("\n") else "")
    threading.Thread(target=line.print, args=("" if text.endswith("\n") else text,)).start()
    with pytest.raises(MachineError, match=reason):
        read_often(source)
    source.close()
    line.close()


def test_a_line_that_does_not_fit_takes_no_others_with_it() -> None:
    line = Line()
    source = SerialSource(SerialSignal(device=line.device, unit="1"))
    assert source.read() == []
    line.print("first\n1\ncalibrating\n2\n")
    readings = []
    while len(readings) < 2:
        readings += source.read()
    assert [each.value for each in readings] == [1.0, 2.0]
    source.close()
    line.close()


def test_a_serial_device_that_is_not_there_is_told_and_tried_again(tmp_path: Path) -> None:
    source = SerialSource(SerialSignal(device=str(tmp_path / "ttyACM0"), unit="1"))
    for _ in range(2):
        with pytest.raises(MachineError, match=r"ttyACM0: .*No such file or directory"):
            source.read()


def test_a_decimal_comma_and_a_separator_are_read() -> None:
    line = Line()
    source = SerialSource(SerialSignal(device=line.device, unit="V", separator="|", column=1, decimal=","))
    assert source.read() == []
    line.print("x\n3|-1,25e1|7\n0|nan|0\n")
    readings = []
    while len(readings) < 2:
        readings += source.read()
    assert readings[0].value == -12.5
    assert math.isnan(readings[1].value)
    source.close()
    line.close()


def test_files_of_machines_and_instruments_have_signals(tmp_path: Path) -> None:
    file = tmp_path / "oven.yaml"
    content = {"protocol": "scpi", "resource": "ASRL/dev/ttyS9", "signals": {"grip": {"query": "T?", "unit": "degC"}}}
    file.write_text(yaml.safe_dump(content))
    description = load_instrument(file)
    assert [name for name, _ in description.entries()] == ["signals.grip"]
    assert description.signals["grip"].si(20.0) == pytest.approx(293.15)
    strain = description.signals["grip"].model_copy(update={"unit": "mV", "scale": 0.1})
    assert strain.si(20.0) == pytest.approx(2e-3)
    assert math.isnan(strain.si(9.91e37)), "of SCPI: not a number"
    with pytest.raises(ConfigurationError, match="force: Field required"):
        load_machine(file)
    file.write_text(yaml.safe_dump({**content, "signals": {"grip": {"query": "T?", "unit": "stone"}}}))
    with pytest.raises(ConfigurationError, match="the unit 'stone' is not known; write one such as N, kN"):
        load_instrument(file)
