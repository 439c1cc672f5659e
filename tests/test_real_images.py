"""Real images through the nodes: a carbon-fibre plate with a hole under eleven loads, and fringes on two sponges."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from running_system import CONFIG, ROOT, Progress

import fringedic
from fringedic.configuration.fringe_images import FringeImageDescription
from fringedic.frames.messages import image_array
from fringedic.images import measure_phase_images
from fringedic.recording.reader import BagReader
from fringedic_bringup.procedures.run import load_rig, run_experiment

DATA = Path(os.environ.get("FRINGEDIC_DATA", ROOT.parent / "shared" / "data"))
IMAGES = DATA / "open_hole_tension"
FRINGES = DATA / "fringes_object"
FRINGE_RIG = """
namespace: rig
virtual_rig: {{preset: plane, size: small, projector: {{columns: 1920, rows: 1080}}}}
camera: {{source: files, files: {images}}}
projector: {{source: virtual}}
sequence: {{pitches_px: [{pitch}], shifts: 3, orientation: {direction}}}
nodes:
  phase: {{relative_phase: accept, minimum_modulation_grey_level: 4.0}}
programme:
  experiment: sponges
  steps: [{{mode: fringes}}]
"""


@pytest.mark.slow
@pytest.mark.skipif(not IMAGES.is_dir(), reason=f"no real images in {IMAGES}; set FRINGEDIC_DATA")
def test_open_hole_tension_through_the_nodes(tmp_path: Path) -> None:
    """There is no ground truth: every load is measured, in most of the image, and the reference does not move."""
    path = CONFIG / "open_hole_tension.yaml"
    rig, programme = load_rig(path, None, IMAGES)
    report = run_experiment(rig, path, programme, tmp_path / "run", Progress())
    assert [step.error for step in report.steps] == [""] * 12
    assert sum(step.dropped + step.missing for step in report.steps) == 0
    topics = BagReader(tmp_path / "run" / "bag").find("camera/image_raw", "dic/displacement")
    assert BagReader(tmp_path / "run" / "bag").counts[topics["dic/displacement"]] == 12
    assert sorted(path.name for path in report.pictures) == [
        f"step_{step:03d}{kind}.png" for step in range(12) for kind in ("", "_sigma")
    ]
    with fringedic.open_experiment(report.folder / "bag") as dataset:
        for step in range(12):
            maps = dataset.sel(step=step)
            measured = np.isfinite(maps.displacement_x.values).mean()
            x, y = (float(maps[f"displacement_{axis}"].median()) for axis in "xy")
            assert np.isfinite([x, y]).all()
            assert measured > 0.6, (step, measured)
        assert float(np.abs(dataset.displacement_x.sel(step=0)).max()) == 0.0


@pytest.mark.slow
@pytest.mark.skipif(not FRINGES.is_dir(), reason=f"no real fringes in {FRINGES}; set FRINGEDIC_DATA")
@pytest.mark.parametrize(("direction", "pitch", "first"), [("vertical", 200 / 3, 0), ("horizontal", 100.0, 9)])
def test_real_fringes_through_the_nodes(tmp_path: Path, direction: str, pitch: float, first: int) -> None:
    """Camera (files), phase and recorder; only the coupling has no calibration.

    The shifts of the images run the other way: the order of the files turns them. One pitch gives a phase up to whole
    fringes; up to these it is that of the Gray code, the sign of vertical and horizontal fringes included.
    """
    images = tmp_path / "images"
    images.mkdir()
    for number, offset in enumerate((0, 2, 1)):
        (images / f"{number}.png").symlink_to(FRINGES / f"pat{first + offset:02d}.png")
    path = tmp_path / "rig.yaml"
    path.write_text(FRINGE_RIG.format(images=images, pitch=pitch, direction=direction))
    rig, programme = load_rig(path, None, None)
    report = run_experiment(rig, path, programme, tmp_path / "run", Progress())
    assert ["no calibration yet" in step.error for step in report.steps] == [True]
    assert sum(step.dropped + step.missing for step in report.steps) == 0

    reader = BagReader(tmp_path / "run" / "bag")
    topics = reader.find("camera/image_raw", "phase/map", "phase/status")
    assert reader.counts[topics["camera/image_raw"]] == 3
    messages = {topic: message for topic, message, _ in reader.messages(list(topics.values()))}
    status = messages[topics["phase/status"]]
    assert (status.error_code, status.relative) == (0, True)
    recorded = image_array(messages[topics["phase/map"]])

    description = FringeImageDescription.load(ROOT / "docs" / "examples" / f"fringes_object_{direction}.yaml")
    away = recorded / (2 * np.pi) - measure_phase_images(FRINGES, description).coordinate.values / pitch
    known = np.isfinite(away)
    assert known.mean() > 0.4
    fractions = np.abs(away - np.round(away))[known]
    assert np.median(fractions) < (1e-3 if pitch < 100 else 0.05)
