"""Reference plane and lens of the virtual rig: place of the plate, direction of the distortion, printed grid."""

import math

import cv2
import numpy as np
import pytest

from fringedic.errors import VirtualRigError
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

BROWN = {"k1": -4.0, "k2": 30.0, "p1": 0.02, "p2": -0.03}
BUMP = {"bump_percent": (0.6, 0.0), "bump_centre_percent": (20.0, -10.0), "bump_radius_percent": 12.0}


def rig_of(**changes):
    return VirtualRig(VirtualRigConfiguration.from_dict({"preset": "reference_plane", "size": "tiny", **changes}))


def plane_at(angle, height=0.0, **changes):
    return rig_of(specimen={"angle_degree": angle, "height_mm": height}, ideal=True, **changes)


def test_a_positive_angle_raises_the_right_side():
    for angle, height in ((12.0, 0.0), (-7.0, 3.0)):
        truth = plane_at(angle, height).truth(0.0)
        slope = math.tan(math.radians(angle))
        error = float(np.abs(truth.z - (truth.x * slope + 1e-3 * height)).max())
        assert error < 1e-12
        assert float(truth.z[60, 150]) > float(truth.z[60, 10]) if angle > 0 else True


def test_the_axis_of_rotation_does_not_move():
    """The axis passes through (2, 0, 1) mm and points 3 degrees left of y and 2 degrees up."""
    stage = {"axis_x_mm": 2.0, "axis_z_mm": 1.0, "axis_yaw_degree": 3.0, "axis_pitch_degree": 2.0}
    truth = plane_at(10.0, stage=stage).truth(0.0)
    points = np.stack([truth[name].values.ravel() for name in "xyz"], axis=1)
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    normal *= np.sign(normal[2])
    yaw, pitch, angle = (math.radians(value) for value in (3.0, 2.0, 10.0))
    axis = np.array([-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    up = np.array([0.0, 0.0, 1.0])
    # Rodrigues' formula for the turn by -angle about the axis
    expected = math.cos(angle) * up - math.sin(angle) * np.cross(axis, up) + (1 - math.cos(angle)) * (axis @ up) * axis
    assert np.abs(normal - expected).max() < 1e-9
    through = np.array([2e-3, 0.0, 1e-3])
    foot_before = np.array([0.0, 0.0, -1e-3]) @ up
    assert (points.mean(axis=0) - through) @ normal == pytest.approx(foot_before, abs=1e-9), (
        "same distance from the axis"
    )


def test_the_lens_has_browns_distortion_and_a_bump_on_one_side():
    rig = rig_of(ideal=True, camera={"lens": {**BROWN, **BUMP}, "tilt_x_degree": 1.0, "principal_column": 70.0})
    column, row = rig.straight_pixels()
    optics = rig.optics()
    focal = optics["camera_distance"] / optics["pixel_size"]
    matrix = np.array([[focal, 0, 70.0], [0, focal, optics["principal_row"]], [0, 0, 1]])
    x, y = (column - 70.0) / focal, (row - optics["principal_row"]) / focal
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    brown = np.array([BROWN[name] for name in ("k1", "k2", "p1", "p2")])
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, brown)[0].reshape(*rig.shape, 2)
    centre = 79.5 + 0.2 * 160, 59.5 - 0.1 * 160
    bump = 0.6 * 1.6 * np.exp(-((seen[..., 0] - centre[0]) ** 2 + (seen[..., 1] - centre[1]) ** 2) / (2 * 19.2**2))
    rows, columns = np.mgrid[: rig.shape[0], : rig.shape[1]]
    error = max(np.abs(seen[..., 0] + bump - columns).max(), np.abs(seen[..., 1] - rows).max())
    assert error < 1e-7
    only_bump = rig_of(ideal=True, camera={"lens": BUMP}).straight_pixels()
    shift = only_bump[0] - columns
    assert shift.min() < -0.9, "the lens shows things farther right, so the straight pixel lies to the left"
    assert shift[43, 111] == pytest.approx(-0.96, abs=0.05)
    assert abs(shift[:, :30]).max() < 0.01
    assert np.abs(only_bump[1] - rows).max() < 1e-9


def test_the_truth_contains_the_lens():
    """Every pixel sees its point: the point's straight pixel is where the pin-hole alone projects it."""
    for preset in ("reference_plane", "skin", "leather"):
        rig = rig_of(preset=preset, camera={"lens": {**BROWN, **BUMP}})
        optics, position = rig.optics(), 0.7 * rig.maximum_position
        truth, here = rig.truth(position), rig.truth(position, position)
        column, row = rig.straight_pixels()
        centre, scale = np.array([0, 0, optics["camera_distance"]]), optics["camera_distance"] / optics["pixel_size"]
        for shape in (truth, here):
            v = np.stack([shape[name].values for name in "xyz"], axis=-1) - centre
            a, b = optics["camera_tilt_x"], optics["camera_tilt_y"]
            untilt_x = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
            untilt_y = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
            v = v @ (untilt_y @ untilt_x).T
            error_c = optics["principal_column"] - scale * v[..., 0] / v[..., 2] - column
            error_r = optics["principal_row"] + scale * v[..., 1] / v[..., 2] - row
            error = max(np.nanmax(np.abs(error_c)), np.nanmax(np.abs(error_r)))
            assert error < 1e-6
            assert np.isfinite(error_c).mean() > 0.9


def test_the_grid_is_printed_with_its_pitch_and_turn():
    white = np.full((150, 200), 255, np.uint8)
    entries = {"sensor": {"bits": 16, "background": 0.0}, "ideal": True, "size": "small"}
    for kind in ("lines", "cosine"):
        stage = {"grid_kind": kind, "grid_pitch_mm": 8.0, "grid_turned_degree": 3.0}
        rig = rig_of(**entries, stage=stage, specimen={"surface": "grid"})
        plain = rig.with_specimen({"kind": "reference_plane"})
        ratio = rig.expose(white, 0.0, 0).astype(float) / plain.expose(white, 0.0, 0)
        truth = rig.truth(0.0)
        # the axes of the grid in half pitches
        x, y, turn = truth.x.values * 250, truth.y.values * 250, math.radians(3.0)
        a, b = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
        amplitudes = [abs(np.mean(ratio * np.exp(-1j * np.pi * axis))) for axis in (a, b)]
        crossing = (np.abs((a + 1) % 2 - 1) < 0.1) & (np.abs((b + 1) % 2 - 1) < 0.1)
        between = (np.abs(a % 2 - 1) < 0.1) & (np.abs(b % 2 - 1) < 0.1)
        expected = 0.5 / np.pi if kind == "lines" else 0.125
        levels = ratio[crossing].mean(), ratio[between].mean()
        assert levels[0] == pytest.approx(0.05 / 0.7, abs=0.01)
        assert levels[1] == pytest.approx(1.0, abs=0.02)
        assert amplitudes == pytest.approx([expected * (1 - 0.05 / 0.7)] * 2, rel=0.02)


def test_alignments_have_their_errors():
    aligned, misaligned, distorted = (
        rig_of(alignment=name).optics() for name in ("aligned", "misaligned", "distorted")
    )
    assert aligned["projector_rotation"] == [0.0, 0.0, 0.0]
    assert misaligned["projector_rotation"][2] == pytest.approx(math.radians(0.7))
    assert misaligned["camera_tilt_x"] == pytest.approx(math.radians(0.2))
    assert (misaligned["projector_k1"], distorted["projector_k1"]) == (0.0, 0.1)
    twin = rig_of(alignment="misaligned", ideal=True)
    truth = twin.truth(0.0)
    nearest = np.unravel_index(np.argmin(np.hypot(truth.x - 1.5e-3, truth.y).values), twin.shape)
    off = abs(twin.view(0.0).projector_column[nearest] - 49.5)
    assert off < 0.5
    assert twin.configuration.sensor.read_noise_grey_level == 0.0
    with pytest.raises(VirtualRigError, match="askew"):
        rig_of(alignment="askew")
    with pytest.raises(VirtualRigError, match="jelly"):
        twin.with_specimen({"kind": "jelly"})
