"""The virtual extensometer against textures of exactly known strain: Gaussian spots that are moved, then drawn."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import PadError, ShapeMismatchError
from fringedic.extensometer import VirtualExtensometer

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
        x = (self._x - COLUMNS / 2) * (1 + along) + COLUMNS / 2 + right
        y = (self._y - ROWS / 2) * (1 + across) + ROWS / 2 + down
        image = np.zeros((ROWS, COLUMNS))
        near_x, near_y = np.floor(x).astype(int), np.floor(y).astype(int)
        for step_x in range(-6, 8):
            for step_y in range(-6, 8):
                column, row = near_x + step_x, near_y + step_y
                inside = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
                distance = (column - x) ** 2 + (row - y) ** 2
                np.add.at(image, (row[inside], column[inside]), np.exp(-distance[inside] / (2 * SPOT**2)))
        image = 40 + 35 * image
        if noise is not None:
            image += np.random.default_rng(noise).normal(size=image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def speckle() -> Speckle:
    return Speckle(seed=3)


def test_tension_along_the_line_is_positive(speckle: Speckle) -> None:
    """Along +x only: strain and displacements have their signs; contraction across does not count."""
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    read = gauge.measure(speckle.image(along=0.01, across=-0.003))
    assert read.valid, read.reason
    print(f"error {1e6 * (read.strain - 0.01):.1f} µstrain, sigma {1e6 * read.sigma:.1f} µstrain")
    assert read.strain == pytest.approx(0.01, abs=60e-6)
    np.testing.assert_allclose(read.displacements, [[-0.8, 0.0], [0.8, 0.0]], atol=0.01)
    across = VirtualExtensometer(speckle.image(), (160, 60), (160, 140), pad=40)
    assert across.measure(speckle.image(along=0.01, across=-0.003)).strain == pytest.approx(-0.003, abs=120e-6)


def test_scatter_is_what_sigma_says(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(noise=1), LEFT, RIGHT)
    reads = [gauge.measure(speckle.image(along=0.002, right=0.3, noise=seed)) for seed in range(2, 42)]
    scatter = np.std([read.strain for read in reads])
    # sigma counts the noise of both images; the reference's is the same in all reads
    expected = np.median([read.sigma for read in reads]) / np.sqrt(2)
    print(f"scatter {1e6 * scatter:.2f} µstrain, expected {1e6 * expected:.2f} µstrain")
    assert 0.7 < scatter / expected < 1.3  # a standard deviation of 40 values is known to 11 %


def test_follows_a_large_motion_from_image_to_image(speckle: Speckle) -> None:
    """20 images to 8 % and 16 px: much more than a pad could be searched in at once."""
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    for k in range(1, 21):
        strain = 0.004 * k
        read = gauge.measure(speckle.image(along=strain, right=0.8 * k, noise=k))
        assert read.valid, f"image {k}: {read.reason}"
        assert read.strain == pytest.approx(strain, abs=150e-6), f"image {k}"


def test_lost_pad_is_named_and_found_again(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    covered = speckle.image(along=0.01)
    covered[:, 180:] = np.random.default_rng(0).integers(0, 255, covered[:, 180:].shape)
    read = gauge.measure(covered)
    assert not read.valid and np.isnan(read.strain) and np.isnan(read.sigma)
    assert "second pad is not recognised" in read.reason and "first" not in read.reason
    assert not gauge.measure(np.full((ROWS, COLUMNS), 90, np.uint8)).valid
    assert gauge.measure(speckle.image(along=0.01)).strain == pytest.approx(0.01, abs=60e-6)


def test_pad_that_leaves_the_image(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    reads = [gauge.measure(speckle.image(right=-8.0 * k)) for k in range(1, 9)]
    assert "first pad has left the image" in reads[-1].reason
    assert reads[0].valid


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [((20, 100), RIGHT, "first pad at column 20"), (LEFT, (240, 190), "second pad"), (LEFT, LEFT, "same point")],
)
def test_pads_that_cannot_be_followed(
    speckle: Speckle, first: tuple[int, int], second: tuple[int, int], words: str
) -> None:
    with pytest.raises(PadError, match=words):
        VirtualExtensometer(speckle.image(), first, second)


def test_pad_without_texture() -> None:
    with pytest.raises(PadError, match="first pad"):
        VirtualExtensometer(np.full((ROWS, COLUMNS), 90, np.uint8), LEFT, RIGHT)


def test_image_of_another_size(speckle: Speckle) -> None:
    gauge = VirtualExtensometer(speckle.image(), LEFT, RIGHT)
    with pytest.raises(ShapeMismatchError, match=r"\(100, 320\)"):
        gauge.measure(speckle.image()[:100])
