"""The grey-level residual: zero for a displaced texture, and there where the texture changed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from fringedic.correlation import grey_residual
from fringedic.errors import CorrelationError

SHIFT_X, SHIFT_Y = 1.3, -0.6


def textures(spacing=1):
    """Return a texture, the same displaced and twice as bright, and its displacement."""
    wide = gaussian_filter(np.random.default_rng(4).normal(size=(120, 140)), 2.0)
    row, column = np.mgrid[10:110, 10:130].astype(float)
    reference = map_coordinates(wide, [row, column], order=5)
    deformed = 10 + 2 * map_coordinates(wide, [row - SHIFT_Y, column - SHIFT_X], order=5)
    points = reference[::spacing, ::spacing]
    return reference, deformed, np.full_like(points, SHIFT_X), np.full_like(points, SHIFT_Y)


@pytest.mark.parametrize("spacing", [1, 4])
def test_displaced_and_brighter_texture_leaves_nothing(spacing):
    reference, deformed, x, y = textures(spacing)
    residual = grey_residual(reference, deformed, x, y, spacing)
    assert residual.shape == x.shape
    margin = -(-10 // spacing)  # the interpolation continues the texture beyond the image in its own way
    inside = residual[margin:-margin, margin:-margin]
    assert np.abs(inside).max() < 0.005 * reference.std()
    wrong = grey_residual(reference, deformed, x + 1, y, spacing)
    assert np.nanstd(wrong) > 0.1 * reference.std()


def test_residual_is_where_the_texture_changed():
    reference, deformed, x, y = textures()
    deformed[46:54, 56:64] += 5 * deformed.std()
    residual = np.abs(grey_residual(reference, deformed, x, y))
    changed = np.zeros(residual.shape, bool)
    changed[40:60, 48:70] = True
    assert np.nanmin(residual[48:53, 57:61]) > 3 * reference.std()
    assert np.nanmax(residual[~changed]) < 0.5 * reference.std()


def test_unmeasured_points_and_places_outside_have_none():
    reference, deformed, x, y = textures()
    reference[20, 30] = x[40, 50] = deformed[60, 70] = np.nan
    residual = grey_residual(reference, deformed, x, y)
    missing = np.isnan(residual[1:, :-2])
    assert missing[19, 30]
    assert missing[39, 50]
    assert missing[59:61, 68:70].all(), "all points that are interpolated from the missing pixel"
    assert np.count_nonzero(missing) == 6
    assert np.isnan(residual[0]).all(), "displaced out of the image"


def test_other_shapes_are_refused():
    reference, deformed, x, y = textures()
    with pytest.raises(CorrelationError, match="do not belong together at a spacing of 2 px"):
        grey_residual(reference, deformed, x, y, 2)
    with pytest.raises(CorrelationError, match="has no texture"):
        grey_residual(reference, np.full_like(deformed, 90.0), x, y)
    with pytest.raises(CorrelationError, match="nearly no point is measured"):
        grey_residual(reference, deformed, np.full_like(x, np.nan), y)
