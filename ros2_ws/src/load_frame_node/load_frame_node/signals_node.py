"""Publishes further signals of a rig: numbers of topics, serial lines, instruments and drivers of a laboratory."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from fringedic.errors import FringedicError, MachineError
from fringedic.settings.signals import ScaledSignal, SignalSettings, SignalsNodeSettings, signal_settings
from fringedic.signals import Channel
from fringedic_msgs.msg import Signal
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import SAMPLES
from fringedic_ros.signals import signal_message
from load_frame_node.machines.description import ModbusInstrument, ScpiInstrument
from load_frame_node.signal_sources.source import Reading, Source

_PERIOD_S = 0.05  # between two messages of a signal: the readings in between are in one message
_NAN_PERIOD_S = 0.5  # between two samples of a source that is silent
_PAUSE_S = 0.1  # after an error
_REPEATED_S = 10.0  # between two reports of a source that stays silent


class SignalsNode(HardwareNode[SignalsNodeSettings]):
    """Topic `signals`: the samples of all sources that the parameter `signals` declares."""

    def __init__(self) -> None:
        super().__init__("signals", SignalsNodeSettings)
        self._publisher = self.create_publisher(Signal, "signals", SAMPLES)
        self._sources: dict[str, tuple[SignalSettings, Source]] = {}
        self._readers: list[_Reader] = []

    def open(self) -> None:
        """Open all sources, or none if one is refused."""
        try:
            for name, settings in signal_settings(self.parameters.value.signals).items():
                self._sources[name] = settings, settings.open(self)
        except Exception:  # of a driver of a laboratory, too
            self.close()
            raise

    def activate(self) -> None:
        """Start reading."""
        self._readers = [_Reader(self, name, *each) for name, each in self._sources.items()]

    def deactivate(self) -> None:
        """Stop reading."""
        for reader in self._readers:
            reader.stop()
        self._readers = []

    def close(self) -> None:
        """Close all sources."""
        for _, source in self._sources.values():
            source.close()
        self._sources = {}

    def publish(self, channel: Channel, stamps: Sequence[int], values: np.ndarray, sigmas: np.ndarray) -> None:
        """Publish samples of a signal."""
        self._publisher.publish(signal_message(channel, stamps, values, sigmas))
        self.diagnostics.success()

    def report(self, sentence: str) -> None:
        """Report that a source gives no readings."""
        self.get_logger().error(sentence)
        self.diagnostics.failure(sentence)


class _Reader:
    """Reads a source in a thread of its own, and publishes what it gives."""

    def __init__(self, node: SignalsNode, name: str, settings: SignalSettings, source: Source) -> None:
        self._node, self._name, self._settings, self._source = node, name, settings, source
        self._channels = _channels(name, settings, source)
        self._waiting: dict[str, list[Reading]] = {each: [] for each in self._channels}
        self._published_s = 0.0
        self._heard_s = time.monotonic()
        self._silent_s = 0.0  # when NaN was published last; 0 while readings come
        self._reported_s = 0.0
        self._error = ""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"signal-{name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._take(self._source.read())
            except Exception as error:  # a driver of a laboratory may raise anything; the others go on
                known = isinstance(error, FringedicError)
                self._error = str(error) if known else f"{type(error).__name__}: {error}"
                self._stopping.wait(_PAUSE_S)
            if time.monotonic() - self._published_s >= _PERIOD_S:
                self._publish()
            self._check_silence()
        self._publish()

    def _take(self, readings: Sequence[Reading]) -> None:
        for each in readings:
            name = each.name or self._name
            if name not in self._waiting:
                raise MachineError(f"its driver gives a signal '{name}', which it does not declare")
            self._waiting[name].append(each)
        if any(each.value == each.value for each in readings):
            if self._silent_s:
                self._node.get_logger().info(f"signal {self._name}: readings come again")
            self._heard_s, self._silent_s, self._error = time.monotonic(), 0.0, ""

    def _publish(self) -> None:
        self._published_s = time.monotonic()
        for name, readings in self._waiting.items():
            if readings:
                channel, scaling = self._channels[name]
                values = np.array([each.value for each in readings])
                self._node.publish(channel, [each.stamp_ns for each in readings], *scaling(values))
                readings.clear()

    def _check_silence(self) -> None:
        """Report a source that is silent, and publish that nothing is measured."""
        now = time.monotonic()
        silent = now - self._heard_s
        if silent < self._settings.silent_after_s or now - self._silent_s < _NAN_PERIOD_S:
            return
        if not self._silent_s:
            self._reported_s = now - _REPEATED_S
        self._silent_s = now
        reason = f": {self._error}" if self._error else "; check its connection"
        if now - self._reported_s >= _REPEATED_S:
            self._reported_s = now
            self._node.report(f"signal {self._name}: no reading for {silent:.1f} s{reason}")
        for channel, _ in self._channels.values():
            nothing = np.full(1, np.nan)
            self._node.publish(channel, [time.time_ns()], nothing, nothing)


def _channels(name: str, settings: SignalSettings, source: Any) -> dict[str, tuple[Channel, Any]]:
    """Return channel and calibration of each signal of a source."""
    description = getattr(source, "description", None)
    if isinstance(description, (ModbusInstrument, ScpiInstrument)):
        return {
            each: (
                signal.channel(each, name),
                lambda values, sigma=signal.sigma_si: (values, np.full(values.size, sigma)),
            )
            for each, signal in description.signals.items()
        }
    assert isinstance(settings, ScaledSignal), "only instruments have several signals"
    return {name: (settings.channel(name), settings.scaling().apply)}


def main() -> int:
    """Run the signals node."""
    return run(SignalsNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
