"""For tests of cameras: a client that requests frames, and a GigE Vision camera on the loopback."""

from __future__ import annotations

import fcntl
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, Image

from fringedic_msgs.msg import ClockDrift, Exposure
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.qos import IMAGES, LATCHED
from fringedic_ros.testing import Peer

_LOCK = Path(tempfile.gettempdir()) / "fringedic-gige-camera.lock"
_PORT = 3956  # of the control protocol, the same for every camera: only one can run at a time


class Studio(Peer):
    """Requests frames from a camera node and collects its messages."""

    def __init__(self) -> None:
        super().__init__()
        self.images = self.listen(Image, "camera/image_raw", IMAGES)
        self.infos = self.listen(CameraInfo, "camera/camera_info", IMAGES)
        self.exposures = self.listen(Exposure, "camera/exposure", IMAGES)
        self.clocks = self.listen(ClockDrift, "camera/clock", LATCHED)
        self.capture_client = self.create_client(CaptureFrame, "camera/capture")

    def capture(self, index: int = 0, count: int = 100, **fields: Any) -> CaptureFrame.Response:
        """Request one frame and wait for the response."""
        self.ask(self.capture_client, CaptureFrame.Request(count=0), "the camera node")  # takes no frame
        expected = {"image_subscribers": 1, "exposure_subscribers": 1}
        request = CaptureFrame.Request(**{"experiment": "test", "index": index, "count": count, **expected, **fields})
        future = self.capture_client.call_async(request)
        self.wait(future.done, "the camera's answer")
        return future.result()

    def frame(self, stamp: Time) -> tuple[Image, CameraInfo, Exposure]:
        """Return the three messages that were published with a stamp."""

        def with_stamp() -> list[tuple[Image, CameraInfo, Exposure]]:
            found = [
                [m for m in heard if m.header.stamp == stamp] for heard in (self.images, self.infos, self.exposures)
            ]
            return list(zip(*found, strict=False))

        self.wait(with_stamp, "the three messages of a frame")
        assert len(with_stamp()) == 1
        return with_stamp()[0]


class FakeCamera:
    """The fake GigE Vision camera of Aravis as a process, plugged in from entering to leaving the `with` block.

    Only one test at a time on this computer can use it.
    """

    address = "127.0.0.1"

    def __enter__(self) -> Self:
        self._lock = _LOCK.open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        self._process: subprocess.Popen[bytes] | None = None
        try:
            self.plug_in()
        except BaseException:
            self._lock.close()  # the next test must not wait for a camera that did not start
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.pull()
        self._lock.close()

    def plug_in(self, *, lost_per_thousand: int = 0, description: Path | None = None) -> None:
        """Start the camera, with a share of lost packets, or with another GenICam description."""
        command = ["arv-fake-gv-camera-0.8", "-i", self.address, "-r", str(lost_per_thousand)]
        if description is not None:
            command += ["-g", str(description)]
        assert not _port_is_open(), "another camera listens on this computer; end it"
        self._process = subprocess.Popen(command)
        deadline = time.monotonic() + 30
        while not _port_is_open():
            assert self._process.poll() is None, "the fake camera ended"
            assert time.monotonic() < deadline, "the fake camera does not listen"
            time.sleep(0.01)

    def pull(self) -> None:
        """Remove the camera as a pulled cable would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def _port_is_open() -> bool:
    sockets = Path("/proc/net/udp").read_text().splitlines()[1:]
    return any(int(line.split()[1].split(":")[1], 16) == _PORT for line in sockets)
