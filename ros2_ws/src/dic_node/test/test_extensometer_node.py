"""The extensometer node in a process of its own, fed with frames as a camera sends them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from scipy.ndimage import gaussian_filter, map_coordinates
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic_msgs.msg import Exposure, StepStatus
from fringedic_ros.images import image_message
from fringedic_ros.qos import EVENTS, IMAGES, STATE
from fringedic_ros.records import exposure_message
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import NodeProcess, Peer

ROWS, COLUMNS = 480, 640
EXPOSURE_S = 0.005


class Rig(Peer):
    """Camera, and controller that reads the strain."""

    def __init__(self) -> None:
        super().__init__()
        self.strains = self.listen(Float64, "extensometer/strain", STATE)
        self.sigmas = self.listen(Float64, "extensometer/sigma", STATE)
        self.valid = self.listen(Bool, "extensometer/valid", STATE)
        self._images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self._exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        self._zero = self.create_client(Trigger, "extensometer/zero")
        self._set_parameters = self.create_client(SetParameters, "extensometer/set_parameters")
        self.stamp_ns = 0  # of the latest frame
        self._texture = gaussian_filter(np.random.default_rng(1).normal(size=(ROWS, COLUMNS)), 1.4)
        self._texture *= 40 / self._texture.std()

    def ready(self) -> None:
        for publisher in (self._images, self._exposures, self._steps):
            self.wait(lambda publisher=publisher: publisher.get_subscription_count() == 1, "the extensometer")

    def send(
        self,
        strain: float,
        kind: PatternKind = PatternKind.OTHER,
        *,
        stamp_ns: int | None = None,
        exposure_s: float = EXPOSURE_S,
    ) -> None:
        """One frame of the texture stretched along the columns about the middle of the image.

        Its exposure begins now, unless it has a stamp.
        """
        row, column = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
        material = (column - COLUMNS / 2) / (1 + strain) + COLUMNS / 2
        image = np.clip(128 + map_coordinates(self._texture, [row, material], order=5, mode="reflect"), 0, 255)
        begin = self.get_clock().now().nanoseconds
        self.stamp_ns = begin + round(0.5e9 * exposure_s) if stamp_ns is None else stamp_ns
        self._images.publish(image_message(image.round().astype(np.uint8), stamp_ns=self.stamp_ns, frame_id="camera"))
        record = FrameRecord("", 0, 0, 0, ProjectedPattern(kind), self.stamp_ns, exposure_s, 0)
        self._exposures.publish(exposure_message(record, frame_id="camera"))

    def read(self, strain: float) -> tuple[float, float]:
        """Strain and sigma of one frame; the NaN of the time without frames before is ignored."""
        self.forget()
        self.send(strain)
        self.wait(lambda: any(flag.data for flag in self.valid), "a valid strain")
        self.wait(lambda: self._numbers(self.strains) and self._numbers(self.sigmas), "its numbers")
        return self._numbers(self.strains)[-1], self._numbers(self.sigmas)[-1]

    def _numbers(self, messages: list[Float64]) -> list[float]:
        return [message.data for message in messages if not np.isnan(message.data)]

    def send_early(self, strain: float, **options: Any) -> None:
        """One frame that may not become the reference."""
        self.forget()
        self.send(strain, **options)
        self.wait(lambda: self.strains, "the answer to the frame")
        assert not any(flag.data for flag in self.valid)

    def publish_stage(self, stage: int, *, reference: bool = False, stamp_ns: int | None = None) -> None:
        message = StepStatus(stage=stage, reference=reference)
        message.header.stamp = to_msg(self.get_clock().now().nanoseconds if stamp_ns is None else stamp_ns)
        self._steps.publish(message)
        assert self._steps.wait_for_all_acked(Duration(seconds=180))
        self.meet("extensometer")  # before it answers, a node takes one message of each topic

    def zero(self) -> None:
        self.ask(self._zero, Trigger.Request(), "the zero")

    def change_subset(self) -> None:
        """Change the size of the gauge subsets, and restore it: each change requests a reference."""
        for size in (40, 48):
            change = Parameter("subset_px", value=size).to_parameter_msg()
            self.ask(self._set_parameters, SetParameters.Request(parameters=[change]), "the change of parameters")


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """The rig with a node that serves all tests of this module."""
    rclpy.init()
    rig = Rig()
    parameters = {"first_px": [160, 240], "second_px": [480, 240], "frame_timeout_s": 0.3}
    with NodeProcess("dic_node.extensometer_node", tmp_path_factory.mktemp("extensometer"), parameters):
        rig.ready()
        yield rig
    rig.destroy_node()
    rclpy.shutdown()


@pytest.fixture
def rig(running: Rig) -> Rig:
    """The rig before the first frame: the next one is the reference."""
    running.zero()
    return running


def test_strain_beside_its_sigma_and_validity(rig: Rig) -> None:
    assert rig.read(0.0)[0] == pytest.approx(0.0, abs=1e-5)
    for strain in (0.002, 0.005, -0.003):
        measured, sigma = rig.read(strain)
        assert measured == pytest.approx(strain, abs=1e-4)
        assert 0 < sigma < 1e-4
    rig.zero()
    rig.read(0.005)
    assert rig.read(0.010)[0] == pytest.approx(1.010 / 1.005 - 1, abs=1e-4), "against the frame after the zero"


def test_the_frame_after_a_reference_step_is_the_reference(rig: Rig) -> None:
    rig.read(0.0)
    for reference in (False, True):
        rig.publish_stage(StepStatus.END, reference=reference)
        read = [rig.read(strain)[0] for strain in (0.005, 0.010)]
        expected = 1.010 / 1.005 - 1 if reference else 0.010
        assert read[1] == pytest.approx(expected, abs=1e-4), reference


@pytest.mark.parametrize("requested_by", ["step", "zero", "parameters"])
def test_a_frame_of_before_the_request_does_not_become_the_reference(rig: Rig, requested_by: str) -> None:
    """Such frames are queued after the process stood still."""
    rig.read(0.0)
    before = rig.stamp_ns + 1
    if requested_by == "step":
        rig.publish_stage(StepStatus.END, reference=True, stamp_ns=before)
    elif requested_by == "zero":
        rig.zero()
    else:
        rig.change_subset()
    rig.send_early(0.002, stamp_ns=before)
    rig.read(0.005)
    assert rig.read(0.010)[0] == pytest.approx(1.010 / 1.005 - 1, abs=1e-4)


def test_a_frame_that_was_being_exposed_at_the_request_does_not_become_the_reference(rig: Rig) -> None:
    rig.send_early(0.002, stamp_ns=rig.get_clock().now().nanoseconds, exposure_s=3600)
    rig.read(0.005)
    assert rig.read(0.010)[0] == pytest.approx(1.010 / 1.005 - 1, abs=1e-4)


def test_the_end_of_a_step_does_not_replace_a_later_request_of_zero(rig: Rig) -> None:
    rig.read(0.0)
    last_exposure = rig.stamp_ns + 1
    rig.zero()
    rig.publish_stage(StepStatus.END, reference=True, stamp_ns=last_exposure)
    rig.send_early(0.002, stamp_ns=last_exposure + 1000, exposure_s=1e-6)
    rig.read(0.005)
    assert rig.read(0.010)[0] == pytest.approx(1.010 / 1.005 - 1, abs=1e-4)


def test_frames_with_a_pattern_are_ignored(rig: Rig) -> None:
    rig.read(0.0)
    rig.forget()
    rig.send(0.005, PatternKind.FRINGES)
    rig.send(0.001, PatternKind.WHITE)
    rig.wait(lambda: any(flag.data for flag in rig.valid), "a valid strain")
    rig.wait(lambda: any(strain.data == pytest.approx(0.001, abs=1e-4) for strain in rig.strains), "its number")
    assert not any(strain.data == pytest.approx(0.005, abs=1e-3) for strain in rig.strains)


@pytest.mark.parametrize("stage", [StepStatus.PROCESS, StepStatus.END, StepStatus.ERROR])
def test_free_run_is_ignored_while_a_step_takes_its_frames(rig: Rig, stage: int) -> None:
    """The projector already shows the first pattern while the free run still goes on."""
    rig.read(0.0)
    for taking in (StepStatus.BEGIN, StepStatus.CAPTURE):
        rig.publish_stage(taking)
        rig.send(0.005)
        rig.wait(lambda: not rig.valid[-1].data, "the strain is invalid")
        assert not any(strain.data == pytest.approx(0.005, abs=1e-3) for strain in rig.strains)
        rig.forget()
        rig.send(0.001, PatternKind.WHITE)
        rig.wait(lambda: any(flag.data for flag in rig.valid), "the strain of a frame in white light")
    rig.publish_stage(stage)
    assert rig.read(0.002)[0] == pytest.approx(0.002, abs=1e-4)


def test_missing_frames_are_reported_once(rig: Rig) -> None:
    rig.read(0.0)
    rig.wait(lambda: not rig.valid[-1].data, "the report that frames are missing")
    rig.wait(lambda: np.isnan(rig.strains[-1].data), "its number")
    rig.serve(0.6)
    flags = [flag.data for flag in rig.valid]
    assert flags[flags.index(True) :] == [True, False]
    assert rig.read(0.001)[0] == pytest.approx(0.001, abs=1e-4)


def test_every_frame_of_a_stream_is_answered_or_replaced_by_a_newer_one(rig: Rig) -> None:
    """The last frame always counts: a controller never acts on an old strain while a newer frame waits."""
    rig.read(0.0)
    rig.forget()
    for k in range(1, 11):
        rig.send(0.0005 * k)
        rig.serve(0.02)
    rig.wait(lambda: rig.strains and abs(rig.strains[-1].data - 0.005) < 1e-4, "the strain of the last frame")
    read = [strain.data for strain in rig.strains if not np.isnan(strain.data)]
    assert read == sorted(read)
