"""Calibration from its frames to its files: what a session says, refuses and finds, on exact phases of a tiny rig."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.calibration import check_rig
from fringedic.calibration.findings import CalibrationWarning
from fringedic.calibration.fit_results import Reason, Verdict
from fringedic.calibration.history import record_check
from fringedic.calibration.placement import PlaneKind
from fringedic.calibration.recorded import calibrate_recording
from fringedic.calibration.sentences import (
    check_in_words,
    in_force_words,
    placing_instruction,
    plane_in_words,
    verdict_sentence,
)
from fringedic.calibration.session import CalibrationSession, Plane, Setting
from fringedic.errors import CalibrationError, RecordingError
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.recording import BagWriter, Topic
from fringedic.report.calibration import write_calibration_report
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PITCH = 5.0
SIGMA = 2 * math.pi * 0.002
NOW = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)
TWIN = VirtualRig(
    VirtualRigConfiguration.from_dict(
        {"preset": "plate", "size": "tiny", "stage": {"grid_pitch_mm": 3.0, "grid_blur_um": 170.0}}
    )
)
EXACT = RigModel(**TWIN.optics())


def plane(degrees: float, height: float = 0.0, *, lift: float = 0.0, seed: int = 0, held_out: bool = False) -> Plane:
    """The plane z = height + x tan(angle), really `lift` [m] higher, as a rig with exact phases and noise sees it."""
    angle = math.radians(degrees)
    row, column = np.mgrid[: EXACT.camera_height, : EXACT.camera_width]
    rays = EXACT.ray_matrix @ np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    reach = (height + lift - EXACT.camera_distance) / (rays[2] - math.tan(angle) * rays[0])
    x, y, z = rays * reach
    phase = EXACT.phase(x, y, z + EXACT.camera_distance, PITCH).reshape(column.shape)
    phase += np.random.default_rng(seed).normal(0.0, SIGMA, phase.shape)
    return Plane(angle, height, held_out, phase.astype(np.float32), np.full(phase.shape, SIGMA, np.float32))


@pytest.fixture(scope="module")
def measured() -> CalibrationSession:
    """A session with the grid."""
    session = CalibrationSession()
    twin = TWIN.with_specimen({"kind": "reference_plane", "surface": "grid"})
    white = np.full(twin.projector_shape, 250, np.uint8)
    session.measure_grid(np.stack([twin.expose(white, 0.0, frame) for frame in range(4)]), 3.0e-3)
    return session


@pytest.fixture
def session(measured: CalibrationSession) -> CalibrationSession:
    size = EXACT.projector_width, EXACT.projector_height
    measured.begin(Setting("of today", size, ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, PITCH, 1, 4)))
    return measured


def test_words_for_an_operator() -> None:
    assert "grid" in placing_instruction(PlaneKind.GRID, 0.0, 0.0)
    assert "with the grid on it to +12.00 degree (right" in placing_instruction(PlaneKind.GRID, math.radians(12), 0.0)
    assert placing_instruction(PlaneKind.PLANE, math.radians(-12), 0.0).endswith(
        "-12.00 degree (left side towards the camera)"
    )
    assert placing_instruction(PlaneKind.PLANE, 0.0, 2.5e-3).endswith("+0.00 degree, 2.500 mm above its place")


def test_planes_need_the_grid() -> None:
    with pytest.raises(CalibrationError, match="grid"):
        CalibrationSession().begin(Setting("x", (100, 75), ProjectedPattern(PatternKind.FRINGES)))
    with pytest.raises(CalibrationError, match="begin"):
        CalibrationSession().calibrate(NOW)


def test_a_plane_that_was_not_moved(session: CalibrationSession) -> None:
    quality = session.add_plane(plane(0.0))
    assert quality.valid == 1.0
    assert quality.noise == pytest.approx(SIGMA, rel=1e-6)
    assert plane_in_words(quality) == "100 % of the image measured, noise 0.0020 fringe"
    unmoved = plane(0.0, seed=1)
    with pytest.raises(CalibrationError, match="not moved"):
        session.add_plane(Plane(math.radians(5), 0.0, False, unmoved.phase, unmoved.sigma))
    session.add_plane(plane(5.0, seed=2))  # after it was turned, the calibration goes on


def test_drift_is_measured_and_said(session: CalibrationSession, tmp_path: Path) -> None:
    """The first plane is 40 µm nearer at the end, while the noise of a pixel is 22 µm."""
    for seed, angle in enumerate((0.0, -18.0, -9.0, 9.0, 18.0)):
        session.add_plane(plane(angle, seed=seed))
    session.add_plane(plane(0.0, lift=40e-6, seed=9, held_out=True))
    result = session.calibrate(NOW)
    assert result.go
    assert session.drift == pytest.approx(40e-6, rel=0.03)
    assert CalibrationWarning.DRIFT in [each.code for each in result.warnings]

    session.save(tmp_path, verdict_sentence(result))
    write_calibration_report(session.result, tmp_path / "report.html")
    words = in_force_words(tmp_path / "calibration.yaml", NOW + timedelta(hours=5))
    assert "of today, 5 hours old. GO" in words[0]
    assert any("warm up" in each for each in words)
    old = in_force_words(tmp_path / "calibration.yaml", NOW + timedelta(days=9))
    assert "9 days old" in old[0]
    assert "fringedic check" in old[1]
    check = check_rig(result.model, plane(0.0).phase, pitch=PITCH, earlier=plane(0.0, lift=90e-6).phase)
    record_check(tmp_path, check, NOW + timedelta(days=8), verdict=check_in_words(check))
    checked = in_force_words(tmp_path / "calibration.yaml", NOW + timedelta(days=9))
    assert "last checked 24 hours ago: The rig holds" in checked[1]
    assert "have moved by" in checked[1]
    assert not any("fringedic check" in words for words in checked)
    assert "the check is older" in in_force_words(tmp_path / "calibration.yaml", NOW + timedelta(days=19))[2]
    (tmp_path / "calibration_fit.yaml").unlink()
    assert "not known" in in_force_words(tmp_path / "calibration.yaml", NOW)[0]


def test_a_rig_that_stands_still_has_no_drift(session: CalibrationSession) -> None:
    for seed, angle in enumerate((0.0, -18.0, -9.0, 9.0, 18.0)):
        session.add_plane(plane(angle, seed=seed))
    session.add_plane(plane(0.0, seed=9, held_out=True))
    result = session.calibrate(NOW)
    assert session.drift < 5e-6
    warnings = [each.code for each in result.warnings]
    assert CalibrationWarning.DRIFT not in warnings
    assert CalibrationWarning.NOT_TESTED in warnings, "the first plane repeated is no test of the model"


@pytest.mark.parametrize(("reached", "known"), [(0.004, True), (0.2, False)])
def test_stage_that_reports_the_angle_that_it_reached(reached: float, known: bool, session: CalibrationSession) -> None:
    for seed, angle in enumerate((0.0, -18.0, -9.0, 9.0, 18.0)):
        session.add_plane(plane(angle, seed=seed))
    session.add_plane(plane(reached, seed=9, held_out=True))
    result = session.calibrate(NOW)
    assert math.isfinite(session.drift) == known
    assert (CalibrationWarning.DRIFT_UNKNOWN in [each.code for each in result.warnings]) != known


def test_a_repeated_plane_does_not_excuse_the_plane_that_tests(session: CalibrationSession) -> None:
    """The plane kept out deviates by 3.5 times the noise of a pixel (22 µm), the repeated one by none of it."""
    for seed, angle in enumerate((0.0, -18.0, -9.0, 9.0, 18.0)):
        session.add_plane(plane(angle, seed=seed))
    session.add_plane(plane(13.0, lift=77e-6, seed=8, held_out=True))
    session.add_plane(plane(0.0, seed=9, held_out=True))
    result = session.calibrate(NOW)
    assert result.tested
    assert (result.verdict, result.reason) == (Verdict.NO_GO, Reason.HELD_OUT_DEVIATES)


@pytest.mark.parametrize(
    ("kept", "first"), [(1, PlaneKind.SPECIMEN), *((kept, PlaneKind.PLANE) for kept in range(1, 6))]
)
def test_recorded_session_that_was_cut_off_is_refused(tmp_path: Path, kept: int, first: PlaneKind) -> None:
    """The planes are a grid on either side and four angles, the last of which is held out; the first is repeated."""
    kind = "fringedic_msgs/msg/ReferencePlane"
    store = get_typestore(Stores.ROS2_JAZZY)
    text = (Path(__file__).parents[3] / "fringedic_msgs" / "msg" / "ReferencePlane.msg").read_text()
    store.register(get_types_from_msg(text, kind))
    definition, _ = store.generate_msgdef(kind, ros_version=2)
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](0, 0), "")
    planes = [(PlaneKind.GRID, angle, False) for angle in (0.0, -0.2, 0.2)]
    planes.append((first, 0.0, False))
    planes += [(PlaneKind.PLANE, angle, angle == 0.2) for angle in (-0.3, 0.3, 0.2)]
    planes.append((PlaneKind.PLANE, 5e-5, True))
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_recorded_topic(Topic("/rig/experiment/plane", kind, definition, "ros2msg", "", ""))
        for step, (plane, angle, held_out) in enumerate(planes[: 3 + kept]):
            name, number = ("grid", step) if plane == PlaneKind.GRID else ("planes", step - 3)
            message = store.types[kind](header, plane, angle, 0.0, name, number, 3e-3, held_out, 1e-3, 0.0)
            writer.write("/rig/experiment/plane", bytes(store.serialize_cdr(message, kind)), step, step)
    reason = "'planes' ended before its last plane" if kept < 5 else "has no camera/image_raw"
    with pytest.raises(RecordingError, match=reason):
        calibrate_recording(tmp_path / "bag")
