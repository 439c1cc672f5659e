"""The report of a test without steps at rest shows the noise floor that was measured before."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.metadata import Metadata, NoiseFloorMetadata
from fringedic.report import write_report
from fringedic.steps.parameters import DicParameters
from fringedic.steps.recorded_parameters import StepSettings

NOISE = NoiseFloorMetadata(steps=3, window_px=24, spatial={"displacement_x_px": 0.01234})


def test_the_noise_floor_from_before_the_test_is_shown(tmp_path: Path) -> None:
    row, column = np.mgrid[:20, :30] * 1e-3
    file = tmp_path / "sheet.nc"
    settings = StepSettings({"dic": DicParameters(window=32, spacing=1)}, None, {}, Metadata(noise=NOISE))
    with DatasetWriter(file, {"experiment": "sheet", "source": "bag"}) as writer:
        for step, load in enumerate((0.0, 1e-3)):
            shape = {"x": column, "y": -row, "z": 0 * row, "shape_z": 0 * row, "texture": 0 * row + 90}
            displacement = {"u": load * column, "v": load * row, "w": load * row}
            fields = {"displacement_x": load * column, "displacement_y": load * row}
            maps = {name: values.astype(np.float32) for name, values in (shape | displacement | fields).items()}
            writer.add(Row(step, 10**9 * (step + 1), "", 0, 0, 1.0, 0.0, maps), settings)
    page = write_report(file).read_text("utf-8")
    assert "the noise floor is not measured" not in page
    assert "From 3 steps at rest before the experiment" in page
    assert ">0.01234</td>" in page
    assert "with a window of 24 px, the test with 32 px" in page
