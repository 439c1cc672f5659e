"""Grids and fabrics: the right repetition, or the vectors of the texture with the result."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fringedic.correlation import measure_displacement
from fringedic.correlation.lattice import find_lattice
from fringedic.correlation.pyramid import build_pyramid

SHAPE = (280, 360)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
PITCH = 12.0
TURN = 2 * np.pi
NOISE = 12.0  # [grey level] of 12 bits; the waves have a standard deviation of 500


def weave(x, y, degrees=0.0):
    turn = np.deg2rad(degrees)
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    return 2048 + 500 * (np.cos(2 * np.pi * along / PITCH) + np.cos(2 * np.pi * across / PITCH))


class Fabric:
    """A weave whose threads differ by random spots with a part of its contrast, under an affine motion."""

    def __init__(self, speckle, random, degrees=0.0):
        self.random, self.degrees = random, degrees
        self.spots = speckle(SHAPE, 5)

    def grey(self, matrix=((1, 0), (0, 1)), shift=(0.0, 0.0)):
        """The point p is at matrix p + shift."""
        back = np.linalg.inv(matrix)
        x, y = X - shift[0], Y - shift[1]
        motion = None
        if matrix != ((1, 0), (0, 1)) or shift != (0.0, 0.0):
            gradient = np.array(matrix) - np.eye(2)

            def motion(x, y):
                return tuple(gradient[i, 0] * x + gradient[i, 1] * y + shift[i] for i in range(2))

        woven = weave(back[0, 0] * x + back[0, 1] * y, back[1, 0] * x + back[1, 1] * y, self.degrees)
        return woven + self.random * 500 / 614 * (self.spots.grey(motion) - 2048)


def errors(field, x, y):
    return np.stack([field.displacement_x - x, field.displacement_y - y])


def scores(field, x, y):
    return errors(field, x, y) / np.stack([field.sigma_x, field.sigma_y])


@pytest.mark.parametrize("width", [0.0, 1.0, 3.0, 8.0])
def test_random_texture_is_not_periodic(width):
    generator = np.random.default_rng(3)
    for _ in range(10):
        noise = generator.normal(size=(480, 640)).astype(np.float32)
        assert find_lattice(build_pyramid(cv2.GaussianBlur(noise, (0, 0), width) if width else noise)) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_straight_edges_are_no_repetition(speckle, expose, seed):
    """A strip before a plain background looks the same after any shift along its edges."""
    grey = speckle((480, 1280), seed).grey()
    grey[:, :450] = grey[:, -450:] = 300
    assert find_lattice(build_pyramid((expose(grey, 31, seed).astype(np.float32) - 2048) / 500)) is None


@pytest.mark.parametrize("degrees", [0.0, 17.0, 40.0])
def test_vectors_of_a_lattice(degrees, expose):
    image = (expose(weave(X, Y, degrees), NOISE, 1).astype(np.float32) - 2048) / 500
    lattice = find_lattice(build_pyramid(image))
    turn = np.deg2rad(degrees)
    exact = PITCH * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    multiples = lattice.vectors @ np.linalg.inv(exact)
    np.testing.assert_allclose(multiples, np.rint(multiples), atol=0.003)
    assert abs(abs(np.linalg.det(multiples)) - 1) < 0.01


@pytest.mark.parametrize("shift", [(2.5, 0.0), (17.0, -8.0), (100.3, 40.2)])
def test_random_part_decides(speckle, expose, shift):
    """2 % of the contrast, hardly more than the noise, are enough; the result says nothing of repetitions."""
    fabric = Fabric(speckle, 0.02)
    field = measure_displacement(expose(fabric.grey(), NOISE, 1), expose(fabric.grey(shift=shift), NOISE, 2), spacing=4)
    z = scores(field, *shift)
    assert "repeats_px" not in field.attrs
    assert field.valid.mean() > 0.55
    assert np.nanmax(np.abs(z)) < 6
    assert 0.85 < np.sqrt(np.nanmean(z**2)) < 1.15


@pytest.mark.parametrize(
    ("matrix", "shift"),
    [
        pytest.param(((1.03, 0.01), (0.0, 0.99)), (9.0, 0.0), id="strain"),
        pytest.param(((0.9397, -0.3420), (0.3420, 0.9397)), (60.0, -50.0), id="20 degrees"),
    ],
)
def test_random_part_decides_after_strain_and_rotation(speckle, expose, matrix, shift):
    fabric = Fabric(speckle, 0.05)
    field = measure_displacement(
        expose(fabric.grey(), NOISE, 1), expose(fabric.grey(matrix, shift), NOISE, 2), spacing=4
    )
    gradient = np.array(matrix) - np.eye(2)
    x, y = X[::4, ::4], Y[::4, ::4]
    z = scores(field, *(gradient[i, 0] * x + gradient[i, 1] * y + shift[i] for i in range(2)))
    assert "repeats_px" not in field.attrs
    assert np.nanmax(np.abs(z)) < 6
    assert field.valid.mean() > 0.6


def test_random_part_decides_after_a_wave(speckle, expose):
    """The displacement of a point is compared with that of its repetition, which the wave has moved otherwise."""
    fabric = Fabric(speckle, 0.08)
    shift, wavelength = (97.0, 45.0), 240.0

    def displaced(x, y):
        return shift[0] + 3 * np.sin(TURN * (x + y) / wavelength), shift[1] + 0 * y

    x, y = X - shift[0], Y - shift[1]
    for _ in range(30):  # the material point that is displaced to each pixel
        dx, dy = displaced(x, y)
        x, y = X - dx, Y - dy
    spots = fabric.spots.grey(displaced)
    deformed = weave(x, y) + 0.08 * 500 / 614 * (spots - 2048)
    field = measure_displacement(expose(fabric.grey(), NOISE, 1), expose(deformed, NOISE, 2), spacing=4)
    z = scores(field, *displaced(X[::4, ::4], Y[::4, ::4]))
    assert "repeats_px" not in field.attrs
    assert field.valid.mean() > 0.5
    assert np.nanmax(np.abs(z)) < 6


def test_both_vectors_are_found_behind_a_bar(expose):
    """A bar lowers the autocorrelation across it."""
    grey = weave(X, Y)
    grey[100:150] = 700
    image = (expose(grey, NOISE, 1).astype(np.float32) - 2048) / 500
    assert find_lattice(build_pyramid(image)).vectors.shape == (2, 2)


def test_perfect_lattice_is_known_up_to_its_vectors(speckle, expose):
    """Without a prediction the smallest displacement, with one the closest; the vectors are told."""
    fabric = Fabric(speckle, 0.0)
    reference, deformed = expose(fabric.grey(), NOISE, 1), expose(fabric.grey(shift=(17.0, -8.0)), NOISE, 2)
    smallest = measure_displacement(reference, deformed, spacing=4)
    assert np.nanmax(np.abs(scores(smallest, 17.0 - PITCH, -8.0 + PITCH))) < 6
    np.testing.assert_allclose(np.sort(np.abs(smallest.attrs["repeats_px"])), [0, 0, PITCH, PITCH], atol=0.05)
    near = np.full(smallest.valid.shape, 16.0), np.full(smallest.valid.shape, -7.0)
    followed = measure_displacement(reference, deformed, spacing=4, initial=near)
    assert np.nanmax(np.abs(scores(followed, 17.0, -8.0))) < 6
    assert "repeats_px" in followed.attrs


def test_lattice_that_bends(expose):
    """The displacement varies by more than a period over the image: no part of it is a period off."""
    exact = 10 * np.sin(2 * np.pi * Y / 300)
    field = measure_displacement(expose(weave(X, Y), NOISE, 1), expose(weave(X - exact, Y), NOISE, 2), spacing=4)
    wrong = errors(field, exact[::4, ::4], 0)
    assert np.nanmax(np.abs(wrong - np.nanmedian(wrong, axis=(1, 2), keepdims=True))) < 1
    assert "repeats_px" in field.attrs
