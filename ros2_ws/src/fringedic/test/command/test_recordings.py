"""Commands about recordings: exit codes, and recommendations that work."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from fringedic import open_experiment
from fringedic.command.main import app
from fringedic.errors import ImageError, RecordingError, StepFailedError
from fringedic.images.recorded import save_images
from fringedic.recording import BagReader, BagWriter, Topic
from fringedic.recording.repair import info
from fringedic.recording.sentences import next_command

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
LEFT, RIGHT = "/stereo/left/image_raw", "/stereo/right/image_raw/compressed"


def copy(target, keep):
    """Write the messages of the recording for which a function of topic and number in the topic is true."""
    reader = BagReader(RECORDED)
    numbers = dict.fromkeys(reader.topics, -1)
    with BagWriter(target) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            numbers[message.topic] += 1
            if keep(message.topic, numbers[message.topic]):
                writer.write(*message)
    return target


def of_cameras(target, left, right=()):
    """Write a recording of other cameras: raw images (encoding, pixels), and compressed ones (suffix, pixels)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "camera")
    with BagWriter(target) as writer:
        for name, kind in ((LEFT, "sensor_msgs/msg/Image"), (RIGHT, "sensor_msgs/msg/CompressedImage")):
            definition, _ = store.generate_msgdef(kind, ros_version=2)
            writer.add_recorded_topic(Topic(name, kind, definition, "ros2msg", "", ""))
        for number, (encoding, pixels) in enumerate(left):
            data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
            height, width = pixels.shape[:2]
            message = types["sensor_msgs/msg/Image"](header, height, width, encoding, 0, data.size // height, data)
            content = store.serialize_cdr(message, "sensor_msgs/msg/Image")
            writer.write(LEFT, bytes(content), 10**8 * number, 10**8 * number)
        for number, (suffix, pixels) in enumerate(right):
            message = types["sensor_msgs/msg/CompressedImage"](header, suffix, cv2.imencode(f".{suffix}", pixels)[1])
            content = store.serialize_cdr(message, "sensor_msgs/msg/CompressedImage")
            writer.write(RIGHT, bytes(content), 10**8 * number, 10**8 * number)
    return target


def test_no_measured_step_is_an_error(tmp_path):
    """Each step has a phase, and no shape that is valid at all points."""
    output = tmp_path / "new.nc"
    words = ["process", str(RECORDED), "--set", "coupling.minimum_valid_fraction=1", "--output", str(output)]
    done = CliRunner().invoke(app, words)
    assert "whole: 0 of 3 steps" in done.output
    assert (done.exit_code, type(done.exception)) == (1, StepFailedError)
    assert output.exists(), "with the reasons"


def test_settings_that_are_missing_are_said_at_once(tmp_path):
    bag = copy(tmp_path / "bag", lambda topic, _: not topic.endswith("node_parameters"))
    assert "--set specimen.force_sign=1" in next_command(info(bag))
    given = ["--set", "specimen.force_sign=-1", "--set", "specimen.force_tare_newton=0"]
    done = CliRunner().invoke(app, ["process", str(bag), *given, "--step", "1"])
    assert done.exit_code == 0, done.output
    words = " ".join(done.output.split())
    missing = "the settings of phase, dic, coupling, experiment are not in the recording, defaults are used"
    assert missing in words
    assert words.index(missing) < words.index("step 0: measured")


@pytest.mark.parametrize(
    ("topic", "words"),
    [("experiment/reference", "bag --reference STEP`"), ("calibration", "fringes need --calibration FILE")],
)
def test_recommended_command_has_the_options_for_what_is_missing(tmp_path, topic, words):
    assert next_command(info(RECORDED)) == f"next: `fringedic process {RECORDED}` measures the recorded frames"
    assert words in next_command(info(copy(tmp_path / "bag", lambda name, _: not name.endswith(topic))))


def test_recording_of_another_camera_is_measured_by_its_topic(tmp_path, speckle):
    scene = speckle((96, 128), seed=3)
    shifted = scene.image(lambda x, y: (np.full_like(x, 0.6), np.zeros_like(y)))
    images = [(each / 16).astype(np.uint8) for each in (scene.image(), shifted)]
    bag = of_cameras(tmp_path / "bag", [("mono8", each) for each in images])
    summary = info(bag)
    assert next_command(summary, summary.types).startswith(f"next: `fringedic measure {bag} --bag {LEFT}` measures")
    output = tmp_path / "measured"
    done = CliRunner().invoke(app, ["measure", str(bag), "--bag", LEFT, "--output", str(output)])
    assert done.exit_code == 0, done.output
    with open_experiment(output / "displacement.nc") as dataset:
        assert float(np.nanmedian(dataset.displacement_x.isel(step=1))) == pytest.approx(0.6, abs=0.02)


def test_images_are_written_without_loss(tmp_path):
    random = np.random.default_rng(1)
    grey = random.integers(0, 4096, (20, 30), dtype=np.uint16)
    colour = random.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    bag = of_cameras(tmp_path / "bag", [("mono16", grey), ("rgb8", colour)], [("png", grey), ("jpg", colour)])
    first, second = (cv2.imread(str(each), cv2.IMREAD_UNCHANGED) for each in save_images(bag, LEFT, tmp_path / "a"))
    assert np.array_equal(first, grey)
    assert np.array_equal(second, colour[:, :, ::-1])
    compressed = save_images(bag, RIGHT, tmp_path / "b")
    assert [each.name for each in compressed] == ["image_0.png", "image_1.jpg"]
    assert np.array_equal(cv2.imread(str(compressed[0]), cv2.IMREAD_UNCHANGED), grey)


def test_topic_without_images_names_those_with_images(tmp_path):
    bag = of_cameras(tmp_path / "bag", [("32FC1", np.ones((4, 5), np.float32))])
    with pytest.raises(RecordingError, match=f"no images on /tf; there are images on {LEFT}$"):
        save_images(bag, "/tf", tmp_path / "images")
    with pytest.raises(ImageError, match=f"{LEFT}, image 0: 32FC1 are no grey levels"):
        save_images(bag, LEFT, tmp_path / "images")
