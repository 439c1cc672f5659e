"""A virtual rig calibrates itself by its own pictures, through the real nodes, and its recording does so again."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from running_system import Told

from fringedic.calibration_recording import calibrate_recording
from fringedic.errors import MissingTopicError
from fringedic.recording import BagReader, BagWriter
from fringedic.results import dataset_from_derived, image_array, open_experiment, process_bag
from fringedic.rig import RigModel
from fringedic.rig_file import calibration_of, load_rig_file
from fringedic_bringup.calibrate import calibrate, with_angles
from fringedic_bringup.check import check
from fringedic_bringup.replay import replay
from fringedic_bringup.report import CalibrationReport, RunReport

ANGLES = "0,-18,-9,6,12,18"
PITCH = 5.0  # the finest of the tiny rig [projector px]
LENS = {"k1": -0.12, "k2": 0.3, "p1": 4e-4, "p2": -6e-4}


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory, tiny: Path) -> Path:
    """The tiny rig with a lens."""
    path = tmp_path_factory.mktemp("rig") / "tiny.yaml"
    text = tiny.read_text()
    assert "stage: {" in text
    path.write_text(text.replace("stage: {", f"camera: {{lens: {LENS}}}, stage: {{"))
    return path


@pytest.fixture(scope="module")
def calibrated(rig_file: Path, tmp_path_factory: pytest.TempPathFactory) -> CalibrationReport:
    folder = tmp_path_factory.mktemp("calibration") / "tiny"
    rig = with_angles(load_rig_file(rig_file), ANGLES)
    return calibrate(rig, rig_file, folder, Told(), ask=lambda _: False)


def test_agrees_with_the_truth(calibrated: CalibrationReport, rig_file: Path) -> None:
    """At 400 µm per pixel; the figures at 50 µm per pixel come from the demo."""
    assert calibrated.go, calibrated.words
    measured = RigModel.from_yaml(calibrated.file)
    exact = calibration_of(load_rig_file(rig_file).virtual_configuration())
    lens = measured.camera_distortion
    assert lens is not None and exact.camera_distortion is not None

    # The surface that the same phase stands for. What a lens does like a tilt moves the foot of the camera's pin-hole,
    # with it the origin, and nothing else: the common shift along the plane is left out.
    row, column = np.mgrid[: exact.camera_height, : exact.camera_width]
    x, y = (column - 79.5) * 380e-6, (59.5 - row) * 380e-6
    heights = (-5e-3, 0.0, 5e-3)
    phases = [exact.phase(x, y, np.full(x.shape, height), PITCH) for height in heights]
    differences = [measured.reconstruct(phase, PITCH) - exact.reconstruct(phase, PITCH) for phase in phases]
    for height, difference in zip(heights, differences, strict=True):
        shift = {"x": float(differences[1].x.mean()), "y": float(differences[1].y.mean()), "z": 0.0}
        errors = {name: 1e6 * float(np.sqrt(((difference[name] - shift[name]) ** 2).mean())) for name in "xyz"}
        print(f"height {1e3 * height:+.0f} mm: " + ", ".join(f"{name} {errors[name]:.1f} µm" for name in "xyz"))
        # 400 µm per pixel: .05 px across, and the noise of a pixel is 44 µm in z
        assert errors["x"] < 20 and errors["y"] < 20 and errors["z"] < 20, errors


def test_leaves_a_report_and_says_what_it_found(calibrated: CalibrationReport) -> None:
    assert calibrated.report is not None and "<html" in calibrated.report.read_text()[:500]
    camera, rig = calibrated.words
    assert "px" in camera and rig.startswith("GO")
    assert (calibrated.folder / "distortion.yaml").exists()


def test_the_recording_gives_the_same_numbers(calibrated: CalibrationReport, tmp_path: Path) -> None:
    """By the command, without nodes, to the last bit of the files."""
    again = tmp_path / "again"
    command = ["fringedic", "calibrate", "--from", str(calibrated.folder / "bag"), "--output", str(again)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert told.returncode == 0, told.stderr
    assert "GO" in told.stdout and str(again / "report.html") in told.stdout
    for name in ("calibration.yaml", "calibration_fit.yaml", "distortion.yaml"):
        assert (again / name).read_text() == (calibrated.folder / name).read_text(), name


def test_a_recording_without_planes_is_no_calibration(calibrated: CalibrationReport) -> None:
    with pytest.raises(MissingTopicError, match="experiment/plane"):
        calibrate_recording(_without_planes(calibrated.folder / "bag"))


def test_a_recording_is_measured_with_another_calibration(
    experiment: RunReport, calibrated: CalibrationReport, tmp_path: Path
) -> None:
    bag = replay(experiment.folder / "bag", tmp_path / "again", Told(), calibration=calibrated.file)
    recorded, replayed = (_maps(each) for each in (experiment.folder / "bag", bag))
    np.testing.assert_array_equal(recorded["phase/map"], replayed["phase/map"])
    reader = BagReader(bag)
    [calibration] = [message for _, message, _ in reader.messages(reader.find("calibration").values())]
    assert calibration.identifier == RigModel.from_yaml(calibrated.file).identifier

    model = RigModel.from_yaml(calibrated.file)
    desk = process_bag(experiment.folder / "bag", output=tmp_path / "desk.nc", calibration=model)
    nodes = dataset_from_derived(bag, output=tmp_path / "nodes.nc")
    former = dataset_from_derived(experiment.folder / "bag", output=tmp_path / "former.nc")
    with open_experiment(desk) as a, open_experiment(nodes) as b, open_experiment(former) as c:
        np.testing.assert_array_equal(a.shape_z.values, b.shape_z.values)
        change = float(np.sqrt(np.nanmean((b.shape_z - c.shape_z).values ** 2)))
    print(f"another calibration moves the surface by {1e6 * change:.1f} µm RMS")
    assert change > 1e-6 and math.isfinite(change)


def test_check_of_a_rig_that_holds_and_of_one_that_was_touched(
    calibrated: CalibrationReport, rig_file: Path, tmp_path: Path
) -> None:
    text = rig_file.read_text().replace("calibration: virtual_rig", f"calibration: {calibrated.file}")
    held = rig_file.with_name("held.yaml")
    held.write_text(text)
    result = check(load_rig_file(held), held, tmp_path / "held", Told(), distance=5e-3, ask=lambda _: False)
    print(result.verdict, *result.warnings)
    assert result.holds, result.verdict
    assert result.distance == pytest.approx(5e-3, rel=2e-3) and result.age < 3600

    touched = rig_file.with_name("touched.yaml")  # somebody knocked against the projector
    touched.write_text(text.replace("size: tiny,", "size: tiny, projector: {yaw_degree: 0.35},"))
    result = check(load_rig_file(touched), touched, tmp_path / "touched", Told(), distance=5e-3, ask=lambda _: False)
    print(result.verdict, *result.warnings)
    assert not result.holds, result.verdict


def _maps(bag: Path) -> dict[str, np.ndarray]:
    reader = BagReader(bag)
    names = reader.find("phase/map")
    return {
        name: np.stack([image_array(message) for _, message, _ in reader.messages([full])])
        for name, full in names.items()
    }


def _without_planes(bag: Path) -> Path:
    reader = BagReader(bag)
    target = bag.with_name("without_planes")
    with BagWriter(target) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.raw():
            if not message.topic.endswith("experiment/plane"):
                writer.write(*message)
    return target
