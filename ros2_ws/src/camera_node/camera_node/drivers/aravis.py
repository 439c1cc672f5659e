"""GigE Vision and USB3 Vision cameras through Aravis.

Aravis is a system library that comes with GObject introspection, not a Python package: `docs/hardware.md` says how to
install it. It is loaded when the first such camera is opened.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from camera_node.drivers.driver import Frame, Scene
from fringedic.clocks import ClockEstimate, DeviceClock
from fringedic.errors import CameraError, CameraTimeoutError

Answer = TypeVar("Answer")

_BUFFERS = 16  # frames that may wait in this process: half a second at 30 frames/s
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between attempts to find a camera that is gone
_ATTEMPTS = 3  # to take a frame of which packets are lost, while its pattern stands still
# what the receiver of a GigE Vision camera counts, and under which name it is told
_COUNTED = {
    "packets_lost": "n_missing_packets",
    "packets_asked_for_again": "n_resend_requests",
    "packets_resent": "n_resent_packets",
    "frames_incomplete": "n_failures",
    "packets_without_buffer": "n_underruns",
}
_LARGEST_DEVIATION = 0.05  # of the exposure time that a camera takes from the one asked for
_PIXEL_FORMATS = {format: f"PIXEL_FORMAT_MONO_{format[4:]}" for format in ("Mono8", "Mono10", "Mono12", "Mono16")}
_NUMBER_TYPES = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16}


class Trigger(StrEnum):
    """What begins an exposure."""

    INTERNAL = "internal"  # the camera's own clock, all the time
    SOFTWARE = "software"  # each request
    EXTERNAL_EDGE = "external_edge"  # an electrical edge, for the set exposure time
    EXTERNAL_LEVEL = "external_level"  # an electrical level, for as long as it lasts


@dataclass(frozen=True)
class AravisSettings:
    """How a camera is to be used.

    Attributes
    ----------
    camera
        Its identifier or network address; empty: the only camera that is found.
    exposure_time
        [s].
    gain
        [dB], where the camera has one.
    pixel_format
        "Mono8", "Mono10", "Mono12" or "Mono16".
    region
        (column, row, width, height) [px]; None is the whole sensor.
    trigger
        What begins an exposure.
    trigger_line
        Input of the external triggers, such as "Line1".
    packet_size
        Size of network packets [byte]; 0 finds the largest that passes.
    timeout
        How long to wait for a frame beyond its exposure time [s].
    """

    exposure_time: float
    camera: str = ""
    gain: float = 0.0
    pixel_format: str = "Mono8"
    region: tuple[int, int, int, int] | None = None
    trigger: Trigger = Trigger.SOFTWARE
    trigger_line: str = "Line1"
    packet_size: int = 0
    timeout: float = 5.0


@dataclass
class _Connection:
    """An open camera and its stream."""

    camera: Any
    stream: Any
    asked_exposure_time: float  # [s]
    exposure_time: float  # that the camera made of it [s]
    automatic: tuple[str, ...]  # what the camera could do by itself
    lost: threading.Event  # another has taken the camera over, or it was restarted
    # by exposure time: whether the camera stamps the begin or the end of an exposure is not known
    clocks: dict[float, DeviceClock] = field(default_factory=dict)
    last_frame: int | None = None  # number that the camera gave it
    running: bool = False

    def abandon(self) -> None:
        """Let go of a camera that does not answer; Aravis tries for ten seconds to take leave of it."""
        parts = [self.stream, self.camera]
        self.stream = self.camera = None
        threading.Thread(target=parts.clear, daemon=True).start()


class _IncompleteFrameError(CameraError):
    """Packets of a frame were lost."""


class AravisDriver:
    """A GenICam camera.

    Automatic exposure and gain are switched off, and an exposure is refused when one of them is found on. A frame of
    which packets were lost is taken again, twice at most. A camera that is lost (unplugged, powered down) fails the
    exposures of that time, and is looked for again at the next ones, with pauses that double up to 8 s.

    Parameters
    ----------
    settings
        How the camera is to be used.

    Raises
    ------
    CameraError
        Aravis is not installed, there is no such camera, or it does not offer a setting; the message says which.
    """

    needs_scene = False

    def __init__(self, settings: AravisSettings) -> None:
        self._aravis = _load_aravis()
        self._settings = settings
        self.dropped = 0
        self._rate: float | None = None
        self._pause = _FIRST_PAUSE_S
        self._next_attempt = 0.0
        self._connection: _Connection | None = self._connect()

    @property
    def clock(self) -> ClockEstimate | None:
        """The camera's clock against this computer's."""
        known = [] if self._connection is None else [clock.estimate for clock in self._connection.clocks.values()]
        return max((each for each in known if each is not None), key=lambda each: each.samples, default=None)

    @property
    def counts(self) -> Mapping[str, int]:
        """What was lost on the way from the camera since it was connected."""
        connection = self._connection
        if connection is None or not connection.camera.is_gv_device():
            return {}
        return {name: connection.stream.get_info_uint64_by_name(key) for name, key in _COUNTED.items()}

    def start(self, rate_hz: float) -> None:
        """Expose at a rate [Hz] from now on; `expose` then gives one frame after the other.

        Raises
        ------
        CameraError
            The camera does not offer this rate.
        """
        self._rate = rate_hz
        with self._in_use() as connection:
            self._stop(connection)
            connection.camera.clear_triggers()
            self._aravis.ask("frame rate", lambda: connection.camera.set_frame_rate(rate_hz))
            self._run(connection)

    def interrupt(self) -> None:
        """Nothing: a frame is never long in coming."""

    def stop(self) -> None:
        """End what `start` began."""
        self._rate = None
        if self._connection is not None:
            try:
                self._stop(self._connection)
                self._set_trigger(self._connection.camera)
            except (CameraError, self._aravis.error):
                self._lose()  # the next exposure looks for it

    def expose(self, scene: Scene) -> Frame:
        """Take one frame that begins now, or the next one of a running stream.

        Raises
        ------
        CameraTimeoutError
            No frame came.
        CameraError
            Packets of the frame were lost again and again, the camera sets itself, or it is gone.
        ClockJumpError
            The camera's clock or this computer's was set.
        """
        with self._in_use() as connection:
            if scene.exposure_time != connection.asked_exposure_time:
                connection.asked_exposure_time = math.nan
                connection.exposure_time = _set_exposure_time(connection.camera, scene.exposure_time)
                connection.asked_exposure_time = scene.exposure_time
            if self._rate is not None:
                return self._next(connection)
            self._refuse_automatic(connection)
            for _ in range(_ATTEMPTS):
                try:
                    return self._take(connection)
                except _IncompleteFrameError as error:
                    lost = error
                except CameraTimeoutError:
                    self._stop(connection)  # a frame that comes still must not be taken for the next one
                    raise
            raise CameraError(f"{lost} ({_ATTEMPTS} attempts)")

    def _take(self, connection: _Connection) -> Frame:
        """Take one frame that begins now."""
        self._run(connection)
        self._discard_waiting(connection)
        asked = time.time_ns()
        if self._settings.trigger is Trigger.SOFTWARE:
            connection.camera.software_trigger()
        while True:
            frame = self._next(connection)
            # a frame that was under way began before it was asked for
            if self._settings.trigger is not Trigger.INTERNAL or frame.stamp_ns - asked >= 0.5e9 * frame.exposure_time:
                return frame

    def close(self) -> None:
        """Stop the camera and give it back."""
        connection, self._connection = self._connection, None
        if connection is not None:
            try:
                self._stop(connection)
            except self._aravis.error:
                connection.abandon()  # it is gone already

    # connection

    def _connect(self) -> _Connection:
        settings, aravis, ask = self._settings, self._aravis, self._aravis.ask
        camera = ask("camera", lambda: aravis.camera(settings.camera))
        if settings.pixel_format not in _NUMBER_TYPES:
            raise CameraError(f"pixel format {settings.pixel_format}: use {', '.join(_NUMBER_TYPES)}")
        offered = ask("pixel formats", camera.dup_available_pixel_formats_as_strings)
        if settings.pixel_format not in offered:
            raise CameraError(f"the camera has no pixel format {settings.pixel_format}; it has {', '.join(offered)}")
        ask("pixel format", lambda: camera.set_pixel_format_from_string(settings.pixel_format))
        _set_region(aravis, camera, settings.region)
        automatic = []
        if ask("automatic exposure", camera.is_exposure_auto_available):
            ask("automatic exposure", lambda: camera.set_exposure_time_auto(aravis.module.Auto.OFF))
            automatic.append("exposure_time")
        if ask("automatic gain", camera.is_gain_auto_available):
            ask("automatic gain", lambda: camera.set_gain_auto(aravis.module.Auto.OFF))
            automatic.append("gain")
        exposure_time = ask("exposure time", lambda: _set_exposure_time(camera, settings.exposure_time))
        if ask("gain", camera.is_gain_available):
            ask("gain", lambda: _within(camera.get_gain_bounds(), settings.gain, "dB"))
            ask("gain", lambda: camera.set_gain(settings.gain))
        if camera.is_gv_device():
            ask(
                "packet size",
                lambda: (
                    camera.gv_set_packet_size(settings.packet_size)
                    if settings.packet_size
                    else camera.gv_auto_packet_size()
                ),
            )
        self._set_trigger(camera)
        lost = threading.Event()
        camera.get_device().connect("control-lost", lambda _: lost.set())
        stream = ask("stream", lambda: camera.create_stream(None, None))
        for _ in range(_BUFFERS):
            stream.push_buffer(aravis.module.Buffer.new_allocate(camera.get_payload()))
        return _Connection(camera, stream, settings.exposure_time, exposure_time, tuple(automatic), lost)

    def _refuse_automatic(self, connection: _Connection) -> None:
        for what in connection.automatic:
            if getattr(connection.camera, f"get_{what}_auto")() != self._aravis.module.Auto.OFF:
                name = what.replace("_", " ")
                raise CameraError(
                    f"automatic {name} is on, so grey levels of different frames cannot be compared; it was off when "
                    "the camera was connected: what has switched it on?"
                )

    def _set_trigger(self, camera: Any) -> None:
        trigger, ask = self._settings.trigger, self._aravis.ask
        if trigger is Trigger.INTERNAL:
            ask("trigger", camera.clear_triggers)
        else:
            source = "Software" if trigger is Trigger.SOFTWARE else self._settings.trigger_line
            ask("trigger", lambda: camera.set_trigger(source))
        if trigger is Trigger.EXTERNAL_LEVEL:
            ask("trigger level", lambda: camera.set_string("TriggerActivation", "LevelHigh"))
            ask("exposure as long as the level", lambda: camera.set_string("ExposureMode", "TriggerWidth"))

    @contextmanager
    def _in_use(self) -> Iterator[_Connection]:
        """The connection, made again when it was lost; a device error ends it."""
        if self._connection is not None and self._connection.lost.is_set():
            self._lose()
            self._next_attempt = 0.0  # it may be there again already
        if self._connection is None:
            wait = self._next_attempt - time.monotonic()
            if wait > 0:
                raise CameraError(f"the camera is gone; looking for it again in {wait:.1f} s")
            try:
                self._connection = self._connect()
                if self._rate is not None:
                    self.start(self._rate)
            except CameraError as error:
                self._lose()
                raise CameraError(f"the camera is gone: {error}; check its cable and power") from error
            self._pause = _FIRST_PAUSE_S
        try:
            yield self._connection
        except self._aravis.error as error:
            self._lose()
            raise CameraError(f"the camera does not answer: {_words(error)}; check its cable and power") from error

    def _lose(self) -> None:
        if self._connection is not None:
            self._connection.abandon()
            self._connection = None
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)

    # frames

    def _run(self, connection: _Connection) -> None:
        if not connection.running:
            connection.camera.start_acquisition()
            connection.running = True
            connection.last_frame = None

    def _stop(self, connection: _Connection) -> None:
        if connection.running:
            connection.running = False
            connection.camera.stop_acquisition()
            self._discard_waiting(connection)

    def _discard_waiting(self, connection: _Connection) -> None:
        """Give frames back that came between two requests."""
        while (buffer := connection.stream.try_pop_buffer()) is not None:
            connection.stream.push_buffer(buffer)
        connection.last_frame = None

    def _next(self, connection: _Connection) -> Frame:
        patience = self._settings.timeout + connection.exposure_time + 1 / (self._rate or np.inf)
        buffer = connection.stream.timeout_pop_buffer(round(1e6 * patience))
        if buffer is None:
            connection.camera.get_exposure_time()  # a camera that is gone does not answer this
            raise CameraTimeoutError(
                f"no frame within {patience:.3g} s; "
                + (
                    "is the trigger's cable connected?"
                    if self._settings.trigger in (Trigger.EXTERNAL_EDGE, Trigger.EXTERNAL_LEVEL)
                    else "the camera answers but sends nothing: check the network's firewall and packet size"
                )
            )
        try:
            return self._frame(connection, buffer)
        finally:
            connection.stream.push_buffer(buffer)

    def _frame(self, connection: _Connection, buffer: Any) -> Frame:
        number, status, statuses = buffer.get_frame_id(), buffer.get_status(), self._aravis.module.BufferStatus
        if connection.last_frame is not None and number > connection.last_frame + 1:
            self.dropped += number - connection.last_frame - 1
        connection.last_frame = number
        if status != statuses.SUCCESS:
            self.dropped += 1
        if status == statuses.SIZE_MISMATCH:
            raise CameraError(f"frame {number} has another size or pixel format than the camera was set to")
        if status != statuses.SUCCESS:
            raise _IncompleteFrameError(
                f"frame {number} is incomplete ({status.value_nick}, {self.counts.get('packets_lost', 0)} packets lost "
                "since the camera was connected); check cable, packet size and network load"
            )
        sent = buffer.get_image_pixel_format()
        if sent != getattr(self._aravis.module, _PIXEL_FORMATS[self._settings.pixel_format]):
            raise CameraError(
                f"frame {number} has the pixel format {sent:#010x}, not {self._settings.pixel_format}, to which the "
                "camera was set"
            )
        width, height = buffer.get_image_width(), buffer.get_image_height()
        number_type = _NUMBER_TYPES[self._settings.pixel_format]
        image = np.frombuffer(buffer.get_image_data(), number_type, count=width * height).reshape(height, width).copy()
        clock = connection.clocks.setdefault(connection.exposure_time, DeviceClock())
        arrival = clock.arrival(buffer.get_timestamp(), buffer.get_system_timestamp())
        # the first data leave the camera when the exposure ends
        return Frame(image, arrival - round(0.5e9 * connection.exposure_time), connection.exposure_time)


@dataclass(frozen=True)
class _Aravis:
    """The loaded library."""

    module: Any
    error: type[Exception]

    def ask(self, what: str, question: Callable[[], Answer]) -> Answer:
        """Pass a request to the camera; an error names what was asked for."""
        try:
            return question()
        except (CameraError, self.error) as error:
            raise CameraError(f"{what}: {_words(error)}") from error

    def camera(self, name: str) -> Any:
        if name:
            return self.module.Camera.new(name)
        self.module.update_device_list()
        found = [self.module.get_device_id(index) for index in range(self.module.get_n_devices())]
        if len(found) != 1:
            seen = f"there are {len(found)} cameras: {', '.join(found)}" if found else "no camera is found"
            raise CameraError(f"{seen}; set camera to an identifier or a network address")
        return self.module.Camera.new(found[0])


def _load_aravis() -> _Aravis:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as error:
        raise CameraError(f"Aravis is not installed ({error}); see docs/hardware.md") from error
    return _Aravis(Aravis, GLib.Error)


def _set_region(aravis: _Aravis, camera: Any, region: tuple[int, int, int, int] | None) -> None:
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


def _set_exposure_time(camera: Any, wanted: float) -> float:
    """Set an exposure time and return the one that the camera makes of it [s]."""
    _within(camera.get_exposure_time_bounds(), 1e6 * wanted, "µs")
    camera.set_exposure_time(1e6 * wanted)
    taken = 1e-6 * camera.get_exposure_time()
    if abs(taken - wanted) > _LARGEST_DEVIATION * wanted:
        raise CameraError(f"the camera makes an exposure of {1e3 * taken:g} ms of {1e3 * wanted:g} ms")
    return taken


def _within(bounds: tuple[float, float], value: float, unit: str) -> None:
    lowest, highest = bounds
    if not lowest <= value <= highest:
        raise CameraError(f"{value:g} {unit} is outside {lowest:g} to {highest:g} {unit}")


def _words(error: Exception) -> str:
    """The message alone, without the domain and code that GLib puts around it."""
    return str(getattr(error, "message", error))
