"""Closure of the displacement: a z-score where the displacement is right, large where it is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter, map_coordinates

from fringedic import measure_displacement
from fringedic.correlation.closure import displacement_closure, refuted_points
from fringedic.errors import CorrelationError

MOVED = (0.4, 2.3)  # rows, columns


@pytest.fixture(scope="module", params=[1, 3])
def measured(request):
    """Two noisy images of a texture that moves, of another brightness and contrast, and the displacement."""
    generator = np.random.default_rng(11)
    texture = gaussian_filter(generator.normal(size=(240, 260)), 1.6, mode="wrap")
    texture *= 30 / texture.std()
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(texture), MOVED)).real
    first, second = (image + generator.normal(0, 1, image.shape) for image in (texture, 20 + 1.1 * moved))
    first[100:110, 60:75] = np.nan
    return first, second, measure_displacement(first, second, window=24, spacing=request.param)


def closures(images, field):
    closure = displacement_closure(*images, field)
    return np.stack([closure.closure_x.values, closure.closure_y.values])


def test_the_closure_of_a_right_displacement_is_a_z_score(measured):
    first, second, field = measured
    found = closures((first, second), field)
    known = np.isfinite(found)
    assert known.all(axis=0).sum() > 0.97 * np.isfinite(field.displacement_x.values).sum()
    assert not known[:, ~np.isfinite(field.displacement_x.values)].any()
    assert 0.8 < np.sqrt(np.mean(found[known] ** 2)) < 1.25
    assert np.mean(np.abs(found[known]) <= 3) > 0.985


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("error", [8.0, -8.0])
def test_an_error_of_eight_sigma_is_found_with_its_sign(measured, axis, error):
    first, second, field = measured
    name = f"displacement_{axis}"
    found = closures((first, second), field.assign({name: field[name] + error * field[f"sigma_{axis}"]}))
    part = found["xy".index(axis)]
    part = part[np.isfinite(part)]
    assert np.mean(np.abs(part) > 3) > 0.99
    assert np.mean(np.sign(part) == -np.sign(error)) > 0.99


def test_a_wrong_match_is_found(measured):
    """On a third of the surface: the usual noise comes from the other points."""
    first, second, field = measured
    wrong = field.column < 80
    found = closures((first, second), field.assign(displacement_x=field.displacement_x + np.float32(7) * wrong))
    checked = np.isfinite(found).all(axis=0) & wrong.values
    assert np.mean((np.abs(found) > 3).any(axis=0)[checked]) > 0.99


def test_equal_images_are_confirmed():
    """A residual of zero is perfect: rounding is not compared with itself."""
    texture = gaussian_filter(np.random.default_rng(3).normal(120, 200, (200, 220)), 1.6).astype(np.float32)
    field = measure_displacement(texture, texture.copy(), window=24, spacing=4)
    found = closures((texture, texture), field)
    assert (np.abs(found[np.isfinite(found)]) <= 3).all()


def test_a_right_displacement_is_not_refuted(measured):
    first, second, field = measured
    assert not refuted_points(displacement_closure(first, second, field), field).any()


def test_points_beside_an_occluder_are_refuted():
    """A dark band in front of a surface that is stretched by 1 % moves by 6 px; the displacement is exact elsewhere."""
    size, generator = (300, 400), np.random.default_rng(7)
    texture = 120 + 40 * gaussian_filter(generator.normal(size=(360, 460)), 1.6) * 5.7
    row, column = np.mgrid[: size[0], : size[1]].astype(float)
    images = []
    for strain, band in ((0.0, 190), (0.01, 196)):
        grey = map_coordinates(texture, [30 + row, 30 + column / (1 + strain)], order=5)
        grey[:, band : band + 18] = 25
        grey[:, band + 4 : band + 7] = 90
        images.append((grey + generator.normal(0, 1.5, size)).astype(np.float32))
    field = measure_displacement(*images, window=32, spacing=4)
    refuted = refuted_points(displacement_closure(*images, field), field)
    error = np.abs(np.stack([field.displacement_x - 0.01 * field.column, field.displacement_y]))
    wrong = (error > 5 * np.stack([field.sigma_x, field.sigma_y])).any(axis=0)
    beside = np.abs(field.column.values - 202) < 60
    assert wrong.sum() > 50
    assert (wrong & ~refuted).sum() < 0.2 * wrong.sum()
    assert not refuted[:, ~beside].any()


@pytest.mark.parametrize("slide", [2.5, 7.0])
def test_points_beside_a_seam_are_right_or_refuted(slide):
    """The part below a straight seam slides and reveals nothing; points further away than a window and a half stay."""
    size, generator = (300, 400), np.random.default_rng(5)
    texture = 120 + 40 * gaussian_filter(generator.normal(size=(300, 460)), 1.8) * 6.4
    row, column = np.mgrid[: size[0], : size[1]].astype(float)
    below = row >= 150
    images = []
    for moved in (0.0, slide):
        grey = map_coordinates(texture, [row, 30 + column - moved * below], order=5)
        images.append((grey + generator.normal(0, 1.5, size)).astype(np.float32))
    field = measure_displacement(*images, window=32, spacing=4)
    refuted = refuted_points(displacement_closure(*images, field), field)
    error = np.abs(np.stack([field.displacement_x - slide * (field.row >= 150), field.displacement_y]))
    wrong = (error > 5 * np.stack([field.sigma_x, field.sigma_y])).any(axis=0)
    apart = np.abs(field.row.values - 150) > 48
    assert wrong.sum() > 50
    assert (wrong & ~refuted).sum() <= 0.02 * wrong.sum()
    assert not refuted[apart].any()


def test_edges_of_a_turned_and_stretched_image_are_not_refuted():
    """Beyond the measured points the displacement goes on as it turns and stretches: the images agree there."""
    size, generator = (300, 400), np.random.default_rng(6)
    texture = 120 + 40 * gaussian_filter(generator.normal(size=(700, 800)), 1.8) * 6.4
    row, column = np.mgrid[: size[0], : size[1]].astype(float)
    turn = np.deg2rad(-15)
    motion = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.diag([1.1, 0.97])
    back = np.linalg.inv(motion)
    x, y = column - 200, row - 150
    places = ([row, column], [150 + back[1, 0] * x + back[1, 1] * y, 200 + back[0, 0] * x + back[0, 1] * y])
    images = [
        (map_coordinates(texture, [200 + v, 200 + u], order=5) + generator.normal(0, 1.5, size)).astype(np.float32)
        for v, u in places
    ]
    field = measure_displacement(*images, window=32, spacing=4)
    assert 0.5 < field.valid.mean() < 0.95
    assert refuted_points(displacement_closure(*images, field), field).sum() <= 2


def test_nothing_measured_is_nothing_checked(measured):
    first, second, field = measured
    found = closures((first, second), field.where(False).assign_attrs(field.attrs))
    assert found.shape[1:] == field.displacement_x.shape
    assert not np.isfinite(found).any()


def test_arrays_that_do_not_belong_together_are_refused(measured):
    first, second, field = measured
    with pytest.raises(CorrelationError, match="equal shapes"):
        displacement_closure(first[:-1], second, field)
    with pytest.raises(CorrelationError, match="result of measure_displacement"):
        displacement_closure(first, second, field.drop_attrs())
