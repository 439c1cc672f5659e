"""The noise floor against what is known: the sensor of the twin, noise of given size, nothing that moves."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import RigSetupError
from fringedic.figures.noise_floor import noise_figure
from fringedic.metadata import NoiseFloorMetadata
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig_setup.camera_noise import estimate_camera_noise
from fringedic.rig_setup.noise_floor import noise_of_images
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

READ, SHOT = 1.6, 0.03


@pytest.fixture(scope="module")
def rig() -> VirtualRig:
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "plate",
                "size": "small",
                "camera": {"columns": 240, "rows": 180, "pixel_size_um": 50.0},
                "texture": {"feature_um": 200.0},
                "sensor": {"read_noise_grey_level": READ, "shot_noise_grey_level": SHOT},
            }
        )
    )


@pytest.fixture(scope="module")
def images(rig: VirtualRig) -> list[np.ndarray]:
    white = np.full(rig.projector_shape, 250, np.uint8)
    return [rig.expose(white, 0.0, frame) for frame in range(10)]


def test_camera_noise_is_that_of_the_sensor(rig: VirtualRig) -> None:
    """Ten steps of fringes at rest, in light that flickers by 1 %."""
    rows, columns = rig.projector_shape
    light = 1 + 0.01 * np.random.default_rng(3).normal(size=10)
    frames = []
    for number, image in enumerate(fringe_sequence(columns, rows, [20.0], 4)):
        frames.append([rig.expose(image, 0.0, 4 * k + number, exposure_factor=light[k]) for k in range(10)])
    found = estimate_camera_noise(frames)
    read = math.sqrt(READ**2 + 1 / 12)
    assert found.noise.read == pytest.approx(read, rel=0.03)
    assert found.noise.shot == pytest.approx(SHOT, rel=0.05)
    assert found.flicker == pytest.approx(light.std(ddof=1) / light.mean(), rel=0.05)


def test_displacement_and_strain_of_images_at_rest(images: list[np.ndarray], tmp_path: Path) -> None:
    """Nothing moves, so that what is measured is noise; over time the reference's half of it does not show."""
    measured = noise_of_images(images, window=24, spacing=4)
    metadata = measured.metadata
    for name in ("displacement_x_px", "displacement_y_px"):
        assert 0.003 < metadata.spatial[name] < 0.05
        assert metadata.spatial[name] == pytest.approx(metadata.predicted[name], rel=0.15)
        assert metadata.temporal[name] == pytest.approx(metadata.spatial[name] / math.sqrt(2), rel=0.15)
        assert abs(metadata.bias[name]) < metadata.spatial[name]
        assert 0.9 < metadata.spatial[name] / metadata.limit[name] < 1.4
    assert 1e-6 * metadata.spatial["e_11_ustrain"] == pytest.approx(slope_noise(images, 24, 4), rel=0.01)
    file, picture = measured.save(tmp_path), tmp_path / "noise_floor.png"
    noise_figure(measured).savefig(picture)
    assert NoiseFloorMetadata.load(file) == metadata
    assert picture.stat().st_size > 10_000


def slope_noise(images: list[np.ndarray], window: int, spacing: int) -> float:
    """Scatter of the slope along columns of a plane through 5 x 5 points, by least squares at every place."""
    reference = Reference(images[0], window=window, spacing=spacing)
    row, column = np.mgrid[:5, :5] * float(spacing)
    basis = np.stack([np.ones(25), column.ravel(), row.ravel()], axis=1)
    variances = []
    for image in images[1:]:
        field = measure_displacement(reference, image).displacement_x.values.astype(float)
        blocks = np.lib.stride_tricks.sliding_window_view(field, (5, 5)).reshape(-1, 25)
        blocks = blocks[np.isfinite(blocks).all(axis=1)]
        variances.append(np.linalg.lstsq(basis, blocks.T, rcond=None)[0][1].var())
    return math.sqrt(np.mean(variances))


def test_too_few_steps_and_saturated_frames_are_refused(images: list[np.ndarray]) -> None:
    with pytest.raises(RigSetupError, match="at least 3"):
        noise_of_images(images[:2], window=24, spacing=8)
    with pytest.raises(RigSetupError, match="black or saturated"):
        estimate_camera_noise([[np.full((40, 40), 255, np.uint8)] * 3])
