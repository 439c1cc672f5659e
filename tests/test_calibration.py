"""A virtual rig is calibrated with its own images through the real nodes, and again from the recording."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rewritten import copy_topics
from running_system import Progress, without_ros

from fringedic.calibration.recorded import calibrate_recording
from fringedic.calibration.sentences import check_in_words
from fringedic.command.outcome import CalibrationReport
from fringedic.configuration.changes import with_angles
from fringedic.configuration.rig_file import load_rig_file
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.errors import RecordingError
from fringedic.rig.model import RigModel
from fringedic_bringup.procedures.calibrate import calibrate
from fringedic_bringup.procedures.check import check

ANGLES = "0,-18,-9,6,12,18"
PITCH = 5.0  # the finest of the tiny rig [projector px]
LENS = {"k1": -0.12, "k2": 0.3, "p1": 4e-4, "p2": -6e-4}


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory, tiny: Path) -> Path:
    """The tiny rig with a lens."""
    path = tmp_path_factory.mktemp("rig") / "tiny.yaml"
    text = tiny.read_text()
    assert "stage: {" in text
    people = "specimen: {operator: Ada Lovelace}\nhardware: {calibration_target: glass grid 7}\n"
    path.write_text(people + text.replace("stage: {", f"camera: {{lens: {LENS}}}, stage: {{"))
    return path


@pytest.fixture(scope="module")
def calibrated(rig_file: Path, tmp_path_factory: pytest.TempPathFactory) -> CalibrationReport:
    folder = tmp_path_factory.mktemp("calibration") / "tiny"
    rig = with_angles(load_rig_file(rig_file), ANGLES)
    return calibrate(rig, rig_file, folder, Progress(), ask=lambda _: False)


def test_agrees_with_the_truth(calibrated: CalibrationReport, rig_file: Path) -> None:
    """At 400 µm per pixel; the figures at 50 µm per pixel come from the demo."""
    assert calibrated.go, calibrated.words
    measured = RigModel.from_yaml(calibrated.file)
    exact = calibration_of(load_rig_file(rig_file).virtual_configuration())
    lens = measured.camera_distortion
    assert lens is not None
    assert exact.camera_distortion is not None

    # Surfaces of the same phase are compared. A part of the distortion that resembles a tilt moves the foot of the
    # camera's pin-hole and with it the origin: the common shift along the plane is subtracted.
    row, column = np.mgrid[: exact.camera_height, : exact.camera_width]
    x, y = (column - 79.5) * 380e-6, (59.5 - row) * 380e-6
    heights = (-5e-3, 0.0, 5e-3)
    phases = [exact.phase(x, y, np.full(x.shape, height), PITCH) for height in heights]
    differences = [measured.reconstruct(phase, PITCH) - exact.reconstruct(phase, PITCH) for phase in phases]
    for height, difference in zip(heights, differences, strict=True):
        shift = {"x": float(differences[1].x.mean()), "y": float(differences[1].y.mean()), "z": 0.0}
        errors = {name: 1e6 * float(np.sqrt(((difference[name] - shift[name]) ** 2).mean())) for name in "xyz"}
        # 400 µm per pixel: 0.05 px across, and the noise of a pixel is 44 µm in z
        assert all(error < 20 for error in errors.values()), (height, errors)


def test_report_is_written_and_the_results_are_stated(calibrated: CalibrationReport) -> None:
    assert calibrated.report is not None
    assert "<html" in calibrated.report.read_text()[:500]
    camera, rig = calibrated.words
    assert "px" in camera
    assert rig.startswith("GO")
    assert (calibrated.folder / "distortion.yaml").exists()


def test_the_recording_gives_the_same_files_without_ros(calibrated: CalibrationReport, tmp_path: Path) -> None:
    again = tmp_path / "again"
    command = ["fringedic", "calibrate", "--from", str(calibrated.folder / "bag"), "--output", str(again)]
    environment = {**os.environ, "PYTHONPATH": without_ros()}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "GO" in done.stdout
    assert str(again / "report.html") in done.stdout
    for name in ("calibration.yaml", "calibration_fit.yaml", "distortion.yaml"):
        assert (again / name).read_text() == (calibrated.folder / name).read_text(), name
    for report in (again / "report.html", calibrated.folder / "report.html"):
        traced = report.read_text().split("<h2>Traceability</h2>")[1].split("</table>")[0]
        assert "Ada Lovelace" in traced
        assert "glass grid 7" in traced
        assert re.search(r"pitch of the printed grid</th><td class=\"wide\">[\d.]+ mm<", traced)


def test_a_recording_without_planes_is_no_calibration(calibrated: CalibrationReport) -> None:
    bag = calibrated.folder / "bag"
    with pytest.raises(RecordingError, match="experiment/plane"):
        calibrate_recording(copy_topics(bag, bag.with_name("without_planes"), without=["experiment/plane"]))


def test_check_accepts_an_unchanged_rig_and_refuses_a_moved_one(
    calibrated: CalibrationReport, rig_file: Path, tmp_path: Path
) -> None:
    text = rig_file.read_text().replace("calibration: virtual_rig", f"calibration: {calibrated.file}")
    same = rig_file.with_name("same.yaml")
    same.write_text(text)
    result = check(load_rig_file(same), same, tmp_path / "same", Progress(), distance=5e-3, ask=lambda _: False)
    assert result.holds, check_in_words(result)
    assert result.distance == pytest.approx(5e-3, rel=2e-3)
    assert result.age < 3600

    moved = rig_file.with_name("moved.yaml")
    moved.write_text(text.replace("size: tiny,", "size: tiny, projector: {yaw_degree: 0.35},"))
    result = check(load_rig_file(moved), moved, tmp_path / "moved", Progress(), distance=5e-3, ask=lambda _: False)
    assert not result.holds, check_in_words(result)
