"""The noise floor against what is known: the sensor of the twin, noise of given size, nothing that moves."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fringedic.chain import DicParameters
from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import FactsError, NoiseFloorError
from fringedic.facts import Facts, NoiseFacts
from fringedic.noise_floor import noise_of_images, static_camera
from fringedic.patterns import fringe_sequence
from fringedic.report import write_report
from fringedic.results.rows import Row, Settings
from fringedic.results.writer import DatasetWriter
from fringedic.rig_file import load_rig_file
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
    found = static_camera(frames)
    read = math.sqrt(READ**2 + 1 / 12)
    print(
        f"read {found.noise.read:.3f} (exact {read:.3f}), shot {found.noise.shot:.4f} (exact {SHOT}), "
        f"flicker {100 * found.flicker:.2f} % (exact {100 * light.std(ddof=1) / light.mean():.2f} %)"
    )
    assert found.noise.read == pytest.approx(read, rel=0.03)
    assert found.noise.shot == pytest.approx(SHOT, rel=0.05)
    assert found.flicker == pytest.approx(light.std(ddof=1) / light.mean(), rel=0.05)


def test_displacement_and_strain_of_images_at_rest(images: list[np.ndarray], tmp_path: Path) -> None:
    """Nothing moves, so that what is measured is noise; over time the reference's half of it does not show."""
    measured = noise_of_images(images, window=24, spacing=4)
    facts = measured.facts
    print(facts.spatial, facts.temporal, facts.bias, facts.predicted)
    for name in ("displacement_x_px", "displacement_y_px"):
        assert 0.003 < facts.spatial[name] < 0.05
        assert facts.spatial[name] == pytest.approx(facts.predicted[name], rel=0.15)
        assert facts.temporal[name] == pytest.approx(facts.spatial[name] / math.sqrt(2), rel=0.15)
        assert abs(facts.bias[name]) < facts.spatial[name]
    assert 1e-6 * facts.spatial["e_11_ustrain"] == pytest.approx(slope_noise(images, 24, 4), rel=0.01)
    file, picture = measured.save(tmp_path)
    assert NoiseFacts.load(file) == facts
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


def test_the_rig_file_hands_it_on_to_the_recordings(images: list[np.ndarray], tmp_path: Path) -> None:
    facts = noise_of_images(images[:3], window=24, spacing=8)
    facts.save(tmp_path / "noise")
    path = tmp_path / "rig.yaml"
    path.write_text(
        "virtual_rig: {preset: plate, size: tiny}\ncamera: {source: virtual}\n"
        "noise_floor_file: noise/noise_floor.yaml\n"
    )
    carried = Facts.from_text(load_rig_file(path).facts(path).to_text())
    assert carried.noise == facts.facts
    (tmp_path / "noise" / "noise_floor.yaml").write_text("window: 3")
    with pytest.raises(FactsError, match="no noise floor"):
        load_rig_file(path).facts(path)


def test_a_report_shows_it_where_the_run_has_no_steps_at_rest(images: list[np.ndarray], tmp_path: Path) -> None:
    noise = noise_of_images(images[:3], window=24, spacing=8).facts
    row, column = np.mgrid[:20, :30] * 1e-3
    steps = [
        {"x": column, "y": -row, "z": 0 * row, "shape_z": 0 * row, "u": load * column, "v": load * row, "w": load * row}
        | {"displacement_x": load * column, "displacement_y": load * row, "texture": 0 * row + 90}
        for load in (0.0, 1e-3)
    ]

    file = tmp_path / "sheet.nc"
    settings = Settings({"dic": DicParameters(window=32, spacing=1)}, None, {}, Facts(noise=noise))
    with DatasetWriter(file, {"experiment": "sheet", "source": "bag"}) as writer:
        for step, maps in enumerate(steps):
            float32 = {name: values.astype(np.float32) for name, values in maps.items()}
            writer.add(Row(step, 10**9 * (step + 1), "", 0, 0, 1.0, 1e-4 * step, 1.0, 0.0, float32), settings)
    page = write_report(file).read_text("utf-8")
    assert "the noise floor is not measured" not in page
    assert "From 3 steps at rest before the experiment" in page
    assert f">{noise.spatial['displacement_x_px']:.4g}</td>" in page
    assert "with a window of 24 px, the test with 32 px" in page


def test_what_tells_no_noise_floor_is_named(images: list[np.ndarray]) -> None:
    with pytest.raises(NoiseFloorError, match="at least 3"):
        noise_of_images(images[:2], window=24, spacing=8)
    with pytest.raises(NoiseFloorError, match="black or saturated"):
        static_camera([[np.full((40, 40), 255, np.uint8)] * 3])
