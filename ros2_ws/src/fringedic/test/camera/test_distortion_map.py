"""Distortion map: signs on a lens that bends one side only, inverse, files, messages, the nearest standard model."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scipy.ndimage import gaussian_filter

from fringedic.camera import DistortionMap
from fringedic.errors import CalibrationError, GridError, ImageError
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig

WIDTH, HEIGHT = 160, 120


def one_sided() -> DistortionMap:
    """What an ideal camera sees is seen farther right, in the right half more than in the left: U along columns < 0."""
    columns = np.zeros((4, 4))
    columns[0, :3] = chebyshev.poly2cheb([-0.5, -1.0, -0.5])
    return DistortionMap(WIDTH, HEIGHT, columns, np.zeros((4, 4)))


def bent() -> DistortionMap:
    """An asymmetric field of about 1 px."""
    random = np.random.default_rng(3)
    damped = 0.6 / (1 + np.add.outer(np.arange(6), np.arange(6))) ** 2
    return DistortionMap(WIDTH, HEIGHT, random.normal(size=(6, 6)) * damped, random.normal(size=(6, 6)) * damped)


def test_signs_on_a_lens_that_pushes_to_the_right() -> None:
    lens = one_sided()
    assert lens.ideal(0.0, 60.0)[0] == pytest.approx(0.0, abs=1e-12)
    column, row = lens.ideal(159.0, 30.0)
    assert (column, row) == (pytest.approx(157.0), pytest.approx(30.0)), "seen at 159, 2 px right of its ideal place"
    column, row = lens.seen(157.0, 30.0)
    assert (column, row) == (pytest.approx(159.0), pytest.approx(30.0))


def test_undistorted_image_has_things_at_their_ideal_places() -> None:
    lens = one_sided()
    image = np.zeros((HEIGHT, WIDTH))
    image[40, 140] = 1.0
    straight = lens.undistort(gaussian_filter(image, 2.0))
    centre = np.nansum(straight * np.arange(WIDTH)) / np.nansum(straight)
    assert centre == pytest.approx(float(lens.ideal(140, 40)[0]), abs=0.02)
    ramp = np.tile(lens.ideal(np.arange(WIDTH), 0.0)[0], (HEIGHT, 1))
    straight_ramp = lens.undistort(ramp)
    inner = straight_ramp[10:-10, 10:-10] - np.arange(WIDTH)[None, 10:-10]
    assert np.abs(inner).max() < 1e-4
    assert np.isnan(straight_ramp[:, 158:]).all(), "these ideal places are outside of the image"
    assert np.isfinite(straight_ramp[:, :157]).all()
    with pytest.raises(ImageError, match="160 columns"):
        lens.undistort(np.zeros((10, 10)))


def test_seen_inverts_ideal() -> None:
    lens = bent()
    row, column = np.mgrid[:HEIGHT:7, :WIDTH:7].astype(float)
    error = np.abs(np.stack(lens.seen(*lens.ideal(column, row))) - [column, row]).max()
    assert error < 1e-9
    assert np.isnan(lens.seen(1e7, 0.0)[0])


def test_field_is_ideal_minus_seen_at_any_pixels() -> None:
    lens = bent()
    rows, columns = np.array([3.0, 50.5, 117.0]), np.array([0.0, 31.0, 90.25, 159.0])
    ideal = lens.ideal(columns[None, :], rows[:, None])
    assert np.allclose(lens.field(rows, columns), ideal - np.stack(np.broadcast_arrays(columns, rows[:, None])))
    assert lens.field(rows, columns) is lens.field(rows, columns)
    assert lens.field().shape == (2, HEIGHT, WIDTH)


def test_files_and_equality(tmp_path: Path) -> None:
    lens = bent()
    lens.save(tmp_path / "lens.yaml")
    read = DistortionMap.load(tmp_path / "lens.yaml")
    assert read == lens
    assert hash(read) == hash(lens)
    assert read != one_sided()
    (tmp_path / "lens.yaml").write_text("camera_distortion: {width_px: 5}")
    with pytest.raises(GridError, match=r"lens.yaml: height_px is missing"):
        DistortionMap.load(tmp_path / "lens.yaml")
    (tmp_path / "lens.yaml").write_text("camera: 5")
    with pytest.raises(GridError, match="contains no distortion"):
        DistortionMap.load(tmp_path / "lens.yaml")
    with pytest.raises(GridError, match="square"):
        DistortionMap(10, 10, np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(GridError, match="finite"):
        DistortionMap(10, 10, np.full((2, 2), np.nan), np.zeros((2, 2)))


@pytest.mark.parametrize("width", [float("inf"), float("nan"), 2.5, "1e9", [4], None, -4])
def test_a_size_that_is_no_number_of_pixels_is_refused(width: object) -> None:
    content = DistortionMap(4, 4, np.zeros((2, 2)), np.zeros((2, 2))).to_dict() | {"width_px": width}
    with pytest.raises(GridError, match=r"width|an image of -4 x 4 px"):
        DistortionMap.from_dict(content)


def test_brown_model_of_a_brown_lens() -> None:
    """The field of a lens that OpenCV projects through gives its coefficients back."""
    matrix = np.array([[400.0, 0, 82.0], [0, 400.0, 57.0], [0, 0, 1]])
    expected = (-0.12, 0.05, 0.002, -0.003, 0.0)
    k1, k2, p1, p2, _ = expected
    nodes = np.cos((np.arange(24) + 0.5) * np.pi / 24)
    b, a = (each.ravel() for each in np.meshgrid(nodes, nodes, indexing="ij"))
    seen = np.stack([(a + 1) * 0.5 * (WIDTH - 1), (b + 1) * 0.5 * (HEIGHT - 1)])
    normalised = (seen - matrix[:2, 2:]) / 400.0
    x, y = normalised
    for _ in range(100):
        square = x**2 + y**2
        radial = 1 + k1 * square + k2 * square**2
        x = (normalised[0] - 2 * p1 * x * y - p2 * (square + 2 * x**2)) / radial
        y = (normalised[1] - p1 * (square + 2 * y**2) - 2 * p2 * x * y) / radial
    again = cv2.projectPoints(
        np.stack([x, y, np.ones_like(x)], 1), np.zeros(3), np.zeros(3), matrix, np.array(expected)
    )
    assert np.abs(again[0][:, 0].T - seen).max() < 1e-9, "OpenCV means the same by its coefficients"
    basis = chebyshev.chebvander2d(b, a, [9, 9])
    columns, rows = (
        np.linalg.lstsq(basis, 400.0 * ideal + centre - place, rcond=None)[0].reshape(10, 10)
        for ideal, centre, place in zip((x, y), matrix[:2, 2], seen, strict=True)
    )
    model = DistortionMap(WIDTH, HEIGHT, columns, rows).brown(matrix)
    assert model.residual < 1e-6
    assert model.coefficients == pytest.approx(expected, abs=2e-4)
    assert np.allclose(model.camera_matrix, matrix, atol=1e-3)


def calibration() -> RigModel:
    rig = RigModel(**VirtualRig.from_preset("plate", size="tiny").optics())
    return dataclasses.replace(rig, camera_distortion=bent())


def test_a_rig_reconstructs_along_the_ideal_pixels_lines_of_sight() -> None:
    rig = calibration()
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    ideal = np.stack([*bent().ideal(column, row), np.ones_like(row)], axis=-1)
    direction = ideal @ rig.ray_matrix.T
    z = 0.003 * np.sin(column / 17) + 0.004 * np.cos(row / 23 + 1)
    along = (z - rig.camera_distance) / direction[..., 2]
    x, y = along * direction[..., 0], along * direction[..., 1]
    shape = rig.reconstruct(rig.phase(x, y, z, 10.0), 10.0, np.full(z.shape, 0.02))
    error = max(float(np.abs(shape[name] - true).max()) for name, true in (("x", x), ("y", y), ("z", z)))
    ignored = dataclasses.replace(rig, camera_distortion=None).reconstruct(rig.phase(x, y, z, 10.0), 10.0)
    assert error < 1e-9
    assert float(np.abs(ignored.z - z).max()) > 1e-5
    crop = rig.reconstruct(shape.z.copy(data=rig.phase(x, y, z, 10.0))[20:70, 30:90], 10.0)
    assert np.array_equal(crop.z, shape.z[20:70, 30:90])


def test_a_rig_takes_its_lens_through_files_and_messages(tmp_path: Path) -> None:
    rig = calibration()
    rig.to_yaml(tmp_path / "rig.yaml")
    assert RigModel.from_yaml(tmp_path / "rig.yaml").camera_distortion == rig.camera_distortion
    assert DistortionMap.load(tmp_path / "rig.yaml") == rig.camera_distortion
    assert RigModel.from_message(SimpleNamespace(**rig.message_fields())) == rig
    plain = dataclasses.replace(rig, camera_distortion=None)
    assert RigModel.from_message(SimpleNamespace(**plain.message_fields())) == plain, "messages of older recordings"
    broken = rig.message_fields() | {"distortion_order": 4}
    with pytest.raises(CalibrationError, match="order 4 with 36"):
        RigModel.from_message(SimpleNamespace(**broken))
    with pytest.raises(CalibrationError, match="160 x 120"):
        dataclasses.replace(rig, camera_width=80)
