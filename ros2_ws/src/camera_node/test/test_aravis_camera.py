"""GigE Vision over the loopback: Aravis' own fake camera streams to the driver and to the node.

What arrives is known: the fake camera sends a diagonal ramp that moves by one column with each frame. It sends as soon
as it is triggered, without waiting for the end of an exposure.
"""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from rclpy.publisher import Publisher

from camera_node.drivers import Frame, Scene, aravis_connection
from camera_node.drivers.aravis import AravisDriver, IncompleteFrameError
from camera_node.drivers.aravis_library import load_aravis
from camera_node.testing import FakeCamera, Studio
from fringedic.errors import CameraError, CameraTimeoutError
from fringedic.frames.clocks import DeviceClock
from fringedic.frames.records import frame_record
from fringedic.settings.camera import AravisCamera, Trigger
from fringedic_msgs.msg import StepStatus
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.qos import EVENTS
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import NodeProcess

pytestmark = pytest.mark.hardware

Result = TypeVar("Result")

EXPOSURE_S = 0.01
SCENE = Scene(0, (), 0.0, exposure_time=EXPOSURE_S)
REGION = {"first_column": 64, "first_row": 32, "width": 640, "height": 480}
SMALL_REGION = REGION | {"width": 320, "height": 240}  # of a stream that loses nothing on a busy computer either
TINY_REGION = REGION | {"width": 64, "height": 64}  # a dozen of these frames fit into the usual receive buffer
ON_THEIR_WAY = 5  # frames that may still have the former pixel format when it changes
NONE = CaptureFrame.Request.NONE
_WHERE_DESCRIPTION = 0x200  # register of GigE Vision: "Local:file;address;size", in hexadecimal digits


@pytest.fixture
def camera() -> Iterator[FakeCamera]:
    """A camera that is plugged in."""
    with FakeCamera() as camera:
        yield camera


@contextmanager
def driver(**changes: object) -> Iterator[AravisDriver]:
    values: dict = {"exposure_ms": 1e3 * EXPOSURE_S, "camera": FakeCamera.address, "timeout_s": 2.5, **REGION}
    opened = AravisDriver(AravisCamera(**{**values, **changes}))
    try:
        yield opened
    finally:
        opened.close()


def assert_complete(image: np.ndarray) -> None:
    """Every pixel is that of the ramp, so no packet is missing."""
    first = image[0].astype(int)
    assert set(np.unique(np.diff(first) % 255)) == {1}, "one grey level per column, 0 follows on 254"
    expected = (first[0] + np.add.outer(np.arange(image.shape[0]), np.arange(image.shape[1]))) % 255
    np.testing.assert_array_equal(image % 255, expected)


def exposed_between(frames: list[Frame]) -> np.ndarray:
    """Return how many frames later each of these was exposed than the one before, up to 254.

    The camera adds one grey level per frame, and 0 follows on 254.
    """
    return np.diff([int(frame.image[0, 0]) for frame in frames]) % 255


def frame_or_message(opened: AravisDriver) -> tuple[Frame | None, str]:
    """Take a frame; without one, return the message of the error."""
    try:
        return opened.expose(SCENE), ""
    except CameraError as error:
        return None, str(error)


def eventually(action: Callable[[], Result]) -> Result:
    """Repeat what needs the camera until it succeeds."""
    deadline = time.monotonic() + 180
    while True:
        try:
            return action()
        except CameraError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


@pytest.mark.usefixtures("camera")
@pytest.mark.parametrize("trigger", [Trigger.SOFTWARE, Trigger.INTERNAL])
def test_frame_begins_after_it_was_asked_for(trigger: Trigger) -> None:
    with driver(trigger=trigger) as opened:
        for _ in range(5):
            asked = time.time_ns()
            frame = opened.expose(SCENE)
            answered = time.time_ns()
            assert frame.image.shape == (480, 640)
            assert_complete(frame.image)
            late_ms = 1e-6 * (frame.stamp_ns - asked)
            # triggered, this camera sends before an exposure could have ended
            earliest_ms = 5.0 if trigger is Trigger.INTERNAL else -5.0
            assert late_ms >= earliest_ms, f"middle of an exposure of 10 ms {late_ms:.1f} ms after it was asked for"
            assert frame.stamp_ns < answered
            time.sleep(0.05)  # a camera of its own clock goes on meanwhile


@pytest.fixture
def own_stamps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Stamps of the camera itself, by this computer's clock as the fake camera is a program on it [ns].

    The first frames arrive late, as on a busy computer.
    """
    stamps: list[int] = []

    class LateAtFirst(DeviceClock):
        def arrival(self, device_ns: int, arrived_ns: int) -> int:
            stamps.append(device_ns)
            return super().arrival(device_ns, arrived_ns + (60_000_000 if len(stamps) <= 5 else 0))

    monkeypatch.setattr(aravis_connection, "DeviceClock", LateAtFirst)
    return stamps


@pytest.mark.usefixtures("camera")
def test_late_frames_of_a_new_stream_do_not_count_as_begun_later(own_stamps: list[int]) -> None:
    exposure_s = 0.03  # of a period of 0.04 s: most requests meet an exposure that is under way
    with driver(trigger=Trigger.INTERNAL, exposure_ms=1e3 * exposure_s) as opened:
        for _ in range(6):
            asked = time.time_ns()
            opened.expose(Scene(0, (), 0.0, exposure_time=exposure_s))
            begun_s = 1e-9 * (own_stamps[-1] - asked) - exposure_s
            assert begun_s > -0.005, f"the exposure began {-1e3 * begun_s:.1f} ms before it was asked for"


@pytest.mark.usefixtures("camera")
def test_each_frame_has_its_exposure_time() -> None:
    with driver() as opened:
        for wanted in (0.01, 0.04, 0.0025, 0.01):
            taken = opened.expose(Scene(0, (), 0.0, exposure_time=wanted)).exposure_time
            assert taken == pytest.approx(wanted, abs=1e-6)
            assert opened.camera.get_exposure_time() == pytest.approx(1e6 * wanted)
        with pytest.raises(CameraError, match=r"100000000 µs is outside 10 to 10000000 µs"):
            opened.expose(Scene(0, (), 0.0, exposure_time=100.0))
        assert opened.expose(SCENE).exposure_time == pytest.approx(0.01)


def expose_those_on_their_way(opened: AravisDriver) -> None:
    for _ in range(ON_THEIR_WAY):
        opened.expose(SCENE)


@pytest.mark.usefixtures("camera")
def test_pixels_of_16_bits_arrive_as_they_are_and_others_are_refused() -> None:
    with driver(pixel_format="Mono16") as opened:
        image = opened.expose(SCENE).image
        assert image.dtype == np.uint16
        along_row, along_column = np.diff(image.astype(int)), np.diff(image.astype(int), axis=0)
        # the same ramp in both directions, but for where it begins again
        assert np.median(along_row) == np.median(along_column) > 0
        opened.camera.set_pixel_format_from_string("Mono8")
        with pytest.raises(CameraError, match="has the pixel format 0x01080001, not Mono16"):
            expose_those_on_their_way(opened)
        opened.camera.set_pixel_format_from_string("Mono16")
        for _ in range(ON_THEIR_WAY):
            with suppress(CameraError):
                opened.expose(SCENE)
        assert opened.expose(SCENE).image.dtype == np.uint16


@pytest.mark.parametrize(("pixel_format", "code"), [("Mono10", 0x01100003), ("Mono12", 0x01100005)])
def test_pixels_of_10_and_12_bits(camera: FakeCamera, tmp_path: Path, pixel_format: str, code: int) -> None:
    """The camera offers them with another description; it has no picture for them, so only their layout is seen."""
    entry = f'<EnumEntry Name="{pixel_format}" NameSpace="Standard"><Value>{code}</Value></EnumEntry>'
    plug_in_with(camera, tmp_path, '<EnumEntry Name="BayerBG8"', entry)
    with driver(pixel_format=pixel_format) as opened:
        image = opened.expose(SCENE).image
    assert image.dtype == np.uint16
    assert image.shape == (480, 640)


def memory(device: Any, address: int, size: int) -> bytes:
    """What the camera's registers hold."""
    words = [device.read_register(address + offset) for offset in range(0, size, 4)]
    return struct.pack(f">{len(words)}I", *words)[:size]


def plug_in_with(camera: FakeCamera, folder: Path, before: str, addition: str) -> None:
    """Plug the camera in again with something added to its description of itself."""
    with driver() as opened:
        device = opened.camera.get_device()
        where = memory(device, _WHERE_DESCRIPTION, 512).split(b"\0")[0].decode()
        _, address, size = where.split(";")
        known = memory(device, int(address, 16), int(size, 16)).decode()
    assert known.count(before) == 1
    description = folder / "camera.xml"
    description.write_text(known.replace(before, addition + before))
    camera.pull()
    camera.plug_in(description=description)


@pytest.mark.usefixtures("camera")
def test_stream_of_a_region_is_counted_and_stamped_by_the_camera(own_stamps: list[int]) -> None:
    """Of the 60 frames/s a busy computer loses some."""
    with driver(**SMALL_REGION) as opened:
        opened.start(60.0)
        frames = [eventually(lambda: opened.expose(SCENE))]
        before = opened.dropped
        while len(frames) < 64:
            with suppress(IncompleteFrameError):
                frames.append(opened.expose(SCENE))
        clock, missing = opened.clock, opened.dropped - before
        assert opened.camera.get_frame_rate() == pytest.approx(60.0, rel=1e-3)
        opened.stop()
        delays_ms = 1e-6 * np.subtract([frame.stamp_ns for frame in frames], own_stamps) + 0.5e3 * EXPOSURE_S
        assert 0 < delays_ms[32:].min() <= delays_ms[32:].max() < 5, "the shortest delay, not that of late frames"
        # from frame to frame the ramp moves by one grey level
        moved = np.median(np.diff([frame.image[0, :] for frame in frames], axis=0), axis=1)
        assert moved.min() >= 1, "none is repeated"
        assert moved.sum() == 63 + missing, "none is missing without being counted"
        assert clock is not None
        assert clock.samples == 4
        assert opened.expose(SCENE).image.shape == (240, 320)


@pytest.mark.usefixtures("camera")
def test_frames_wait_while_the_middleware_keeps_the_publisher_waiting() -> None:
    """Of the 36 frames of this time 20 were lost."""
    with driver(**SMALL_REGION) as opened:
        opened.start(30.0)
        eventually(lambda: opened.expose(SCENE))
        before = opened.dropped
        time.sleep(1.2)
        for _ in range(40):
            with suppress(IncompleteFrameError):
                opened.expose(SCENE)
        assert opened.dropped - before < 10, "a busy computer may lose single ones"
        opened.stop()


_OPENED = f"""
from contextlib import suppress
from camera_node.drivers import Scene
from camera_node.drivers.aravis import AravisDriver, IncompleteFrameError
from fringedic.settings.camera import AravisCamera
scene = Scene(0, (), 0.0, exposure_time={EXPOSURE_S})
settings = AravisCamera(exposure_ms=1e3 * {EXPOSURE_S}, camera="{FakeCamera.address}", timeout_s=6.25, **%s)
opened = AravisDriver(settings)
"""
_ENDLESS = f"""{_OPENED % (SMALL_REGION,)}
while True:
    opened.expose(scene)
    print("frame", flush=True)
"""
_STREAM_OF_40 = f"""{_OPENED % (TINY_REGION,)}
opened.start(30.0)
before = None
for _ in range(40):
    with suppress(IncompleteFrameError):
        opened.expose(scene)
    if before is None:
        before = opened.dropped
        print("frame", flush=True)
print(opened.dropped - before, flush=True)
opened.close()
"""


@pytest.mark.usefixtures("camera")
def test_camera_that_a_killed_process_left_running_sends_to_the_next_one() -> None:
    """A camera releases a lost process after 3 s, and may keep its stream."""
    with subprocess.Popen([sys.executable, "-c", _ENDLESS], stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == "frame\n"
        killed.kill()
    time.sleep(0.8)  # then the camera releases it while the next one connects
    with ExitStack() as closing:
        opened = eventually(lambda: closing.enter_context(driver(**SMALL_REGION)))
        assert_complete(opened.expose(SCENE).image)


@pytest.mark.usefixtures("camera")
def test_rate_that_the_camera_does_not_offer() -> None:
    """The camera itself would take the nearest rate without a word."""
    with driver() as opened:
        opened.expose(Scene(0, (), 0.0, exposure_time=0.1))
        with pytest.raises(CameraError, match="does not offer 2000 frames/s, the nearest rate is 1000; use that"):
            opened.start(2000.0)
        assert opened.camera.get_exposure_time() == pytest.approx(1e6 * EXPOSURE_S), "the longer one limits the rate"
        opened.stop()
        for _ in range(2):
            time.sleep(0.2)  # a stream would go on meanwhile
            asked = time.time_ns()
            assert opened.expose(SCENE).stamp_ns >= asked - 50_000_000


@contextmanager
def busy_network(packet: bytes = b"RTPS\x02\x02\x01\x0f") -> Iterator[None]:
    """Send a packet, by default the header of DDS messages, to another program on this network all the time."""
    ended = threading.Event()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind((FakeCamera.address, 0))

        def send() -> None:
            while not ended.wait(0.0005):
                sender.sendto(packet, receiver.getsockname())

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


@pytest.mark.usefixtures("camera")
def test_packets_of_other_programs_are_not_those_of_the_camera() -> None:
    """When another test connects with TCP in this moment, its packet may be the first one of a stream.

    It has the number 65 495, the largest segment on the loopback, where those of a camera have the number of the frame.
    The frames up to it are ignored, and that is reported.
    """
    streams, errors = 0, []
    with busy_network():
        while streams < 5:
            assert len(errors) < 5
            with driver(**SMALL_REGION) as opened:
                opened.start(60.0)
                try:
                    images = [opened.expose(SCENE).image for _ in range(3)]
                except IncompleteFrameError as error:
                    errors.append(str(error))
                    continue
                streams += 1
                for image in images:
                    assert_complete(image)
                assert opened.dropped == 0
                assert not any(opened.counts.values()), opened.counts
    assert all("ignored a frame as an old one" in error for error in errors)


@pytest.mark.usefixtures("camera")
def test_receiver_gets_its_buffers_when_it_has_read_the_packets_of_other_programs() -> None:
    """A late one took them for frames and counted these as lost. The late one is a thread of its name that computes."""
    named = threading.Event()

    def compute() -> None:
        Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text("arv_gv_stream")
        named.set()
        hashlib.pbkdf2_hmac("sha256", b"", b"", 5_000_000)

    receiver = threading.Thread(target=compute)
    receiver.start()
    assert named.wait(60)
    with driver(**SMALL_REGION):
        receiver.join(0.5)  # of some seconds, if it were not waited for
        assert not receiver.is_alive()


@pytest.mark.usefixtures("camera")
def test_socket_stores_frames_while_the_driver_stands_still() -> None:
    """Without the right to read packets of the network card; the buffer of Aravis itself is as large as one frame."""
    as_user = ["setpriv", "--bounding-set=-net_raw", "--inh-caps=-net_raw"] if os.geteuid() == 0 else []
    command = [*as_user, sys.executable, "-c", _STREAM_OF_40]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "frame\n"
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.4)
            process.send_signal(signal.SIGCONT)
            assert int(process.stdout.readline()) < 4, "a busy computer may lose single ones"
        finally:
            process.kill()


@pytest.mark.usefixtures("camera")
def test_frames_behind_those_of_another_camera_are_not_old() -> None:
    """Another camera on this network sends its frame 65 450 while the stream is opened; this one begins at 65 400."""
    packet = struct.pack(">HHI", 0, 65_450, 3 << 24 | 5) + bytes(20)
    with ExitStack() as closing:
        with busy_network(packet):
            opened = closing.enter_context(driver(**SMALL_REGION, timeout_s=0.625))
        for _ in range(3):
            assert_complete(opened.expose(SCENE).image)
        assert opened.dropped <= 1
        assert not any(opened.counts.values()), opened.counts


@pytest.mark.usefixtures("camera")
def test_ignored_frames_of_a_stream_are_counted_once() -> None:
    with driver(**SMALL_REGION) as opened:
        opened.start(20.0)
        frames = [eventually(lambda: opened.expose(SCENE))]
        before = opened.dropped
        connection = opened._connection  # noqa: SLF001 (only a restart in the stream lets it ignore frames of the stream)
        assert connection is not None
        ignored = False
        while not ignored:  # a receiver that begins to read late has its filter already
            assert len(frames) < 20
            assert connection.last_frame is not None
            later = (connection.last_frame + 89) % 65_535 + 1  # by 90; 1 follows on 65 535
            with busy_network(struct.pack(">HHI", 0, later, 3 << 24 | 5) + bytes(20)):
                connection.restart_receiver(load_aravis())
            try:
                frames.append(opened.expose(SCENE))
            except IncompleteFrameError as error:
                ignored = "ignored a frame as an old one" in str(error)
        frames.append(eventually(lambda: opened.expose(SCENE)))
        assert opened.dropped - before == exposed_between(frames).sum() - (len(frames) - 1) > 10


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": "127.0.0.9"}, "camera: "),
        ({"pixel_format": "Mono12"}, "no pixel format Mono12; it has .*Mono8"),
        ({"exposure_ms": 60e3}, "exposure time: .* is outside"),
        ({"gain_db": 90.0}, "gain: 90 dB is outside 0 to 10 dB"),
        ({"first_column": 0, "first_row": 0, "width": 5000}, "leaves the sensor of 2048x2048 px"),
        ({"trigger": Trigger.EXTERNAL_EDGE, "trigger_line": "Line7"}, "trigger: .*Line7"),
    ],
)
@pytest.mark.usefixtures("camera")
def test_setting_that_the_camera_does_not_have(changes: dict, words: str) -> None:
    with pytest.raises(CameraError, match=words), driver(**changes):
        pass


def test_lost_packets_are_counted_and_their_frames_taken_again(camera: FakeCamera) -> None:
    camera.pull()
    camera.plug_in(lost_per_thousand=2)
    with driver(packet_size_byte=1500) as opened:
        failures = 0
        taken = 0
        while opened.dropped < 5 or taken < 5:
            frame, message = frame_or_message(opened)
            if frame is None:
                assert "is incomplete (" in message
                assert "3 attempts" in message
                failures += 1
            else:
                assert_complete(frame.image)
                taken += 1
        assert opened.counts["packets_lost"] >= opened.dropped
        assert opened.counts["frames_incomplete"] == opened.dropped >= 3 * failures
        camera.pull()
        camera.plug_in()
        assert_complete(eventually(lambda: opened.expose(SCENE)).image)


def test_lost_frames_of_a_stream_are_counted_without_their_first_packets_and_across_the_largest_number(
    camera: FakeCamera,
) -> None:
    """The camera begins at 65 400, and 1 follows on 65 535. A frame whose first packet is lost has no number."""
    camera.pull()
    camera.plug_in(lost_per_thousand=100)
    with driver(**SMALL_REGION, packet_size_byte=8000) as opened:
        opened.start(30.0)
        frames = [eventually(lambda: opened.expose(SCENE))]
        before = opened.dropped
        while len(frames) < 64:  # of about 230
            with suppress(IncompleteFrameError):
                frames.append(opened.expose(SCENE))
        distances = exposed_between(frames)
        assert distances.min() >= 1, "none is repeated"
        assert distances.sum() == 63 + opened.dropped - before, (distances, opened.counts)


def test_nothing_gets_through(camera: FakeCamera) -> None:
    camera.pull()
    camera.plug_in(lost_per_thousand=1000)
    with (
        driver(timeout_s=0.625) as opened,
        pytest.raises(CameraTimeoutError, match="sends nothing: check the network's"),
    ):
        opened.expose(SCENE)


@pytest.mark.usefixtures("camera")
def test_automatic_gain_is_switched_off_and_refused_when_it_comes_on() -> None:
    with driver() as opened:
        device = opened.camera
        assert device.get_string("GainAuto") == "Off"
        device.set_string("GainAuto", "Continuous")
        with pytest.raises(CameraError, match="automatic gain is on, so grey levels"):
            opened.expose(SCENE)
        device.set_string("GainAuto", "Off")
        opened.expose(SCENE)


def test_automatic_exposure_that_cannot_be_switched_off(camera: FakeCamera, tmp_path: Path) -> None:
    plug_in_with(
        camera,
        tmp_path,
        '<Enumeration Name="GainAuto"',
        '<Enumeration Name="ExposureAuto" NameSpace="Standard">'
        '<EnumEntry Name="Continuous" NameSpace="Standard"><Value>2</Value></EnumEntry>'
        "<pValue>GainAutoRegister</pValue></Enumeration>",
    )
    with pytest.raises(CameraError, match="automatic exposure: "), driver():
        pass


EXPOSURE_MODE = """
<Enumeration Name="ExposureMode" NameSpace="Standard">
<EnumEntry Name="Timed" NameSpace="Standard"><Value>0</Value></EnumEntry>
<EnumEntry Name="TriggerWidth" NameSpace="Standard"><Value>1</Value></EnumEntry>
<pValue>ExposureModeRegister</pValue></Enumeration>
<IntReg Name="ExposureModeRegister" NameSpace="Custom"><Address>0x13c</Address><Length>4</Length>
<AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
"""
LEVEL_HIGH = '<EnumEntry Name="LevelHigh" NameSpace="Standard"><Value>1</Value></EnumEntry>'


def test_exposures_of_the_trigger_level_end_with_this_trigger(camera: FakeCamera, tmp_path: Path) -> None:
    plug_in_with(camera, tmp_path, "<pValue>TriggerActivationRegister</pValue>", LEVEL_HIGH)
    plug_in_with(camera, tmp_path, '<Enumeration Name="GainAuto"', EXPOSURE_MODE)
    with driver(trigger=Trigger.EXTERNAL_LEVEL, trigger_line="Line0", timeout_s=0.625) as opened:
        assert opened.camera.get_string("ExposureMode") == "TriggerWidth"
        with pytest.raises(CameraError, match=r"20 ms is requested; .* as long as the level, 10 ms: use one exposure"):
            opened.expose(Scene(0, (), 0.0, exposure_time=0.02))
        opened.start(30.0)
        assert opened.camera.get_string("ExposureMode") == "Timed", "a stream has no level"
        opened.stop()
        assert opened.camera.get_string("ExposureMode") == "TriggerWidth"
    with driver() as opened:
        assert opened.camera.get_string("ExposureMode") == "Timed"


PARAMETERS = {"source": "aravis", "camera": FakeCamera.address, "width": 640, "height": 480, "timeout_s": 5.0}


def test_node_loses_its_camera_in_the_middle_of_a_stack(camera: FakeCamera, studio: Studio, tmp_path: Path) -> None:
    with NodeProcess("camera_node.camera_node", tmp_path, PARAMETERS):
        response = studio.capture(0, exposure_time=0.02)
        assert response.error_code == NONE, response.error_message
        assert studio.frame(response.stamp)[2].exposure_time == pytest.approx(0.02, abs=1e-6)
        camera.pull()
        lost = studio.capture(1)
        assert lost.error_code == CaptureFrame.Request.CAMERA_FAILED
        assert "check its cable and power" in lost.error_message
        camera.plug_in()
        studio.wait(lambda: studio.capture(1).error_code == NONE, "the camera again")
        studio.wait(lambda: len(studio.images) == 2, "two images in all")


@contextmanager
def lost_in_a_step(camera: FakeCamera, studio: Studio, folder: Path) -> Iterator[Publisher]:
    """A node with a free run, whose camera was lost in a step and is present again; the publisher of the stages."""
    parameters = {**PARAMETERS, **SMALL_REGION, "frame_rate_hz": 30.0}
    with NodeProcess("camera_node.camera_node", folder, parameters):
        steps = studio.create_publisher(StepStatus, "experiment/step", EVENTS)
        studio.wait(steps.get_subscription_count, "the camera to receive stages")
        assert studio.capture(0).error_code == NONE
        camera.pull()
        assert studio.capture(1).error_code == CaptureFrame.Request.CAMERA_FAILED
        steps.publish(StepStatus(stage=StepStatus.ERROR))
        studio.serve(0.3)  # the free run cannot continue
        studio.forget()
        camera.plug_in()
        yield steps


def test_steps_after_a_lost_camera_get_no_frames_of_the_free_run(
    camera: FakeCamera, studio: Studio, tmp_path: Path
) -> None:
    with lost_in_a_step(camera, studio, tmp_path) as steps:
        studio.wait(lambda: studio.capture(0).error_code == NONE, "the camera again")
        for index in (1, 2):
            studio.serve(0.5)  # a stream would go on meanwhile
            asked = time.time_ns()
            response = studio.capture(index)
            assert response.error_code == NONE, response.error_message
            late_ms = 1e-6 * (to_nanoseconds(response.stamp) - asked)
            assert late_ms >= -50, f"frame {index} is from {-late_ms:.0f} ms before its request"
        studio.forget()
        steps.publish(StepStatus(stage=StepStatus.PROCESS))
        studio.wait(lambda: len(studio.exposures) >= 3, "the free run again")


def test_free_run_continues_by_itself_when_the_camera_is_present_again(
    camera: FakeCamera, studio: Studio, tmp_path: Path
) -> None:
    with lost_in_a_step(camera, studio, tmp_path):
        studio.wait(lambda: len(studio.exposures) >= 3, "the free run again", timeout_s=60.0)


@pytest.mark.usefixtures("camera")
def test_node_streams_at_30_hz_and_publishes_its_clock(studio: Studio, tmp_path: Path) -> None:
    parameters = {**PARAMETERS, **SMALL_REGION, "frame_rate_hz": 30.0}
    with NodeProcess("camera_node.camera_node", tmp_path, parameters):
        studio.wait(lambda: len(studio.exposures) >= 60 and studio.clocks, "60 frames")
    records = [frame_record(exposure) for exposure in studio.exposures]
    indices = [record.index for record in records]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert records[-1].dropped == 0
    # most frames, because a busy computer delays single ones of the fake camera
    assert np.median(np.diff([record.stamp for record in records])) == pytest.approx(1e9 / 30, rel=0.1)
    assert image_array(studio.images[0]).shape == (240, 320)
    assert studio.clocks[-1].clock == "camera"
