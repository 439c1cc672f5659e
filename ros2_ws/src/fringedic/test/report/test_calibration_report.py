"""The calibration report, and images that go wrong while their frames are taken, on frames of the digital twin."""

from __future__ import annotations

import math
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.calibration import RigCalibration, calibrate_rig
from fringedic.calibration.sentences import verdict_sentence, warning_sentences
from fringedic.calibration.traceability import Traceability
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.report.calibration import write_calibration_report
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

ANGLES_DEGREE = (-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0)
SEQUENCE = fringe_sequence(800, 600, [800, 160, 40, 10], [4, 4, 4, 8])
TWIN = VirtualRig(
    VirtualRigConfiguration.from_dict(
        {
            "camera": {"columns": 160, "rows": 120, "pixel_size_um": 400.0},
            "projector": {"roll_degree": 0.7, "yaw_degree": 0.2},
            "stage": {"axis_x_mm": 1.0, "albedo": 0.9},
            "specimen": {"kind": "reference_plane"},
        }
    )
)


def frames(first_degree: float, last_degree: float, seed: int) -> np.ndarray:
    """Frames of a plane that stands at the first angle, and at the last one for the last three frames.

    Moved in the very middle of a period the frames would be those of a plane at rest halfway.
    """
    stacks = []
    for angle in (first_degree, last_degree):
        twin = TWIN.with_specimen({"kind": "reference_plane", "angle_degree": angle})
        stacks.append(np.array([twin.expose(image, 0.0, 100 * seed + i) for i, image in enumerate(SEQUENCE)]))
    still = len(SEQUENCE) - 3
    return np.concatenate([stacks[0][:still], stacks[1][still:]])


@cache
def measured(index: int) -> xr.Dataset:
    return absolute_phase(frames(ANGLES_DEGREE[index], ANGLES_DEGREE[index], index), list(SEQUENCE.patterns))


def calibrate(maps: list[xr.Dataset], **options: object) -> RigCalibration:
    return calibrate_rig(
        [np.asarray(each.phase) for each in maps],
        np.radians(ANGLES_DEGREE),
        400e-6,
        pitch=10.0,
        projector_size=(800, 600),
        sigma=[np.asarray(each.sigma) for each in maps],
        **options,
    )


def good() -> list[xr.Dataset]:
    return [measured(index) for index in range(len(ANGLES_DEGREE))]


class Words(HTMLParser):
    """Collects the text and the pictures of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words, self.pictures, self.open = [], [], []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.pictures.append(dict(attrs))
        elif tag not in ("meta", "br", "i"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag != "i":
            assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_report_says_first_what_it_means(tmp_path: Path) -> None:
    calibration = calibrate(good(), held_out=(4,), identifier="bench <2>")
    file = write_calibration_report(calibration, tmp_path / "folder" / "report.html")
    page = Words(file.read_text("utf-8"))
    assert not page.open, "every element is closed"
    text = " ".join(" ".join(page.words).split())
    assert "bench <2>" in text, "names are text, not elements"
    assert text.index(" GO ") < text.index("What to do") < text.index("Parameters")
    assert len(page.pictures) == 5
    assert all(picture["src"].startswith("data:image/png;base64,") for picture in page.pictures)
    assert all(picture["alt"] for picture in page.pictures)
    assert not re.findall(r"(?:src|href)=\"(?!data:)", file.read_text("utf-8")), "one file, nothing from elsewhere"
    for plane in calibration.planes:
        assert plane.name in text
    assert "kept out" in text
    assert f"h0 = {1e3 * calibration.model.camera_distance:.2f}" not in text, "lengths are in the drawing"
    assert "camera distance h0" in text


def test_report_states_thresholds_and_traceability(tmp_path: Path) -> None:
    calibration = calibrate(good(), held_out=(4,))
    known = Traceability(grid_pitch=2e-3, stage="rotary stage 7", sigma_angle=math.radians(0.01), operator="Ada & Bob")
    page = Words(write_calibration_report(calibration, tmp_path / "report.html", known).read_text("utf-8"))
    text = " ".join(" ".join(page.words).split())
    kept_out, noise = 1e6 * calibration.held_out, 1e6 * calibration.predicted
    limits = f"up to {noise:.3g} µm up to {3 * noise:.3g} µm"
    assert f"largest residual of planes kept out {kept_out:.3g} µm {limits}" in text
    assert "pitch of the printed grid 2 mm" in text
    assert "stage rotary stage 7" in text
    assert "standard uncertainty of an angle 0.01 degree" in text
    assert "standard uncertainty of a height not known enter it as reference_plane.sigma_height_mm" in text
    assert "operator Ada & Bob" in text
    assert f"date {calibration.created:%Y-%m-%d %H:%M} UTC" in text


def test_a_plane_that_moved_while_its_frames_were_taken_is_named(tmp_path: Path) -> None:
    maps = good()
    maps[2] = absolute_phase(frames(-5.0, -4.9, 50), list(SEQUENCE.patterns))
    calibration = calibrate(maps)
    assert not calibration.go
    assert calibration.bad_images == ("image 3 (angle -5 degree)",)
    assert "moved" in verdict_sentence(calibration)
    assert "while its frames were taken" in verdict_sentence(calibration)
    page = Words(write_calibration_report(calibration, tmp_path / "report.html").read_text("utf-8"))
    text = " ".join(" ".join(page.words).split())
    assert "NO-GO" in text
    assert "Repeat image 3 (angle -5 degree)" in text


def test_light_that_changes_is_recognised() -> None:
    maps = good()
    flickering = frames(-5.0, -5.0, 60).astype(float)
    flickering[-6:-3] *= 1.05
    maps[2] = absolute_phase(np.clip(np.rint(flickering), 0, 255).astype(np.uint8), list(SEQUENCE.patterns))
    calibration = calibrate(maps)
    ripple = [max(plane.ripple[:2]) / (2 * math.pi) for plane in calibration.planes]
    assert ripple[2] > 4 * np.median(ripple)
    assert any("image 3" in each for each in (verdict_sentence(calibration), *warning_sentences(calibration)))


def test_a_wrong_pattern_is_recognised() -> None:
    maps = good()
    twin = TWIN.with_specimen({"kind": "reference_plane", "angle_degree": -5.0})
    other = fringe_sequence(800, 600, [800, 160, 40, 12], [4, 4, 4, 8])
    wrong = np.array([twin.expose(image, 0.0, 7000 + i) for i, image in enumerate(other)])
    maps[2] = absolute_phase(wrong, list(SEQUENCE.patterns))
    calibration = calibrate(maps)
    assert not calibration.go
    assert calibration.bad_images == ("image 3 (angle -5 degree)",)
    assert "not that of the plane at any angle" in verdict_sentence(calibration)
