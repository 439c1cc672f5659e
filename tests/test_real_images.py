"""A real tensile test through the nodes: photographs of a carbon-fibre plate with a hole under eleven loads."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from running_system import CONFIG, ROOT, Progress

import fringedic
from fringedic.recording.reader import BagReader
from fringedic_bringup.procedures.run import load_rig, run_experiment

DATA = Path(os.environ.get("FRINGEDIC_DATA", ROOT.parent / "shared" / "data"))
IMAGES = DATA / "open_hole_tension"


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
