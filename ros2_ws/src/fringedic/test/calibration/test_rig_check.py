"""The self-test: a plate anywhere, before and after something has moved; phases come from the digital twin."""

from __future__ import annotations

import dataclasses
import math
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fringedic.calibration import CheckVerdict, check_rig
from fringedic.calibration.findings import CheckProblem, CheckWarning
from fringedic.calibration.history import CHECKS_FILE, record_check, recorded_checks
from fringedic.calibration.sentences import check_in_words, check_sentence, check_warning_sentences
from fringedic.calibration.traceability import Traceability
from fringedic.errors import CalibrationError, ImageError
from fringedic.metadata import CalibrationMetadata, Metadata
from fringedic.report.check import write_check_page
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PITCH = 10.0
NOISE = 0.0021 * 2 * math.pi
TWIN = VirtualRig(
    VirtualRigConfiguration.from_dict(
        {
            "camera": {"columns": 160, "rows": 120, "pixel_size_um": 400.0, "tilt_x_degree": 0.3},
            "projector": {"roll_degree": 0.5, "yaw_degree": 0.2, "k1": 0.1},
            "specimen": {"kind": "reference_plane"},
        }
    )
)
RIG = RigModel(**TWIN.optics())


def plate(seed: int, angle: float = 2.0, height: float = 1.0) -> np.ndarray:
    """Noisy phase of a plate with slopes along both axes [degree], [mm]."""
    specimen = {
        "kind": "rigid",
        "angle_degree": angle,
        "angle_y_degree": -1.0,
        "height_mm": height,
        "half_width_mm": 80.0,
        "half_height_mm": 60.0,
    }
    column = TWIN.with_specimen(specimen).view(0.0).projector_column
    exact = 2 * math.pi / PITCH * (column - (RIG.projector_width - 1) / 2)
    return exact + NOISE * np.random.default_rng(seed).standard_normal(exact.shape)


SIGMA = np.full(TWIN.shape, NOISE)


def test_each_plate_is_measured_with_its_own_sigma() -> None:
    """Every second column of the earlier plate was wrong, and its sigma says so; that of the last plate does not."""
    phase, sigma = plate(2), SIGMA.copy()
    phase[:, ::2] += 0.04
    sigma[:, ::2] = 1.0
    over = ("row", "column")
    earlier = xr.Dataset({"phase": (over, phase), "sigma": (over, sigma)})
    assert check_rig(RIG, plate(1), SIGMA, pitch=PITCH, earlier=earlier).drift < 3e-6
    assert check_rig(RIG, plate(1), SIGMA, pitch=PITCH, earlier=phase).drift > 6e-6


def test_a_rig_that_is_as_it_was_holds() -> None:
    check = check_rig(RIG, plate(1), SIGMA, pitch=PITCH, earlier=plate(2))
    assert check.holds
    assert check.flatness == pytest.approx(check.flatness_noise, rel=0.1)
    assert math.degrees(check.tilt_y) == pytest.approx(2.0, abs=1e-3)
    assert math.degrees(check.tilt_x) == pytest.approx(-1.0, abs=0.01)  # the twin turns about y first
    assert check.height == pytest.approx(1e-3, abs=0.2e-6)
    assert check.drift < check.noise
    assert check.verdict is CheckVerdict.HOLDS
    assert [each.code for each in check.warnings] == [CheckWarning.SCALE_NOT_CHECKED]
    assert "scale is not checked" in check_in_words(check)


@pytest.mark.parametrize(
    "moved",
    [
        {"projector_rotation": (0.003, 0.0, 0.02)},
        {"projector_position": (0.183, 0.0, 0.38)},
        {"projector_focal_length": 3450.0},
    ],
    ids=["turned", "shifted", "zoomed"],
)
def test_a_rig_that_has_moved_is_recognised(moved: dict[str, object]) -> None:
    """The plate's bending, or the known distance, tells that the rig is not the calibrated one any more."""
    wrong = dataclasses.replace(RIG, **moved)
    check = check_rig(wrong, plate(3), SIGMA, pitch=PITCH, lifted=plate(4, height=6.0), distance=_normal(5e-3))
    assert not check.holds
    assert check.verdict is CheckVerdict.FAILS
    assert "Calibrate again" in check_sentence(check)


def _normal(height: float) -> float:
    """Distance along the normal of plates that are lifted by a height along z."""
    return height / math.sqrt(1 + math.tan(math.radians(2)) ** 2 + math.tan(math.radians(1)) ** 2)


def test_known_distances() -> None:
    lifted = check_rig(RIG, plate(5), SIGMA, pitch=PITCH, lifted=plate(6, height=6.0), distance=_normal(5e-3))
    assert lifted.holds
    assert lifted.distance == pytest.approx(_normal(5e-3), abs=0.5e-6)
    truth = TWIN.with_specimen({"kind": "reference_plane"}).truth(0.0)
    ends = [np.array([float(truth[name][r, c]) for name in "xyz"]) for r, c in ((30, 20), (100, 140))]
    column = TWIN.with_specimen({"kind": "reference_plane"}).view(0.0).projector_column
    phase = 2 * math.pi / PITCH * (column - (RIG.projector_width - 1) / 2)
    apart = float(np.linalg.norm(ends[1] - ends[0]))
    marks = check_rig(RIG, phase, SIGMA, pitch=PITCH, marks=((20, 30), (140, 100)), distance=apart)
    assert marks.distance == pytest.approx(apart, abs=0.1e-6)
    wrong = check_rig(RIG, phase, SIGMA, pitch=PITCH, marks=((20, 30), (140, 100)), distance=1.5 * apart)
    assert not wrong.holds
    assert [each.code for each in wrong.problems] == [CheckProblem.SCALE]
    assert "scale" in check_sentence(wrong)


def test_page_states_distance_uncertainty_and_limits(tmp_path: Path) -> None:
    check = check_rig(RIG, plate(5), SIGMA, pitch=PITCH, lifted=plate(6, height=6.0), distance=_normal(5e-3))
    known = Traceability(grid_pitch=2e-3, sigma_height=2e-6, operator="Ada & Bob")
    when = datetime(2026, 11, 22, tzinfo=UTC)
    page = write_check_page(check, tmp_path / "check.html", rig="bench <2>", created=when, traceability=known)
    text = page.read_text("utf-8")
    assert "bench &lt;2&gt; · 2026-11-22 00:00 UTC" in text
    assert f"known distance of {1e3 * check.expected:.3f} mm" in text
    measured = re.search(r"<td class=\"number\">([\d.]+) ± ([\d.]+) mm</td>", text)
    assert measured is not None
    assert float(measured[1]) == pytest.approx(1e3 * check.distance, rel=1e-5)
    assert float(measured[2]) == pytest.approx(1e3 * check.distance_sigma, rel=0.1)
    assert "within 0.2 %" in text
    for entry in ('pitch of the printed grid</th><td class="wide">2 mm', 'of a height</th><td class="wide">0.002 mm'):
        assert entry in text
    assert "Ada &amp; Bob" in text
    assert text.count('<img alt="residual of the flat plate" src="data:image/png;base64,') == 1


def test_drift_and_age_are_said() -> None:
    check = check_rig(RIG, plate(7), SIGMA, pitch=PITCH, earlier=plate(8, height=1.05), age=90 * 86400.0)
    assert check.drift == pytest.approx(50e-6, rel=0.02)
    words = check_warning_sentences(check)
    assert any("90 days" in each for each in words)
    assert any("moved by 50 µm" in each for each in words)


def test_bad_input() -> None:
    with pytest.raises(CalibrationError, match="two marks or"):
        check_rig(RIG, plate(9), SIGMA, pitch=PITCH, distance=1e-3)
    with pytest.raises(ImageError, match="earlier"):
        check_rig(RIG, plate(9), SIGMA, pitch=PITCH, earlier=plate(9)[:-1])
    with pytest.raises(CalibrationError, match="flat plate: only 0 %"):
        check_rig(RIG, np.full(TWIN.shape, np.nan), SIGMA, pitch=PITCH)


def test_checks_are_kept_beside_the_calibration(tmp_path: Path) -> None:
    assert recorded_checks(tmp_path) == []
    good = check_rig(RIG, plate(1), SIGMA, pitch=PITCH, distance=2e-3, lifted=plate(3, height=3.0), earlier=plate(2))
    moved = dataclasses.replace(RIG, projector_rotation=(0.01, 0.0, 0.0))
    bad = check_rig(moved, plate(4), SIGMA, pitch=PITCH)
    for day, check in ((3, good), (4, bad)):
        record_check(tmp_path, check, datetime(2026, 3, day, 9, 30, tzinfo=UTC), verdict=check_in_words(check))
    first, second = recorded_checks(tmp_path)
    assert (first.holds, second.holds, first.created[:10]) == (True, False, "2026-03-03")
    assert first.distance_mm == pytest.approx(2.0, abs=0.002)
    assert first.drift_um is not None
    assert first.response_fringe is not None
    assert first.response_fringe < 5e-4
    assert second.distance_mm is None
    assert "scale is not checked" in second.verdict

    metadata = Metadata(calibration=CalibrationMetadata(verdict="GO.", checks=[first, second]))
    assert Metadata.from_text(metadata.to_text()) == metadata
    (tmp_path / CHECKS_FILE).write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(CalibrationError, match="checks"):
        recorded_checks(tmp_path)
