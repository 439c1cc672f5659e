"""Virtual extensometer on textures of exactly known strain: Gaussian spots that are moved, then drawn."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from fringedic.correlation.extensometer import VirtualExtensometer
from fringedic.errors import CorrelationError, ImageError

ROWS, COLUMNS = 200, 320
LEFT, RIGHT = (80, 100), (240, 100)
SPOT = 1.4  # [px]


class Speckle:
    """Spots at random places of a material that is stretched about the image's middle and shifted."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._x = rng.uniform(-60, COLUMNS + 60, 14_000)
        self._y = rng.uniform(-60, ROWS + 60, 14_000)

    def image(
        self,
        *,
        along: float = 0.0,
        across: float = 0.0,
        right: float = 0.0,
        down: float = 0.0,
        noise: int | None = None,
    ) -> np.ndarray:
        image = 40 + 35 * self._spots(along, across, right, down)
        if noise is not None:
            image += np.random.default_rng(noise).normal(size=image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    @cache  # noqa: B019, the one instance lives as long as the tests
    def _spots(self, along: float, across: float, right: float, down: float) -> np.ndarray:
        x = (self._x - COLUMNS / 2) * (1 + along) + COLUMNS / 2 + right
        y = (self._y - ROWS / 2) * (1 + across) + ROWS / 2 + down
        image = np.zeros(ROWS * COLUMNS)
        near_x, near_y = np.floor(x).astype(int), np.floor(y).astype(int)
        for step_x in range(-6, 8):
            for step_y in range(-6, 8):
                column, row = near_x + step_x, near_y + step_y
                inside = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
                distance = (column - x) ** 2 + (row - y) ** 2
                place = row[inside] * COLUMNS + column[inside]
                image += np.bincount(place, np.exp(-distance[inside] / (2 * SPOT**2)), image.size)
        return image.reshape(ROWS, COLUMNS)


@pytest.fixture(scope="module")
def speckle() -> Speckle:
    return Speckle(seed=3)


def test_tension_along_the_line_is_positive(speckle: Speckle) -> None:
    """Along +x only: strain and displacements have the right signs; lateral contraction has no effect."""
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    read = gauge.measure(speckle.image(along=0.01, across=-0.003))
    assert read.valid, read.reason
    assert read.strain == pytest.approx(0.01, abs=60e-6)
    np.testing.assert_allclose(read.displacements, [[-0.8, 0.0], [0.8, 0.0]], atol=0.01)
    across = VirtualExtensometer(speckle.image(), (160, 60), (160, 140), subset=40)
    assert across.measure(speckle.image(along=0.01, across=-0.003)).strain == pytest.approx(-0.003, abs=120e-6)


def test_scatter_agrees_with_sigma(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(noise=1), LEFT, RIGHT)
    reads = [gauge.measure(speckle.image(along=0.002, right=0.3, noise=seed)) for seed in range(2, 42)]
    scatter = np.std([read.strain for read in reads])
    # sigma includes the noise of both images; that of the reference is the same in all readings
    expected = np.median([read.sigma for read in reads]) / np.sqrt(2)
    assert 0.7 < scatter / expected < 1.3  # a standard deviation of 40 values is known to 11 %


def test_follows_a_large_motion_from_image_to_image(speckle: Speckle) -> None:
    """20 images to 8 % and 16 px: much more than could be searched in one step."""
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    for k in range(1, 21):
        strain = 0.004 * k
        read = gauge.measure(speckle.image(along=strain, right=0.8 * k, noise=k))
        assert read.valid, f"image {k}: {read.reason}"
        assert read.strain == pytest.approx(strain, abs=150e-6), f"image {k}"


def test_lost_gauge_subset_is_named_and_found_again(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    covered = speckle.image(along=0.01)
    covered[:, 180:] = np.random.default_rng(0).integers(0, 255, covered[:, 180:].shape)
    read = gauge.measure(covered)
    assert not read.valid
    assert np.isnan(read.strain)
    assert np.isnan(read.sigma)
    assert "second gauge subset is not recognised" in read.reason
    assert "first" not in read.reason
    assert not gauge.measure(np.full((ROWS, COLUMNS), 90, np.uint8)).valid
    assert gauge.measure(speckle.image(along=0.01)).strain == pytest.approx(0.01, abs=60e-6)


def test_gauge_subset_that_leaves_the_image(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    reads = [gauge.measure(speckle.image(right=-8.0 * k)) for k in range(1, 9)]
    assert "first gauge subset has left the image" in reads[-1].reason
    assert reads[0].valid


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ((20, 100), RIGHT, "first gauge subset at column 20"),
        (LEFT, (240, 190), "second gauge subset"),
        (LEFT, LEFT, "same point"),
    ],
)
def test_gauge_subsets_that_cannot_be_tracked(
    speckle: Speckle, first: tuple[int, int], second: tuple[int, int], words: str
) -> None:
    with pytest.raises(CorrelationError, match=words):
        VirtualExtensometer(speckle.image(), first, second)


def test_gauge_subset_without_texture() -> None:
    with pytest.raises(CorrelationError, match="first gauge subset"):
        VirtualExtensometer(np.full((ROWS, COLUMNS), 90, np.uint8), LEFT, RIGHT)


def test_image_of_another_size(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    with pytest.raises(ImageError, match=r"\(100, 320\)"):
        gauge.measure(speckle.image()[:100])
