"""An operator places a ball before the camera, and the nodes of a rig measure it."""

from __future__ import annotations

from pathlib import Path

import pytest
from running_system import Progress

from fringedic.calibration.acceptance import AcceptanceError, Artefacts, measure_place
from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import CalibrationError
from fringedic_bringup.procedures.accept import shapes_by_nodes

RIG = """\
camera: {source: virtual}
projector: {source: virtual}
calibration: virtual_rig
sequence: {pitches_px: [100, 20, 5], shifts: 4}
virtual_rig:
  preset: plate
  size: tiny
  texture: {floor: 0.95, coverage: 0.01}
  specimen:
    {kind: rigid, shape: balls, radius_mm: 7, height_mm: 2.4, cap_degree: 70, half_width_mm: 8, half_height_mm: 8}
"""


@pytest.mark.slow
def test_nodes_measure_what_the_operator_places(tmp_path: Path) -> None:
    path = tmp_path / "ball.yaml"
    path.write_text(RIG)
    rig = load_rig_file(path)
    model = rig.rig_model
    assert model is not None
    artefacts = Artefacts(diameter=14e-3, spacing=30e-3, volume=(55e-3, 40e-3, 20e-3))
    middle, front = artefacts.places()[0], artefacts.places()[9]  # the ball stays in the middle
    asked: list[str] = []

    def ask(words: str) -> bool:
        asked.append(words)
        return True

    first, second = shapes_by_nodes(rig, tmp_path / "out", Progress(), model=model, places=[middle, front], ask=ask)
    assert asked == [
        "Place 1 of 2: ball at x +0.0, y +0.0, z +0.0 mm",
        "Place 2 of 2: ball at x +0.0, y +0.0, z +3.0 mm",
    ]
    assert abs(measure_place(middle, first, artefacts).errors[AcceptanceError.SIZE]) < 0.4e-3  # 400 µm per pixel
    with pytest.raises(CalibrationError, match="nearer to place"):
        measure_place(front, second, artefacts)
