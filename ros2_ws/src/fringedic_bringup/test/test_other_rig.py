"""Commands refuse the calibration of another rig, fringes that repeat in view, and unsuitable recordings."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.errors import CalibrationError, ConfigurationError, ErrorCode, FringedicError
from fringedic.recording.reader import BagReader
from fringedic.recording.writer import BagWriter
from fringedic.rig.model import RigModel

SOURCES = Path(__file__).parents[2]
TINY = SOURCES / "fringedic_bringup" / "config" / "tiny.yaml"
RECORDED = SOURCES / "fringedic" / "test" / "recordings" / "version_0_1"


def refusal(*words: str | Path) -> FringedicError:
    """Return the error with which a command ends."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 1
    assert isinstance(done.exception, FringedicError), done.exception
    return done.exception


@pytest.fixture
def recorded_model() -> RigModel:
    reader = BagReader(RECORDED / "bag")
    [message] = [message for _, message, _ in reader.messages(reader.find("calibration").values())]
    return RigModel.from_message(message)


@pytest.fixture
def uncalibrated(tmp_path: Path) -> Path:
    """Return a recording of fringes without calibration."""
    reader, target = BagReader(RECORDED / "bag"), tmp_path / "bag"
    topics = [topic for topic in reader.topics if not topic.endswith("/calibration")]
    with BagWriter(target) as writer:
        for topic in topics:
            writer.add_recorded_topic(reader.topics[topic])
        for message in reader.raw(topics):
            writer.write(message.topic, message.data, message.log_time, message.publish_time)
    return target


def rig_with(folder: Path, **changes: object) -> Path:
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(TINY.read_text()) | changes))
    return path


def test_run_refuses_the_calibration_of_another_camera(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, calibration=str(RECORDED / "calibration" / "calibration.yaml"))
    error = refusal("run", rig, "--output", tmp_path / "run")
    assert isinstance(error, ConfigurationError)
    assert "1280 x 960 px" in str(error)
    assert "160 x 120 px" in str(error)
    assert not (tmp_path / "run").exists(), "nothing was started"


@pytest.mark.parametrize("pixel_size_mm", [0.0004, 400.0])
def test_run_refuses_a_pixel_size_in_another_unit(tmp_path: Path, pixel_size_mm: float) -> None:
    calibration = {
        "camera": {"width_px": 160, "height_px": 120, "distance_mm": 400.0, "pixel_size_mm": pixel_size_mm},
        "projector": {"width_px": 100, "height_px": 75, "position_mm": [180.0, 0.0, 380.0], "focal_length_px": 425.0},
    }
    rig = rig_with(tmp_path, calibration=calibration)
    error = refusal("run", rig, "--output", tmp_path / "run")
    assert f"pixel_size of {pixel_size_mm:g} mm" in str(error)
    assert "400 mm" in str(error)


def test_run_refuses_fringes_that_repeat_in_view(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, sequence={"pitches_px": [50.0, 5.0], "shifts": 4})
    error = refusal("run", rig, "--output", tmp_path / "run")
    assert error.code is ErrorCode.INVALID_SEQUENCE
    assert "50 px repeat in the camera's view" in str(error)
    assert "at least 60 px" in str(error)


@pytest.mark.parametrize("load_frame", [None, {"source": "external"}])
def test_run_refuses_positions_that_nothing_moves_to(tmp_path: Path, load_frame: dict[str, str] | None) -> None:
    """All steps were measured at the same load, and the command succeeded."""
    programme = {"experiment": "pull", "steps": [{}, {"position_mm": 0.5}, {"position_mm": 1.0}]}
    rig = rig_with(tmp_path, load_frame=load_frame, programme=programme)
    error = refusal("run", rig, "--output", tmp_path / "run")
    assert isinstance(error, ConfigurationError)
    assert "step 2 of 3 of pull moves the crosshead to 0.5 mm, but this rig moves no machine" in str(error)
    assert not (tmp_path / "run").exists(), "nothing was started"


def test_run_does_not_continue_a_series_of_images(tmp_path: Path) -> None:
    """They began again at the first one, so that later steps were measured from images of earlier ones."""
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((32, 32), np.uint8))
    rig, run = tmp_path / "rig.yaml", tmp_path / "run"
    rig.write_text(yaml.safe_dump({"camera": {"source": "files", "files": "*.png"}}))
    (run / "bag").mkdir(parents=True)
    error = refusal("run", rig, "--output", run, "--continue")
    assert isinstance(error, ConfigurationError)
    assert "run cannot be continued, because the camera would read its files from the first image" in str(error)


@pytest.mark.parametrize("command", ["process", "replay"])
def test_calibration_of_another_rig_is_refused_for_a_recording(
    command: str, recorded_model: RigModel, tmp_path: Path
) -> None:
    other = dataclasses.replace(recorded_model, projector_width=recorded_model.projector_width + 24)
    other.to_yaml(tmp_path / "other.yaml")
    words = (command, RECORDED / "bag", "--calibration", tmp_path / "other.yaml", "--output", tmp_path / "new.nc")
    error = refusal(*words)
    assert isinstance(error, CalibrationError)
    for width in (other.projector_width, recorded_model.projector_width):
        assert f"{width} x {other.projector_height} px" in str(error)
    assert not (tmp_path / "new.nc").exists()


@pytest.mark.parametrize("command", ["process", "replay"])
def test_recording_without_calibration_says_how_to_give_one(command: str, uncalibrated: Path, tmp_path: Path) -> None:
    error = refusal(command, uncalibrated, "--output", tmp_path / "new.nc")
    assert error.code is ErrorCode.NO_CALIBRATION
    assert "--calibration FILE" in str(error)


@pytest.mark.parametrize("command", ["process", "replay"])
def test_two_measurements_under_one_number_are_refused(command: str, tmp_path: Path) -> None:
    reader = BagReader(RECORDED / "bag")
    with BagWriter(tmp_path / "bag") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
            if message.topic.endswith("/exposure"):
                second = int.from_bytes(message.data[4:8], "little") + 60  # of the stamp, after the CDR header
                writer.write(*message._replace(data=message.data[:4] + second.to_bytes(4, "little") + message.data[8:]))
    error = refusal(command, tmp_path / "bag", "--output", tmp_path / "new.nc")
    assert "step 0 of experiment 'tiny' was measured more than once under this number" in str(error)
    assert not (tmp_path / "new.nc").exists(), "nothing was started"


def test_one_of_two_experiments_is_processed(tmp_path: Path) -> None:
    reader, bag = BagReader(RECORDED / "bag"), tmp_path / "bag"
    with BagWriter(bag) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
            if message.topic.endswith("/exposure"):
                writer.write(*message._replace(data=message.data.replace(b"tiny", b"next")))
    assert "holds the experiments tiny, next: say which one" in str(refusal("process", bag))
    words = ("process", bag, "--experiment", "tiny", "--step", "1", "--output", tmp_path / "new.nc")
    done = CliRunner().invoke(app, [*map(str, words)])
    assert done.exit_code == 0, done.exception
    assert "whole: 2 of 2 steps" in done.output


def test_recording_without_calibration_is_measured_with_a_given_one(
    uncalibrated: Path, recorded_model: RigModel, tmp_path: Path
) -> None:
    recorded_model.to_yaml(tmp_path / "same.yaml")
    words = ("process", uncalibrated, "--calibration", tmp_path / "same.yaml", "--output", tmp_path / "new.nc")
    done = CliRunner().invoke(app, [*map(str, words), "--step", "1"])
    assert done.exit_code == 0, done.exception
    assert "step 1: measured" in done.output
