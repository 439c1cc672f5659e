"""The grid on the tilted plane separates the tilt of the camera from that of its lens; truth by the twin's rays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fringedic.calibration.sentences import finding_sentence
from fringedic.camera.findings import GridFinding
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.tilted_grid import TiltedGrid, locate_pin_hole, measure_tilted_grid
from fringedic.errors import GridError, ImageError
from fringedic.patterns.pattern import Orientation
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PITCH = 1.0e-3
TWIN = VirtualRig(
    VirtualRigConfiguration.from_dict(
        {
            "camera": {
                "columns": 400,
                "rows": 300,
                "pixel_size_um": 136.0,
                "distance_mm": 320.0,
                "tilt_x_degree": 0.3,
                "tilt_y_degree": -0.2,
                "lens": {"k1": -0.1, "p1": 1e-3, "p2": -1.5e-3},
            },
            "specimen": {"kind": "reference_plane"},
            "stage": {
                "axis_x_mm": 1.5,
                "axis_z_mm": -0.8,
                "axis_yaw_degree": 0.4,
                "axis_pitch_degree": -0.3,
                "grid_pitch_mm": 1e3 * PITCH,
                "grid_blur_um": 100.0,
            },
        }
    )
)
OPTICS = TWIN.optics()


def picture(degrees: float) -> np.ndarray:
    """Mean of four pictures of the grid on the plane at an angle."""
    seen = TWIN.with_specimen({"kind": "reference_plane", "surface": "grid", "angle_degree": degrees})
    white = np.full(TWIN.projector_shape, 250, np.uint8)
    first = 10 * round(degrees + 90)
    return np.mean([seen.expose(white, 0.0, first + i) for i in range(4)], axis=0)


PICTURES = {degrees: picture(degrees) for degrees in (0.0, 12.0, -9.0)}


@pytest.fixture(scope="module")
def flat() -> GridMeasurement:
    return measure_distortion(PICTURES[0.0], pitch=PITCH)


@pytest.fixture(scope="module")
def tilted(flat: GridMeasurement) -> list[TiltedGrid]:
    return [measure_tilted_grid(PICTURES[degrees], flat, math.radians(degrees)) for degrees in (12.0, -9.0)]


def test_the_tilt_is_told_from_the_lens(flat: GridMeasurement, tilted: list[TiltedGrid]) -> None:
    found = locate_pin_hole(flat, tilted)
    pin_hole = found.plane.pin_hole
    assert pin_hole is not None
    seen, alone = (each.plane.camera(OPTICS["camera_distance"]) for each in (found, flat))
    true = [math.degrees(OPTICS[f"camera_tilt_{axis}"]) for axis in "xy"]
    tilts, before = ([math.degrees(each[f"camera_tilt_{axis}"]) for axis in "xy"] for each in (seen, alone))
    off = pin_hole.deviation(OPTICS["camera_distance"], OPTICS["camera_tilt_x"], OPTICS["camera_tilt_y"])
    straight = np.stack(TWIN.straight_pixels()) - np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)))
    lens, lens_before = (
        float(np.sqrt(np.mean(np.sum((each.distortion.field() - straight) ** 2, axis=0)))) for each in (found, flat)
    )
    assert np.abs(np.subtract(before, true)).max() > 0.05
    assert np.abs(np.subtract(tilts, true)).max() < 0.001
    assert abs(pin_hole.distance - OPTICS["camera_distance"]) < 50e-6
    assert np.abs(off).max() < 4
    assert lens < 0.003 < 0.03 < lens_before
    assert not found.warnings


def test_lines_of_sight_meet_the_plane_where_they_did(flat: GridMeasurement, tilted: list[TiltedGrid]) -> None:
    found = locate_pin_hole(flat, tilted)
    column, row = np.meshgrid(np.linspace(0, 399, 9), np.linspace(0, 299, 7))
    before, after = (np.stack(each.plane.on_plane(*each.distortion.ideal(column, row))) for each in (flat, found))
    # the frame may turn in its plane, by the product of two tilts
    turn = (before[1] * after[0] - before[0] * after[1]).sum() / (before**2).sum()
    moved = np.abs(after - before - turn * np.stack([before[1], -before[0]])).max()
    assert moved < 1e-10


def test_fringes_and_axis_along_the_rows(tilted: list[TiltedGrid], flat: GridMeasurement) -> None:
    """The same pictures turned by a quarter: what was right is up."""
    rotated = measure_distortion(np.rot90(PICTURES[0.0]), pitch=PITCH)
    grids = [measure_tilted_grid(np.rot90(PICTURES[angle]), rotated, math.radians(angle)) for angle in (12.0, -9.0)]
    found = locate_pin_hole(rotated, grids, orientation=Orientation.HORIZONTAL).plane.pin_hole
    upright = locate_pin_hole(flat, tilted).plane.pin_hole
    assert found is not None
    assert upright is not None
    expected = upright.distance, -upright.foot_y, upright.foot_x
    off = np.subtract((found.distance, found.foot_x, found.foot_y), expected)
    assert np.abs(off).max() < 20e-6


def test_errors_of_angles_are_what_the_sigmas_say(flat: GridMeasurement, tilted: list[TiltedGrid]) -> None:
    """Angles wrong by 0.1 degree, which the stage is said to have, move the pin-hole by about its sigma."""
    wrong = [
        TiltedGrid(each.angle + math.radians(error), each.pixels, each.grid, each.sigma, each.residual)
        for each, error in zip(tilted, (0.1, 0.07), strict=True)
    ]
    pin_hole = locate_pin_hole(flat, wrong, sigma_angle=math.radians(0.1)).plane.pin_hole
    assert pin_hole is not None
    off = pin_hole.deviation(OPTICS["camera_distance"], OPTICS["camera_tilt_x"], OPTICS["camera_tilt_y"])
    assert 0.3 < np.linalg.norm(off) < 4


def renamed(tilted: list[TiltedGrid], *degrees: float) -> list[TiltedGrid]:
    """The same pictures under other angles."""
    return [
        TiltedGrid(math.radians(angle), each.pixels, each.grid, each.sigma, each.residual)
        for each, angle in zip(tilted, degrees, strict=True)
    ]


def test_wrong_angles_are_named(flat: GridMeasurement, tilted: list[TiltedGrid]) -> None:
    with pytest.raises(GridError, match="the other way"):
        locate_pin_hole(flat, renamed(tilted, -12.0, 9.0))
    with pytest.raises(GridError, match="both sides"):
        locate_pin_hole(flat, tilted[:1])
    flat_again = measure_tilted_grid(PICTURES[0.0], flat, math.radians(12.0))
    with pytest.raises(GridError, match=r"at \+12 degree .* were at [+-]0.0:"):
        locate_pin_hole(flat, [flat_again, tilted[1]])
    with pytest.raises(GridError, match=r"as if the plane had been at \+1[12]\.\d\d and -[89]\.\d\d degree"):
        locate_pin_hole(flat, renamed(tilted, 13.0, -9.0))
    slightly = locate_pin_hole(flat, renamed(tilted, 12.1, -9.0)).warnings
    assert [each.code for each in slightly] == [GridFinding.CONTRADICTION]
    assert "sigma_angle_degree" in finding_sentence(slightly[0])
    assert "at +12.1 and -9 degree" in finding_sentence(slightly[0])


def test_another_image_size(flat: GridMeasurement) -> None:
    with pytest.raises(ImageError, match="tilted plane"):
        measure_tilted_grid(PICTURES[12.0][:, :-4], flat, 0.2)
