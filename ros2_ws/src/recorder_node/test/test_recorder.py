"""The recorder node: recorded messages, counts and faults."""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Image

from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.recording.reader import BagReader
from fringedic_msgs.msg import Exposure, LoadState, NodeStatus, RecorderStatus, RigCalibration, StepStatus
from fringedic_ros.images import image_message
from fringedic_ros.qos import DIAGNOSTICS, EVENTS, IMAGES, LATCHED, STATE
from fringedic_ros.records import exposure_message
from fringedic_ros.testing import NodeProcess, Peer
from recorder_node.exposure_tally import ExposureTally
from recorder_node.step_tally import StepTally


class Rig(Peer):
    """Publishes the topics of a rig."""

    def __init__(self) -> None:
        super().__init__("rig")
        self.images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self.exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self.steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        self.load = self.create_publisher(LoadState, "load_frame/state", STATE)
        self.phase = self.create_publisher(NodeStatus, "phase/status", EVENTS)
        self.calibration = self.create_publisher(RigCalibration, "calibration", LATCHED)
        self.calibration.publish(RigCalibration(identifier="before the recorder"))
        self.diagnostics: list[DiagnosticArray] = self.listen(DiagnosticArray, "/diagnostics", DIAGNOSTICS)
        self.statuses: list[RecorderStatus] = self.listen(RecorderStatus, "recorder/status", LATCHED)

    def connect(self) -> None:
        self.wait(lambda: self.state == RecorderStatus.RECORDING, "recording")
        for publisher in (self.images, self.exposures, self.steps, self.load):
            self.wait(publisher.get_subscription_count, publisher.topic_name)

    @property
    def state(self) -> int | None:
        return self.statuses[-1].state if self.statuses else None

    def level(self) -> bytes | None:
        """Return the level of the latest diagnostics."""
        return self.diagnostics[-1].status[0].level if self.diagnostics else None

    def image(self, stamp: int, pixels: np.ndarray) -> None:
        self.images.publish(image_message(pixels, stamp_ns=stamp, frame_id="camera_optical_frame"))

    def exposure(self, stamp: int, index: int = 0, count: int = 4, crc: int = 0, step: int = 0) -> None:
        record = FrameRecord(
            "test", step, index, count, ProjectedPattern(PatternKind.WHITE), stamp, 0.01, image_crc=crc
        )
        self.exposures.publish(exposure_message(record, frame_id="camera_optical_frame"))

    def end_step(self) -> None:
        self.steps.publish(StepStatus(experiment="test", step=0, stage=StepStatus.END))


@pytest.fixture
def rig() -> Iterator[Rig]:
    rclpy.init()
    node = Rig()
    yield node
    node.destroy_node()
    rclpy.shutdown()


def recorder(folder: Path, **parameters: Any) -> NodeProcess:
    return NodeProcess(
        "recorder_node.recorder_node", folder, {"bag_path": str(folder / "bag"), "derived": False} | parameters
    )


def test_what_was_published_is_in_the_bag_bit_by_bit(rig: Rig, tmp_path: Path) -> None:
    frames = [np.full((48, 64), value, np.uint8) + np.arange(64, dtype=np.uint8) for value in range(4)]
    with recorder(tmp_path):
        rig.connect()
        for index, pixels in enumerate(frames):
            rig.image(1000 + index, pixels)
            rig.exposure(1000 + index, index)
        rig.load.publish(LoadState(force=12.5, position=1e-3))
        rig.phase.publish(NodeStatus(node="phase"))
        rig.end_step()
        rig.wait(lambda: rig.statuses[-1].messages >= 11, "all messages to be written")
        rig.wait(lambda: rig.statuses[-1].bytes > 4 * 48 * 64, "their size, which follows")
        status = rig.statuses[-1]
        assert (status.images, status.missing_images) == (4, 0)
        assert status.path == str(tmp_path / "bag")

    bag = BagReader(tmp_path / "bag")
    assert not bag.lost
    assert bag.counts == {
        "/camera/image_raw": 4,
        "/camera/exposure": 4,
        "/experiment/step": 1,
        "/load_frame/state": 1,
        "/calibration": 1,
    } | ({"/node_parameters": 1} if "/node_parameters" in bag.counts else {})
    recorded = [message for _, message, _ in bag.messages(["/camera/image_raw"])]
    for index, pixels in enumerate(frames):
        assert np.array_equal(np.reshape(recorded[index].data, pixels.shape), pixels)
        assert recorded[index].header.stamp.nanosec == 1000 + index
    (calibration,) = [message for _, message, _ in bag.messages(["/calibration"])]
    assert calibration.identifier == "before the recorder"
    qos = yaml.safe_load(bag.topics["/calibration"].qos)
    assert qos[0]["durability"] == "transient_local"


def test_split_recording_loses_nothing_between_its_files(rig: Rig, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 256, (48, 64), np.uint8) for _ in range(20)]
    with recorder(tmp_path, split_gb=1e-5):
        rig.connect()
        for index, pixels in enumerate(frames):
            rig.image(1000 + index, pixels)
            rig.exposure(1000 + index, index, len(frames))
        rig.end_step()
        rig.wait(lambda: "/experiment/step" in BagReader(tmp_path / "bag").counts, "all messages to be written")

    bag = BagReader(tmp_path / "bag")
    assert not bag.lost
    assert len(bag.files) >= 4
    recorded = [message for _, message, _ in bag.messages(["/camera/image_raw"])]
    assert [np.reshape(image.data, (48, 64)).tolist() for image in recorded] == [each.tolist() for each in frames]
    assert [each.sequence for each in bag.stored() if each.topic == "/camera/exposure"] == [*range(1, len(frames) + 1)]
    assert (tmp_path / "bag" / "manifest.sha256").exists()
    assert "depth: 0" not in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_frames_of_a_step_are_confirmed_by_their_checksums(rig: Rig, tmp_path: Path) -> None:
    """The order between topics is not that of publishing, and a changed image is not the camera's."""
    frames = [np.arange(35, dtype=np.uint8).reshape(5, 7) + value for value in range(4)]
    crcs = [zlib.crc32(pixels.tobytes()) for pixels in frames]
    with recorder(tmp_path):
        rig.connect()
        rig.image(1, frames[0])
        rig.exposure(1, 0, crc=crcs[0])
        rig.steps.publish(StepStatus(experiment="test", step=0, stage=StepStatus.BEGIN))
        for index in (1, 2):
            rig.image(index + 1, frames[index])
            rig.exposure(index + 1, index, crc=crcs[index])
        rig.steps.publish(StepStatus(experiment="test", step=0, stage=StepStatus.PROCESS))
        rig.wait(lambda: rig.statuses[-1].step_frames == 3, "three frames")
        for stray in range(1, 11):  # of other steps: late ones, or those of another program
            rig.exposure(9, 0, step=stray)
        rig.exposure(4, 3, crc=crcs[3])
        rig.image(4, frames[3] + 1)
        rig.wait(lambda: rig.statuses[-1].images == 4, "the fourth image")
        rig.serve(0.5)
        assert rig.statuses[-1].step_frames == 3
        rig.image(4, frames[3])
        rig.wait(lambda: rig.statuses[-1].step_frames == 4, "all frames")
        status = rig.statuses[-1]
        assert (status.experiment, status.step) == ("test", 0)
        assert status.step_crc == zlib.crc32(struct.pack("<4I", *crcs))
        bag = BagReader(tmp_path / "bag")
        assert bag.counts["/camera/image_raw"] == 5, "the confirmed frames are in the file"


def test_derived_topics_are_recorded_on_request(rig: Rig, tmp_path: Path) -> None:
    with recorder(tmp_path, derived=True):
        rig.connect()
        rig.wait(rig.phase.get_subscription_count, "subscription to phase/status")
        rig.phase.publish(NodeStatus(node="phase", step=7))
        rig.wait(lambda: "/phase/status" in BagReader(tmp_path / "bag").counts, "the message to be written")
    (status,) = [message for _, message, _ in BagReader(tmp_path / "bag").messages(["/phase/status"])]
    assert status.step == 7


def test_an_exposure_without_image_is_counted(rig: Rig, tmp_path: Path) -> None:
    pixels = np.zeros((8, 8), np.uint8)
    with recorder(tmp_path):
        rig.connect()
        rig.image(1, pixels)
        for stamp in (1, 2, 3):
            rig.exposure(stamp)
        rig.image(3, pixels)
        rig.wait(lambda: rig.statuses[-1].missing_images == 1, "the missing image in the status")


def test_killed_in_the_middle_it_leaves_a_readable_bag(rig: Rig, tmp_path: Path) -> None:
    process = recorder(tmp_path, flush_interval_s=0.1)
    process.__enter__()
    rig.connect()
    for stamp in range(20):
        rig.image(stamp, np.full((480, 640), stamp, np.uint8))
        rig.serve(0.02)
    rig.wait(lambda: BagReader(tmp_path / "bag").counts.get("/camera/image_raw") == 20, "twenty images on the disk")
    process.process.kill()
    process.process.wait()

    bag = BagReader(tmp_path / "bag")
    assert bag.lost
    values = [int(message.data[0]) for _, message, _ in bag.messages(["/camera/image_raw"])]
    assert values == list(range(20))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_close_the_bag(rig: Rig, tmp_path: Path, number: signal.Signals) -> None:
    process = recorder(tmp_path)
    process.__enter__()
    rig.connect()
    rig.exposure(1)
    rig.wait(lambda: rig.statuses[-1].messages >= 2, "the message to be written")
    process.process.send_signal(number)
    assert process.process.wait(300) == 0, process.log
    assert not BagReader(tmp_path / "bag").lost


def test_a_removed_folder_fails_the_recording_with_words_and_not_the_node(rig: Rig, tmp_path: Path) -> None:
    with recorder(tmp_path, flush_interval_s=0.1) as process:
        rig.connect()
        rig.wait(lambda: rig.level() == DiagnosticStatus.OK, "diagnostics")
        shutil.rmtree(tmp_path / "bag")
        rig.wait(lambda: rig.state == RecorderStatus.FAILED, "the failure in the status")
        rig.wait(lambda: rig.level() == DiagnosticStatus.ERROR, "the failure in the diagnostics")
        assert rig.diagnostics[-1].status[0].message == rig.statuses[-1].error_message
        assert str(tmp_path / "bag") in rig.statuses[-1].error_message
        rig.exposure(1)
        rig.serve(0.3)
        assert process.process.poll() is None


def test_a_full_disk_fails_the_recording_and_keeps_what_was_written(rig: Rig, tmp_path: Path) -> None:
    limited = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000)); "
    command = limited + "from recorder_node.recorder_node import main; sys.exit(main())"
    arguments = ["--ros-args", "-p", f"bag_path:={tmp_path / 'bag'}", "-p", "flush_interval_s:=0.1"]
    with subprocess.Popen([sys.executable, "-c", command, *arguments]) as process:
        try:
            rig.connect()
            noise = np.random.default_rng(1).integers(0, 255, (1000, 1000), np.uint8)
            for stamp in range(8):
                rig.image(stamp, noise)
            rig.wait(lambda: rig.state == RecorderStatus.FAILED, "the failure in the status")
            assert "the disk is full" in rig.statuses[-1].error_message
            assert process.poll() is None
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(300) == 0
    assert BagReader(tmp_path / "bag").counts["/camera/image_raw"] >= 1


def test_an_existing_folder_is_not_overwritten(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text(json.dumps(1))
    with recorder(tmp_path):
        rig.wait(lambda: rig.state == RecorderStatus.FAILED, "the failure in the status")
        assert "exists already" in rig.statuses[-1].error_message
    assert os.listdir(tmp_path / "bag") == ["precious"]


def test_thirty_images_a_second_lose_none(rig: Rig, tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (960, 1280), np.uint8)
    frames = 60
    with recorder(tmp_path):
        rig.connect()
        for index in range(frames):
            rig.image(index + 1, noise)
            rig.exposure(index + 1, index, frames)
            rig.serve(1 / 30)
        rig.end_step()
        rig.wait(lambda: rig.statuses[-1].messages >= 2 * frames + 2, "all messages to be written")
        assert (rig.statuses[-1].images, rig.statuses[-1].missing_images) == (frames, 0)
    stamps = [
        message.header.stamp.nanosec for _, message, _ in BagReader(tmp_path / "bag").messages(["/camera/image_raw"])
    ]
    assert stamps == list(range(1, frames + 1))


def test_tally_counts_what_newer_images_overtake() -> None:
    tally = ExposureTally()
    tally.add_exposure(10)
    assert tally.missing == 0  # its image may be on the way
    tally.add_image(20)
    assert tally.missing == 1
    tally.add_exposure(20)
    tally.add_image(10)  # it was late after all
    assert tally.missing == 0
    tally.add_exposure(15)  # records travel apart from images and may come later
    assert tally.missing == 1
    tally.add_image(15)
    tally.add_exposure(30)
    tally.end_step()
    assert tally.missing == 1


def test_frames_stay_confirmed_during_a_free_run() -> None:
    """Images of a free run after the last exposure, while the results of the step are computed, replace each other."""
    tally = StepTally()
    for step in (0, 1):
        crcs = [100 * step + index for index in range(16)]
        tally.begin("test", step)
        for index, crc in enumerate(crcs):
            stamp = 100_000 * step + index
            record = FrameRecord(
                "test", step, index, 16, ProjectedPattern(PatternKind.WHITE), stamp, 0.01, image_crc=crc
            )
            tally.add_image(stamp, crc)
            tally.add_record(exposure_message(record, frame_id="camera_optical_frame"))
        for image in range(3000):
            tally.add_image(100_000 * step + 1000 + image, 5)
        assert tally.confirmed() == crcs
