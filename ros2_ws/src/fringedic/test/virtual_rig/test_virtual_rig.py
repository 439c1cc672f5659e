"""Geometry of the virtual rig against formulas repeated here, and the direction of every axis."""

import math
import subprocess
import sys

import numba
import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import map_coordinates

from fringedic.errors import CrossheadRangeError, ImageError, VirtualRigError
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PRESETS = ["plate", "skin", "leather", "rigid", "plane", "sphere", "stepped"]


def rig_of(**changes):
    return VirtualRig(VirtualRigConfiguration.from_dict({"size": "tiny", **changes}))


def rotated_x(angle, v):
    return np.array([v[0], np.cos(angle) * v[1] - np.sin(angle) * v[2], np.sin(angle) * v[1] + np.cos(angle) * v[2]])


def rotated_y(angle, v):
    return np.array([np.cos(angle) * v[0] + np.sin(angle) * v[2], v[1], -np.sin(angle) * v[0] + np.cos(angle) * v[2]])


def rotated_z(angle, v):
    return np.array([np.cos(angle) * v[0] - np.sin(angle) * v[1], np.sin(angle) * v[0] + np.cos(angle) * v[1], v[2]])


def camera_sees(optics, x, y, z):
    """Return the pixel of a point: undo the tilt Rx Ry on the vector from the pin-hole, then similar triangles."""
    v = np.array([x, y, z - optics["camera_distance"]])
    v = rotated_y(-optics["camera_tilt_y"], rotated_x(-optics["camera_tilt_x"], v))
    metres_per_depth = optics["pixel_size"] / optics["camera_distance"]
    column = optics["principal_column"] + v[0] / -v[2] / metres_per_depth * optics["pixel_aspect"]
    return column, optics["principal_row"] - v[1] / -v[2] / metres_per_depth


def projector_lights(optics, x, y, z):
    """Return the projector pixel of a point: undo roll, pitch and yaw on its components right, up and backwards."""
    position = np.array(optics["projector_position"])
    forward = -position / np.sqrt((position**2).sum())
    right = np.array([-forward[2], 0.0, forward[0]]) / np.hypot(forward[0], forward[2])
    up = np.array([right[1] * forward[2] - right[2] * forward[1], right[2] * forward[0] - right[0] * forward[2], 0.0])
    up[2] = right[0] * forward[1] - right[1] * forward[0]
    v = np.array([x - position[0], y - position[1], z - position[2]])
    v = np.array([np.tensordot(axis, v, 1) for axis in (right, up, -forward)])
    yaw, pitch, roll = optics["projector_rotation"]
    v = rotated_z(-roll, rotated_x(-pitch, rotated_y(-yaw, v)))
    m, n = v[0] / -v[2], v[1] / -v[2]
    bend = 1 + optics["projector_k1"] * (m**2 + n**2)
    focal = optics["projector_focal_length"]
    return (
        optics["projector_principal_column"] + focal * bend * m,
        optics["projector_principal_row"] - focal * bend * n,
    )


@pytest.mark.parametrize("name", PRESETS)
def test_pixels_points_and_projector_pixels_agree_with_the_pin_holes(name):
    strange = {
        "camera": {"pixel_aspect": 1.02, "principal_column": 83.0, "principal_row": 57.5, "tilt_x_degree": 1.5},
        "projector": {"k1": 0.3, "principal_column": 47.0, "yaw_degree": 1.0, "pitch_degree": -2.0, "y_mm": 9.0},
    }
    rig = rig_of(preset=name, **strange)
    optics, end = rig.optics(), 0.8 * rig.maximum_position
    rows, columns = np.mgrid[: rig.shape[0], : rig.shape[1]]

    truth = rig.truth(end)
    there = np.isfinite(truth.x.values)
    own = np.abs(np.array(camera_sees(optics, truth.x.values, truth.y.values, truth.z.values)) - [columns, rows])
    moved = camera_sees(optics, *(truth[p].values + truth[d].values for p, d in ("xu", "yv", "zw")))
    seen = np.array([columns + truth.displacement_x.values, rows + truth.displacement_y.values])
    other = np.abs(np.array(moved) - seen)

    # the deformed image's own points, taken as the reference of a truth without displacement
    here = rig.truth(end, end)
    light = np.array(projector_lights(optics, here.x.values, here.y.values, here.z.values))
    projected = np.abs(light[0] - here.projector_column.values)
    projected_row = np.abs(light[1] - rig.view(end).projector_row)
    assert np.array_equal(truth.z_deformed.values, here.z.values, equal_nan=True)
    assert (here.displacement_x.values[np.isfinite(here.z.values)] == 0.0).all()

    errors = [np.nanmax(e) for e in (own, other, projected, projected_row)]
    assert max(errors) < 1e-6
    assert there.mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plate", "skin", "leather"])
def test_every_pixel_finds_its_point(name):
    """The surface of the full size on half as many columns and rows: steps from pixel to pixel twice as long."""
    full = VirtualRig.from_preset(name).configuration.camera
    half = {"columns": 640, "rows": 480, "pixel_size_um": 2 * full.pixel_size_um}
    rig = VirtualRig(VirtualRigConfiguration.from_dict({"preset": name, "camera": half}))
    truth = rig.truth(rig.maximum_position)
    optics = rig.optics()
    column, row = camera_sees(optics, truth.x.values, truth.y.values, truth.z.values)
    error = max(
        np.nanmax(np.abs(column - truth.column.values[None, :])), np.nanmax(np.abs(row - truth.row.values[:, None]))
    )
    specimen, there = rig.configuration.specimen, np.isfinite(truth.x.values)
    assert truth.sizes == {"row": 480, "column": 640}
    assert error < 1e-6
    # every pixel within the straight edges of the undeformed specimen was found
    within = (
        np.abs(optics["pixel_size"] * (truth.column - optics["principal_column"])) < specimen.half_width_mm * 0.98e-3
    )
    assert there[:, within].all()


@pytest.mark.parametrize("name", ["plate", "skin", "leather"])
def test_displaced_pixels_show_the_same_material(name):
    rig = rig_of(preset=name, size="small")
    end = 0.5 * rig.maximum_position
    truth = rig.truth(end)
    reference, deformed = rig.view(0.0), rig.view(end)
    rows, columns = np.mgrid[: rig.shape[0], : rig.shape[1]]
    place = [rows + truth.displacement_y.values, columns + truth.displacement_x.values]
    inside = truth.valid.values & (np.hypot(columns - 160, rows - 120) < 95)
    error = 0.0
    for before, after in ((reference.X, deformed.X), (reference.Y, deformed.Y)):
        found = map_coordinates(np.nan_to_num(after), place, order=5)
        error = max(error, np.abs(found - before)[inside].max())
    pixel = rig.optics()["pixel_size"]
    assert error / pixel < 1e-5  # what is left is the interpolation of the map in this test


@pytest.mark.parametrize(("axis", "sign_x", "sign_y"), [(0, 1, 0), (1, 0, -1)])
def test_translations_move_the_image_the_right_way(axis, sign_x, sign_y):
    translation = [0.0, 0.0, 0.0]
    translation[axis] = 1.0
    rig = rig_of(preset="rigid", ideal=True, specimen={"translation": translation})
    pixels = 3
    position = pixels * rig.optics()["pixel_size"]
    truth = rig.truth(position)
    np.testing.assert_allclose(truth.displacement_x, pixels * sign_x, atol=1e-8)
    np.testing.assert_allclose(truth.displacement_y, pixels * sign_y, atol=1e-8)

    white = np.full(rig.projector_shape, 250, np.uint8)
    before, after = (rig.expose(white, p, 0).astype(float) for p in (0.0, position))
    dx, dy = pixels * sign_x, pixels * sign_y
    inner = before[10:-10, 10:-10]
    right_way = np.corrcoef(inner.ravel(), after[10 + dy : -10 + dy, 10 + dx : -10 + dx].ravel())[0, 1]
    wrong_way = np.corrcoef(inner.ravel(), after[10 - dy : -10 - dy, 10 - dx : -10 - dx].ravel())[0, 1]
    assert right_way > 0.999
    assert abs(wrong_way) < 0.2


def test_rising_towards_the_camera_magnifies():
    rig = rig_of(preset="rigid", ideal=True, specimen={"translation": (0.0, 0.0, 1.0)})
    truth = rig.truth(4e-3)
    h0 = rig.optics()["camera_distance"]
    magnified = (truth.column - 79.5) * (h0 / (h0 - 4e-3) - 1.0)
    np.testing.assert_allclose(truth.displacement_x, magnified.broadcast_like(truth.x), atol=1e-8)
    np.testing.assert_allclose(truth.w, 4e-3, atol=1e-12)


def test_turning_about_z_is_counter_clockwise_in_the_image():
    rig = rig_of(
        preset="rigid",
        ideal=True,
        specimen={"translation": (0.0, 0.0, 0.0), "rotation_degree_per_mm": (0.0, 0.0, 2.0)},
    )
    truth = rig.truth(5e-3)
    angle = math.radians(10.0)
    right = truth.isel(row=60, column=150)
    np.testing.assert_allclose(right.u, right.x * (math.cos(angle) - 1) - right.y * math.sin(angle), atol=1e-12)
    np.testing.assert_allclose(right.v, right.x * math.sin(angle) + right.y * (math.cos(angle) - 1), atol=1e-12)
    assert right.displacement_y < -5  # the right side moves up


def test_light_on_an_inclined_plane_agrees_with_the_closed_form():
    changes = {}
    for angle in (0.0, 12.0):
        rig = rig_of(preset="plane", ideal=True, specimen={"angle_degree": angle})
        truth, optics = rig.truth(0.0), rig.optics()
        d, _, hp = optics["projector_position"]
        np.testing.assert_allclose(truth.z, truth.x * math.tan(math.radians(angle)), atol=1e-12)
        expected = optics["projector_focal_length"] * (truth.x * hp - truth.z * d)
        expected = expected / (d**2 + hp**2 - truth.x * d - truth.z * hp) + 0.5 * (optics["projector_width"] - 1)
        error = float(np.abs(truth.projector_column - expected).max())
        assert error < 1e-9
        changes[angle] = truth.projector_column
    change = changes[12.0] - changes[0.0]
    assert (
        change[:, 90:] < 0
    ).all()  # raised on the right: the light comes from farther right, so it falls farther left
    assert float(changes[0.0].diff("column").min()) > 0  # columns grow towards +x


def test_plate_is_in_uniform_tension():
    rig = rig_of(preset="plate", ideal=True)
    specimen = rig.configuration.specimen
    truth = rig.truth(rig.maximum_position)
    strain = rig.maximum_position / (1e-3 * specimen.gauge_length_mm)
    np.testing.assert_allclose(truth.u, -specimen.poisson * strain * truth.x, atol=1e-12, equal_nan=True)
    np.testing.assert_allclose(truth.v, strain * (truth.y + 0.05), atol=1e-12)
    assert float(np.abs(truth.w).max()) > 1e-4


def test_skin_is_stretched_by_ten_percent_and_asymmetric():
    rig = rig_of(preset="skin", ideal=True, specimen={"relief_um": 0.0})
    truth = rig.truth(rig.maximum_position)
    e_yy = np.gradient(truth.v.values, axis=0) / np.gradient(truth.y.values, axis=0)
    left, right = np.nanmean(truth.v.values[:, :60]), np.nanmean(truth.v.values[:, -60:])
    assert 0.09 < np.nanmax(e_yy) < 0.105
    assert right - left > 1e-4
    field = [float(truth[name].max() - truth[name].min()) * 1e3 for name in ("x", "y")]
    np.testing.assert_allclose(field, [13.0, 9.75], rtol=0.02)


def test_leather_moves_out_of_plane_without_stretching():
    rig = rig_of(preset="leather", size="small", ideal=True)
    truth = rig.truth(rig.maximum_position)
    before = np.stack([truth[n].values for n in "xyz"])
    after = before + np.stack([truth[n].values for n in "uvw"])
    fold = np.s_[:, 5:60, 60:280]
    lengths = [np.sqrt((np.diff(p[fold], axis=2) ** 2).sum(0)).sum(1) for p in (before, after)]
    stretch = lengths[1] / lengths[0] - 1
    rms = {n: float(np.sqrt((truth[n] ** 2).mean())) * 1e3 for n in "uvw"}
    assert np.abs(stretch).max() < 0.02
    assert rms["w"] > 1.5 * max(rms["u"], rms["v"])


def test_speckle_covers_half_of_the_plate():
    rig = rig_of(preset="plate", ideal=True, sensor={"bits": 16, "ambient_light": 1.0, "white_level": 0.4})
    image = rig.expose(np.zeros(rig.projector_shape, np.uint8), 0.0, 0) / (65535 * 0.4)
    on = np.isfinite(rig.view(0.0).X)
    floor = rig.configuration.texture.floor
    dark = (image[on] < 0.5 * (1 + floor)).mean()
    assert abs(dark - 0.5) < 0.04
    assert image[on].std() > 0.25


def test_no_other_room_is_imported():
    code = (
        "import sys, fringedic.virtual_rig\n"
        "print([m for m in sys.modules if m.startswith('fringedic.')"
        " and not m.startswith(('fringedic.virtual_rig', 'fringedic.errors', 'fringedic.wording'))])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_same_seed_same_images_on_any_number_of_threads():
    stripes = np.tile((np.arange(100) * 37 % 251).astype(np.uint8), (75, 1))
    threads = numba.get_num_threads()
    images = []
    try:
        for count in (threads, 1):
            numba.set_num_threads(count)
            rig = rig_of(preset="skin", seed=5)
            images.append(rig.expose(stripes, 3e-4, 17))
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(*images)
    assert not np.array_equal(images[0], rig.expose(stripes, 3e-4, 18))
    other = rig_of(preset="skin", seed=6)
    assert np.corrcoef(images[0].ravel(), other.expose(stripes, 3e-4, 17).ravel())[0, 1] < 0.9


def test_truth_is_saved_with_its_steps(tmp_path):
    rig = rig_of(preset="leather")
    rig.save_truth(tmp_path / "truth.nc", [0.0, 2e-3, 4e-3])
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf") as saved:
        assert saved.u.dims == ("step", "row", "column")
        assert saved.x.dims == ("row", "column")
        assert saved.u.attrs["units"] == "m"
        np.testing.assert_array_equal(saved.position, [0.0, 2e-3, 4e-3])
        np.testing.assert_allclose(saved.w[2], rig.truth(4e-3).w, atol=1e-9)


def test_entries_change_single_values_of_a_preset():
    description = {
        "preset": "skin",
        "size": "small",
        "specimen": {"device_angle_degree": -30.0},
        "sensor": {"bits": 12},
    }
    rig = VirtualRig(VirtualRigConfiguration.from_dict(description))
    assert rig.configuration.specimen.device_angle_degree == -30.0
    assert rig.configuration.texture.kind == "furrows"
    swapped = VirtualRigConfiguration.from_dict({"preset": "skin", "specimen": {"kind": "rigid", "shape": "sphere"}})
    assert swapped.specimen.kind == "rigid"


@pytest.mark.parametrize(
    ("description", "named"),
    [
        ({"preset": "paper"}, "paper"),
        ({"preset": "plate", "size": "huge"}, "huge"),
        ({"preset": "plate", "camera": {"pixel_siez_um": 50}}, "camera.pixel_siez_um"),
        ({"preset": "plate", "camera": {"distance_mm": math.nan}}, "camera.distance_mm"),
        ({"preset": "plate", "sensor": {"bits": 9}}, "sensor.bits"),
        ({"specimen": {"kind": "jelly"}}, "jelly"),
    ],
)
def test_wrong_entries_are_named(description, named):
    with pytest.raises(VirtualRigError, match=named):
        VirtualRigConfiguration.from_dict(description)


@pytest.mark.parametrize("position", [-1e-3, 2e-3, math.nan])
def test_positions_outside_the_range_are_refused(position):
    rig = rig_of(preset="plate")
    with pytest.raises(CrossheadRangeError, match="0 to 1 mm"):
        rig.truth(position)


def test_images_of_another_size_are_refused():
    rig = rig_of(preset="plate")
    with pytest.raises(ImageError, match=r"\(75, 100\)"):
        rig.expose(np.zeros((100, 75), np.uint8), 0.0, 0)
