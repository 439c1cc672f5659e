"""Parts that move otherwise than the rest, and what has texture but no displacement."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fringedic.correlation import measure_displacement

SHAPE = (280, 360)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
MIDDLE = (180.0, 140.0)
NOISE = 12.0
SQUARE = np.ones((3, 3), np.uint8)


def turned(degrees):
    turn = np.deg2rad(degrees)

    def motion(x, y):
        u, v = x - MIDDLE[0], y - MIDDLE[1]
        return (np.cos(turn) - 1) * u - np.sin(turn) * v, np.sin(turn) * u + (np.cos(turn) - 1) * v

    return motion


def shifted(dx, dy):
    return lambda x, y: (0 * x + dx, 0 * y + dy)


def block(x, y):
    return (np.abs(x - MIDDLE[0]) < 70) & (np.abs(y - MIDDLE[1]) < 60)


def disk(x, y):
    return np.hypot(x - MIDDLE[0], y - MIDDLE[1]) < 105


@pytest.fixture(scope="module")
def surfaces(speckle):
    return speckle(SHAPE, 11, radius=1.8), speckle(SHAPE, 12, radius=1.8)


def pair(surfaces, expose, part, moved_part, motion):
    """A part of one surface in front of another one that stands still."""
    front, back = surfaces
    still = back.grey()
    reference = np.where(part(X, Y), front.grey(), still)
    deformed = np.where(moved_part(X, Y), front.grey(motion), still)
    exact = [np.where(part(X, Y), each, 0.0) for each in motion(X, Y)]
    return expose(reference, NOISE, 1), expose(deformed, NOISE, 2), exact


@pytest.mark.parametrize("shift", [(7.0, 0.0), (15.0, 0.0), (60.0, -20.0)])
def test_block_that_slides(surfaces, expose, shift):
    moved = lambda x, y: block(x - shift[0], y - shift[1])  # noqa: E731
    reference, deformed, exact = pair(surfaces, expose, block, moved, shifted(*shift))
    field = measure_displacement(reference, deformed, spacing=2)
    check_both(field, exact, block(X, Y)[::2, ::2])


@pytest.mark.parametrize("degrees", [5.0, 60.0])
def test_disk_that_turns(surfaces, expose, degrees):
    reference, deformed, exact = pair(surfaces, expose, disk, disk, turned(degrees))
    field = measure_displacement(reference, deformed, spacing=2)
    check_both(field, exact, disk(X, Y)[::2, ::2])


def check_both(field, exact, part):
    wrong = np.stack([field.displacement_x - exact[0][::2, ::2], field.displacement_y - exact[1][::2, ::2]])
    z = wrong / np.stack([field.sigma_x, field.sigma_y])
    assert field.attrs["motions"] == 2
    assert field.valid.values[part].mean() > 0.8
    assert field.valid.values[~part].mean() > 0.75  # the part covers some of it
    # a pixel at the border itself shows both
    seam = cv2.dilate(part.astype(np.uint8), SQUARE) != cv2.erode(part.astype(np.uint8), SQUARE)
    wrong[:, seam] = np.nan
    assert np.nanmax(np.abs(wrong)) < 1
    assert np.mean(np.abs(z[np.isfinite(z)]) > 6) < 2e-3


def test_another_surface_is_named(surfaces, expose, speckle):
    """Where the texture has changed there is no displacement, and its share is told."""
    still, other = surfaces[1].grey(), speckle(SHAPE, 13, radius=1.8).grey()
    field = measure_displacement(
        expose(still, NOISE, 1), expose(np.where(block(X, Y), other, still), NOISE, 2), spacing=2
    )
    share = block(X, Y).mean()
    assert field.attrs["motions"] == 1
    assert 0.6 * share < field.attrs["unmatched_fraction"] < 1.2 * share
    well_inside = block((X - MIDDLE[0]) * 1.3 + MIDDLE[0], (Y - MIDDLE[1]) * 1.3 + MIDDLE[1])[::2, ::2]
    assert not field.valid.values[well_inside].any()


def test_one_motion_says_nothing(surfaces, expose):
    still, moved = surfaces[1].grey(), surfaces[1].grey(shifted(30.2, -12.7))
    field = measure_displacement(expose(still, NOISE, 1), expose(moved, NOISE, 2), spacing=2)
    assert field.attrs.keys() == {"method", "window_px", "spacing_px"}
