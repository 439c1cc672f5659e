"""Regions: their masks against the exact areas, files and text, and what the displacement makes of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fringedic.errors import ImageError
from fringedic.frames.region import Polygon, Region
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import DicParameters

SLANTED = Polygon(((20.5, 10.0), (150.0, 30.25), (120.0, 100.0), (30.0, 80.0)))
HOLE = Polygon(((60.0, 40.0), (90.0, 40.0), (90.0, 60.0), (60.0, 60.0)), hole=True)
REGION = Region((SLANTED, HOLE), 200, 120)


def signed_distances(points: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Smallest distance to the lines through the sides of a convex polygon [px], positive inside, (row, column)."""
    row, column = np.mgrid[:120, :200].astype(float)
    distances = []
    for (x0, y0), (x1, y1) in zip(points, (*points[1:], points[0]), strict=True):
        length = np.hypot(x1 - x0, y1 - y0)
        distances.append(((x1 - x0) * (row - y0) - (y1 - y0) * (column - x0)) / length)
    return np.min(distances, axis=0)


def test_mask_is_what_the_lines_enclose() -> None:
    mask = REGION.mask()
    outer, inner = signed_distances(SLANTED.points), signed_distances(HOLE.points)
    certain = (np.abs(outer) > 1) & (np.abs(inner) > 1)
    np.testing.assert_array_equal(mask[certain], ((outer > 0) & (inner < 0))[certain])
    x, y = np.array(SLANTED.points).T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) - 30 * 20
    assert mask.sum() == pytest.approx(area, rel=0.03), "half the pixels on the line are too many"


def test_points_of_a_grid_are_those_of_the_mask() -> None:
    columns, rows = np.arange(3, 200, 4), np.arange(1, 120, 7)
    np.testing.assert_array_equal(REGION.mask_at(columns, rows), REGION.mask()[np.ix_(rows, columns)])


def test_a_region_without_an_image_size_has_a_mask_for_every_image() -> None:
    region = Region.rectangle((2, 1), (5, 3))
    mask = region.mask_for((10, 8))
    assert mask[1:4, 2:6].all()
    assert mask.sum() == 12
    with pytest.raises(ImageError, match="no image size"):
        region.mask()
    with pytest.raises(ImageError, match="empty"):
        region.mask_for((1, 1))


def test_positions_beyond_any_image_are_refused() -> None:
    """OpenCV draws with 32 bits: a corner of 1e9 px would be drawn elsewhere."""
    with pytest.raises(ImageError, match=r"it has to be a number from -1000000 to 1000000"):
        Region.rectangle((0, 0), (1e9, 4))
    with pytest.raises(ImageError, match=r"it has to be a number from -1000000 to 1000000"):
        Region.from_text("{width: 8, height: 8, polygons: [{points: [[0, 0], [1000000000, 0], [4, 4]]}]}")
    with pytest.raises(ImageError, match="width: Input should be less than or equal to 32768"):
        Region.from_text("{width: 1000000000, height: 8, polygons: [{points: [[0, 0], [4, 0], [4, 4]]}]}")
    for columns in ([0, 1e12], [0, np.nan], [-4, 0]):
        with pytest.raises(ImageError, match="positions from 0 to 32768 px"):
            Region.rectangle((0, 0), (4, 4)).mask_at(columns, [0, 4])


def test_corners_alone_are_no_region() -> None:
    """Earlier versions took the corners (row, column) here: they are refused, not transposed."""
    with pytest.raises(ImageError, match=r"positions \(column, row\)"):
        Region(((0, 0), (0, 80), (80, 0)))
    with pytest.raises(ImageError, match="at least three"):
        Region.polygon([(0, 0), (1, 1)])


def test_file_and_text_are_the_same_region(tmp_path: Path) -> None:
    picture, corners = REGION.save(tmp_path / "sub" / "region.png")
    assert Region.load(corners) == REGION
    assert Region.from_text(REGION.to_text()) == REGION
    assert "\n" not in REGION.to_text()
    np.testing.assert_array_equal(cv2.imread(str(picture), cv2.IMREAD_UNCHANGED) == 255, REGION.mask())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{width: 10, height: 10, polygons: []}", "polygons"),
        ("{width: 10, height: 10, polygons: [{points: [[1, 2], [3, 4]]}]}", "points"),
        ("{width: 10, polygons: [{points: [[1, 2], [3, 4], [5, 5]]}]}", "height"),
        ("[", "no YAML"),
    ],
)
def test_what_is_no_region_is_named(text: str, words: str) -> None:
    with pytest.raises(ImageError, match=words):
        Region.from_text(text)
    with pytest.raises(ValueError, match=words):
        DicParameters(region=text)


def test_displacement_is_measured_in_the_region_alone(speckle) -> None:
    """The valid fraction is that of the region's points, however small the region is."""
    surface = speckle((120, 200), 9)
    tracker = DisplacementTracker(DicParameters(window=16, spacing=4, region=REGION.to_text()))
    tracker.step("test", 0, 1, surface.image().astype(np.float32))
    result = tracker.step("test", 1, 2, surface.image(lambda x, y: (0.3 + 0 * x, -0.2 + 0 * y)).astype(np.float32))
    measured = np.isfinite(result.displacement[..., 0])
    mask = REGION.mask()[::4, ::4]
    assert not measured[~mask].any()
    inside = cv2.distanceTransform(REGION.mask().astype(np.uint8), cv2.DIST_L2, 5)[::4, ::4] > 16
    assert inside.sum() > 40
    assert measured[inside].all(), "a window's width away from its line"
    assert result.valid_fraction == pytest.approx(measured.sum() / mask.sum())
    error = result.displacement[measured] - (0.3, -0.2)
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_another_size_is_named(speckle) -> None:
    tracker = DisplacementTracker(DicParameters(window=16, region=REGION.to_text()))
    with pytest.raises(ImageError, match="200x120"):
        tracker.step("test", 0, 1, speckle((96, 128), 9).image().astype(np.float32))
