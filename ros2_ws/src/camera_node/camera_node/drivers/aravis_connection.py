"""Connection to a GenICam camera: its settings, its stream and its acquisition."""

from __future__ import annotations

import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from camera_node.drivers.aravis_library import Aravis
from fringedic.errors import CameraError
from fringedic.frames.clocks import DeviceClock
from fringedic.settings.camera import AravisCamera, Trigger
from fringedic.wording.numbers import number_text

# Frames that may wait in this process. The middleware may keep a publisher waiting for a second (decision 0031), and
# 64 are two seconds at 30 frames/s; cameras with large images have fewer.
_LEAST_BUFFERS, _MOST_BUFFERS, _BUFFER_BYTES = 16, 64, 256_000_000
# A stream that may read packets of the network card receives those of all programs for some milliseconds, until its
# filter is set, and takes them for parts of a frame. The kernel hands them over within 5 ms, and the receiver drops
# them as long as it has no buffers; but the number of the first one is then its last frame, and it ignores frames up to
# 100 numbers before.
_OTHER_PACKETS_S = 0.1
_RECEIVER = "arv_gv_stream"  # name of its thread
# [byte] Receive buffer of any other stream, which Aravis would make as large as one frame. The kernel limits it to
# net.core.rmem_max.
_SOCKET_BUFFER = 2**25
# counts of the receiver of a GigE Vision camera: name in the diagnostics, and name in Aravis
_COUNTED = {
    "packets_lost": "n_missing_packets",
    "packets_asked_for_again": "n_resend_requests",
    "packets_resent": "n_resent_packets",
    "frames_incomplete": "n_failures",
    "packets_without_buffer": "n_underruns",
}
PIXEL_TYPES = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16}
_NUMBERS = 65_535  # of frames in GigE Vision: 1 follows on the largest one, and 0 is none
_LARGEST_DEVIATION = 0.05  # of the exposure time that a camera sets, relative to the requested one
_LARGEST_RATE_DEVIATION = 0.01  # of its frame rate


@dataclass
class AravisConnection:
    """An open camera and its stream.

    Attributes
    ----------
    camera, stream
        Objects of Aravis; None after `abandon`.
    asked_exposure_time, exposure_time
        Requested exposure time, and the one that the camera set [s].
    automatic
        Settings that the camera could control by itself: "exposure_time", "gain".
    clocks
        Clock of the camera by exposure time: cameras stamp the start or the end of an exposure without reporting which.
    last_frame
        Number that the camera gave to the last frame; None before the first one.
    running
        Whether the acquisition runs.
    """

    camera: Any
    stream: Any
    asked_exposure_time: float
    exposure_time: float
    automatic: tuple[str, ...]
    clocks: dict[float, DeviceClock] = field(default_factory=dict)
    last_frame: int | None = None
    running: bool = False
    _lost_before: Counter[str] = field(init=False, default_factory=Counter)
    _counted_before: Counter[str] = field(init=False, default_factory=Counter)
    _ignored_before: int = field(init=False, default=0)

    def supply(self, aravis: Aravis) -> None:
        """Give the receiver its buffers, when it has dropped the packets of other programs."""
        if self.camera.is_gv_device():
            time.sleep(_OTHER_PACKETS_S)
            while not _receiver_waits():  # the computer is busy
                time.sleep(0.01)
            self._counted_before = self._counted()
        self.expect_frame()
        payload = self.camera.get_payload()
        for _ in range(min(max(_BUFFER_BYTES // max(payload, 1), _LEAST_BUFFERS), _MOST_BUFFERS)):
            self.stream.push_buffer(aravis.module.Buffer.new_allocate(payload))

    @property
    def clock(self) -> DeviceClock:
        """Clock of the camera at the present exposure time."""
        return self.clocks.setdefault(self.exposure_time, DeviceClock())

    def expect_frame(self) -> None:
        """Begin to look for packets that the receiver ignores."""
        self._ignored_before = self._ignored()

    @property
    def ignores_frame(self) -> bool:
        """Whether the receiver has ignored packets of the camera since `expect_frame`."""
        return self._ignored() > self._ignored_before

    def restart_receiver(self, aravis: Aravis) -> None:
        """Start the receiver again: it forgets which frame was the last one."""
        self._lost_before = Counter(self.counts())
        self.stream.stop_thread(True)  # with its buffers
        self.stream.start_thread()
        self.supply(aravis)

    def counts(self) -> dict[str, int]:
        """Return the losses between camera and computer since the camera was connected; none of USB3 Vision."""
        return {
            name: self._lost_before[name] + count - self._counted_before[name]
            for name, count in self._counted().items()
        }

    def _counted(self) -> Counter[str]:
        if not self.camera.is_gv_device():
            return Counter()
        return Counter({name: self.stream.get_info_uint64_by_name(key) for name, key in _COUNTED.items()})

    def _ignored(self) -> int:
        return int(self.stream.get_info_uint64_by_name("n_ignored_packets")) if self.camera.is_gv_device() else 0

    @property
    def lost(self) -> bool:
        """Whether another program has taken over the camera, or it was restarted; False for USB3 Vision.

        Polled, because a handler of the signal "control-lost" runs in the thread of Aravis that keeps the camera alive.
        If that thread releases the camera last, it waits for its own end, and GLib ends the process.
        """
        return self.camera.is_gv_device() and not self.camera.get_device().is_controller()

    def missing_before(self, number: int) -> int:
        """Return how many frames are missing between the last one and the one of this number, which is the last now."""
        last, self.last_frame = self.last_frame, number
        missing = 0 if last is None else (number - last - 1) % _NUMBERS
        return missing if missing < _NUMBERS // 2 else 0  # otherwise it is no later frame

    def count_frame_without_number(self) -> None:
        """Take an incomplete frame for the one after the last: without its first packet its number is not known."""
        if self.last_frame is not None:
            self.last_frame += 1

    def abandon(self) -> None:
        """Release a camera that does not answer, in a thread: Aravis needs ten seconds for it."""
        parts = [self.stream, self.camera]
        self.stream = self.camera = None
        threading.Thread(target=parts.clear, daemon=True).start()

    def start(self) -> None:
        """Start the acquisition, unless it runs."""
        if not self.running:
            self.camera.start_acquisition()
            self.running = True
            self.last_frame = None

    def stop(self) -> None:
        """Stop the acquisition and discard the frames that wait."""
        if self.running:
            self.running = False
            self.camera.stop_acquisition()
            self.discard_waiting()

    def discard_waiting(self) -> None:
        """Discard frames that arrived between two requests."""
        while (buffer := self.stream.try_pop_buffer()) is not None:
            self.stream.push_buffer(buffer)
        self.last_frame = None

    def refuse_automatic(self, aravis: Aravis) -> None:
        """Check that the camera does not control exposure time or gain by itself.

        Raises
        ------
        CameraError
            It does.
        """
        for what in self.automatic:
            if getattr(self.camera, f"get_{what}_auto")() != aravis.module.Auto.OFF:
                name = what.replace("_", " ")
                raise CameraError(
                    f"automatic {name} is on, so grey levels of different frames cannot be compared; it was off when "
                    "the camera was connected: check which program has switched it on"
                )


def connect(aravis: Aravis, settings: AravisCamera) -> AravisConnection:
    """Open a camera, apply its settings and create its stream.

    Raises
    ------
    CameraError
        There is no such camera, or it refuses a setting; the message names it.
    """
    ask = aravis.ask
    camera = ask("camera", lambda: aravis.camera(settings.camera))
    with suppress(aravis.error):  # a camera that is stopped may refuse it
        camera.stop_acquisition()  # one that a killed process left running goes on sending to that process
    _set_pixel_format(aravis, camera, settings.pixel_format)
    _set_region(aravis, camera, settings.region)
    automatic = _switch_automatic_off(aravis, camera)
    set_timed(aravis, camera)  # before the exposure time, which some cameras lock in the other mode
    exposure_time = ask("exposure time", lambda: set_exposure_time(camera, settings.exposure_time))
    if ask("gain", camera.is_gain_available):
        ask("gain", lambda: _check_range(camera.get_gain_bounds(), settings.gain_db, "dB"))
        ask("gain", lambda: camera.set_gain(settings.gain_db))
    if camera.is_gv_device():
        ask("packet size", lambda: _set_packet_size(camera, settings.packet_size_byte))
    set_trigger(aravis, camera, settings)
    stream = ask("stream", lambda: camera.create_stream(None, None))
    if camera.is_gv_device():
        stream.set_property("socket-buffer", aravis.module.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", _SOCKET_BUFFER)
    connection = AravisConnection(camera, stream, settings.exposure_time, exposure_time, automatic)
    connection.supply(aravis)
    return connection


def _receiver_waits() -> bool:
    """Whether no receiver in this process has packets to read."""
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it has ended
            name, _, state = (thread / "stat").read_text().rpartition(") ")
            if name.endswith(f"({_RECEIVER}") and not state.startswith("S"):
                return False
    return True


def set_timed(aravis: Aravis, camera: Any) -> None:
    """Let the exposure time end the exposures, which a camera may have been set not to do before."""
    what = "exposure mode"
    if not aravis.ask(what, lambda: camera.is_feature_available("ExposureMode")):
        return
    if aravis.ask(what, lambda: camera.get_string("ExposureMode")) != "Timed":  # some cameras only offer to read it
        aravis.ask(what, lambda: camera.set_string("ExposureMode", "Timed"))


def set_trigger(aravis: Aravis, camera: Any, settings: AravisCamera) -> None:
    """Set the event that starts an exposure.

    Raises
    ------
    CameraError
        The camera does not offer it.
    """
    trigger, ask = settings.trigger, aravis.ask
    if trigger is Trigger.INTERNAL:
        ask("trigger", camera.clear_triggers)
    else:
        source = "Software" if trigger is Trigger.SOFTWARE else settings.trigger_line
        ask("trigger", lambda: camera.set_trigger(source))
    if trigger is Trigger.EXTERNAL_LEVEL:
        ask("trigger level", lambda: camera.set_string("TriggerActivation", "LevelHigh"))
        ask("exposure as long as the level", lambda: camera.set_string("ExposureMode", "TriggerWidth"))


def set_frame_rate(aravis: Aravis, camera: Any, wanted: float) -> None:
    """Set the rate of a free run [Hz].

    Raises
    ------
    CameraError
        The camera does not offer this rate.
    """
    aravis.ask("frame rate", lambda: camera.set_frame_rate(wanted))
    given = aravis.ask("frame rate", camera.get_frame_rate)
    if abs(given - wanted) > _LARGEST_RATE_DEVIATION * wanted:
        raise CameraError(
            f"frame rate: the camera does not offer {wanted:g} frames/s, the nearest rate is {given:.4g}; use that, or "
            "a shorter exposure or a smaller region"
        )


def set_exposure_time(camera: Any, wanted: float) -> float:
    """Set an exposure time and return the one that the camera has set [s].

    Raises
    ------
    CameraError
        The exposure time is outside the range of the camera, or differs too much from the one that it has set.
    """
    _check_range(camera.get_exposure_time_bounds(), 1e6 * wanted, "µs")
    camera.set_exposure_time(1e6 * wanted)
    taken = 1e-6 * camera.get_exposure_time()
    if abs(taken - wanted) > _LARGEST_DEVIATION * wanted:
        raise CameraError(
            f"the camera set an exposure time of {1e3 * taken:g} ms instead of {1e3 * wanted:g} ms; choose another"
        )
    return taken


def _set_pixel_format(aravis: Aravis, camera: Any, pixel_format: str) -> None:
    if pixel_format not in PIXEL_TYPES:
        raise CameraError(f"pixel format {pixel_format}: use {', '.join(PIXEL_TYPES)}")
    offered = aravis.ask("pixel formats", camera.dup_available_pixel_formats_as_strings)
    if pixel_format not in offered:
        raise CameraError(f"the camera has no pixel format {pixel_format}; it has {', '.join(offered)}")
    aravis.ask("pixel format", lambda: camera.set_pixel_format_from_string(pixel_format))


def _switch_automatic_off(aravis: Aravis, camera: Any) -> tuple[str, ...]:
    """Switch automatic exposure and gain off, and return which of them the camera has."""
    automatic, off = [], aravis.module.Auto.OFF
    if aravis.ask("automatic exposure", camera.is_exposure_auto_available):
        aravis.ask("automatic exposure", lambda: camera.set_exposure_time_auto(off))
        automatic.append("exposure_time")
    if aravis.ask("automatic gain", camera.is_gain_auto_available):
        aravis.ask("automatic gain", lambda: camera.set_gain_auto(off))
        automatic.append("gain")
    return tuple(automatic)


def _set_packet_size(camera: Any, size: int) -> None:
    if size:
        camera.gv_set_packet_size(size)
    else:
        camera.gv_auto_packet_size()


def _set_region(aravis: Aravis, camera: Any, region: tuple[int, int, int, int] | None) -> None:
    sensor = aravis.ask("sensor size", camera.get_sensor_size)
    wanted = region or (0, 0, sensor.width, sensor.height)
    if wanted[0] + wanted[2] > sensor.width or wanted[1] + wanted[3] > sensor.height:
        raise CameraError(f"region {list(wanted)} leaves the sensor of {sensor.width}x{sensor.height} px")
    aravis.ask("region", lambda: camera.set_region(*wanted))
    given = aravis.ask("region", camera.get_region)
    if (given.x, given.y, given.width, given.height) != wanted:
        raise CameraError(
            f"region {list(wanted)} is not possible on this camera, the nearest is "
            f"{[given.x, given.y, given.width, given.height]} (column, row, width, height)"
        )


def _check_range(bounds: tuple[float, float], value: float, unit: str) -> None:
    lowest, highest = bounds
    if not lowest <= value <= highest:
        wanted, low, high = (number_text(each, 6) for each in (value, lowest, highest))
        raise CameraError(f"{wanted} {unit} is outside {low} to {high} {unit}")
