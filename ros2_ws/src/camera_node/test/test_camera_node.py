"""The camera node in a process of its own: what it publishes, and that every fault leaves it able to go on."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray as xr
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from sensor_msgs.msg import Image

from camera_node import testing
from fringedic.camera import DistortionMap
from fringedic.frames.records import frame_record
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import Exposure, LoadState, RigCalibration, StepStatus
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array, image_message
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED, STATE
from fringedic_ros.records import calibration_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer

MODULE = "camera_node.camera_node"
JUMPING_CLOCK = Path(__file__).parents[4] / "tests" / "jumping_clock"  # back by 60 s at SIGUSR1
Request = CaptureFrame.Request
FRINGES = {"kind": int(PatternKind.FRINGES), "pitch": 25.0, "shift": 2, "shifts": 4}


class Studio(testing.Studio):
    """Plays experiment, projector and load frame for one camera."""

    def __init__(self) -> None:
        super().__init__()
        self.position = 0.0
        self._loaded = Time()  # of the latest sample

    def capture(self, index: int = 0, count: int = 100, **fields: Any) -> CaptureFrame.Response:
        return super().capture(index, count, **{"loaded": self._loaded, **fields})

    def add_projector(self) -> None:
        self._patterns = self.create_publisher(Image, "projector/image", LATCHED)

    def add_load_frame(self) -> None:
        self._loads = self.create_publisher(LoadState, "load_frame/state", STATE)
        self._samples = self.create_timer(0.01, self._tell_load)
        self._tell_load()

    def begin_load_frame(self, later_s: float) -> None:
        """Publish the first sample some time [s] later than requests of frames begin to name it."""
        self._loaded = self.get_clock().now().to_msg()

        def begin() -> None:
            timer.cancel()
            self.add_load_frame()

        timer = self.create_timer(later_s, begin)

    def end_load_frame(self, later_s: float) -> None:
        """Publish a last sample, which all subscribers acknowledge, and end a time [s] after it."""
        self.destroy_timer(self._samples)
        self._tell_load()
        assert self._loads.wait_for_all_acked(Duration(seconds=180))
        self._end = self.create_timer(later_s, self._leave)

    def _leave(self) -> None:
        self.destroy_timer(self._end)
        self.destroy_publisher(self._loads)

    def _tell_load(self) -> None:
        state = LoadState(mode=LoadState.HOLD, position=self.position)
        state.header.stamp = self._loaded = self.get_clock().now().to_msg()
        self._loads.publish(state)

    def show(self, pattern: np.ndarray) -> Time:
        shown = self.get_clock().now().nanoseconds
        self._patterns.publish(image_message(pattern, stamp_ns=shown, frame_id="projector_optical_frame"))
        return to_msg(shown)


def save(folder: Path, name: str, image: np.ndarray) -> None:
    assert cv2.imwrite(str(folder / name), image)


def test_camera_info_tells_of_the_lens_once_calibrated(studio: Studio, tmp_path: Path) -> None:
    # U = c r^2 (x, y) from the image's centre, 1 px at its corner: a cubic barrel in Chebyshev polynomials
    half_width, half_height = 79.5, 59.5
    c = 1 / np.hypot(half_width, half_height) ** 3
    columns, rows = np.zeros((4, 4)), np.zeros((4, 4))
    columns[0, [1, 3]] = c * half_width**3 * np.array([0.75, 0.25])
    columns[[0, 2], 1] += c * half_width * half_height**2 * 0.5
    rows[[1, 3], 0] = c * half_height**3 * np.array([0.75, 0.25])
    rows[1, [0, 2]] += c * half_height * half_width**2 * 0.5
    rig = RigModel(
        **VirtualRig.from_preset("plate", size="tiny").optics(),
        camera_distortion=DistortionMap(160, 120, columns, rows),
    )
    assert np.hypot(*(np.array(rig.camera_distortion.ideal(159.0, 119.0)) - [159, 119])) == pytest.approx(1.0)
    publisher = studio.create_publisher(RigCalibration, "calibration", LATCHED)
    with NodeProcess(MODULE, tmp_path, {"virtual_rig": '"{preset: plate, size: tiny}"'}):
        before = studio.frame(studio.capture().stamp)[1]
        assert list(before.k) == [0.0] * 9
        publisher.publish(calibration_message(rig, stamp_ns=1, frame_id="reference_plane"))
        deadline = time.monotonic() + 180
        after = before
        while not any(after.k) and time.monotonic() < deadline:
            after = studio.frame(studio.capture().stamp)[1]
    assert after.distortion_model == "plumb_bob"
    focal = rig.camera_distance / rig.pixel_size
    assert after.p[0] == pytest.approx(focal * rig.pixel_aspect)
    # what the image shows at (159, 40) belongs to the pixel p_u of the undistorted image
    seen = np.array([[[159.0, 40.0]]])
    pattern = np.array(after.p).reshape(3, 4)[:, :3]
    ideal = cv2.undistortPoints(seen, np.array(after.k).reshape(3, 3), np.array(after.d), None, np.eye(3), pattern)
    expected = rig.camera_distortion.ideal(159.0, 40.0)
    assert ideal.ravel() == pytest.approx(np.ravel(expected), abs=0.005)


def test_virtual_frames_are_those_of_the_twin(studio: Studio, tmp_path: Path) -> None:
    """Same pattern, position and frame number give the same image; the truth of each step is written."""
    rig = VirtualRig.from_preset("plate", size="tiny")
    rows, columns = rig.projector_shape
    truth_folder = tmp_path / "truth"
    parameters = {
        "virtual_rig": '"{preset: plate, size: tiny}"',
        "truth_folder": str(truth_folder),
        "exposure_ms": 20.0,
        "settle_ms": 50.0,
    }
    projection = ProjectedPattern(PatternKind.FRINGES, pitch=25.0, shift=2, shifts=4)
    patterns = [
        render_pattern(projection, columns, rows),
        render_pattern(ProjectedPattern(PatternKind.WHITE), columns, rows),
    ]
    studio.add_projector()
    studio.add_load_frame()
    steps = [(0, 0.1e-3), (1, 0.4e-3), (3, 0.3e-3)]  # step 2 was given up before its last frame
    with NodeProcess(MODULE, tmp_path, parameters):
        number, last_stamp = 0, 0
        for step, position in steps:
            studio.position = position
            for index, pattern in enumerate(patterns):
                shown = studio.show(pattern)
                kind = FRINGES if index == 0 else {"kind": int(PatternKind.WHITE)}
                response = studio.capture(index, len(patterns), step=step, shown=shown, **kind)
                assert response.error_code == Request.NONE, response.error_message
                image, info, exposure = studio.frame(response.stamp)
                np.testing.assert_array_equal(image_array(image), rig.expose(pattern, position, number))
                assert (info.header, info.width, info.height) == (image.header, 160, 120)
                assert image.header.frame_id == "camera_optical_frame"
                record = frame_record(exposure)
                assert (record.experiment, record.step, record.index, record.count) == ("test", step, index, 2)
                assert record.exposure_time == 0.02
                assert index == 1 or record.pattern == projection
                assert record.stamp > last_stamp
                assert record.stamp >= to_nanoseconds(shown) + 60_000_000  # settled, then half the exposure
                last_stamp, number = record.stamp, number + 1
        # beyond the machine's range there is no specimen to see
        studio.position = 5e-3
        response = studio.capture(0, 2, step=4)
        assert response.error_code == Request.CAMERA_FAILED
        assert "5 mm is outside" in response.error_message
    with xr.open_dataset(truth_folder / "truth.nc", engine="h5netcdf") as truth:
        assert truth.sizes["step"] == 4
        np.testing.assert_allclose(truth.position, [0.1e-3, 0.4e-3, np.nan, 0.3e-3])
        for step, position in steps:
            exact = rig.truth(position, 0.1e-3)
            for name in exact.data_vars:
                written = truth[name].isel(step=step) if "step" in truth[name].dims else truth[name]
                expected = exact[name].values
                written_as = expected.astype(np.float32) if expected.dtype == float else expected
                np.testing.assert_array_equal(written.values, written_as, err_msg=f"{name} of step {step}")
        assert np.isnan(truth.u.isel(step=2)).all()
        assert not truth.valid.isel(step=2).any()


def test_a_load_frame_is_awaited_that_the_camera_has_not_discovered_yet(studio: Studio, tmp_path: Path) -> None:
    """The first frames of a step showed the specimen at rest, the others at its position."""
    rig = VirtualRig.from_preset("plate", size="tiny")
    white = render_pattern(ProjectedPattern(PatternKind.WHITE), *reversed(rig.projector_shape))
    studio.add_projector()
    studio.position = 0.4e-3
    with NodeProcess(MODULE, tmp_path, {"virtual_rig": '"{preset: plate, size: tiny}"'}):
        assert studio.capture(0, 2, kind=int(PatternKind.WHITE)).error_code == Request.NONE  # it is ready
        studio.begin_load_frame(later_s=1.0)
        shown = studio.show(white)
        response = studio.capture(1, 2, shown=shown, kind=int(PatternKind.WHITE))
        assert response.error_code == Request.NONE, response.error_message
        image = image_array(studio.frame(response.stamp)[0])
        np.testing.assert_array_equal(image, rig.expose(white, 0.4e-3, 1))


@pytest.mark.parametrize("later_s", [0.0, 1.0], ids=["before the exposure", "while its sample is awaited"])
def test_a_load_frame_that_has_ended_leaves_its_last_position(studio: Studio, tmp_path: Path, later_s: float) -> None:
    rig = VirtualRig.from_preset("plate", size="tiny")
    white = render_pattern(ProjectedPattern(PatternKind.WHITE), *reversed(rig.projector_shape))
    studio.add_projector()
    studio.add_load_frame()
    with NodeProcess(MODULE, tmp_path, {"virtual_rig": '"{preset: plate, size: tiny}"'}):
        for number, position in enumerate((0.1e-3, 0.4e-3)):
            studio.position = position
            if number:
                studio.end_load_frame(later_s)
            shown = studio.show(white)
            response = studio.capture(0, 1, step=number, shown=shown, kind=int(PatternKind.WHITE))
            assert response.error_code == Request.NONE, response.error_message
            image = image_array(studio.frame(response.stamp)[0])
            np.testing.assert_array_equal(image, rig.expose(white, position, number))


def test_pattern_that_never_comes_and_then_the_next(studio: Studio, tmp_path: Path) -> None:
    studio.add_projector()
    white = np.full((75, 100), 250, np.uint8)
    with NodeProcess(MODULE, tmp_path, {"virtual_rig": '"{preset: plate, size: tiny}"', "timeout_s": 3.0}):
        announced = to_msg(studio.get_clock().now().nanoseconds + 10**9)
        response = studio.capture(3, shown=announced)
        assert response.error_code == Request.CAMERA_TIMEOUT
        assert "frame 3: the pattern shown at" in response.error_message
        shown = studio.show(white)
        assert studio.capture(3, shown=shown).error_code == Request.NONE
        studio.show(white)
        response = studio.capture(4, shown=shown)
        assert response.error_code == Request.CAMERA_FAILED
        assert "another pattern" in response.error_message
        assert studio.capture(4, kind=9).error_code == Request.CAMERA_FAILED
        assert studio.capture(4).error_code == Request.NONE


def test_files_with_faults_and_what_comes_after(studio: Studio, tmp_path: Path) -> None:
    """Unreadable, hanging, of another size and 16 bits: each is told, and the next capture works."""
    folder = tmp_path / "images"
    folder.mkdir()
    pictures = {n: np.random.default_rng(n).integers(0, 255, (6, 8), np.uint8) for n in (0, 3)}
    save(folder, "0.png", pictures[0])
    (folder / "1.png").write_bytes(b"no picture")
    os.mkfifo(folder / "2.png")  # a camera that does not answer: reading waits for a writer
    save(folder, "3.png", pictures[3])
    save(folder, "4.tif", np.full((3, 4), 60000, np.uint16))
    parameters = {"source": "files", "files": str(folder), "timeout_s": 3.0}
    with NodeProcess(MODULE, tmp_path, parameters):
        first = studio.capture(0)
        np.testing.assert_array_equal(image_array(studio.frame(first.stamp)[0]), pictures[0])
        unreadable = studio.capture(1)
        assert unreadable.error_code == Request.CAMERA_FAILED
        assert "1.png is not an image" in unreadable.error_message
        hanging = studio.capture(2)
        assert hanging.error_code == Request.CAMERA_TIMEOUT
        assert "the frame did not come within 3.01 s" in hanging.error_message
        third = studio.capture(3)
        np.testing.assert_array_equal(image_array(studio.frame(third.stamp)[0]), pictures[3])
        heard = [studio.count_subscribers(name) for name in ("load_frame/state", "projector/image", "experiment/step")]
        assert heard == [0, 0, 1], "a camera that sees the scene itself is not told what is in it"
        image = studio.frame(studio.capture(4).stamp)[0]
        assert (image.encoding, image.width, image.height, image_array(image)[0, 0]) == ("mono16", 4, 3, 60000)
        assert "all 5 images" in studio.capture(5).error_message
        assert len(studio.images) == 3


def test_waits_for_subscribers(studio: Studio, tmp_path: Path) -> None:
    save(tmp_path, "0.png", np.zeros((4, 4), np.uint8))
    with NodeProcess(MODULE, tmp_path, {"source": "files", "files": str(tmp_path), "timeout_s": 600.0}):
        response = studio.capture(image_subscribers=2)
        assert (response.error_code, response.subscribers) == (Request.NO_SUBSCRIBER, 1)
        assert "camera/image_raw has 1 subscribers and 2 are expected" in response.error_message
        response = studio.capture(exposure_subscribers=2)
        assert response.error_code == Request.NO_SUBSCRIBER
        assert "camera/exposure has 1 and 2 are expected" in response.error_message
        other = Peer("other")
        other.listen(Image, "camera/image_raw", IMAGES)
        other.listen(Exposure, "camera/exposure", IMAGES)
        response = studio.capture(image_subscribers=2, exposure_subscribers=2)
        assert (response.error_code, response.subscribers) == (Request.NONE, 2)
        other.destroy_node()


def test_viewers_of_images_alone_hold_nothing_up(studio: Studio, tmp_path: Path) -> None:
    save(tmp_path, "0.png", np.zeros((4, 4), np.uint8))
    with NodeProcess(MODULE, tmp_path, {"source": "files", "files": str(tmp_path), "timeout_s": 2.0}):
        viewers = [Peer(f"viewer_{number}") for number in range(2)]
        for viewer in viewers:
            viewer.listen(Image, "camera/image_raw", IMAGES)
        response = studio.capture(image_subscribers=3)
        assert (response.error_code, response.subscribers) == (Request.NONE, 1), response.error_message
        studio.frame(response.stamp)
        for viewer in viewers:
            viewer.destroy_node()


def test_free_run_counts_every_frame(studio: Studio, tmp_path: Path) -> None:
    for name in range(3):
        save(tmp_path, f"{name}.tif", np.full((40, 60), name, np.uint8))
    settle_s = 0.3
    parameters = {"source": "files", "files": str(tmp_path), "repeat": "true", "frame_rate_hz": 50}
    with NodeProcess(MODULE, tmp_path, {**parameters, "settle_ms": 1e3 * settle_s}):
        studio.wait(lambda: studio.exposures, "a frame of the free run")
        studio.forget()
        studio.wait(lambda: len(studio.exposures) >= 50, "frames of the free run")
        records = [frame_record(exposure) for exposure in studio.exposures]
        assert [record.index for record in records] == list(range(records[0].index, records[0].index + len(records)))
        assert {record.experiment for record in records} == {""}
        stamps = np.array([record.stamp for record in records])
        assert (np.diff(stamps) > 0).all()
        steps = studio.create_publisher(StepStatus, "experiment/step", EVENTS)
        studio.wait(steps.get_subscription_count, "the camera to hear of steps")
        asked = [studio.capture(index, 2) for index in range(2)]
        assert [response.error_code for response in asked] == [Request.NONE] * 2, "a step pauses the free run"
        _, _, last = studio.frame(asked[-1].stamp)
        studio.serve(0.5)
        assert studio.exposures[-1] is last, "until its frames are taken"
        studio.forget()
        process_ns = time.time_ns()
        steps.publish(StepStatus(experiment="test", stage=StepStatus.PROCESS))
        studio.wait(lambda: len(studio.exposures) >= 3, "frames after the step")
        assert [frame_record(exposure).experiment for exposure in studio.exposures[:3]] == [""] * 3
        assert studio.exposures[0].index > records[-1].index, "the count goes on"
        after_s = 1e-9 * (frame_record(studio.exposures[0]).stamp - process_ns)
        assert after_s >= settle_s, f"{after_s:.3f} s after the step, while the projector may show its last pattern"


def test_stopped_process_goes_on(studio: Studio, tmp_path: Path) -> None:
    """A camera process that is stopped answers when it continues; nothing is published twice."""
    for name in range(2):
        save(tmp_path, f"{name}.png", np.full((4, 4), name, np.uint8))
    with NodeProcess(MODULE, tmp_path, {"source": "files", "files": str(tmp_path)}) as node:
        studio.capture(0)
        node.process.send_signal(signal.SIGSTOP)
        future = studio.capture_client.call_async(Request(experiment="test", index=1, count=2))
        studio.serve(0.5)
        assert not future.done()
        node.process.send_signal(signal.SIGCONT)
        studio.wait(future.done, "the late answer")
        assert future.result().error_code == Request.NONE
        studio.frame(future.result().stamp)
        assert len(studio.images) == 2


# starts one node after the other, each in a process of its own that has loaded already what a node needs
STARTS = """
import json, os, sys
from camera_node.camera_node import main
for line in sys.stdin:
    sys.argv = ["camera", "--ros-args", *(word for each in json.loads(line) for word in ("-p", each))]
    if not os.fork():
        print(f"code {main()}", flush=True)
        os._exit(0)
    os.wait()
"""


def test_bad_parameters_end_the_start_in_words() -> None:
    refused: list[tuple[list[str], str]] = [
        (["source:=files"], "camera: value error, source: files needs the key files, the images that it reads"),
        (["source:=files", "files:=/nowhere"], "camera cannot configure: /nowhere: no such image or folder"),
        (["source:=v4l2", "camera:=/dev/video97"], "camera cannot configure: there is no device /dev/video97"),
        (["source:=topic", "topic:=camera/image_raw"], "/camera/image_raw is a topic of this node itself"),
        (["exposure_ms:=.nan"], "camera.exposure_ms = nan: must be a finite number"),
        (['virtual_rig:="{preset: tent}"'], "tent"),
    ]
    run = subprocess.run(
        [sys.executable, "-c", STARTS],
        input="".join(json.dumps(parameters) + "\n" for parameters, _ in refused),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    logs = run.stdout.split("code ")
    assert [log[:1] for log in logs[1:]] == ["1"] * len(refused), run.stdout
    for log, (_, words) in zip(logs, refused, strict=False):
        assert words in log
        assert "Traceback" not in log


def test_clock_that_is_set_back(studio: Studio, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The frame after it fails by name, the ones after that are in order again; `/clock` changes nothing."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(JUMPING_CLOCK), os.environ.get("PYTHONPATH", "")]))
    parameters = {"virtual_rig": '"{preset: plate, size: tiny}"', "use_sim_time": "true"}
    with NodeProcess(MODULE, tmp_path, parameters) as camera:
        studio.wait(lambda: studio.capture().error_code == Request.NONE, "the first frame", 200.0)
        camera.process.send_signal(signal.SIGUSR1)
        responses = []
        studio.wait(lambda: responses.append(studio.capture()) or responses[-1].error_code, "the error")
        assert responses[-1].error_code == Request.CAMERA_FAILED
        assert re.search("the clock jumped back by (59|60)", responses[-1].error_message)
        response = studio.capture()
        assert response.error_code == Request.NONE, response.error_message
        assert abs(response.stamp.sec + 60 - time.time()) < 30
