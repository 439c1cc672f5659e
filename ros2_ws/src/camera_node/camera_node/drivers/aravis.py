"""GigE Vision and USB3 Vision cameras through Aravis."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from rclpy.node import Node

from camera_node.drivers.aravis_connection import (
    PIXEL_TYPES,
    AravisConnection,
    connect,
    set_exposure_time,
    set_frame_rate,
    set_timed,
    set_trigger,
)
from camera_node.drivers.aravis_library import error_message, load_aravis
from camera_node.drivers.driver import Frame, Scene
from fringedic.errors import CameraError, CameraTimeoutError
from fringedic.frames.clocks import ClockEstimate
from fringedic.settings.camera import AravisCamera, Trigger

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between two attempts to find a lost camera
_ATTEMPTS = 3  # to take a frame of which packets are lost, while its pattern is on the screen
_LONGEST_SETTLING = 10  # frames of one request: the clock of a camera with exposures of 10 s never settles
_TRANSFER_S = 0.25  # of a frame, from the end of its exposure
_PIXEL_FORMATS = {name: f"PIXEL_FORMAT_MONO_{name.removeprefix('Mono')}" for name in PIXEL_TYPES}


class IncompleteFrameError(CameraError):
    """Packets of a frame were lost, or ignored."""


class AravisDriver:
    """A GenICam camera.

    Automatic exposure and gain are switched off, and an exposure fails when one of them is found on. A frame with lost
    packets is taken again, twice at most. While a camera is lost (unplugged, powered down), exposures fail; the driver
    tries to connect again at each exposure, with pauses that double up to 8 s.

    Parameters
    ----------
    settings
        Settings of the camera.

    Attributes
    ----------
    dropped
        Frames that were exposed and did not arrive completely.

    Raises
    ------
    CameraError
        Aravis is not installed, there is no such camera, or it does not offer a setting; the message names it.
    """

    needs_scene = False

    def __init__(self, settings: AravisCamera, _node: Node | None = None) -> None:
        self._aravis = load_aravis()
        self._settings = settings
        self.dropped = 0
        self._rate: float | None = None
        self._pause = _FIRST_PAUSE_S
        self._next_attempt = 0.0
        self._connection: AravisConnection | None = connect(self._aravis, self._settings)

    @property
    def clock(self) -> ClockEstimate | None:
        """Clock of the camera relative to the clock of this computer."""
        known = [] if self._connection is None else [clock.estimate for clock in self._connection.clocks.values()]
        return max((each for each in known if each is not None), key=lambda each: each.samples, default=None)

    @property
    def camera(self) -> Any:
        """Camera object of Aravis, for settings that the driver does not use; None while the camera is lost."""
        return None if self._connection is None else self._connection.camera

    @property
    def counts(self) -> Mapping[str, int]:
        """Losses between camera and computer since the camera was connected."""
        return {} if self._connection is None else self._connection.counts()

    def start(self, rate_hz: float) -> None:
        """Start to expose at a rate [Hz]; `expose` then returns one frame after the other.

        Raises
        ------
        CameraError
            The camera does not offer this rate; `stop` restores its trigger.
        """
        with self._in_use() as connection:
            connection.stop()
            connection.camera.clear_triggers()
            set_timed(self._aravis, connection.camera)
            self._set_exposure_time(connection, self._settings.exposure_time)  # a longer one would limit the rate
            set_frame_rate(self._aravis, connection.camera, rate_hz)
            connection.start()
        self._rate = rate_hz  # not before: a stream that did not start is none that a lost camera continues

    def interrupt(self) -> None:
        """Do nothing: `expose` returns soon."""

    def stop(self) -> None:
        """End the stream that `start` began."""
        self._rate = None
        if self._connection is not None:
            try:
                self._connection.stop()
                set_trigger(self._aravis, self._connection.camera, self._settings)
            except (CameraError, self._aravis.error):
                self._lose()  # the next exposure connects again

    def expose(self, scene: Scene) -> Frame:
        """Take one frame that begins now, or the next one of a running stream.

        Raises
        ------
        CameraTimeoutError
            No frame came.
        CameraError
            Packets were lost in every attempt, the camera controls its exposure by itself, or it is lost.
        ClockJumpError
            The clock of the camera or of this computer was set.
        """
        with self._in_use() as connection:
            self._check_level(scene.exposure_time)
            self._set_exposure_time(connection, scene.exposure_time)
            if self._rate is not None:
                return self._next(connection)
            connection.refuse_automatic(self._aravis)
            for _ in range(_ATTEMPTS):
                try:
                    return self._take(connection)
                except IncompleteFrameError as error:
                    lost = error
                except CameraTimeoutError:
                    connection.stop()  # a frame that arrives later must not be taken for the next one
                    raise
            raise CameraError(f"{lost} ({_ATTEMPTS} attempts)")

    def _check_level(self, wanted: float) -> None:
        by_level = self._settings.trigger is Trigger.EXTERNAL_LEVEL and self._rate is None
        if by_level and wanted != self._settings.exposure_time:
            raise CameraError(
                f"an exposure of {1e3 * wanted:g} ms is requested; the trigger external_level exposes as long as the "
                f"level, {1e3 * self._settings.exposure_time:g} ms: use one exposure time, or another trigger"
            )

    @staticmethod
    def _set_exposure_time(connection: AravisConnection, wanted: float) -> None:
        if wanted != connection.asked_exposure_time:
            connection.asked_exposure_time = math.nan
            connection.exposure_time = set_exposure_time(connection.camera, wanted)
            connection.asked_exposure_time = wanted

    def _take(self, connection: AravisConnection) -> Frame:
        """Take one frame that begins now."""
        connection.start()
        connection.discard_waiting()
        connection.expect_frame()
        asked = time.time_ns()
        if self._settings.trigger is Trigger.SOFTWARE:
            connection.camera.software_trigger()
            return self._next(connection)
        taken = 0
        while True:
            frame = self._next(connection)
            taken += 1
            # a clock or a generator goes on between requests: a frame that was under way began before this one, and one
            # that arrived late seems to have begun later as long as the shortest delay is not known
            settled = connection.clock.settled or taken >= _LONGEST_SETTLING
            if settled and frame.stamp_ns - asked >= 0.5e9 * frame.exposure_time:
                return frame

    def close(self) -> None:
        """Stop the camera and disconnect it."""
        connection, self._connection = self._connection, None
        if connection is not None:
            try:
                connection.stop()
            except self._aravis.error:
                connection.abandon()  # the camera is lost

    # connection

    @contextmanager
    def _in_use(self) -> Iterator[AravisConnection]:
        """Provide the connection, opened again when it was lost; an error of the device ends it."""
        if self._connection is not None and self._connection.lost:
            self._lose()
            self._next_attempt = 0.0  # the camera may be present again
        if self._connection is None:
            wait = self._next_attempt - time.monotonic()
            if wait > 0:
                raise CameraError(f"the camera is lost; the next attempt to connect is in {wait:.1f} s")
            try:
                self._connection = connect(self._aravis, self._settings)
                if self._rate is not None:
                    self.start(self._rate)
            except CameraError as error:
                self._lose()
                raise CameraError(f"the camera is lost: {error}; check its cable and power") from error
            self._pause = _FIRST_PAUSE_S
        try:
            yield self._connection
        except self._aravis.error as error:
            self._lose()
            raise CameraError(
                f"the camera does not answer: {error_message(error)}; check its cable and power"
            ) from error

    def _lose(self) -> None:
        if self._connection is not None:
            self._connection.abandon()
            self._connection = None
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)

    # frames

    def _next(self, connection: AravisConnection) -> Frame:
        begun = connection.exposure_time + 1 / (self._rate or np.inf)
        transfer = min(_TRANSFER_S, self._settings.driver_timeout)
        buffer = connection.stream.timeout_pop_buffer(round(1e6 * (begun + transfer)))
        if buffer is None and connection.ignores_frame:
            if self._rate is None:
                self.dropped += 1  # those of a stream are counted by their numbers
                connection.stop()  # a frame that comes later must not be taken for the next one
            connection.restart_receiver(self._aravis)
            raise IncompleteFrameError(
                "Aravis ignored a frame as an old one, after a packet of another camera or program; if this is "
                "repeated, give the camera its own network card"
            )
        if buffer is None:
            buffer = connection.stream.timeout_pop_buffer(round(1e6 * (self._settings.driver_timeout - transfer)))
        if buffer is None:
            connection.camera.get_exposure_time()  # raises an error when the camera is lost
            raise CameraTimeoutError(
                f"no frame within {begun + self._settings.driver_timeout:.3g} s; "
                + (
                    "check the cable of the trigger"
                    if self._settings.trigger in (Trigger.EXTERNAL_EDGE, Trigger.EXTERNAL_LEVEL)
                    else "the camera answers but sends nothing: check the network's firewall and packet size"
                )
            )
        connection.expect_frame()
        try:
            return self._frame(connection, buffer)
        finally:
            connection.stream.push_buffer(buffer)

    def _frame(self, connection: AravisConnection, buffer: Any) -> Frame:
        status, statuses = buffer.get_status(), self._aravis.module.BufferStatus
        if status != statuses.SUCCESS:
            self.dropped += 1
            connection.count_frame_without_number()
        if status == statuses.SIZE_MISMATCH:
            raise CameraError("a frame has another size or pixel format than the camera was set to")
        if status != statuses.SUCCESS:
            raise IncompleteFrameError(
                f"a frame is incomplete ({status.value_nick}, {self.counts.get('packets_lost', 0)} packets lost "
                "since the camera was connected); check cable, packet size and network load"
            )
        number = buffer.get_frame_id()
        self.dropped += connection.missing_before(number)
        sent = buffer.get_image_pixel_format()
        if sent != getattr(self._aravis.module, _PIXEL_FORMATS[self._settings.pixel_format]):
            raise CameraError(
                f"frame {number} has the pixel format {sent:#010x}, not {self._settings.pixel_format}, to which the "
                "camera was set"
            )
        width, height = buffer.get_image_width(), buffer.get_image_height()
        number_type = PIXEL_TYPES[self._settings.pixel_format]
        image = np.frombuffer(buffer.get_image_data(), number_type, count=width * height).reshape(height, width).copy()
        arrival = connection.clock.arrival(buffer.get_timestamp(), buffer.get_system_timestamp())
        # the first data leave the camera at the end of the exposure
        return Frame(image, arrival - round(0.5e9 * connection.exposure_time), connection.exposure_time)
